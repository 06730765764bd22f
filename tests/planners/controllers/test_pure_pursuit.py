"""The path follower."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Belief, Costmap, Footprint, Goal, Observation, Path, State, Twist
from robocar.planners.controllers.pure_pursuit import PurePursuit, PurePursuitParameters
from robocar.planners.geometry.collision import footprint_free
from robocar.planners.geometry.polyline import blocked_ahead, nearest_on_path, point_ahead
from tests.planners.kinematic import DT, car

OBSERVATION = Observation(0.0)


def overlap_area(polygon: np.ndarray, row: int, col: int) -> float:
    """Area of a convex polygon clipped to a cell's square (Sutherland and Hodgman, 1974; shoelace formula)."""
    for axis, bound, sign in ((0, col, 1), (0, col + 1, -1), (1, row, 1), (1, row + 1, -1)):
        clipped = []
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            da, db = sign * (a[axis] - bound), sign * (b[axis] - bound)
            if da >= 0:
                clipped.append(a)
            if da * db < 0:
                clipped.append(a + (b - a) * da / (da - db))
        if len(clipped) < 3:
            return 0.0
        polygon = np.array(clipped)
    x, y = polygon.T
    return 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_footprint_check_is_exact(seed: int) -> None:
    """Oracle: the area of overlap with every lethal cell, by polygon clipping."""
    rng = np.random.default_rng(seed)
    costs = np.where(rng.random((12, 12)) < 0.12, rng.choice([254, 255], (12, 12)), 253).astype(np.uint8)
    pose = SE2(rng.uniform(-1, 13), rng.uniform(-1, 13), rng.uniform(-3, 3))
    footprint = Footprint.rectangle(*rng.uniform(0.3, 3.0, 3))
    areas = [overlap_area(footprint.at(pose), row, col) for row, col in np.argwhere(costs >= 254)]
    largest = max(areas, default=0.0)
    decided = largest > 1e-9 or largest == 0.0
    assert footprint_free(costs, pose.x, pose.y, pose.theta, np.array(footprint.vertices)) == (largest == 0.0) or not decided


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_nearest_point_and_lookahead_by_sampling(seed: int) -> None:
    """Oracle: the path sampled finely by arc length."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.uniform(-1, 1, (int(rng.integers(2, 8)), 2)), axis=0)
    at, lookahead = rng.uniform(-2, 2, 2), rng.uniform(0.0, 3.0)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc = np.concatenate([[0], np.cumsum(steps)])
    fine = np.linspace(0, arc[-1], 20001)
    samples = np.stack([np.interp(fine, arc, points[:, k]) for k in range(2)], axis=1)
    segment, share, distance = nearest_on_path(points, 0, *at, math.inf)
    assert distance == pytest.approx(np.linalg.norm(samples - at, axis=1).min(), abs=1e-3)
    travelled = arc[segment] + share * steps[segment]
    x, y, left = point_ahead(points, segment, share, lookahead)
    assert left == pytest.approx(arc[-1] - travelled, abs=1e-9)
    expected = [np.interp(travelled + lookahead, arc, points[:, k]) for k in range(2)]
    np.testing.assert_allclose([x, y], expected, atol=1e-9)


def test_the_window_keeps_to_the_present_lane() -> None:
    """By hand: a hairpin with lanes 0.2 m apart; beside the second lane but still on the first, the first one is followed."""
    hairpin = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 0.2], [0.0, 0.2]])
    assert nearest_on_path(hairpin, 0, 1.0, 0.15, 2.0)[0] == 0
    assert nearest_on_path(hairpin, 0, 1.0, 0.15, 20.0)[0] == 2


def test_only_what_lies_ahead_blocks_a_path_and_the_way_out_of_blocked_cells_does_not() -> None:
    """By hand, on a row of ten cells."""
    points = np.stack([np.arange(10) + 0.5, np.full(10, 0.5)], axis=1)

    def blocked(cells: list[int], segment: int) -> bool:
        costs = np.zeros((1, 10), dtype=np.uint8)
        costs[0, cells] = 253
        return blocked_ahead(Costmap(costs, 1.0).data, points, segment)

    assert not blocked([], 0)
    assert blocked([5], 0)
    assert blocked([5], 4)
    assert not blocked([5], 6)
    assert not blocked([2, 3], 2)
    assert blocked([2, 3, 7], 2)
    assert blocked([9], 8)
    assert blocked([7, 8, 9], 7)


def follow(path: Path, pose: SE2, goal: Goal, costmap: Costmap | None = None, ticks: int = 1500) -> tuple[list[SE2], list[Twist]]:
    planner = PurePursuit(car(), DT)
    poses, twists = [pose], []
    for _ in range(ticks):
        twists.append(planner.command(State.of(Belief(poses[-1])), path, costmap, OBSERVATION, goal).twist)
        poses.append(poses[-1] @ twists[-1].step(DT))
        if twists[-1] == Twist() and goal.reached(poses[-1]):
            break
    return poses, twists


@pytest.mark.parametrize("radius", [0.5, 1.0, -0.7])
def test_a_circle_is_driven_on_its_curvature(radius: float) -> None:
    """Analytic: on a circle of radius R the arc to a point of it has curvature 1/R; speed regulated by min(1, |R| / 0.3)."""
    angles = np.linspace(0, 1.5 * math.pi, 400)
    path = Path(np.stack([abs(radius) * np.sin(angles), radius * (1 - np.cos(angles))], axis=1))
    poses, twists = follow(path, SE2(), Goal(path.points[-1]), ticks=60)
    cruising = twists[20:]
    np.testing.assert_allclose([t.omega / t.v for t in cruising], 1 / radius, rtol=0.03)
    np.testing.assert_allclose([t.v for t in cruising], 0.4, rtol=0.01)
    np.testing.assert_allclose([math.hypot(p.x, p.y - radius) for p in poses], abs(radius), atol=0.01)


def test_limits_are_kept_and_it_stops_at_the_goal() -> None:
    """Property: every twist within the robot's speeds and accelerations, on a path with corners, from standing to standing."""
    limits = car().limits
    path = Path(np.array([[0.0, 0.0], [1.5, 0.0], [1.5, 1.0], [0.5, 1.0], [0.5, 2.0]]))
    goal = Goal(path.points[-1])
    poses, twists = follow(path, SE2(0.0, 0.0, 2.5), goal)
    v, omega = np.array([(t.v, t.omega) for t in [Twist(), *twists]]).T
    assert v.min() >= limits.min_vel_x
    assert v.max() <= limits.max_vel_x + 1e-12
    assert np.abs(omega).max() <= limits.max_vel_theta + 1e-12
    assert np.abs(np.diff(v)).max() <= limits.acc_lim_x * DT + 1e-9
    assert np.abs(np.diff(omega)).max() <= limits.acc_lim_theta * DT + 1e-9
    assert twists[-1] == Twist()
    assert math.dist(poses[-1].position, goal.position) <= 0.5 * goal.xy_goal_tolerance
    assert v.max() == pytest.approx(0.4)


def test_it_turns_on_the_spot_to_a_path_behind_it() -> None:
    """By hand: the path leads back, so the first second is rotation, the shorter way (left, from heading 0 to 170 degrees)."""
    poses, twists = follow(Path(np.array([[0.0, 0.0], [-2.0, 0.35]])), SE2(), Goal(np.array([-2.0, 0.35])), ticks=20)
    assert all(t.v == 0.0 for t in twists)
    assert all(t.omega > 0.0 for t in twists)
    assert poses[-1].theta > 0.5


def test_the_heading_of_the_goal_is_taken_up() -> None:
    path = Path(np.array([[0.0, 0.0], [1.0, 0.0]]))
    goal = Goal(path.points[-1], heading=-2.0)
    poses, _ = follow(path, SE2(), goal)
    assert goal.reached(poses[-1])
    assert abs(math.remainder(poses[-1].theta + 2.0, math.tau)) <= 0.5 * goal.yaw_goal_tolerance + 1e-9


def test_it_backs_out_of_where_it_cannot_turn() -> None:
    """By hand: posts 2 cm beside the nose stop a turn of 90 degrees either way, but not one from a little farther back."""
    costs = np.zeros((80, 80), dtype=np.uint8)
    costs[51, 48] = costs[28, 48] = 254  # about (0.085, 0.115) and (0.085, -0.115)
    costmap, planner, pose = Costmap(costs, 0.01, SE2(-0.4, -0.4)), PurePursuit(car(), DT), SE2()
    speeds = []
    for _ in range(200):
        goal = Goal(pose.position, heading=math.pi / 2)  # to turn wherever it is
        twist = planner.command(State.of(Belief(pose)), None, costmap, OBSERVATION, goal).twist
        speeds.append(twist.v)
        pose = pose @ twist.step(DT)
        x, y = (np.array(pose.position) + 0.4) / 0.01
        assert footprint_free(costs, x, y, pose.theta, np.array(car().footprint.vertices) / 0.01)
    assert min(speeds) < 0.0 <= speeds[-1]
    assert -0.12 < pose.x < -0.005
    assert abs(math.remainder(pose.theta - math.pi / 2, math.tau)) < 0.2


def test_it_stops_before_a_wall_across_its_path() -> None:
    """Property: a wall at x = 1.0 m is never touched, and the car comes to within 0.1 m of it."""
    costs = np.zeros((40, 60), dtype=np.uint8)
    costs[:, 40] = 254
    costmap = Costmap(costs, 0.05, SE2(-1.0, -1.0))
    poses, _ = follow(Path(np.array([[0.0, 0.0], [1.8, 0.0]])), SE2(), Goal(np.array([1.8, 0.0])), costmap, ticks=200)
    front = [SE2(p.x, p.y, p.theta).transform(car().footprint.vertices)[:, 0].max() for p in poses]
    assert max(front) <= 1.0
    assert max(front) >= 0.9


def test_near_obstacles_it_is_slower_but_passes() -> None:
    """Property: in a corridor 0.3 m wide (the car is 0.18 m) with costs on its floor it drives through, below full speed."""
    costs = np.full((30, 80), 200, dtype=np.uint8)
    costs[12, :] = costs[19, :] = 254  # free between y = 0.65 and 0.95
    costmap = Costmap(costs, 0.05)
    path = Path(np.array([[0.3, 0.8], [3.7, 0.8]]))
    poses, twists = follow(path, SE2(0.3, 0.81, 0.05), Goal(path.points[-1]), costmap)
    assert math.dist(poses[-1].position, path.points[-1]) <= 0.05
    assert max(t.v for t in twists) < 0.3
    assert min(t.v for t in twists[10:40]) > 0.1


def test_without_a_path_it_drives_to_the_goal() -> None:
    """Straight ahead of the car: no turning."""
    twist = PurePursuit(car(), DT).command(State.of(Belief(SE2())), None, None, OBSERVATION, Goal(np.array([1.0, 0.0]))).twist
    assert twist == Twist(0.05, 0.0)  # one control period of 1 m/s^2


@pytest.mark.parametrize(
    ("name", "value"), [("desired_linear_vel", 0.0), ("lookahead_dist", math.nan), ("proximity_slowdown", 1.0)]
)
def test_wrong_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        PurePursuitParameters(**{name: value})
