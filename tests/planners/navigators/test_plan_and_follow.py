"""Plan and follow, and react, in a small world without physics."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import (
    OCCUPIED,
    SE2,
    Belief,
    Drive,
    Field,
    GiveUp,
    Goal,
    Hold,
    Lines,
    Navigator,
    Observation,
    OccupancyGrid,
    Points,
    Scan,
    Serial,
    State,
    Text,
    Twist,
)
from robocar.core.work import total
from robocar.formats.generated import maze, rooms
from robocar.planners.controllers import pure_pursuit
from robocar.planners.costmap.layered import inflate
from robocar.planners.navigators.plan_and_follow import NavigatorParameters, PlanAndFollow, plan_and_follow
from robocar.planners.navigators.reactive import Reactive
from robocar.planners.search import a_star, d_star_lite, theta_star
from tests.planners.kinematic import BEAM, DT, Drives, car, context, drive

PLANNERS = {"a-star": a_star.build, "theta-star": theta_star.build, "d-star-lite": d_star_lite.build}


def field(rows: int, cols: int, *boxes: tuple[float, float, float, float]) -> OccupancyGrid:
    """An open field on 5 cm cells with boxes given as (x0, y0, x1, y1) [m]."""
    data = np.zeros((rows, cols), dtype=np.int8)
    for x0, y0, x1, y1 in boxes:
        data[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = OCCUPIED
    return OccupancyGrid(data, 0.05)


def navigator(prior: OccupancyGrid | None, start: SE2, planner: str = "a-star", **parameters: object) -> PlanAndFollow:
    return plan_and_follow(context(car(), prior, start, **parameters), PLANNERS[planner], pure_pursuit.build)


def texts(drives: Drives) -> list[str]:
    return [trace["plan"].message for trace in drives.traces if "plan" in trace]


@pytest.mark.parametrize("planner", list(PLANNERS))
def test_it_drives_to_the_goal_without_contact(planner: str) -> None:
    """Contact is checked exactly at every tick by the world; the way is at most 30 % longer than the planner's own path."""
    world = field(60, 100, (1.5, 0.0, 1.7, 2.2), (3.0, 0.8, 3.2, 3.0))
    start = SE2(0.5, 0.5, 2.0)
    drives = drive(navigator(world, start, planner), car(), world, start, Goal(np.array([4.5, 2.5])))
    assert drives.status == "success"
    (path,) = drives.traces[0]["global"].lines
    assert drives.length <= 1.3 * np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


@pytest.mark.parametrize(("planner", "seed"), [("a-star", 0), ("d-star-lite", 1), ("theta-star", 2)])
def test_rooms_are_driven_without_contact(planner: str, seed: int) -> None:
    """Generated rooms, two free cells chosen at random where the car can turn; contact is checked exactly at every tick."""
    rng = np.random.default_rng(seed)
    world = rooms(90, 90, rng, resolution=0.05)
    cells = np.argwhere(~inflate(world, car().footprint.circumscribed_radius).blocked)
    a, b = world.world_from_cell(cells[rng.integers(len(cells), size=2)])
    start = SE2(a[0], a[1], rng.uniform(-3, 3))
    drives = drive(navigator(world, start, planner), car(), world, start, Goal(b), ticks=4000)
    assert drives.status == "success", drives.reason


def test_a_maze_with_corridors_of_0_4_m_is_driven() -> None:
    world = maze(11, 11, 1, np.random.default_rng(5), resolution=0.4)
    cells = np.argwhere(world.free)
    a, b = world.world_from_cell(cells[[0, -1]])
    drives = drive(navigator(world, SE2(*a)), car(), world, SE2(*a), Goal(b), ticks=4000)
    assert drives.status == "success"


@pytest.mark.parametrize("planner", list(PLANNERS))
def test_an_obstacle_that_the_map_does_not_show_is_driven_around(planner: str) -> None:
    """The prior lacks a box across the straight way: the sonars see it, the path is replanned, nothing is touched."""
    world, prior = field(60, 100, (2.2, 1.0, 2.5, 1.9)), field(60, 100)
    start = SE2(0.5, 1.5, 0.0)
    nav = navigator(prior, start, planner)
    drives = drive(nav, car(), world, start, Goal(np.array([4.5, 1.5])))
    assert drives.status == "success"
    assert total(*drives.work)["replans"] >= 1
    assert any(text.startswith("path blocked") for text in texts(drives))


def test_without_a_map_it_finds_its_way_around_a_box() -> None:
    world = field(80, 120, (2.0, 1.2, 2.3, 2.6))
    start = SE2(0.6, 2.0, 0.0)
    drives = drive(navigator(None, start), car(), world, start, Goal(np.array([5.0, 2.0])))
    assert drives.status == "success"


def test_the_same_episode_twice_is_bit_identical() -> None:
    world, prior = field(60, 100, (2.2, 1.0, 2.5, 1.9)), field(60, 100)
    start = SE2(0.5, 1.5, 0.0)
    goal = Goal(np.array([4.5, 1.5]))
    runs = [drive(navigator(prior, start, "d-star-lite"), car(), world, start, goal).poses for _ in range(2)]
    assert runs[0] == runs[1]


def test_it_gives_up_with_the_planner_s_reason() -> None:
    """A wall through the whole known map; and a goal in a wall."""
    world = field(40, 80, (2.0, 0.0, 2.2, 2.0))
    start = SE2(0.5, 1.0)
    closed = drive(navigator(world, start), car(), world, start, Goal(np.array([3.5, 1.0])))
    assert (closed.status, closed.twists) == ("no_path", [])
    assert "no way from (0.500, 1.000) to (3.500, 1.000)" in closed.reason
    inside = drive(navigator(world, start), car(), world, start, Goal(np.array([2.1, 1.0])))
    assert "the robot does not fit at the goal" in inside.reason
    outside = drive(navigator(world, start), car(), world, start, Goal(np.array([9.0, 1.0])))
    assert "lies outside the map" in outside.reason


def test_a_way_closed_by_what_is_seen_ends_stuck_after_looking_again() -> None:
    """The gap of the prior is walled up: it drives there, sees it, forgets what it saw once in vain, and gives up untouched."""
    prior = field(40, 80, (2.0, 0.0, 2.2, 0.7), (2.0, 1.3, 2.2, 2.0))
    world = field(40, 80, (2.0, 0.0, 2.2, 2.0))
    start = SE2(0.5, 1.0)
    drives = drive(navigator(prior, start), car(), world, start, Goal(np.array([3.5, 1.0])))
    assert drives.status == "stuck"
    assert drives.length > 0.5


def test_a_goal_too_near_to_a_wall_is_approached_within_its_tolerance() -> None:
    """The goal lies 7 cm from the wall, the car's inscribed radius is 9 cm: it goes to the nearest place that is good enough."""
    world = field(40, 80, (3.0, 0.0, 3.2, 2.0))
    start = SE2(0.5, 1.0)
    goal = Goal(np.array([2.93, 1.0]))
    drives = drive(navigator(world, start), car(), world, start, goal)
    assert drives.status == "success"


def test_a_new_goal_is_planned_for_at_once_and_counts_begin_anew() -> None:
    nav = navigator(field(40, 80), SE2(0.5, 1.0))
    for k, goal in enumerate([Goal(np.array([2.0, 1.0])), Goal(np.array([0.6, 0.5]))]):
        command = nav.command(State.of(Belief(SE2(0.5, 1.0))), Observation(k * DT), goal)
        np.testing.assert_array_equal(command.trace["global"].lines[0][-1], goal.position)
        assert command.trace["plan"].message.startswith("new goal")
        assert set(command.work) == {"expansions"}
    again = nav.command(State.of(Belief(SE2(0.5, 1.0))), Observation(0.1), Goal(np.array([0.6, 0.5])))
    assert "global" not in again.trace
    assert again.work == {}


@pytest.mark.parametrize("planner", list(PLANNERS))
def test_out_of_an_unknown_dead_end_it_comes_back(planner: str) -> None:
    """By hand: a U of 4 x 2 m, open to the left, round the start, the goal behind it; the car has no map and must leave the U."""
    world = field(160, 200, (2.0, 2.9, 6.1, 3.0), (2.0, 5.0, 6.1, 5.1), (6.0, 2.9, 6.1, 5.1))
    start, goal = SE2(4.5, 4.0), Goal(np.array([7.5, 4.0]))
    drives = drive(navigator(None, start, planner), car(), world, start, goal)
    assert drives.status == "success"
    assert min(pose.x for pose in drives.poses) < 2.0


def test_where_there_is_no_way_it_says_so_in_the_end() -> None:
    """By hand: a closed room of 2 x 2 m without a map, the goal outside. It believes it when it has looked again."""
    world = field(80, 160, (1.0, 1.0, 3.1, 1.1), (1.0, 3.0, 3.1, 3.1), (1.0, 1.0, 1.1, 3.1), (3.0, 1.0, 3.1, 3.1))
    start, goal = SE2(2.0, 2.0), Goal(np.array([6.0, 2.0]))
    drives = drive(navigator(None, start, max_clearings=2), car(), world, start, goal, ticks=12_000)
    assert (drives.status, drives.reason[:12]) == ("stuck", "no way from ")


def test_off_the_path_it_plans_anew() -> None:
    nav = navigator(field(60, 100), SE2(0.5, 1.0))
    goal = Goal(np.array([4.0, 1.0]))
    nav.command(State.of(Belief(SE2(0.5, 1.0))), Observation(0.0), goal)
    assert "global" not in nav.command(State.of(Belief(SE2(0.8, 1.2))), Observation(0.1), goal).trace
    command = nav.command(State.of(Belief(SE2(1.0, 1.5))), Observation(0.2), goal)
    np.testing.assert_array_equal(command.trace["global"].lines[0][0], [1.0, 1.5])
    assert command.work["replans"] == 1
    assert command.trace["plan"].message.startswith("0.47 m off the path")  # which runs along cell centres, y = 1.025


def test_what_a_planning_shows() -> None:
    """Design, section 10: path, costmap, heat map of the search, counts and a line of the log."""
    nav = navigator(field(40, 80), SE2(0.5, 1.0))
    trace = nav.command(State.of(Belief(SE2(0.5, 1.0))), Observation(0.0), Goal(np.array([2.0, 1.0]))).trace
    kinds = {name: type(drawable) for name, drawable in trace.items()}
    assert kinds == {"global": Lines, "plan": Text, "costmap": Field, "search": Field, "lookahead": Points}


def test_an_obstacle_inside_its_own_inflation_is_escaped_from() -> None:
    """The car stands 7 cm beside a post, too near to plan from there: it plans from the nearest free cell."""
    world = field(40, 80, (1.0, 1.12, 1.1, 1.3))
    nav = navigator(world, SE2(1.05, 1.05))
    command = nav.command(State.of(Belief(SE2(1.05, 1.05))), Observation(0.0), Goal(np.array([3.0, 1.0])))
    assert isinstance(command, Drive)
    path = command.trace["global"].lines[0]
    np.testing.assert_array_equal(path[0], [1.05, 1.05])
    costmap = nav.costmap.costmap()
    blocked = [costmap.data[tuple(cell)] >= 253 for cell in costmap.cell_from_world(path)]
    assert blocked[0]
    assert not any(blocked[1:])


def test_at_the_goal_it_stands_and_turns_to_its_heading() -> None:
    nav = navigator(field(40, 80), SE2(2.0, 1.0))
    at_goal = nav.command(State.of(Belief(SE2(2.0, 1.0))), Observation(0.0), Goal(np.array([2.0, 1.01])))
    assert at_goal.twist == Twist()
    turning = nav.command(State.of(Belief(SE2(2.0, 1.0))), Observation(0.1), Goal(np.array([2.0, 1.01]), heading=1.0))
    assert turning.twist.v == 0.0
    assert turning.twist.omega > 0.0


def test_without_a_goal_it_gives_up() -> None:
    for nav in (navigator(field(40, 80), SE2(0.5, 1.0)), Reactive(Recorder())):
        assert isinstance(nav, Navigator)
        assert isinstance(nav.command(State.of(Belief(SE2())), Observation(0.0), None), GiveUp)


class Recorder:
    """A controller that counts how often it is asked."""

    def __init__(self, serial: bool = False) -> None:
        self.asked, self.serial = 0, serial

    def command(self, state, path, costmap, observation, goal):
        self.asked += 1
        return Serial("M1") if self.serial else Drive(Twist(0.1 * self.asked), trace={"note": Text("asked")})


def scan(time: float) -> Observation:
    return Observation(time, sonars=(Scan(time, np.array([1.0]), np.zeros(1), 4.0, BEAM),))


def test_reactive_asks_at_new_scans_repeats_in_between_and_stops_when_they_stay_away() -> None:
    """By hand: scans at 0.1 and 0.2 s; repeated until 0.7 s, stopped after it, awake again at the next scan."""
    goal, nav = Goal(np.zeros(2)), Reactive(Recorder())

    def speed(observation: Observation) -> float:
        return nav.command(State.of(Belief(SE2())), observation, goal).twist.v

    assert speed(Observation(0.0)) == 0.0
    assert [speed(scan(0.1)), speed(Observation(0.15)), speed(scan(0.2))] == pytest.approx([0.1, 0.1, 0.2])
    assert [speed(Observation(t)) for t in (0.3, 0.7, 0.71, 0.9)] == pytest.approx([0.2, 0.2, 0.0, 0.0])
    assert speed(scan(1.0)) == pytest.approx(0.3)
    assert nav.command(State.of(Belief(SE2())), Observation(1.05), goal).trace == {}


def test_reactive_does_not_send_a_serial_line_twice() -> None:
    goal, nav = Goal(np.zeros(2)), Reactive(Recorder(serial=True))
    assert nav.command(State.of(Belief(SE2())), scan(0.0), goal) == Serial("M1")
    assert nav.command(State.of(Belief(SE2())), Observation(0.1), goal) == Hold()


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_boxes_are_never_touched(seed: int) -> None:
    """Property: whatever becomes of the episode, it is no contact; the map is known. Starts where the car can turn."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform([0.0, 0.0], [3.5, 2.5], (8, 2))
    world = field(60, 80, *((x, y, x + w, y + h) for (x, y), (w, h) in zip(corners, rng.uniform(0.05, 0.6, (8, 2)), strict=True)))
    cells = np.argwhere(~inflate(world, car().footprint.circumscribed_radius).blocked)
    a, b = world.world_from_cell(cells[rng.integers(len(cells), size=2)])
    start = SE2(a[0], a[1], rng.uniform(-3, 3))
    drives = drive(navigator(world, start), car(), world, start, Goal(b), ticks=1500)
    assert drives.status in ("success", "no_path", "stuck", "timeout")
    assert drives.status != "timeout" or drives.length > 0.0


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_wrong_parameters_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="max_path_deviation"):
        NavigatorParameters(max_path_deviation=value)
