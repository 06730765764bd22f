"""Sensors in a world. Oracles: distances in closed form, moments of the noise, brute force for rates and delays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Drive, Hold, Observation, Scan, Twist
from robocar.core.solids import Box
from robocar.sim.car import FitOut
from robocar.sim.sensors.accelerometer import AccelerometerParameters
from robocar.sim.sensors.channel import Channel
from robocar.sim.sensors.compass import CompassParameters
from robocar.sim.sensors.encoder import EncoderParameters
from robocar.sim.sensors.lidar import LidarParameters
from robocar.sim.sensors.parameters import SensorParameters
from robocar.sim.sensors.psd import PsdParameters
from robocar.sim.sensors.sonar import SonarParameters, cone_rays
from robocar.sim.simulation import Simulation
from tests.sim.rooms import IDENTICAL_CARS, drive, room

EXACT = SensorParameters(
    sonar=SonarParameters(range_std=0.0, relative_std=0.0, dropout=0.0),
    lidar=LidarParameters(range_std=0.0, dropout=0.0),
    psd=PsdParameters(relative_std=0.0),
    compass=CompassParameters(std=0.0, resolution=0.0),
    accelerometer=AccelerometerParameters(std=0.0),
)
HALF_CONE = math.radians(7.5)
MAX_INCIDENCE = math.radians(60.0)
FRONT_LEFT, FRONT_RIGHT = SE2(0.10, 0.05), SE2(0.10, -0.05)  # robocar.xml
TILT = 0.002  # [m] the car sinks and nods a little on its tyres


def observe(simulation: Simulation, pose: SE2) -> tuple[Observation, SE2]:
    """What the car senses a tick after it was put somewhere, and where it is then."""
    simulation.kidnap(pose)
    simulation.act(Hold())
    return simulation.sense(), simulation.ground_truth().pose


def heard(observation: Observation, name: str) -> float:
    (scan,) = (scan for scan in observation.sonars if scan.name == name)
    return float(scan.ranges[0])


# -- rates and delays --------------------------------------------------------------------------------------------------


def hand_outs(period: int, delay: int, tick: int, ticks: int) -> list[tuple[int, int]]:
    """Brute force in whole milliseconds: (time handed out, time taken) of a channel polled at every tick."""
    taken, expected, k = [], [], 0
    for now in range(0, ticks * tick, tick):
        if now >= k * period:
            taken.append(now)
            while k * period <= now:
                k += 1
        arrived = [t for t in taken if t + delay <= now]
        new = [t for t in arrived if t + delay > now - tick or now == 0]
        if new:
            expected.append((now, new[-1]))
    return expected


def polled(period: int, delay: int, tick: int, ticks: int) -> list[tuple[int, int]]:
    channel = Channel(period / 1000, delay / 1000, lambda time: round(1000 * time))
    time, found = 0.0, []
    for i in range(ticks):
        value = channel.poll(time)
        if value is not None:
            found.append((i * tick, value))
        time += tick / 1000  # as the physics does: rounding errors add up
    return found


@given(
    period=st.integers(1, 400),
    delay=st.integers(0, 700),
    tick=st.sampled_from([5, 10, 20, 50]),
)
def test_channels_take_when_due_and_hand_out_after_the_delay(period: int, delay: int, tick: int) -> None:
    """Also with periods that are no multiple of the tick, and delays longer than the period."""
    assert polled(period, delay, tick, 200) == hand_outs(period, delay, tick, 200)


def test_channels_by_hand() -> None:
    assert polled(100, 0, 50, 6) == [(0, 0), (100, 100), (200, 200)]
    assert polled(70, 0, 50, 8) == [(0, 0), (100, 100), (150, 150), (250, 250), (300, 300), (350, 350)]
    assert polled(50, 120, 50, 6) == [(150, 0), (200, 50), (250, 100)]
    assert polled(20, 0, 50, 3) == [(0, 0), (50, 50), (100, 100)]


def test_a_period_of_zero_is_every_tick() -> None:
    channel = Channel(0.0, 0.0, lambda time: time)
    assert [channel.poll(0.05 * i) for i in range(4)] == [0.05 * i for i in range(4)]


def test_after_hours_the_rate_still_holds() -> None:
    channel = Channel(0.1, 0.0, lambda time: time)
    taken = [i for i in range(200_000) if channel.poll(i * 0.05) is not None]
    assert taken == list(range(0, 200_000, 2))


def test_readings_carry_the_time_when_they_were_taken() -> None:
    """In the simulation: lidar every 100 ms, 120 ms late; the sonar at once."""
    sensors = replace(EXACT, lidar=replace(EXACT.lidar, delay=0.12))
    observations = drive(room(fit_out=FitOut(lidar="scan360"), sensors=sensors), Hold(), 1.0)
    scans = [(o.time, o.lidar.time) for o in observations if o.lidar is not None]
    assert scans == [pytest.approx((0.15 + 0.1 * i, 0.1 * i)) for i in range(9)]
    assert [scan.time for o in observations for scan in o.sonars] == [o.time for o in observations for _ in range(2)]


def test_delayed_readings_are_of_the_past() -> None:
    """A car that backs away from a wall: the late reading is the distance of then."""
    simulation = room(12, 8, start=SE2(10.9, 4), sensors=replace(EXACT, sonar=replace(EXACT.sonar, delay=0.5)))
    distance = {}
    compared = 0
    for _ in range(60):
        observation = simulation.sense()
        distance[round(simulation.time, 3)] = 12 - 0.10 - simulation.ground_truth().pose.x
        for scan in observation.sonars:
            assert observation.time - scan.time == pytest.approx(0.5)
            assert scan.ranges[0] == pytest.approx(distance[round(scan.time, 3)], abs=TILT)
            compared += 1
        simulation.act(Drive(Twist(-0.2, 0.0)))
    assert compared == 2 * 50
    assert max(distance.values()) - min(distance.values()) > 0.4


# -- sonar -------------------------------------------------------------------------------------------------------------

HALL = (24.0, 24.0)  # larger than any range in its middle


@pytest.fixture(scope="module")
def hall() -> Simulation:
    """One hall with exact sensors for all static distances: the car is put where it is wanted."""
    return room(*HALL, fit_out=FitOut("front+sides", "scan360"), sensors=EXACT)


@settings(deadline=None, max_examples=40)
@given(distance=st.floats(0.05, 4.9), sign=st.sampled_from([-1, 1]))
def test_sonar_perpendicular_to_a_wall(hall: Simulation, distance: float, sign: int) -> None:
    """All four sonars in turn, at both walls."""
    x = 12 + sign * (12 - 0.10 - distance)
    observation, pose = observe(hall, SE2(x, 12.0, 0.0 if sign > 0 else math.pi))
    expected = 12 - abs(pose.x - 12) - 0.10
    assert heard(observation, "front_left") == pytest.approx(expected, abs=TILT)
    assert heard(observation, "front_right") == pytest.approx(expected, abs=TILT)
    observation, pose = observe(hall, SE2(12 + sign * (12 - 0.10 - distance), 12.0, -math.pi / 2))
    expected = 12 - abs(pose.x - 12) - 0.09
    assert heard(observation, "left" if sign > 0 else "right") == pytest.approx(expected, abs=TILT)


@settings(deadline=None, max_examples=60)
@given(angle=st.floats(-85.0, 85.0).map(math.radians), distance=st.floats(0.3, 2.3))
def test_sonar_at_an_oblique_wall(hall: Simulation, angle: float, distance: float) -> None:
    """A plane at perpendicular distance D, its normal `angle` off the axis: the nearest point of the cone.

    D where the normal lies in the cone, else D / cos(angle - half cone) at the cone's edge, lost where even that ray meets
    the wall at more than the largest angle of incidence. Close to the limits either is right.
    """
    grazing = abs(angle) - HALF_CONE
    assume(abs(grazing - MAX_INCIDENCE) > math.radians(0.2))
    heading = SE2(theta=angle)
    mount = heading @ FRONT_LEFT
    observation, pose = observe(hall, SE2(24 - distance - mount.x, 12.0, angle))
    sonar = pose @ FRONT_LEFT
    nearest = 24 - sonar.x
    angle = abs(sonar.theta)
    if angle - HALF_CONE > MAX_INCIDENCE:
        expected = math.inf
    else:
        expected = nearest / math.cos(max(angle - HALF_CONE, 0.0))
        expected = expected if expected <= 5.0 else math.inf
    assume(not 4.98 < nearest / max(math.cos(max(angle - HALF_CONE, 0.0)), 1e-3) < 5.02)
    assert heard(observation, "front_left") == pytest.approx(expected, rel=0.002, abs=TILT)


@pytest.mark.parametrize(("angle", "lost"), [(66.0, False), (67.2, False), (67.8, True), (80.0, True)])
def test_echoes_at_grazing_incidence_are_lost(hall: Simulation, angle: float, lost: bool) -> None:
    """60 degrees from the normal at the edge of the 15 degree cone: at 67.5 degrees between axis and normal."""
    observation, _ = observe(hall, SE2(23.0, 12.0, math.radians(angle)))
    assert math.isinf(heard(observation, "front_left")) == lost


def test_nothing_in_range_is_infinite(hall: Simulation) -> None:
    observation, _ = observe(hall, SE2(12.0, 12.0, 0.3))
    assert [float(scan.ranges[0]) for scan in observation.sonars] == [math.inf] * 4
    observation, _ = observe(hall, SE2(24 - 0.10 - 5.05, 12.0))
    assert math.isinf(heard(observation, "front_left"))
    observation, _ = observe(hall, SE2(24 - 0.10 - 4.95, 12.0))
    assert heard(observation, "front_left") == pytest.approx(4.95, abs=TILT)


@pytest.mark.parametrize(("offset", "seen"), [(0.0, True), (6.0, True), (-6.0, True), (9.5, False), (-9.5, False)])
def test_the_cone_is_fifteen_degrees_wide(offset: float, seen: bool) -> None:
    """A thin post two metres away, `offset` degrees beside the axis of the left sonar, its face towards the car."""
    direction = SE2(theta=math.radians(offset))
    post = SE2(12.0, 12.0) @ FRONT_LEFT @ direction @ SE2(2.0)
    observation = room(*HALL, sensors=EXACT, solids=[Box((0.04, 0.04, 0.3), post)]).sense()
    assert heard(observation, "front_left") == (pytest.approx(1.98, abs=0.005) if seen else math.inf)


def test_the_first_echo_counts() -> None:
    """A post before a wall."""
    post = Box((0.04, 0.04, 0.3), SE2(4.0, 4.0) @ FRONT_RIGHT @ SE2(1.0, 0.05))
    observation = room(sensors=EXACT, solids=[post]).sense()
    assert heard(observation, "front_right") == pytest.approx(0.98, abs=0.005)
    assert heard(observation, "front_left") == pytest.approx(0.98, abs=0.01)  # 5 cm off its axis to the other side


def test_what_passes_above_or_below_the_cone_is_not_heard() -> None:
    """A kerb of 3 cm close to the car is below a cone that starts at 10 cm."""
    kerb = Box((0.05, 1.0, 0.03), SE2(4.35, 4.0))
    assert heard(room(*HALL, start=SE2(4, 4), sensors=EXACT, solids=[kerb]).sense(), "front_left") == math.inf
    step = replace(kerb, size=(0.05, 1.0, 0.12))
    observation = room(*HALL, start=SE2(4, 4), sensors=EXACT, solids=[step]).sense()
    assert heard(observation, "front_left") == pytest.approx(4.325 - 4.10, abs=TILT)


def test_the_rays_fill_the_cone_and_stay_inside() -> None:
    rays = cone_rays(math.radians(15))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
    off_axis = np.arccos(rays[:, 0])
    assert off_axis.max() == pytest.approx(HALF_CONE)
    assert off_axis.min() == 0.0
    level = np.sort(np.arctan2(rays[:, 1], rays[:, 0])[np.abs(rays[:, 2]) < 1e-12])
    assert np.degrees(np.diff(level)).max() < 2.0
    assert (level[0], level[-1]) == pytest.approx((-HALF_CONE, HALF_CONE))


def readings(simulation: Simulation, count: int) -> np.ndarray:
    """`count` readings of the left front sonar of a parked car."""
    scans: list[Scan] = []
    while len(scans) < count:
        scans += [scan for scan in simulation.sense().sonars if scan.name == "front_left"]
        simulation.act(Hold())
    return np.array([float(scan.ranges[0]) for scan in scans])


@pytest.mark.parametrize("distance", [0.5, 3.0])
def test_sonar_noise_has_the_moments_it_is_given(distance: float) -> None:
    """Normal noise of hypot(4 mm, 0.3 % of the range): mean and standard deviation of 600 readings within five sigma."""
    simulation = room(start=SE2(8 - 0.10 - distance, 4), sensors=SensorParameters(sonar=SonarParameters(dropout=0.0)))
    found = readings(simulation, 600)
    std = math.hypot(0.004, 0.003 * distance)
    assert found.mean() == pytest.approx(distance, abs=5 * std / math.sqrt(600) + TILT)
    assert found.std() == pytest.approx(std, rel=5 / math.sqrt(2 * 600))


def test_sonar_drop_outs_have_their_share() -> None:
    """Binomial: five sigma."""
    simulation = room(sensors=SensorParameters(sonar=SonarParameters(dropout=0.2)))
    lost = np.isnan(readings(simulation, 600))
    assert lost.mean() == pytest.approx(0.2, abs=5 * math.sqrt(0.2 * 0.8 / 600))


def test_noise_never_brings_readings_out_of_range() -> None:
    near = room(start=SE2(8 - 0.10 - 0.03, 4), sensors=SensorParameters(sonar=SonarParameters(dropout=0.0, range_std=0.05)))
    found = readings(near, 200)
    assert found.min() == 0.02
    far = room(
        *HALL, start=SE2(24 - 0.10 - 4.99, 12), sensors=SensorParameters(sonar=SonarParameters(dropout=0.0, range_std=0.05))
    )
    found = readings(far, 200)
    assert found[np.isfinite(found)].max() <= 5.0
    assert 0.2 < np.isinf(found).mean() < 0.8


# -- laser -------------------------------------------------------------------------------------------------------------


def box_room(x: float, y: float, angles: np.ndarray, width: float, depth: float) -> np.ndarray:
    """Closed form: from a point inside of a rectangle to its sides along directions."""
    with np.errstate(divide="ignore"):
        to_x = np.where(np.cos(angles) > 0, width - x, -x) / np.cos(angles)
        to_y = np.where(np.sin(angles) > 0, depth - y, -y) / np.sin(angles)
    return np.minimum(to_x, to_y)


@pytest.mark.parametrize(("lidar", "reach"), [("hokuyo", 5.6), ("scan360", 6.0)])
@pytest.mark.parametrize("start", [SE2(2.0, 1.5, 0.4), SE2(0.5, 7.0, -2.5), SE2(7.2, 3.3, 1.9)])
def test_laser_in_a_room(lidar: Any, reach: float, start: SE2) -> None:
    simulation = room(10, 8, start=start, fit_out=FitOut(lidar=lidar), sensors=EXACT)
    scan = simulation.sense().lidar
    assert scan is not None
    laser = simulation.ground_truth().pose @ scan.robot_from_sensor
    expected = box_room(laser.x, laser.y, laser.theta + scan.bearings, 10, 8)
    clear = np.abs(expected - reach) > 0.01
    assert clear.mean() > 0.9
    np.testing.assert_allclose(scan.ranges[clear], np.where(expected <= reach, expected, np.inf)[clear], atol=0.003)
    assert np.isinf(scan.ranges).any()
    assert scan.max_range == reach
    assert scan.beam_width == 0.0


def test_laser_noise_has_the_moments_it_is_given() -> None:
    """1 cm, and a share of lost beams: five sigma over ten scans."""
    sensors = SensorParameters(lidar=LidarParameters(dropout=0.05))
    simulation = room(4, 4, start=SE2(2, 2, 0.3), fit_out=FitOut(lidar="scan360"), sensors=sensors)
    residuals = []
    for observation in drive(simulation, Hold(), 1.0):
        if observation.lidar is not None:
            laser = SE2(2, 2, 0.3) @ observation.lidar.robot_from_sensor
            residuals.append(
                observation.lidar.ranges - box_room(laser.x, laser.y, laser.theta + observation.lidar.bearings, 4, 4)
            )
    found = np.concatenate(residuals)
    assert len(found) == 10 * 360
    lost = np.isnan(found)
    kept = found[~lost]
    assert lost.mean() == pytest.approx(0.05, abs=5 * math.sqrt(0.05 * 0.95 / 3600))
    assert kept.mean() == pytest.approx(0.0, abs=5 * 0.01 / math.sqrt(len(kept)) + TILT)
    assert kept.std() == pytest.approx(0.01, rel=5 / math.sqrt(2 * len(kept)) + 0.02)
    assert not np.array_equal(residuals[0], residuals[1], equal_nan=True)


# -- the small ones ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "inside"), [(0.05, False), (0.12, True), (0.5, True), (0.78, True), (0.85, False), (3.0, False)]
)
def test_psd_measures_from_10_to_80_cm(hall: Simulation, distance: float, inside: bool) -> None:
    """Thesis, Table 1.1."""
    observation, pose = observe(hall, SE2(24 - 0.10 - distance, 12.0))
    assert observation.psd is not None
    expected = 24 - 0.10 - pose.x if inside else math.nan
    assert observation.psd.value == pytest.approx(expected, abs=TILT, nan_ok=True)


def test_psd_noise_has_the_moments_it_is_given() -> None:
    simulation = room(start=SE2(8 - 0.10 - 0.4, 4))
    found = np.array([o.psd.value for o in drive(simulation, Hold(), 25.0) if o.psd is not None])
    assert len(found) == 500
    assert found.mean() == pytest.approx(0.4, abs=5 * 0.02 * 0.4 / math.sqrt(500) + TILT)
    assert found.std() == pytest.approx(0.02 * 0.4, rel=5 / math.sqrt(2 * 500))


def test_encoders_count_whole_pulses_of_the_true_angle() -> None:
    """200 pulses a turn (thesis, section 3.5): the angle since the start, rounded down to 1.8 degrees."""
    simulation = room(seed=2)
    wheels = [simulation.data.joint(f"robocar/rear_{side}_wheel") for side in ("left", "right")]
    zero = [float(wheel.qpos[0]) for wheel in wheels]
    pulse = math.radians(1.8)
    counts, true = [], []
    for tick in range(100):
        reading = simulation.sense().wheel_angles
        assert reading is not None
        assert reading.time == simulation.time
        counts.append([reading.value.left / pulse, reading.value.right / pulse])
        true.append([(float(wheel.qpos[0]) - start) / pulse for wheel, start in zip(wheels, zero, strict=True)])
        simulation.act(Drive(Twist(0.3, 0.5) if tick < 50 else Twist(-0.2, 1.0)))
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    np.testing.assert_array_equal(np.round(counts), np.floor(true))
    assert np.abs(counts).max() > 100


def test_encoders_may_be_slower_than_the_loop() -> None:
    simulation = room(sensors=SensorParameters(encoder=EncoderParameters(period=0.2)))
    taken = [o.time for o in drive(simulation, Hold(), 1.0) if o.wheel_angles is not None]
    assert taken == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])


def test_compass_noise_and_resolution() -> None:
    """0.4 degrees of normal noise, then rounded to 0.1 degrees (which adds 0.1 / sqrt(12))."""
    simulation = room(start=SE2(4, 4, 1.0), fit_out=FitOut(compass=True))
    found = np.degrees([o.compass.value for o in drive(simulation, Hold(), 25.0) if o.compass is not None])
    std = math.hypot(0.4, 0.1 / math.sqrt(12))
    assert len(found) == 500
    np.testing.assert_allclose(found / 0.1, np.round(found / 0.1), atol=1e-6)
    assert found.mean() == pytest.approx(math.degrees(1.0), abs=5 * std / math.sqrt(500))
    assert found.std() == pytest.approx(std, rel=5 / math.sqrt(2 * 500))


def test_compass_readings_near_the_back_direction_stay_in_the_half_open_circle() -> None:
    simulation = room(start=SE2(4, 4, math.pi), fit_out=FitOut(compass=True))
    found = np.array([o.compass.value for o in drive(simulation, Hold(), 5.0) if o.compass is not None])
    assert np.all((found > -math.pi) & (found <= math.pi))
    assert found.min() < 0 < found.max()
    assert np.abs(found).min() > math.radians(177)


@settings(deadline=None, max_examples=20)
@given(heading=st.floats(-math.pi, math.pi))
def test_an_exact_compass_gives_the_heading(heading: float) -> None:
    simulation = room(2, 2, start=SE2(1, 1, heading), fit_out=FitOut(compass=True), sensors=EXACT)
    reading = simulation.sense().compass
    assert reading is not None
    assert math.remainder(reading.value - simulation.ground_truth().pose.theta, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert math.remainder(reading.value - heading, math.tau) == pytest.approx(0.0, abs=1e-3)  # it sinks into its tyres askew


def accelerations(observations: Sequence[Observation]) -> np.ndarray:
    """(n, 2) [m/s^2]"""
    return np.array([o.acceleration.value for o in observations if o.acceleration is not None])


def test_the_accelerometer_feels_no_gravity_at_rest() -> None:
    """Two axes in the floor's plane; its noise has the standard deviation it is given."""
    parked = accelerations(drive(room(sensors=EXACT), Hold(), 3.0))
    assert np.abs(parked[10:].mean(axis=0)).max() < 0.03
    noisy = accelerations(drive(room(seed=1), Hold(), 25.0))
    assert noisy.shape == (500, 2)
    quiet = accelerations(drive(room(seed=1, sensors=EXACT), Hold(), 25.0))
    noise = noisy - quiet  # equal seeds: the same car in the same motion
    assert noise.std(axis=0) == pytest.approx([0.05, 0.05], rel=5 / math.sqrt(2 * 500))
    assert noise.mean(axis=0) == pytest.approx([0.0, 0.0], abs=5 * 0.05 / math.sqrt(500))


def test_the_accelerometer_feels_speeding_up_braking_and_turning() -> None:
    """Means over a ramp are the change of the true speed over its time; in a circle v x omega towards its centre."""
    simulation = room(12, 12, start=SE2(2, 6), sensors=EXACT, physics=IDENTICAL_CARS)
    drive(simulation, Hold(), 0.5)
    before = simulation.ground_truth().twist.v
    up = accelerations(drive(simulation, Drive(Twist(0.4, 0.0)), 0.5))
    after = simulation.ground_truth().twist.v
    assert after - before > 0.3
    assert up[:, 0].mean() == pytest.approx((after - before) / 0.5, rel=0.25)
    drive(simulation, Drive(Twist(0.4, 0.0)), 1.0)
    down = accelerations(drive(simulation, Drive(Twist(0.0, 0.0)), 0.5))
    assert down[:, 0].mean() == pytest.approx(-0.8, rel=0.25)
    drive(simulation, Drive(Twist(0.3, 0.8)), 1.5)
    left = accelerations(drive(simulation, Drive(Twist(0.3, 0.8)), 3.0))
    twist = simulation.ground_truth().twist
    assert left[:, 1].mean() == pytest.approx(twist.v * twist.omega, rel=0.2)
    drive(simulation, Drive(Twist(0.3, -0.8)), 1.5)
    right = accelerations(drive(simulation, Drive(Twist(0.3, -0.8)), 3.0))
    assert right[:, 1].mean() == pytest.approx(-left[:, 1].mean(), rel=0.2)


def test_the_bumper_is_pressed_on_contact_ahead_only() -> None:
    ahead = room(start=SE2(7.8, 4), sensors=EXACT)
    observations = drive(ahead, Drive(Twist(0.2, 0.0)), 2.0)
    pressed = [o.bumper.value for o in observations if o.bumper is not None]
    assert not any(pressed[:8])  # 10 cm to go take half a second
    assert np.mean(pressed[20:]) > 0.9  # slipping wheels push unevenly
    assert ahead.ground_truth().contact
    behind = room(start=SE2(0.15, 4), sensors=EXACT)
    observations = drive(behind, Drive(Twist(-0.2, 0.0)), 2.0)
    assert behind.ground_truth().contact
    assert not any(o.bumper.value for o in observations if o.bumper is not None)


# -- random streams ----------------------------------------------------------------------------------------------------


def readings_of(simulation: Simulation, names: Sequence[str]) -> list[np.ndarray]:
    """Of the named sonars and all small sensors on a short drive."""
    observations = drive(simulation, lambda time: Drive(Twist(0.2, math.sin(3 * time))), 2.0)
    rows = [[float(s.ranges[0]) for o in observations for s in o.sonars if s.name == name] for name in names]
    rows += [
        [o.psd.value for o in observations if o.psd],
        [float(v) for o in observations if o.acceleration for v in o.acceleration.value],
    ]
    rows += [[v for o in observations if o.wheel_angles for v in (o.wheel_angles.value.left, o.wheel_angles.value.right)]]
    return [np.array(row) for row in rows]


@pytest.mark.parametrize(
    "more", [FitOut("front+sides"), FitOut(lidar="hokuyo"), FitOut("front+sides", "scan360", compass=True)], ids=str
)
def test_adding_a_sensor_changes_no_other_sensors_readings(more: FitOut) -> None:
    names = ["front_left", "front_right"]
    few = readings_of(room(start=SE2(4, 4, 0.5), seed=5), names)
    many = readings_of(room(start=SE2(4, 4, 0.5), seed=5, fit_out=more), names)
    assert [row.size for row in few] == [40, 40, 40, 80, 80]
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(few, many, strict=True))


def test_equal_seeds_equal_readings_and_other_seeds_others() -> None:
    names = ["front_left", "front_right"]
    first, again, other = (readings_of(room(seed=seed), names) for seed in (3, 3, 4))
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(a, b, equal_nan=True) for a, b in zip(first[:2], other[:2], strict=True))


def test_two_sonars_have_noise_of_their_own() -> None:
    """Uncorrelated: five sigma of the correlation of independent noise."""
    simulation = room(sensors=SensorParameters(sonar=SonarParameters(dropout=0.0)))
    pairs = np.array([[float(s.ranges[0]) for s in o.sonars] for o in drive(simulation, Hold(), 20.0)])
    assert pairs.shape == (400, 2)
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 5 / math.sqrt(400)
