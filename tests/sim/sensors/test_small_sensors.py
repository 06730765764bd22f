"""PSD, wheel encoders, compass, accelerometer and bumper.

Oracles: distances in closed form, the true wheel angles, headings, speeds and contacts, moments of the noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Drive, Hold, Observation, Twist
from robocar.sim.fit_out import FitOut
from robocar.sim.world import World
from tests.sim.rooms import IDENTICAL_CARS, drive, room
from tests.sim.sensors.exact import EXACT, TILT, observe


@pytest.mark.parametrize(
    ("distance", "inside"), [(0.05, False), (0.12, True), (0.5, True), (0.78, True), (0.85, False), (3.0, False)]
)
def test_psd_measures_from_10_to_80_cm(hall: World, distance: float, inside: bool) -> None:
    """Thesis, Table 1.1."""
    observation, pose = observe(hall, SE2(24 - 0.10 - distance, 12.0))
    assert observation.psd is not None
    expected = 24 - 0.10 - pose.x if inside else math.nan
    assert observation.psd.value == pytest.approx(expected, abs=TILT, nan_ok=True)


def test_psd_noise_has_the_moments_it_is_given() -> None:
    world = room(start=SE2(8 - 0.10 - 0.4, 4))
    found = np.array([o.psd.value for o in drive(world, Hold(), 25.0) if o.psd is not None])
    assert len(found) == 500
    assert found.mean() == pytest.approx(0.4, abs=5 * 0.02 * 0.4 / math.sqrt(500) + TILT)
    assert found.std() == pytest.approx(0.02 * 0.4, rel=5 / math.sqrt(2 * 500))


def test_encoders_count_whole_pulses_of_the_true_angle() -> None:
    """200 pulses a turn (thesis, section 3.5): the angle since the start, rounded down to 1.8 degrees."""
    world = room(seed=2)
    wheels = [world.data.joint(f"robocar/rear_{side}_wheel") for side in ("left", "right")]
    zero = [float(wheel.qpos[0]) for wheel in wheels]
    pulse = math.radians(1.8)
    counts, true = [], []
    for tick in range(100):
        reading = world.robot.sense().wheel_angles
        assert reading is not None
        assert reading.time == world.time
        counts.append([reading.value.left / pulse, reading.value.right / pulse])
        true.append([(float(wheel.qpos[0]) - start) / pulse for wheel, start in zip(wheels, zero, strict=True)])
        world.robot.act(Drive(Twist(0.3, 0.5) if tick < 50 else Twist(-0.2, 1.0)))
        world.step()
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    np.testing.assert_array_equal(np.round(counts), np.floor(true))
    assert np.abs(counts).max() > 100


def test_encoders_may_be_slower_than_the_loop() -> None:
    world = room(sensors={"encoder": {"period": 0.2}})
    taken = [o.time for o in drive(world, Hold(), 1.0) if o.wheel_angles is not None]
    assert taken == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])


def test_compass_noise_and_resolution() -> None:
    """0.4 degrees of normal noise, then rounded to 0.1 degrees (which adds 0.1 / sqrt(12))."""
    world = room(start=SE2(4, 4, 1.0), fit_out=FitOut(compass=True))
    found = np.degrees([o.compass.value for o in drive(world, Hold(), 25.0) if o.compass is not None])
    std = math.hypot(0.4, 0.1 / math.sqrt(12))
    assert len(found) == 500
    np.testing.assert_allclose(found / 0.1, np.round(found / 0.1), atol=1e-6)
    assert found.mean() == pytest.approx(math.degrees(1.0), abs=5 * std / math.sqrt(500))
    assert found.std() == pytest.approx(std, rel=5 / math.sqrt(2 * 500))


def test_compass_readings_near_the_back_direction_stay_in_the_half_open_circle() -> None:
    world = room(start=SE2(4, 4, math.pi), fit_out=FitOut(compass=True))
    found = np.array([o.compass.value for o in drive(world, Hold(), 5.0) if o.compass is not None])
    assert np.all((found > -math.pi) & (found <= math.pi))
    assert found.min() < 0 < found.max()
    assert np.abs(found).min() > math.radians(177)


@settings(deadline=None, max_examples=20)
@given(heading=st.floats(-math.pi, math.pi))
def test_an_exact_compass_gives_the_heading(heading: float) -> None:
    world = room(2, 2, start=SE2(1, 1, heading), fit_out=FitOut(compass=True), sensors=EXACT)
    reading = world.robot.sense().compass
    assert reading is not None
    assert math.remainder(reading.value - world.ground_truth().pose.theta, math.tau) == pytest.approx(0.0, abs=1e-9)
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
    world = room(12, 12, start=SE2(2, 6), sensors=EXACT, physics=IDENTICAL_CARS)
    drive(world, Hold(), 0.5)
    before = world.ground_truth().twist.v
    up = accelerations(drive(world, Drive(Twist(0.4, 0.0)), 0.5))
    after = world.ground_truth().twist.v
    assert after - before > 0.3
    assert up[:, 0].mean() == pytest.approx((after - before) / 0.5, rel=0.25)
    drive(world, Drive(Twist(0.4, 0.0)), 1.0)
    down = accelerations(drive(world, Drive(Twist(0.0, 0.0)), 0.5))
    assert down[:, 0].mean() == pytest.approx(-0.8, rel=0.25)
    drive(world, Drive(Twist(0.3, 0.8)), 1.5)
    left = accelerations(drive(world, Drive(Twist(0.3, 0.8)), 3.0))
    twist = world.ground_truth().twist
    assert left[:, 1].mean() == pytest.approx(twist.v * twist.omega, rel=0.2)
    drive(world, Drive(Twist(0.3, -0.8)), 1.5)
    right = accelerations(drive(world, Drive(Twist(0.3, -0.8)), 3.0))
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
