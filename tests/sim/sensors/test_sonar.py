"""Sonars in a world. Oracles: distances in closed form, the cone's geometry, moments of the noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Hold, Observation, Scan
from robocar.core.solids import Box
from robocar.sim.sensors.sonar import cone_rays
from robocar.sim.world import World
from tests.sim.rooms import room
from tests.sim.sensors.exact import EXACT, HALL, TILT, observe

HALF_CONE = math.radians(7.5)
MAX_INCIDENCE = math.radians(60.0)
FRONT_LEFT, FRONT_RIGHT = SE2(0.10, 0.05), SE2(0.10, -0.05)  # robot.xml


def heard(observation: Observation, name: str) -> float:
    (scan,) = (scan for scan in observation.sonars if scan.name == name)
    return float(scan.ranges[0])


@settings(deadline=None, max_examples=40)
@given(distance=st.floats(0.05, 4.9), sign=st.sampled_from([-1, 1]))
def test_sonar_perpendicular_to_a_wall(hall: World, distance: float, sign: int) -> None:
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
def test_sonar_at_an_oblique_wall(hall: World, angle: float, distance: float) -> None:
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
def test_echoes_at_grazing_incidence_are_lost(hall: World, angle: float, lost: bool) -> None:
    """60 degrees from the normal at the edge of the 15 degree cone: at 67.5 degrees between axis and normal."""
    observation, _ = observe(hall, SE2(23.0, 12.0, math.radians(angle)))
    assert math.isinf(heard(observation, "front_left")) == lost


def test_nothing_in_range_is_infinite(hall: World) -> None:
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
    observation = room(*HALL, sensors=EXACT, solids=[Box((0.04, 0.04, 0.3), post)]).robot.sense()
    assert heard(observation, "front_left") == (pytest.approx(1.98, abs=0.005) if seen else math.inf)


def test_the_first_echo_counts() -> None:
    """A post before a wall."""
    post = Box((0.04, 0.04, 0.3), SE2(4.0, 4.0) @ FRONT_RIGHT @ SE2(1.0, 0.05))
    observation = room(sensors=EXACT, solids=[post]).robot.sense()
    assert heard(observation, "front_right") == pytest.approx(0.98, abs=0.005)
    assert heard(observation, "front_left") == pytest.approx(0.98, abs=0.01)  # 5 cm off its axis to the other side


def test_what_passes_above_or_below_the_cone_is_not_heard() -> None:
    """A kerb of 3 cm close to the car is below a cone that starts at 10 cm."""
    kerb = Box((0.05, 1.0, 0.03), SE2(4.35, 4.0))
    assert heard(room(*HALL, start=SE2(4, 4), sensors=EXACT, solids=[kerb]).robot.sense(), "front_left") == math.inf
    step = replace(kerb, size=(0.05, 1.0, 0.12))
    observation = room(*HALL, start=SE2(4, 4), sensors=EXACT, solids=[step]).robot.sense()
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


def readings(simulation: World, count: int) -> np.ndarray:
    """`count` readings of the left front sonar of a parked car."""
    scans: list[Scan] = []
    while len(scans) < count:
        scans += [scan for scan in simulation.robot.sense().sonars if scan.name == "front_left"]
        simulation.robot.act(Hold())
        simulation.step()
    return np.array([float(scan.ranges[0]) for scan in scans])


@pytest.mark.parametrize("distance", [0.5, 3.0])
def test_sonar_noise_has_the_moments_it_is_given(distance: float) -> None:
    """Normal noise of hypot(4 mm, 0.3 % of the range): mean and standard deviation of 600 readings within five sigma."""
    simulation = room(start=SE2(8 - 0.10 - distance, 4), sensors={"sonar": {"dropout": 0.0}})
    found = readings(simulation, 600)
    std = math.hypot(0.004, 0.003 * distance)
    assert found.mean() == pytest.approx(distance, abs=5 * std / math.sqrt(600) + TILT)
    assert found.std() == pytest.approx(std, rel=5 / math.sqrt(2 * 600))


def test_sonar_drop_outs_have_their_share() -> None:
    """Binomial: five sigma."""
    simulation = room(sensors={"sonar": {"dropout": 0.2}})
    lost = np.isnan(readings(simulation, 600))
    assert lost.mean() == pytest.approx(0.2, abs=5 * math.sqrt(0.2 * 0.8 / 600))


def test_noise_never_brings_readings_out_of_range() -> None:
    near = room(start=SE2(8 - 0.10 - 0.03, 4), sensors={"sonar": {"dropout": 0.0, "range_std": 0.05}})
    found = readings(near, 200)
    assert found.min() == 0.02
    far = room(*HALL, start=SE2(24 - 0.10 - 4.99, 12), sensors={"sonar": {"dropout": 0.0, "range_std": 0.05}})
    found = readings(far, 200)
    assert found[np.isfinite(found)].max() <= 5.0
    assert 0.2 < np.isinf(found).mean() < 0.8
