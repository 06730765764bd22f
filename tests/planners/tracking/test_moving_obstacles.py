"""What moves, as controllers see it, and how they get out of its way. Oracles: the truth, brute force, exact distances."""

import math
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import OCCUPIED, SE2, STOP, Array, Costmap, Drive, Goal, Observation, OccupancyGrid, State, Twist
from robocar.planners.controllers import dwa, mppi
from robocar.planners.controllers.dwa import DynamicWindow
from robocar.planners.controllers.mppi import MPPI
from robocar.planners.controllers.steering import Steering, SteeringParameters
from robocar.planners.controllers.trajectory_costs import DEPTH, NEVER, RobotBody, RolloutAim, RolloutHorizon, rollouts
from robocar.planners.geometry.outlines import CostmapView, Outlines
from robocar.planners.navigators.plan_and_follow import plan_and_avoid
from robocar.planners.search import a_star
from robocar.planners.tracking.moving_obstacles import NONE, MovingObstacles, courses, depth_later, encounter, met, near
from tests.planners.beams import PERIOD, Disc, drive, laser_car, scan_of
from tests.planners.kinematic import context

OPEN = OccupancyGrid(np.zeros((160, 160), dtype=np.int8), 0.05)
NOWHERE = CostmapView(np.zeros((1, 1), dtype=np.uint8), 1.0, 0.0, 0.0, 0.0, None, 0.0)  # in which discs are given in metres


class Turning(Disc):
    """Goes to and fro: it turns back at `TURN`."""

    TURN = 3.0  # [s]

    def at(self, time: float) -> Array:
        return super().at(time if time < self.TURN else 2.0 * self.TURN - time)


def seen(movers: list[Disc], seconds: float, pose: SE2 = SE2(4.0, 4.0), twist: Twist = Twist()) -> MovingObstacles:
    """What is known after scans every 0.1 s, with the laser's noise, from a robot that drives."""
    robot, rng = laser_car(), np.random.default_rng(0)
    moving = MovingObstacles(robot)
    for k in range(round(seconds / 0.1) + 1):
        moving.update(pose, Observation(0.1 * k, lidar=scan_of(robot, OPEN, pose, 0.1 * k, movers, rng)))
        pose = pose @ twist.step(0.1)
    return moving


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_encounters_are_those_of_all_discs_at_all_times(seed: int) -> None:
    """Brute force with numpy."""
    rng = np.random.default_rng(seed)
    discs = np.column_stack([rng.uniform(-20, 20, (3, 2)), rng.uniform(-6, 6, (3, 2)), rng.uniform(2, 8, 3)])
    times = np.arange(0.1, 4.05, 0.1)
    distances = np.linalg.norm(discs[:, None, :2] + times[:, None] * discs[:, None, 2:4], axis=2)
    shares = distances / discs[:, 4:]
    depths = np.maximum(0.0, 1.0 - shares).sum(axis=0)
    closeness = np.clip(2.0 - shares.min(axis=0), 0.0, 1.0)
    found = np.array([encounter(discs, t, 0.0, 0.0) for t in times])
    np.testing.assert_allclose(found, np.column_stack([depths, closeness]), atol=1e-12)
    assert depth_later(discs, 0.0, 4.0, 0.1, 0.0, 0.0) == pytest.approx(depths.sum())


def test_an_encounter_outweighs_all_else_and_the_deepest_is_worst() -> None:
    assert met(0.0, 0.0) == 0.0
    assert 0.0 < met(0.0, 0.5) < met(0.0, 1.0) < 5.0 < met(1e-6, 1.0) < met(0.3, 1.0)
    np.testing.assert_array_equal(met(np.array([0.0, 0.2]), np.array([0.5, 1.0])), [met(0.0, 0.5), met(0.2, 1.0)])


@settings(max_examples=60, deadline=None)
@given(vx=st.floats(-0.4, 0.4), vy=st.floats(-0.4, 0.4), ahead=st.floats(0.0, 0.3))
def test_straight_on_is_one_course(vx: float, vy: float, ahead: float) -> None:
    """Analytic."""
    times = np.arange(0.0, 1.05, 0.1)
    centres = np.column_stack([times, 2.0 + vx * times, 3.0 + vy * times])
    ((x, y, *velocity),) = courses(centres, 1.0 + ahead)
    assert (x, y) == pytest.approx((2.0 + vx * (1.0 + ahead), 3.0 + vy * (1.0 + ahead)))
    assert velocity == pytest.approx([vx, vy])


def test_one_that_has_turned_back_may_do_either() -> None:
    """0.4 s after a turn the last 0.35 s show its new velocity; the whole second does not."""
    times = np.arange(0.0, 1.05, 0.1)
    centres = np.column_stack([times, 0.3 * np.where(times < 0.6, times, 1.2 - times), np.zeros(11)])
    lagging, recent = courses(centres, 1.0)
    assert recent == pytest.approx((0.06, 0.0, -0.3, 0.0))
    assert lagging[2] > -0.15
    # What its places say it cannot be so fast.
    assert max(math.hypot(*course[2:]) for course in courses(centres * [1.0, 20.0, 1.0], 1.0)) == pytest.approx(0.6)


@pytest.mark.parametrize("twist", [Twist(), Twist(0.3, 0.0), Twist(0.2, 0.8)])
@pytest.mark.parametrize("velocity", [(0.3, 0.0), (-0.1, 0.2), (0.0, -0.3)])
def test_discs_lie_where_the_movers_are(velocity: tuple[float, float], twist: Twist) -> None:
    """Oracle: the truth, seen from a robot that stands, drives, turns. Room: both radii and 0.1 m."""
    mover = Disc((5.0, 5.2), velocity, 0.15)
    (row,) = seen([mover], 2.0, twist=twist).discs(NOWHERE, None, 2.05)
    assert row[:2] == pytest.approx(mover.at(2.05), abs=0.06)
    assert row[2:4] == pytest.approx(velocity, abs=0.07)
    assert row[4] == pytest.approx(0.15 + laser_car().footprint.circumscribed_radius + 0.1, abs=0.04)


@pytest.mark.parametrize("after", [0.5, 0.7, 1.0])
def test_one_that_turns_back_is_not_lost_sight_of(after: float) -> None:
    """Its speed passes through zero: a tracker alone would take it for something that stands. One of its courses is the truth."""
    mover = Turning((5.0, 4.0), (0.0, 0.3), 0.15)
    time = mover.TURN + after
    discs = seen([mover], time).discs(NOWHERE, None, time)
    assert len(discs) > 0
    off = np.linalg.norm(discs[:, 2:4] - (0.0, -0.3), axis=1)
    assert off.min() < 0.1
    assert discs[np.argmin(off), :2] == pytest.approx(mover.at(time), abs=0.08)


def test_what_stands_is_none() -> None:
    assert len(seen([Disc((5.0, 5.0), (0.0, 0.0), 0.15)], 2.0, twist=Twist(0.3, 0.2)).discs(NOWHERE, None, 2.0)) == 0
    moving = seen([Disc((5.0, 5.0), (0.3, 0.0), 0.15)], 2.0)
    assert len(moving.discs(NOWHERE, None, 2.0)) == 1


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_scans_of_any_sort_give_finite_discs(seed: int) -> None:
    """Property: a mover seen through beams that are lost, empty, zero or negative."""
    rng, robot = np.random.default_rng(seed), laser_car()
    moving = MovingObstacles(robot)
    for k in range(20):
        scan = scan_of(robot, OPEN, SE2(4.0, 4.0), 0.1 * k, [Disc((5.0, 3.6), (0.0, 0.3), 0.15)], rng)
        ranges = np.array(scan.ranges)
        ranges[rng.random(len(ranges)) < 0.02 * rng.integers(4)] = rng.choice([0.0, -0.1, np.nan, np.inf])
        moving.update(SE2(4.0, 4.0), Observation(0.1 * k, lidar=replace(scan, ranges=ranges)))
        assert np.isfinite(moving.discs(NOWHERE, None, 0.1 * k)).all()


def test_near_is_within_one_and_a_half_rooms() -> None:
    discs = np.array([[1.0, 0.0, 0.0, 0.0, 0.4]])
    for x, expected in ((0.39, False), (0.41, True), (0.9, True), (1.59, True), (1.61, False)):
        assert near(discs, CostmapView(NOWHERE.costs, 1.0, x, 0.0, 0.0, None, 0.0)) == expected


AISLE = np.zeros((160, 160), dtype=np.int8)
AISLE[:67], AISLE[93:] = OCCUPIED, OCCUPIED  # 1.3 m wide, its middle at y = 4.0


@pytest.mark.parametrize("local", [dwa, mppi])
@pytest.mark.parametrize(
    ("start", "velocity", "world"),
    [
        ((6.5, 4.0), (-0.3, 0.0), OPEN),  # head-on
        ((6.5, 4.15), (-0.3, 0.0), OPEN),  # a little aside
        ((4.0, 1.5), (0.0, 0.3), OPEN),  # from the side, to meet it half way
        ((0.2, 4.1), (0.4, 0.0), OPEN),  # from behind, faster than the car gets up to speed
        ((6.5, 4.0), (-0.3, 0.0), OccupancyGrid(AISLE, 0.05)),  # head-on in an aisle
    ],
)
def test_a_mover_that_gives_way_to_nobody_is_never_touched(
    start: tuple[float, float], velocity: tuple[float, float], world: OccupancyGrid, local: ModuleType
) -> None:
    """Oracle: exact distance of the outline to the disc at every half tick; the car reaches its goal beyond."""
    robot = laser_car()
    setting = replace(context(robot, world), control_period=PERIOD)
    navigator = plan_and_avoid(setting, a_star.build, local.build)
    result = drive(
        navigator, world, SE2(1.0, 4.0), Goal(np.array([7.0, 4.0])), movers=[Disc(start, velocity, 0.15)], seconds=60.0
    )
    assert result.status == "success", result.reason
    assert result.closest > 0.02


@pytest.mark.parametrize("local", [dwa, mppi])
@pytest.mark.parametrize("seed", range(2))
def test_a_mover_that_turns_back_in_front_of_its_follower_is_never_touched(seed: int, local: ModuleType) -> None:
    """Oracle: exact distance; in an aisle, behind a disc that drives ahead at about the car's own speed and comes back."""
    rng, world = np.random.default_rng([21, seed]), OccupancyGrid(AISLE, 0.05)
    navigator = plan_and_avoid(replace(context(laser_car(), world), control_period=PERIOD), a_star.build, local.build)
    start = (2.0 + rng.uniform(0.7, 1.1), 4.0 + rng.uniform(-0.05, 0.05))
    mover = Turning(start, (rng.uniform(0.25, 0.35), 0.0), rng.uniform(0.14, 0.2))
    result = drive(navigator, world, SE2(2.0, 4.0), Goal(np.array([7.5, 4.0])), movers=[mover], seconds=10.0, seed=seed)
    assert result.status != "collision", result.reason


def test_who_backs_away_need_not_stand_in_the_way_afterwards() -> None:
    """A disc comes at 0.3 m/s, 0.8 m ahead. To go on backing is counted as what it is: nothing is met in 4 s; who backed for 2 s
    and stood would be met."""
    start, limits = np.array([80.0, 80.0, 0.0, -4.0, 0.0]), np.array([16.0, 4.0])
    discs, back = np.array([[96.0, 80.0, -6.0, 0.0, 7.6]]), np.array([[-4.0, 0.0]])
    body, aim = RobotBody(np.empty((0, 2)), 2.7, 0.0, False), RolloutAim(np.array([[100.0, 80.0]]), np.array([100.0, 80.0]), 0.0)
    costs = np.zeros((160, 160), dtype=np.uint8)
    costs.flags.writeable = False
    stands, goes_on = (
        rollouts(costs, start, limits, back, body, aim, horizon, discs)[0, DEPTH]
        for horizon in (RolloutHorizon(0.1, 20, 5, NEVER), RolloutHorizon(0.1, 40, 5, NEVER, 0.0))
    )
    # Closed form: the gap of 16 cells shrinks by 2 cells a second while it backs, by 6 once it stands; the room is 7.6 cells.
    assert goes_on == 0.0
    assert stands > 0.0


@pytest.mark.parametrize(("wall", "mover", "expected"), [(False, True, 0.4), (True, True, 0.24), (True, False, 0.12)])
def test_it_slows_down_beside_what_stands_and_not_beside_what_moves(wall: bool, mover: bool, expected: float) -> None:
    """A wall, or the imprint of a mover, 1 cm beside the car: where there is no room for the padded outline it drives at
    `cautious_vel`, twice that where it has to hurry; a mover alone is no reason to be slow."""
    costs = np.zeros((80, 80), dtype=np.uint8)
    costs[42, 40:44] = 254 if mover or wall else 0  # 2 cells north of the centre of the car
    costs[37, :] = 254 if wall else 0
    costs.flags.writeable = False
    robot = laser_car()
    pose, map_ = SE2(2.05, 2.0), Costmap(costs, 0.05)
    view = Outlines(robot.footprint, 0.02).views(map_, pose)[0]
    assert not view.roomy
    discs = np.array([[42.0, 45.5, 0.0, -4.0, (0.17 + 0.1 + robot.footprint.circumscribed_radius) / 0.05]]) if mover else NONE
    assert Steering(robot, 0.1, SteeringParameters()).highest_speed(view, 10.0, discs) == pytest.approx(expected)


class Waits:
    """Stands, as a recovery does, and lets the controller get out of the way."""

    def __init__(self, local: DynamicWindow | MPPI) -> None:
        self.local = local

    def command(self, state: State, observation: Observation, goal: Goal) -> Drive:
        return self.local.evade(state, None, observation) or STOP


@pytest.mark.parametrize("local", [dwa, mppi])
@pytest.mark.parametrize(("start", "comes"), [((6.5, 4.05), True), ((6.5, 5.5), False)])
def test_a_car_that_waits_gets_out_of_the_way_of_what_comes_only(
    start: tuple[float, float], comes: bool, local: ModuleType
) -> None:
    """Oracle: exact distance to a disc that would touch it, or would pass 1.3 m beside it."""
    planner = local.build(replace(context(laser_car(), None), control_period=PERIOD))
    mover = Disc(start, (-0.3, 0.0), 0.15)
    result = drive(Waits(planner), OPEN, SE2(4.0, 4.0), Goal(np.array([9.0, 9.0])), movers=[mover], seconds=14.0)
    assert result.status == "timeout", result.reason
    assert result.closest > 0.02
    assert any(twist != Twist() for twist in result.twists) == comes
    assert result.twists[-1] == Twist()


@pytest.mark.parametrize("local", [dwa, mppi])
def test_a_recovery_gives_way_to_what_comes_and_goes_on(local: ModuleType) -> None:
    """Oracle: exact distance; the goal is blocked by something that stands on it, so the navigator waits and turns."""
    robot, goal = laser_car(), Goal(np.array([5.0, 4.0]))
    setting = replace(context(robot, OPEN), control_period=PERIOD)
    navigator = plan_and_avoid(setting, a_star.build, local.build)
    movers = [Disc((5.0, 4.0), (0.0, 0.0), 0.15), Disc((4.3, 9.5), (0.0, -0.3), 0.15)]
    result = drive(navigator, OPEN, SE2(2.5, 4.0), goal, movers=movers, seconds=30.0)
    assert result.status == "timeout", result.reason
    assert any("recovery" in trace for trace in result.traces)
    assert result.closest > 0.02
