"""Obstacles that move: what is taken for one, its velocity, predicted collisions. Oracles: the truth, simulation, algebra."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from robocar.core import OCCUPIED, SE2, Observation, OccupancyGrid, Twist
from robocar.planners.bugs.ocpb.collision_points import (
    Collision,
    Moving,
    StraightDrive,
    crossing,
    predict,
    standing_world,
    with_virtual,
)
from robocar.planners.tracking.kernel import line
from robocar.planners.tracking.panorama import ScanPanorama, Surround
from robocar.planners.tracking.tracker import Kind, ObstacleTracker, Tracked
from tests.planners.beams import Disc, disc_ranges, laser_car, scan_of
from tests.planners.tracking.tracking_reference import Reference

OPEN = OccupancyGrid(np.zeros((200, 200), dtype=np.int8), 0.05)


def follow(poses: list[SE2], movers: list[Disc], world: OccupancyGrid = OPEN, seed: int = 0) -> ObstacleTracker:
    """What is known after scans from these poses, 0.1 s apart, with the laser's noise."""
    robot, rng = laser_car(), np.random.default_rng(seed)
    obstacles, surround = ObstacleTracker(1.0, 5.5), Surround(robot, 0.4)
    for k, pose in enumerate(poses):
        seen = surround.panorama(Observation(0.1 * k, lidar=scan_of(robot, world, pose, 0.1 * k, movers, rng)), pose)
        assert seen is not None
        obstacles.update(seen)
    return obstacles


def tracked(x: float, y: float, vx: float, vy: float, radius: float) -> Tracked:
    return Tracked(1, 0.0, np.array([x, y]), radius, np.zeros((2, 2)), Kind.DYNAMIC, np.array([vx, vy]))


@pytest.mark.parametrize("speed", [0.1, 0.2, 0.4])
@pytest.mark.parametrize("angle", [0, 60, 120, 180, 240])
def test_a_mover_is_dynamic_with_its_velocity(speed: float, angle: float) -> None:
    """Oracle: the truth, for a robot that drives at 0.3 m/s; eq. 7 to 0.06 m/s, 2.4 s after it came into sight."""
    velocity = speed * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    middle = np.array([6.8, 5.6])
    mover = Disc(tuple(middle - 1.2 * velocity), tuple(velocity), 0.15)
    obstacles = follow([SE2(4.0 + 0.03 * k, 5.0) for k in range(25)], [mover])
    assert [o.kind for o in obstacles.tracked] == [Kind.DYNAMIC]
    found = obstacles.dynamic[0]
    assert found.velocity == pytest.approx(velocity, abs=0.06)
    assert found.position == pytest.approx(mover.at(2.4), abs=0.15)
    assert found.radius == pytest.approx(0.15, abs=0.06)


def test_what_stands_is_stationary_however_the_robot_drives_by() -> None:
    """A box and a post stand; the robot passes them at 0.3 m, so that other faces come into sight: never dynamic."""
    data = np.zeros((200, 200), dtype=np.int8)
    data[110:122, 100:112] = OCCUPIED
    data[86:90, 120:124] = OCCUPIED
    world, post = OccupancyGrid(data, 0.05), Disc((6.5, 5.4), (0.0, 0.0), 0.12)
    kinds = set()
    for seed in range(3):
        for last in range(10, 110, 5):
            poses = [SE2(4.0 + 0.03 * k, 5.0, 0.2 * math.sin(0.2 * k)) for k in range(max(0, last - 30), last)]
            kinds |= {o.kind for o in follow(poses, [post], world, seed).tracked}
    assert Kind.STATIONARY in kinds
    assert Kind.DYNAMIC not in kinds


def test_one_that_stops_becomes_stationary() -> None:
    robot, rng = laser_car(), np.random.default_rng(1)
    obstacles, surround, pose = ObstacleTracker(1.0, 5.5), Surround(robot, 0.4), SE2(4.0, 5.0)
    kinds = []
    for k in range(60):
        mover = Disc((6.0, 4.5 + 0.03 * min(k, 30)), (0.0, 0.0), 0.15)
        seen = surround.panorama(Observation(0.1 * k, lidar=scan_of(robot, OPEN, pose, 0.1 * k, [mover], rng)), pose)
        assert seen is not None
        obstacles.update(seen)
        kinds.append(obstacles.tracked[0].kind)
    assert kinds[29] is Kind.DYNAMIC
    assert kinds[-1] is Kind.STATIONARY


@pytest.mark.parametrize("seed", [0, 1])
def test_the_kernel_follows_the_rules(seed: int) -> None:
    """Oracle: the rules in plain Python (`tracking_reference`), to the bit; movers that hide each other, scans left out."""
    rng = np.random.default_rng(seed)
    data = np.zeros((200, 200), dtype=np.int8)
    for row, col, height, width in zip(*rng.integers(10, 180, (2, 8)), *rng.integers(2, 14, (2, 8)), strict=True):
        data[row : row + height, col : col + width] = OCCUPIED
    world, robot = OccupancyGrid(data, 0.05), laser_car()
    movers = [Disc(tuple(rng.uniform(2, 8, 2)), tuple(rng.uniform(-0.4, 0.4, 2)), rng.uniform(0.1, 0.3)) for _ in range(8)]
    obstacles, reference, surround = ObstacleTracker(1.0, 5.5), Reference(1.0, 5.5), Surround(robot, 0.4)
    pose, kinds, same = SE2(5.0, 5.0), set(), []
    for k in np.flatnonzero(rng.random(100) > 0.1):
        pose = pose @ Twist(rng.uniform(0.0, 0.4), rng.uniform(-1.0, 1.0)).step(0.1)
        seen = surround.panorama(Observation(0.1 * k, lidar=scan_of(robot, world, pose, 0.1 * k, movers, rng)), pose)
        assert seen is not None
        obstacles.update(seen)
        reference.update(seen)
        kinds |= {o.kind for o in obstacles.tracked}
        ours, theirs = ([(o.number, o.time, o.kind, o.radius) for o in found.tracked] for found in (obstacles, reference))
        same.append(ours == theirs)
        for a, b in zip(obstacles.tracked, reference.tracked, strict=True):
            same.append(np.array_equal([a.position, a.velocity, *a.ends], [b.position, b.velocity, *b.ends]))
    assert all(same)
    assert kinds == set(Kind)


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=3, max_size=12))
def test_the_line_through_positions(points: list[tuple[float, float]]) -> None:
    """Oracle: numpy's least squares."""
    times = 0.1 * np.arange(len(points))
    found = line(np.column_stack([times, points]))
    slope, at_last = np.polyfit(times - times[-1], np.array(points), 1)
    assert found == pytest.approx([*at_last, *slope], abs=1e-8)


@settings(deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(st.integers(0, 2**32 - 1))
def test_collisions_are_those_of_a_simulation(seed: int) -> None:
    """Brute force: both circles moved on in steps of 5 ms."""
    rng, speed, reach = np.random.default_rng(seed), 0.3, 0.5
    heading, length, delay, stay = rng.uniform([-3, 0, 0, 0], [3, 4, 2, 2])
    away, course = rng.uniform(0.55, 3.0), rng.uniform(-math.pi, math.pi)
    x, y = away * math.cos(course), away * math.sin(course)
    vx, vy = rng.uniform(0.0, 0.5) * np.array([math.cos(c := course + math.pi + rng.normal(0, 0.5)), math.sin(c)])
    times = np.arange(0.0, delay + length / speed + stay, 0.005)
    gone = np.clip((times - delay) * speed, 0.0, length)
    apart = np.hypot(x + vx * times - gone * math.cos(heading), y + vy * times - gone * math.sin(heading))
    assume(abs(apart.min(initial=9.0) - reach) > 0.01)
    obstacle = tracked(x, y, vx, vy, 0.2)
    drive = StraightDrive(0.0, 0.0, heading, length, speed, delay, stay, reach - 0.2)
    found = predict(Moving.of([obstacle]), 0.0, drive, 60.0)
    touching = times[apart < reach]
    assert (found is not None) == bool(len(touching))
    assume(found is not None)
    assert found is not None
    assert found.first == pytest.approx(touching[0], abs=0.02)
    assert found.last == pytest.approx(touching[-1], abs=0.02)
    assert math.dist(found.point, found.start) == pytest.approx(reach, abs=1e-3)  # eq. 8: where the two touch
    assert found.robot_time == pytest.approx(np.clip(found.first - delay, 0.0, length / speed), abs=1e-9)  # eq. 9


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_the_lines_cross_where_algebra_says(heading: float, course: float, x: float, y: float) -> None:
    """Oracle: numpy's solution of the two lines' equations."""
    c, s = math.cos(heading), math.sin(heading)
    velocity = 0.3 * np.array([math.cos(course), math.sin(course)])
    assume(abs(math.sin(heading - course)) > 0.05)
    gone, other = np.linalg.solve(np.array([[c, -velocity[0]], [s, -velocity[1]]]), [x, y])
    assume(min(abs(gone), abs(other)) > 1e-6)
    point = crossing(np.zeros(2), heading, np.array([x, y]), velocity)
    expected = [gone * c, gone * s] if gone >= 0.0 and other >= 0.0 else None
    assert (point is None) == (expected is None)
    assert point is None or point == pytest.approx(expected, abs=1e-6)


def test_a_virtual_obstacle_is_seen_like_a_real_one() -> None:
    """Oracle: rays against circles; a capsule of no length is a circle. What moves is not seen any more."""
    bearings = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    centre, obstacle = np.array([2.0, 0.5]), tracked(1.0, -1.0, 0.1, 0.0, 0.2)
    real = np.minimum(disc_ranges(np.zeros(2), bearings, np.array([1.0, -1.0]), 0.2), 4.0)
    seen = ScanPanorama(0.0, np.zeros(2), bearings, real, 6.0, math.tau / 360)
    still = standing_world(seen, Moving.of([obstacle]), 0.05)
    assert np.array_equal(np.isnan(still.ranges), real < 4.0)
    collision = Collision(obstacle, centre, 1.0, 1.0, 1.0, 2.0, centre, centre)
    virtual = with_virtual(still, [collision])
    expected = np.fmin(still.ranges, disc_ranges(np.zeros(2), bearings, centre, 0.2))
    there = np.isfinite(expected)
    assert virtual.ranges[there] == pytest.approx(expected[there])
    assert np.isnan(virtual.ranges[np.isnan(still.ranges) & ~np.isfinite(disc_ranges(np.zeros(2), bearings, centre, 0.2))]).all()
