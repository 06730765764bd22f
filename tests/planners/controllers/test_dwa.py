"""The Dynamic Window Approach: its trajectories, its choice, and what it does where there is none."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robocar
from robocar.core import (
    OCCUPIED,
    SE2,
    Belief,
    Command,
    Controller,
    Costmap,
    Drive,
    GiveUp,
    Goal,
    Lines,
    Observation,
    OccupancyGrid,
    Path,
    Robot,
    State,
    Twist,
)
from robocar.paths import MODELS
from robocar.planners.controllers import dwa
from robocar.planners.controllers.dwa import DwaParameters, DynamicWindow
from robocar.planners.controllers.steering import SteeringParameters
from robocar.planners.controllers.trajectory_costs import (
    NEVER,
    RobotBody,
    RolloutAim,
    RolloutHorizon,
    outline_cost,
    path_distance,
    rollouts,
)
from robocar.planners.costmap.layered import CostmapParameters, inflate, safe_cost
from robocar.planners.geometry.collision import footprint_free
from robocar.planners.navigators.plan_and_follow import plan_and_avoid
from robocar.planners.search import a_star
from robocar.planners.tracking.moving_obstacles import NONE
from tests.planners.kinematic import DT, car, context, drive
from tests.planners.navigators.test_plan_and_follow import field

OPEN = Costmap(np.zeros((120, 120), dtype=np.uint8), 0.05, SE2(-3.0, -3.0))
POINT, TWO_SECONDS = RobotBody(np.empty((0, 2)), 2.7, 0.0, False), RolloutHorizon(0.1, 20, 5, NEVER)


def planner(robot: Robot | None = None, **parameters: object) -> DynamicWindow:
    return DynamicWindow(robot or car(), DT, DwaParameters(**parameters), inflation=CostmapParameters())  # type: ignore[arg-type]


def at(pose: SE2, local: Controller, costmap: Costmap | None, path: Path | None, goal: Goal, tick: int = 0) -> Command:
    return local.command(State.of(Belief(pose)), path, costmap, Observation(tick * DT), goal)


def drives(
    local: DynamicWindow, costmap: Costmap, pose: SE2, path: Path | None, goal: Goal, ticks: int
) -> list[tuple[SE2, Twist]]:
    """Poses and twists until the car stands at the goal, without physics."""
    log = []
    for tick in range(ticks):
        command = at(pose, local, costmap, path, goal, tick)
        twist = command.twist if isinstance(command, Drive) else Twist()
        log.append((pose, twist))
        pose = pose @ twist.step(DT)
    return log


@settings(max_examples=60, deadline=None)
@given(v=st.floats(0.0, 0.4), omega=st.floats(-1.5, 1.5), theta=st.floats(-3.0, 3.0))
def test_a_twist_that_is_kept_leads_along_its_arc(v: float, omega: float, theta: float) -> None:
    """Analytic: the exact arc; straight pieces of 0.1 s along the chord's direction miss it by less than 1 mm in 2 s."""
    start = np.array([60.0, 60.0, theta, v / 0.05, omega])
    end = SE2(60.0, 60.0, theta) @ Twist(v / 0.05, omega).step(2.0)
    goal = np.array([end.x, end.y])
    limits, samples = np.array([16.0, 4.0]), np.array([[v / 0.05, omega]])
    path = np.array([[60.0, 60.0], [90.0, 60.0]])
    terms = rollouts(OPEN.data, start, limits, samples, POINT, RolloutAim(path, goal, 0.0), TWO_SECONDS, NONE)[0]
    collides, cost, near, off, way, turned, *_ = terms
    assert (collides, cost) == (0.0, 0.0)
    assert near * 0.05 <= 1e-3
    assert way * 0.05 == pytest.approx(2.0 * v, abs=1e-9)
    assert turned == pytest.approx(2.0 * abs(omega), abs=1e-9)
    assert off == pytest.approx(path_distance(path, end.x, end.y), abs=0.02)


def test_accelerations_are_kept_on_the_way_to_a_twist() -> None:
    """By hand: from rest at 0.8 m/s^2 in steps of 0.1 s to 0.4 m/s: 0.08, 0.16 ... 0.40, then on: 0.08 (1 + 2 + 3 + 4) 0.1 + 16
    times 0.04 = 0.72 m."""
    start, samples, limits = np.array([10.0, 60.0, 0.0, 0.0, 0.0]), np.array([[8.0, 0.0]]), np.array([16.0, 4.0])
    goal, path = np.array([110.0, 60.0]), np.array([[10.0, 60.0], [110.0, 60.0]])
    terms = rollouts(OPEN.data, start, limits, samples, POINT, RolloutAim(path, goal, 0.0), TWO_SECONDS, NONE)
    assert terms[0, 4] * 0.05 == pytest.approx(0.72)
    assert terms[0, 2] * 0.05 == pytest.approx(5.0 - 0.72)


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), resolution=st.sampled_from([0.02, 0.05, 0.1]), inflation=st.sampled_from([0.1, 0.2, 0.5]))
def test_cheap_cells_are_never_near_an_obstacle(seed: int, resolution: float, inflation: float) -> None:
    """Oracle: the exact check of the outline: what `safe_cost` spares never hides a contact."""
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid(np.where(rng.random((30, 30)) < 0.02, OCCUPIED, 0), resolution)
    p, footprint = CostmapParameters(inflation_radius=inflation, walled=False), car().footprint
    costs = inflate(grid, footprint.inscribed_radius, p).data
    vertices, safe = np.array(footprint.vertices / resolution), safe_cost(p, footprint, resolution)
    for x, y, theta in np.column_stack([rng.uniform(0, 30, (40, 2)), rng.uniform(-3, 3, 40)]):
        free = footprint_free(costs, x, y, theta, vertices)
        assert (outline_cost(costs, x, y, theta, vertices, safe, False) < math.inf) == free


@pytest.mark.parametrize("row", [52, 57, 62])
def test_the_choice_is_the_cheapest_of_all_samples(row: int) -> None:
    """Oracle: eq. 6 written down naively, with every pose of every trajectory checked; 4 x 7 samples before an obstacle."""
    data = np.zeros((120, 120), dtype=np.int8)
    data[row : row + 6, 70:76] = OCCUPIED  # 0.5 m ahead
    grid = OccupancyGrid(data, 0.05, SE2(-3.0, -3.0))
    robot, p = car(), DwaParameters(vx_samples=4, vtheta_samples=7, window=10.0)
    costmap = inflate(grid, robot.footprint.inscribed_radius, CostmapParameters(walled=False))
    outline = np.array(robot.footprint.vertices) * (1.0 + 0.02 / robot.footprint.inscribed_radius) / 0.05
    path, goal = Path(np.array([[0.0, 0.0], [2.5, 0.0]])), Goal(np.array([2.5, 0.0]))
    command = at(SE2(), planner(vx_samples=4, vtheta_samples=7, window=10.0), costmap, path, goal)
    best: tuple[float, tuple[float, float]] = (math.inf, (0.0, 0.0))
    # The obstacle hides what lies beyond 0.5 m: the local goal is the farthest of sixths of the lookahead in sight.
    seen = max(k / 6 for k in range(1, 7) if not costmap.blocked[60, 60 : 61 + int(k / 6 / 0.05)].any())
    forward = p.forward_point_distance * min(1.0, max(0.0, seen / p.lookahead_dist - 0.2) / 0.3)
    for v_end, w_end in itertools.product(np.linspace(0.4, 0.0, 4), np.linspace(-1.5, 1.5, 7)):
        x, y, theta, v, w, total, near, free = 60.0, 60.0, 0.0, 0.0, 0.0, 0.0, math.inf, True
        ahead = (x, y)
        for _ in range(20):
            v, w = min(v_end, v + 0.1 * robot.limits.acc_lim_x), math.copysign(min(abs(w_end), abs(w) + 0.6), w_end)
            c, s = math.cos(theta + 0.05 * w), math.sin(theta + 0.05 * w)
            x, y, theta = x + v * 0.1 * c / 0.05, y + v * 0.1 * s / 0.05, theta + 0.1 * w
            free &= footprint_free(costmap.data, x, y, theta, outline)
            total += min(float(costmap.data[math.floor(y), math.floor(x)]), 252.0) / 20
            ahead = (x + forward * c / 0.05, y + forward * s / 0.05)
            near = min(near, math.dist(ahead, (60.0 + seen / 0.05, 60.0)) * 0.05)
        score = (
            p.cost_scale * total / 252.0
            + p.goal_distance_scale * near / 0.8
            + p.path_distance_scale * abs(ahead[1] - 60.0) * 0.05 / 0.8
            + p.slowness_scale * (0.05 / max(v_end, 0.05)) ** 2
        )
        if free and (v_end, w_end) != (0.0, 0.0) and score < best[0]:
            best = (score, (v_end, w_end))
    assert best[0] < math.inf
    assert isinstance(command, Drive)
    limits = robot.limits
    assert command.twist.v == pytest.approx(min(best[1][0], limits.acc_lim_x * DT))
    assert command.twist.omega == pytest.approx(math.copysign(min(abs(best[1][1]), limits.acc_lim_theta * DT), best[1][1]))


@pytest.mark.parametrize("scoring", ["cost", "objective"])
def test_a_wall_across_the_way_is_never_touched(scoring: str) -> None:
    """Exact contact check at each tick for 20 s against a wall, with a path that leads through it."""
    grid = field(80, 80, (2.5, 0.0, 2.7, 4.0))
    robot = car()
    costmap = inflate(grid, robot.footprint.inscribed_radius, CostmapParameters(walled=False))
    path, goal = Path(np.array([[0.5, 2.0], [3.5, 2.0]])), Goal(np.array([3.5, 2.0]))
    log = drives(planner(scoring=scoring), costmap, SE2(0.5, 2.0, 0.0), path, goal, 400)
    outline = np.array(robot.footprint.vertices / 0.05)
    assert all(footprint_free(costmap.data, pose.x / 0.05, pose.y / 0.05, pose.theta, outline) for pose, _ in log)
    assert max(pose.x for pose, _ in log) > 1.5


@pytest.mark.parametrize("scoring", ["cost", "objective"])
@pytest.mark.parametrize("start", [SE2(0.0, 0.0, 0.0), SE2(0.0, 0.0, 3.0), SE2(0.3, -0.4, -1.0)])
def test_it_arrives_and_keeps_speeds_and_accelerations(scoring: str, start: SE2) -> None:
    """Property: within the limits at each tick; it stands within half the tolerance of the goal, turned as asked."""
    limits = car().limits
    goal = Goal(np.array([1.5, 0.5]), heading=2.0)
    path = Path(np.array([[0.0, 0.0], [1.0, 0.0], [1.5, 0.5]]))
    log = drives(planner(scoring=scoring), OPEN, start, path, goal, 500)
    assert goal.reached(log[-1][0])
    assert log[-1][1] == Twist()
    twists = np.array([(t.v, t.omega) for _, t in log])
    assert twists[:, 0].min() >= 0.0
    assert twists[:, 0].max() <= limits.max_vel_x
    assert np.abs(twists[:, 1]).max() <= limits.max_vel_theta
    assert np.abs(np.diff(twists[:, 0])).max() <= limits.acc_lim_x * DT + 1e-9
    assert np.abs(np.diff(twists[:, 1])).max() <= limits.acc_lim_theta * DT + 1e-9


def test_it_turns_to_its_path_before_it_drives() -> None:
    """A path straight behind: it turns on the spot until the path lies ahead within 0.2 rad."""
    path, goal = Path(np.array([[0.0, 0.0], [-2.0, 0.0]])), Goal(np.array([-2.0, 0.0]))
    log = drives(planner(), OPEN, SE2(0.0, 0.0, 0.1), path, goal, 200)
    first = next(pose for pose, twist in log if twist.v > 0.0)
    assert math.hypot(first.x, first.y) < 1e-9
    assert abs(math.remainder(first.theta - math.pi, math.tau)) <= 0.2
    assert min(pose.x for pose, _ in log) < -1.5


def test_where_nothing_is_admissible_it_stands_and_says_so() -> None:
    """In a box as tight as the slim outline (0.75 of the car's) it can neither go nor turn; 0.3 s later it gives up as stuck."""
    data = np.full((80, 80), OCCUPIED)
    data[32:48, 31:49] = 0  # x -0.09 to 0.09, y -0.08 to 0.08 m
    box = inflate(OccupancyGrid(data, 0.01, SE2(-0.4, -0.4)), car().footprint.inscribed_radius, CostmapParameters())
    goal, path = Goal(np.array([1.5, 0.0])), Path(np.array([[0.0, 0.0], [1.5, 0.0]]))
    local = planner(vx_samples=3, vtheta_samples=3, window=0.5)
    commands = [at(SE2(), local, box, path, goal, tick) for tick in range(12)]
    kinds = [type(command) for command in commands]
    assert kinds[0] is Drive
    assert GiveUp in kinds
    given_up = commands[kinds.index(GiveUp)]
    assert isinstance(given_up, GiveUp)
    assert given_up.status == "stuck"
    assert kinds.index(GiveUp) == round(0.3 / DT)


def test_candidates_and_choice_are_shown_twice_a_second() -> None:
    path, goal = Path(np.array([[0.0, 0.0], [2.5, 0.0]])), Goal(np.array([2.5, 0.0]))
    local, pose, shown = planner(), SE2(), []
    for tick in range(40):
        command = at(pose, local, OPEN, path, goal, tick)
        assert isinstance(command, Drive)
        if command.trace:
            shown.append(tick)
            candidates, chosen = command.trace["candidates"], command.trace["local"]
            assert isinstance(candidates, Lines)
            assert isinstance(chosen, Lines)
            assert candidates.values is not None
            assert len(candidates.lines) == len(candidates.values) > 10
            np.testing.assert_allclose(chosen.lines[0][0], pose.position, atol=1e-9)
            # Thinned for the recording, from the car on; the chosen one is drawn in full.
            assert {line.shape for line in candidates.lines} == {(6, 2)}
            np.testing.assert_allclose([line[0] for line in candidates.lines], [pose.position] * len(candidates.lines), atol=1e-9)
            assert chosen.lines[0].shape == (21, 2)
        pose = pose @ command.twist.step(DT)
    assert shown == [0, 10, 20, 30]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scoring", "eq5"), ("vx_samples", 0), ("vtheta_samples", -3), ("sim_time", 0.0), ("sim_time", math.inf),
        ("sim_granularity", -0.1), ("window", math.nan), ("cost_scale", -0.1), ("path_distance_scale", math.nan),
        ("lookahead_dist", 0.0), ("sim_granularity", 3.0),
    ],
)  # fmt: skip
def test_wrong_parameters_are_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        DwaParameters(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["max_vel_x", "rotate_to_heading_angular_vel", "approach_deceleration", "failure_tolerance"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_wrong_steering_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        SteeringParameters(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("acc_lim_x", 0.0), ("acc_lim_theta", -1.0), ("max_vel_x", 0.0), ("max_vel_theta", math.nan), ("min_vel_x", 0.5)],
)
def test_limits_that_are_zero_or_crossed_are_refused(name: str, value: float) -> None:
    robot = car()
    with pytest.raises(ValueError, match=name):
        planner(replace(robot, limits=replace(robot.limits, **{name: value})))


@pytest.mark.parametrize("seed", range(2))
def test_unknown_boxes_are_driven_around(seed: int) -> None:
    """Two boxes on the way that the prior does not show; contact is checked exactly at every tick."""
    rng = np.random.default_rng(seed)
    y = 1.5 + rng.uniform(-0.2, 0.2, 2)
    world = field(60, 120, (2.0, y[0] - 0.3, 2.4, y[0] + 0.2), (3.7, y[1] - 0.2, 4.0, y[1] + 0.4))
    start, goal = SE2(0.5, 1.5, rng.uniform(-3, 3)), Goal(np.array([5.4, 1.5]))
    navigator = plan_and_avoid(context(car(), field(60, 120), start), a_star.build, dwa.build)
    result = drive(navigator, car(), world, start, goal)
    assert result.status == "success", result.reason


def test_the_car_speeds_up_and_turns_as_its_trajectories_say() -> None:
    """Oracle: MuJoCo. From rest, twists ramped at the limits that the planner is told: after 1.5 s the car is within 2 cm and
    0.06 rad of where the planner's own simulation has it; so the accelerations are the car's."""
    simulation = robocar.simulate({"map": str(MODELS / "maps" / "cluttered.yaml"), "start": [0.5, 0.5, 0.3], "goal": [1, 1]})
    try:
        limits, dt = simulation.robot.robot.limits, simulation.control_period
        simulation.robot.sense()
        start, expected, twist = simulation.ground_truth().pose, SE2(), Twist()
        for _ in range(round(1.5 / dt)):
            twist = Twist(min(0.4, twist.v + limits.acc_lim_x * dt), min(0.8, twist.omega + limits.acc_lim_theta * dt))
            simulation.robot.act(Drive(twist))
            simulation.step()
            simulation.robot.sense()
            expected = expected @ twist.step(dt)
        moved = start.inverse() @ simulation.ground_truth().pose
    finally:
        simulation.close()
    assert expected.x > 0.3
    assert math.dist(moved.position, expected.position) < 0.02
    assert abs(moved.theta - expected.theta) < 0.06
