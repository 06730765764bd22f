"""Oracles: connected components, the maximum principle, symmetry, A*, distance transforms, and the plain potential."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Costmap, Field, GoalOccupied, NoPathFound, OutsideMap, ParameterError, StartOccupied
from robocar.formats.generated import maze, rooms
from robocar.formats.movingai import load_movingai_map
from robocar.planners.harmonic.laplace import laplace_problem, solve
from robocar.planners.harmonic.planner import Harmonic, HarmonicParameters, build
from robocar.planners.harmonic.streamline import descend, streamline
from robocar.planners.search.a_star import AStar
from tests.planners.grids import costmaps, free_pair


def free_everywhere(free: np.ndarray, line: np.ndarray) -> bool:
    """Whether a polyline in grid coordinates (n, 2) as (col, row) keeps to free cells: each segment sampled 16 times."""
    t = np.linspace(0, 1, 17)[:, None, None]
    samples = ((1 - t) * line[:-1] + t * line[1:]).reshape(-1, 2) if len(line) > 1 else line
    cells = np.floor(samples).astype(int)
    return bool(free[cells[:, 1], cells[:, 0]].all())


def costmap_of(free: np.ndarray, resolution: float = 0.05, origin: SE2 | None = None) -> Costmap:
    return Costmap(np.where(free, 0, 254).astype(np.uint8), resolution, origin or SE2())


@given(costmaps(), st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=80, deadline=None)
def test_a_path_is_found_exactly_where_there_is_one(costmap, seed, smooth) -> None:
    pair = free_pair(costmap, seed)
    if pair is None:
        return
    start, goal = (costmap.world_from_cell(c) for c in pair)
    planner = Harmonic(HarmonicParameters(smooth=smooth))
    _, labels = cv2.connectedComponents((~costmap.blocked).astype(np.uint8), connectivity=4)
    if labels[tuple(pair[0])] != labels[tuple(pair[1])]:
        with pytest.raises(NoPathFound):
            planner.plan(costmap, start, goal)
        return
    plan = planner.plan(costmap, start, goal)
    np.testing.assert_allclose(plan.path.points[[0, -1]], [start, goal], atol=1e-12)
    assert free_everywhere(~costmap.blocked, costmap.grid_from_world(plan.path.points))
    assert plan.cost == pytest.approx(plan.path.length)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.1, 0.25, 0.38]),
    st.floats(0, 0.999999),  # 1 - 2**-53 added to a column is the next column
    st.floats(0, 0.999999),
)
@settings(max_examples=40, deadline=None)
def test_streamlines_rise_everywhere_and_reach_the_goal(seed, share, dx, dy) -> None:
    rng = np.random.default_rng(seed)
    free = rng.random((24, 31)) >= share
    cells = np.argwhere(free)
    goal = cells[rng.integers(len(cells))]
    potential = solve(laplace_problem(~free, goal))
    starts = np.argwhere(potential.problem.unknowns)
    start = starts[rng.integers(len(starts))] if len(starts) else goal
    line = streamline(potential, (start[1] + dx, start[0] + dy))
    np.testing.assert_allclose(line[[0, -1]], [(start[1] + dx, start[0] + dy), goal[::-1] + 0.5], atol=1e-12)
    assert free_everywhere(free, line)
    assert len(line) < 50 * free.size
    path = descend(potential, tuple(int(i) for i in start))
    w = potential.w[tuple(path.T)]
    assert np.all(np.diff(w) > 0)
    assert np.abs(np.diff(path, axis=0)).max(initial=0) <= 1
    assert tuple(path[-1]) == tuple(goal)


def test_the_streamline_of_a_symmetric_map_is_its_axis() -> None:
    # mirror symmetry: from the middle of a corridor to its other end the line is straight
    potential = solve(laplace_problem(np.zeros((15, 80), dtype=bool), (7, 75)))
    line = streamline(potential, (3.5, 7.5))
    np.testing.assert_allclose(line[:, 1], 7.5, atol=1e-9)
    assert np.all(np.diff(line[:, 0]) > 0)


def test_streamlines_cross_at_right_angles_the_lines_of_equal_potential() -> None:
    # around one goal far from the walls w depends on the distance alone: the streamline is a straight ray
    n = 121
    rows, cols = np.indices((n, n)) - n // 2
    disc = np.hypot(rows, cols) < 58
    potential = solve(laplace_problem(~disc, (n // 2, n // 2)))
    for angle in (0.3, 1.1, 2.5, 4.0):
        centre = n // 2 + 0.5
        line = streamline(potential, centre + 45 * np.array([np.cos(angle), np.sin(angle)])) - centre
        directions = np.arctan2(line[:, 1], line[:, 0])[np.hypot(*line.T) > 5]
        assert len(directions) > 50
        np.testing.assert_allclose(np.angle(np.exp(1j * (directions - angle))), 0, atol=0.06)


@pytest.mark.parametrize("seed", range(3))
def test_streamlines_keep_farther_from_walls_than_shortest_paths(seed) -> None:
    rng = np.random.default_rng(seed)
    free = rooms(120, 120, rng).free
    clearance = cv2.distanceTransform(free.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    costmap = costmap_of(free)
    cells = np.argwhere(clearance > 3)
    pairs = cells[rng.integers(len(cells), size=(50, 2))]
    start, goal = costmap.world_from_cell(next(p for p in pairs if np.abs(p[0] - p[1]).min() > 50))

    def mean_clearance(plan) -> float:
        grid = costmap.grid_from_world(plan.path.points)
        steps = np.linalg.norm(np.diff(grid, axis=0), axis=1)
        middle = np.floor((grid[1:] + grid[:-1]) / 2).astype(int)
        return float(np.average(clearance[middle[:, 1], middle[:, 0]], weights=steps))

    harmonic, shortest = Harmonic().plan(costmap, start, goal), AStar().plan(costmap, start, goal)
    assert mean_clearance(harmonic) > 1.2 * mean_clearance(shortest)
    assert harmonic.path.length >= 0.99 * shortest.path.length * 0.924  # octile paths exceed straight ones by 8 % at most


def test_reflecting_walls_give_shorter_paths_and_mixed_ones_lie_between() -> None:
    free = np.ones((60, 100), dtype=bool)
    free[:45, 30:33] = False
    free[15:, 65:68] = False
    costmap = costmap_of(free)
    start, goal = costmap.world_from_cell([(10, 10), (50, 90)])
    lengths = [
        Harmonic(parameters).plan(costmap, start, goal).path.length
        for parameters in (
            HarmonicParameters(wall_conductance=0.0, leak=0.05),
            HarmonicParameters(wall_conductance=0.02, leak=0.001),
            HarmonicParameters(),
        )
    ]
    shortest = AStar().plan(costmap, start, goal).path.length
    assert lengths[0] < lengths[1] < lengths[2]
    assert lengths[0] < 1.08 * shortest


def test_the_plain_potential_is_flat_in_a_maze_where_ours_is_not() -> None:
    free = maze(60, 60, 2, np.random.default_rng(2)).free
    potential = solve(laplace_problem(~free, (1, 1)))
    starts = [tuple(int(i) for i in c) for c in np.argwhere(potential.problem.unknowns)[::7]]
    assert len(starts) > 200
    plain = 1.0 - potential.w  # u in doubles, as the paper stores it
    stuck = sum(
        u >= min(plain[r + 1, c], plain[r - 1, c], plain[r, c + 1], plain[r, c - 1]) for r, c in starts for u in [plain[r, c]]
    )
    ours = [descend(potential, start)[-1] for start in starts]
    flat = sum(plain[r, c] == 1.0 for r, c in starts)
    assert stuck > 0
    assert flat > 0.5 * len(starts)
    assert np.all(np.array(ours) == (1, 1))


def test_every_random_start_on_every_benchmark_map_reaches_the_goal(data_dir) -> None:
    files = sorted((data_dir / "movingai").glob("*.map"))
    assert files
    rng = np.random.default_rng(0)
    for file in files:
        free = load_movingai_map(file).free
        cells = np.argwhere(free)
        goal = cells[rng.integers(len(cells))]
        potential = solve(laplace_problem(~free, goal))
        starts = np.argwhere(potential.problem.unknowns)
        for start in starts[rng.integers(len(starts), size=60)]:
            assert tuple(descend(potential, (int(start[0]), int(start[1])))[-1]) == tuple(goal)
            line = streamline(potential, start[::-1] + rng.random(2))
            assert tuple(line[-1]) == tuple(goal[::-1] + 0.5)
            assert free_everywhere(free, line)


def test_the_next_start_costs_nothing_and_a_change_of_the_map_is_noticed() -> None:
    free = np.ones((80, 90), dtype=bool)
    free[40, :70] = False
    planner = Harmonic()
    costmap = costmap_of(free, origin=SE2(-1, 2, 0.5))
    start, other, goal = costmap.world_from_cell([(5, 5), (10, 60), (75, 10)])
    assert planner.plan(costmap, start, goal).work["cycles"] > 0
    assert planner.plan(costmap, other, goal).work["cycles"] == 0
    changed = free.copy()
    changed[40, 70:82] = False
    plan = planner.plan(costmap_of(changed, origin=SE2(-1, 2, 0.5)), start, goal)
    assert plan.work["cycles"] > 0
    assert free_everywhere(changed, costmap.grid_from_world(plan.path.points))
    again = Harmonic().plan(costmap_of(changed, origin=SE2(-1, 2, 0.5)), start, goal)
    np.testing.assert_allclose(again.path.points[-1], plan.path.points[-1])
    assert again.path.length == pytest.approx(plan.path.length, rel=1e-6)
    blocked = free.copy()
    blocked[40] = False
    with pytest.raises(NoPathFound):
        planner.plan(costmap_of(blocked, origin=SE2(-1, 2, 0.5)), start, goal)


def test_the_trace_shows_potential_and_streamline() -> None:
    free = np.ones((20, 30), dtype=bool)
    free[5:8, 5:8] = False
    costmap = costmap_of(free)
    trace = Harmonic().plan(costmap, *costmap.world_from_cell([(2, 2), (15, 25)])).trace
    field = trace["harmonic/potential"]
    assert isinstance(field, Field)
    assert field.grid.data[15, 25] == 0.0  # log10 1 at the goal
    assert np.array_equal(np.isnan(field.grid.data), ~free)
    assert set(trace) == {"harmonic/potential", "harmonic/streamline", "harmonic/residual", "harmonic/cycles"}


def test_bad_input_is_named() -> None:
    free = np.ones((10, 10), dtype=bool)
    free[4] = False
    costmap = costmap_of(free, 1.0)
    planner = Harmonic()
    with pytest.raises(OutsideMap):
        planner.plan(costmap, np.array([-1.0, 1.0]), np.array([2.0, 2.0]))
    with pytest.raises(StartOccupied):
        planner.plan(costmap, np.array([1.0, 4.5]), np.array([2.0, 2.0]))
    with pytest.raises(GoalOccupied):
        planner.plan(costmap, np.array([2.0, 2.0]), np.array([1.0, 4.5]))
    with pytest.raises(NoPathFound, match=r"\(2.000, 2.000\)"):
        planner.plan(costmap, np.array([2.0, 2.0]), np.array([2.0, 8.0]))
    same = planner.plan(costmap, np.array([2.1, 2.2]), np.array([2.3, 2.4]))
    np.testing.assert_array_equal(same.path.points, [[2.1, 2.2], [2.3, 2.4]])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("wall_conductance", 1.5),
        ("wall_conductance", 0.0),
        ("leak", -1.0),
        ("tolerance", 1e-16),
        ("tolerance", 1.0),
        ("max_step", 2.0),
    ],
)
def test_bad_parameters_are_refused(name, value, make_context) -> None:
    with pytest.raises(ValueError, match=name):
        HarmonicParameters(**{name: value})
    with pytest.raises(ParameterError, match=name):
        build(make_context({name: value}))


@pytest.fixture
def make_context():
    from robocar.core import Context, Footprint, Limits, Robot
    from robocar.core.robot import Calibration

    def make(parameters):
        robot = Robot(
            Footprint.circle(0.1),
            Limits(0.0, 0.3, 1.0, 1.0, 1.0),
            Calibration(0.04, np.array([1.0, 2.0]), np.array([0.4, 0.4])),
            100,
        )
        return Context(robot, None, None, (), parameters, np.random.default_rng(0), 0.05)

    return make
