"""Down the gradient without a path. Oracles: the corridor's potential in closed form, cold solutions, exact contact checks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robocar.core import (
    LETHAL,
    OCCUPIED,
    SE2,
    Belief,
    Costmap,
    Drive,
    Field,
    Goal,
    Lines,
    Observation,
    OccupancyGrid,
    ParameterError,
    Path,
    State,
    Text,
    Twist,
)
from robocar.formats.generated import maze, rooms
from robocar.planners.controllers.pure_pursuit import PurePursuit
from robocar.planners.costmap.layered import inflate
from robocar.planners.harmonic import local as harmonic_local
from robocar.planners.harmonic import planner as harmonic
from robocar.planners.harmonic.laplace import laplace_problem, solve
from robocar.planners.harmonic.local import HarmonicLocal, HarmonicLocalParameters
from robocar.planners.harmonic.planner import Harmonic
from robocar.planners.harmonic.streamline import streamline
from tests.planners.kinematic import DT, Drives, car, context, drive

NOTHING = Observation(0.0)
RESOLUTION = 0.05


def follower(**parameters: float) -> HarmonicLocal:
    return HarmonicLocal(Harmonic(), PurePursuit(car(), DT), HarmonicLocalParameters(**parameters))


def hall(rows: int, cols: int, *boxes: tuple[float, float, float, float], origin: SE2 | None = None) -> Costmap:
    """Free cells of 5 cm with blocked boxes given as (x0, y0, x1, y1) [m] in the grid's frame."""
    costs = np.zeros((rows, cols), dtype=np.uint8)
    for x0, y0, x1, y1 in boxes:
        costs[round(y0 / RESOLUTION) : round(y1 / RESOLUTION), round(x0 / RESOLUTION) : round(x1 / RESOLUTION)] = LETHAL
    return Costmap(costs, RESOLUTION, origin or SE2())


def way_of(command: Drive) -> np.ndarray:
    lines = command.trace["local"]
    assert isinstance(lines, Lines)
    return lines.lines[0]


@pytest.mark.parametrize("origin", [SE2(), SE2(-3.0, 2.0, 0.7)])
@pytest.mark.parametrize("offset", [0.3, -0.45])
def test_in_a_corridor_it_heads_for_the_middle_as_the_closed_form_says(origin: SE2, offset: float) -> None:
    """Analytic: w = exp(k x) cos(k y) far from the ends, so sin(k y) falls like exp(-k x) along a streamline; walls hold 0 at the
    centres of the cells beside the corridor."""
    rows, cols = 31, 400
    corridor = hall(rows, cols, origin=origin)
    middle = rows * RESOLUTION / 2
    start = origin @ SE2(6.0, middle + offset, 0.0)
    goal = Goal(origin.transform(np.array([18.0, middle])))
    way = origin.inverse().transform(
        way_of(follower(horizon=1.5).command(State.of(Belief(start)), None, corridor, NOTHING, goal))
    )
    k = math.pi / ((rows + 1) * RESOLUTION)
    expected = np.arcsin(math.sin(k * offset) * np.exp(-k * (way[:, 0] - 6.0))) / k
    np.testing.assert_allclose(way[:, 1] - middle, expected, atol=0.006)
    assert 1.5 <= np.linalg.norm(np.diff(way, axis=0), axis=1).sum() <= 1.5 + RESOLUTION


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.01, 1.2))
@settings(max_examples=40, deadline=None)
def test_a_short_streamline_is_the_beginning_of_the_long_one(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    walls = rng.random((20, 30)) < 0.2
    walls[5, 5] = walls[15, 25] = False
    potential = solve(laplace_problem(walls, (15, 25)))
    start = np.array([5.5, 5.5])
    assume(potential.problem.unknowns[5, 5])
    long = streamline(potential, start)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(long, axis=0), axis=1))])
    limit = share * lengths[-1]
    short = streamline(potential, start, max_length=limit)
    np.testing.assert_array_equal(short, long[: len(short)])
    assert len(short) == min(len(long), 1 + np.searchsorted(lengths, limit))


def test_the_path_it_is_given_is_not_followed() -> None:
    """Property: a car with a path along the wall and one with none drive the same, from tick to tick."""
    room = hall(60, 100, (2.0, 0.0, 2.3, 2.0))
    goal = Goal(np.array([4.5, 0.5]))
    crooked = Path(np.array([[0.5, 0.5], [0.15, 2.8], [4.8, 2.8], [4.5, 0.5]]))
    driven = []
    for path in (None, crooked):
        local, pose, twists = follower(), SE2(0.5, 0.5, 0.3), []
        for _ in range(100):
            twists.append(local.command(State.of(Belief(pose)), path, room, NOTHING, goal).twist)
            pose = pose @ twists[-1].step(DT)
        driven.append(twists)
    assert driven[0] == driven[1]
    assert max(t.v for t in driven[0]) > 0.3


def test_what_blocks_the_way_has_the_potential_solved_again_and_what_does_not_has_not() -> None:
    """Oracle: the new way keeps to free cells, and the potential is that of a solver that starts from nothing."""
    local = follower()
    goal, pose = Goal(np.array([4.5, 1.5])), SE2(0.5, 1.5)
    before = hall(60, 100)
    assert "harmonic_local" in local.command(State.of(Belief(pose)), None, before, NOTHING, goal).trace
    aside = hall(60, 100, (2.5, 2.5, 2.8, 2.8))
    command = local.command(State.of(Belief(pose)), None, aside, NOTHING, goal)
    assert set(command.trace) == {"local", "lookahead"}
    blocked = hall(60, 100, (1.0, 1.3, 1.2, 1.8))
    command = local.command(State.of(Belief(pose)), None, blocked, NOTHING, goal)
    assert isinstance(command.trace["harmonic_local"], Text)
    field = command.trace["harmonic/potential"]
    assert isinstance(field, Field)
    cold, _ = Harmonic().potential(blocked, blocked.cell_inside(goal.position))
    free = ~blocked.blocked
    np.testing.assert_allclose(field.grid.data[free], (cold.log2 * math.log10(2.0))[free], rtol=0, atol=1e-8)
    assert np.isnan(field.grid.data[~free]).all()
    cells = blocked.cell_from_world(way_of(command))
    assert not blocked.blocked[cells[:, 0], cells[:, 1]].any()


@pytest.mark.parametrize("news", ["a new path", "another goal", "a larger map", "a reset"])
def test_what_is_farther_off_than_the_horizon_counts_from_a_new_plan_on(news: str) -> None:
    """Oracle: a follower that has seen nothing before."""
    path, goal, pose = Path(np.array([[0.5, 1.4], [4.5, 1.5]])), Goal(np.array([4.5, 1.5])), SE2(0.5, 1.4)
    seen = hall(60, 100, (2.5, 0.0, 2.8, 2.0))
    local = follower(horizon=0.5)
    before = way_of(local.command(State.of(Belief(pose)), path, hall(60, 100), NOTHING, goal))
    np.testing.assert_array_equal(way_of(local.command(State.of(Belief(pose)), path, seen, NOTHING, goal)), before)
    if news == "a new path":
        path = Path(path.points + 0.0)
    elif news == "another goal":
        goal = Goal(goal.position - 0.2)
    elif news == "a larger map":
        seen = hall(61, 100, (2.5, 0.0, 2.8, 2.0))
    else:
        local = follower(horizon=0.5)
    after = way_of(local.command(State.of(Belief(pose)), path, seen, NOTHING, goal))
    expected = way_of(follower(horizon=0.5).command(State.of(Belief(pose)), path, seen, NOTHING, goal))
    np.testing.assert_allclose(after, expected, atol=1e-9)
    assert np.abs(after[-1] - before[-1]).max() > 0.02


def test_from_blocked_cells_the_way_leads_over_the_nearest_free_one() -> None:
    """By hand: the car stands one cell deep in the left of a box's cells."""
    room = hall(60, 100, (1.0, 1.0, 1.5, 2.0))
    way = way_of(follower().command(State.of(Belief(SE2(1.02, 1.52))), None, room, NOTHING, Goal(np.array([4.0, 1.5]))))
    np.testing.assert_allclose(way[:2], [[1.02, 1.52], [0.975, 1.525]], atol=1e-9)


def test_near_the_goal_the_way_ends_at_it() -> None:
    goal = Goal(np.array([2.01, 1.49]))
    way = way_of(follower().command(State.of(Belief(SE2(1.5, 1.5))), None, hall(60, 60), NOTHING, goal))
    np.testing.assert_array_equal(way[-1], goal.position)


@pytest.mark.parametrize(
    "boxes", [[(3.0, 0.0, 3.2, 3.0)], [(4.4, 1.4, 4.6, 1.6)]], ids=["a wall before the goal", "the goal is blocked"]
)
def test_where_no_streamline_leads_to_the_goal_the_path_is_driven(boxes: list[tuple[float, float, float, float]]) -> None:
    """Oracle: pure pursuit alone."""
    room, path, goal = hall(60, 100, *boxes), Path(np.array([[0.5, 0.5], [2.0, 1.0]])), Goal(np.array([4.5, 1.5]))
    belief = Belief(SE2(0.5, 0.5, 0.2))
    expected = PurePursuit(car(), DT).command(State.of(belief), path, room, NOTHING, goal)
    assert expected.twist != Twist()
    assert follower().command(State.of(belief), path, room, NOTHING, goal).twist == expected.twist


def test_outside_the_map_and_without_one_it_still_commands() -> None:
    """Oracle: pure pursuit alone."""
    goal, path = Goal(np.array([2.0, 1.5])), Path(np.array([[-1.0, 1.5], [2.0, 1.5]]))
    belief = Belief(SE2(-1.0, 1.5, 0.1))
    for costmap in (hall(60, 60), None):
        expected = PurePursuit(car(), DT).command(State.of(belief), path, costmap, NOTHING, goal)
        assert follower().command(State.of(belief), path, costmap, NOTHING, goal).twist == expected.twist


def navigate(world: OccupancyGrid, prior: OccupancyGrid | None, start: SE2, goal: Goal, ticks: int = 3000, **parameters: object):
    navigator = harmonic_local.build(context(car(), prior, start, **parameters))
    return drive(navigator, car(), world, start, goal, ticks)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rooms_are_driven_without_contact(seed: int) -> None:
    """Generated rooms, two free cells chosen at random where the car can turn; contact is checked exactly at every tick."""
    rng = np.random.default_rng(seed)
    world = rooms(90, 90, rng, resolution=RESOLUTION)
    cells = np.argwhere(~inflate(world, car().footprint.circumscribed_radius).blocked)
    a, b = world.world_from_cell(cells[rng.integers(len(cells), size=2)])
    drives = navigate(world, world, SE2(a[0], a[1], rng.uniform(-3, 3)), Goal(b))
    assert drives.status == "success", drives.reason


def test_a_maze_is_driven_without_contact() -> None:
    world = maze(7, 7, 1, np.random.default_rng(5), resolution=0.4)
    cells = np.argwhere(world.free)
    start, goal = world.world_from_cell(cells[[0, -1]])
    drives = navigate(world, world, SE2(start[0], start[1]), Goal(goal))
    assert drives.status == "success", drives.reason


@pytest.mark.parametrize("known", [True, False], ids=["prior map without them", "no prior map"])
def test_unmapped_obstacles_are_driven_around(known: bool) -> None:
    """Contact is checked exactly at every tick; without a look around them the straight way would hit the first."""
    data = np.zeros((60, 100), dtype=np.int8)
    prior = OccupancyGrid(data, RESOLUTION)
    data = data.copy()
    data[24:36, 30:36] = data[10:26, 60:66] = OCCUPIED
    start = SE2(0.25, 1.5)  # too far off to hear the first at once
    drives = navigate(OccupancyGrid(data, RESOLUTION), prior if known else None, start, Goal(np.array([4.5, 1.4])))
    assert drives.status == "success", drives.reason
    assert solutions(drives) >= 2


def solutions(drives: Drives) -> int:
    """How often the potential was solved."""
    return sum("harmonic/potential" in trace for trace in drives.traces)


def test_without_a_way_it_gives_up() -> None:
    data = np.zeros((60, 100), dtype=np.int8)
    data[:, 50:53] = OCCUPIED
    world = OccupancyGrid(data, RESOLUTION)
    drives = navigate(world, world, SE2(0.5, 1.5), Goal(np.array([4.5, 1.5])))
    assert (drives.status, len(drives.poses)) == ("no_path", 1)
    assert "no way" in drives.reason


def test_a_second_episode_drives_as_the_first() -> None:
    """Property: nothing outlasts the navigator."""
    world = OccupancyGrid(np.zeros((60, 60), dtype=np.int8), RESOLUTION)
    first, second = [], []
    for drives in (first, second):
        navigator = harmonic_local.build(context(car(), world, SE2(0.5, 0.5)))
        drives.extend(drive(navigator, car(), world, SE2(0.5, 0.5), Goal(np.array([2.0, 2.2]))).twists)
    assert first == second
    assert len(first) > 50


def test_parameters_are_checked_and_reach_their_parts() -> None:
    world = OccupancyGrid(np.zeros((60, 60), dtype=np.int8), RESOLUTION)
    navigator = harmonic_local.build(
        context(car(), world, None, controller={"horizon": 0.7, "lookahead_dist": 0.3}, planner={"max_step": 0.25})
    )
    assert isinstance(navigator.controller, HarmonicLocal)
    assert navigator.controller.planner is navigator.global_planner
    assert navigator.controller.parameters.horizon == 0.7
    assert navigator.controller.planner.parameters == harmonic.HarmonicParameters(max_step=0.25)
    assert navigator.controller.pursuit.parameters.lookahead_dist == 0.3
    with pytest.raises(ParameterError, match=r"horizon must be at least 0.1 m, not 0.05"):
        harmonic_local.build(context(car(), world, None, controller={"horizon": 0.05}))
