"""Frontiers against their definition and scipy; exploration in worlds without physics and with."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from robocar.core import (
    INSCRIBED,
    SE2,
    Belief,
    Calibration,
    Context,
    Costmap,
    Done,
    Drive,
    Footprint,
    Limits,
    Observation,
    OccupancyGrid,
    ParameterError,
    Points,
    RangeSensor,
    Robot,
    Scan,
    State,
)
from robocar.core.distance import ClearanceField
from robocar.core.rays import cast_rays
from robocar.estimation.cascade import MapperView
from robocar.estimation.mapping.mapping import OccupancyMapper
from robocar.planners.controllers import pure_pursuit
from robocar.planners.costmap import known_space
from robocar.planners.exploration import explore
from robocar.planners.exploration.frontiers import costs_of_ways, find_frontiers
from robocar.planners.search import a_star

FOOTPRINT = Footprint.rectangle(0.1, 0.1, 0.09)
DT = 0.1


def random_grid(seed: int) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    return OccupancyGrid(rng.choice([-1, 0, 100], (14, 17), p=[0.2, 0.6, 0.2]).astype(np.int8), 0.1)


def steps_by_scipy(costmap: Costmap, start: tuple[int, int]) -> np.ndarray:
    """Dijkstra over all steps between free neighbours, the cells beside a diagonal free, too."""
    rows, cols = costmap.shape
    free, data = ~costmap.blocked, costmap.data.astype(float)
    a, b, lengths = [], [], []
    for r in range(rows):
        for c in range(cols):
            for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
                i, j = r + dr, c + dc
                if not (0 <= i < rows and 0 <= j < cols and free[r, c] and free[i, j] and free[r, j] and free[i, c]):
                    continue
                a.append(r * cols + c)
                b.append(i * cols + j)
                lengths.append(math.hypot(dr, dc) * costmap.resolution * (1 + (data[r, c] + data[i, j]) / 2 / 252))
    graph = coo_array((lengths, (a, b)), shape=(rows * cols, rows * cols))
    return dijkstra(graph.tocsr(), directed=False, indices=start[0] * cols + start[1]).reshape(rows, cols)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_costs_of_ways(seed: int) -> None:
    """Oracle: scipy's Dijkstra; and A* itself to one of the cells."""
    rng = np.random.default_rng(seed)
    costs = rng.choice([0, 60, 252, 253, 254, 255], (12, 15), p=[0.4, 0.2, 0.15, 0.1, 0.1, 0.05]).astype(np.uint8)
    costs[3, 4] = 0
    costmap = Costmap(costs, 0.1)
    ways = costs_of_ways(costmap, (3, 4))
    np.testing.assert_allclose(ways, steps_by_scipy(costmap, (3, 4)), rtol=1e-7)
    cells = np.argwhere(np.isfinite(ways))
    goal = cells[rng.integers(len(cells))]
    plan = a_star.AStar().plan(costmap, costmap.world_from_cell((3, 4)), costmap.world_from_cell(goal))
    assert plan.cost == pytest.approx(ways[tuple(goal)])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3))
def test_frontiers_are_what_they_are_defined_to_be(seed: int, least: int) -> None:
    """Oracle: the definition, by loops: unknown cells beside (by a side) a cell that can be come to, in groups by corners."""
    grid = random_grid(seed)
    data = grid.data.copy()
    data[5, 5] = 0
    grid = OccupancyGrid(data, grid.resolution)
    costmap = known_space.ways(grid, 0.02)
    ways = costs_of_ways(costmap, (5, 5))
    border = np.zeros(grid.shape, dtype=bool)
    for r, c in np.argwhere(grid.unknown):
        beside = [(r + dr, c + dc) for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0))]
        border[r, c] = any(grid.contains(cell) and np.isfinite(ways[cell]) for cell in beside)
    labels, count = ndimage.label(border, np.ones((3, 3)))
    expected = {tuple(map(tuple, np.argwhere(labels == k))) for k in range(1, count + 1)}
    found = find_frontiers(costmap, grid.unknown, (5, 5), least)
    assert {tuple(map(tuple, f.cells)) for f in found} == {cells for cells in expected if len(cells) >= least}
    assert [f.cost for f in found] == sorted(f.cost for f in found)
    beside = [abs(f.viewpoint[0] - f.nearest[0]) + abs(f.viewpoint[1] - f.nearest[1]) for f in found]
    assert beside == [1] * len(found)
    assert [f.cost for f in found] == pytest.approx([ways[f.viewpoint] for f in found])


def test_costmaps_of_a_map_in_the_making() -> None:
    """Oracle: by hand: the unknown is not entered; it may be come near, which is sure only at the radius from it."""
    data = np.zeros((20, 40), dtype=np.int8)
    data[:, 30:] = -1
    data[:, 0] = 100
    grid = OccupancyGrid(data, 0.05)
    ways = known_space.ways(grid, 0.09)
    assert np.all(ways.data[:, 30:] >= INSCRIBED)
    assert np.all(ways.data[:, 3:30] < INSCRIBED)
    assert np.all(ways.data[:, :2] >= INSCRIBED)
    sure = known_space.surely_free(grid, 0.09)
    assert not sure[:, 28:].any()
    assert sure[:, 3:28].all()
    assert np.all(known_space.ways(grid, 0.09, sure).data[:, 28:30] == known_space.UNSURE)
    here = SE2(0.51, 0.51)
    window = known_space.surroundings(grid, here, 0.3, 0.09)
    assert window.shape == (13, 13)
    assert np.allclose(window.world_from_cell(window.cell_from_world(here.position)), grid.world_from_cell((10, 10)))
    assert known_space.is_known(grid, (0.5, 0.5))
    assert not known_space.is_known(grid, (1.8, 0.5))
    assert not known_space.is_known(grid, (-5.0, 0.5))


def two_rooms() -> OccupancyGrid:
    """4 x 2.5 m: two rooms, a door of 0.7 m, a pillar."""
    data = np.zeros((50, 80), dtype=np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    data[:, 40] = 100
    data[30:44, 40] = 0
    data[14:20, 55:61] = 100
    return OccupancyGrid(data, 0.05)


def context(lidar: RangeSensor | None, **parameters: object) -> Context:
    limits = Limits(-0.2, 0.4, 1.5, 0.8, 4.0)
    robot = Robot(FOOTPRINT, limits, Calibration(0.042, np.array([0.0, 1.0]), np.array([0.2, 0.2])), 200, (), lidar)
    return Context(robot, None, SE2(), (), dict(parameters), np.random.default_rng(0), DT)


def explored(world: OccupancyGrid, start: SE2, bearings: np.ndarray, reach: float, limit: float = 200.0):
    """A perfect car with a perfect laser explores: the last command, the map, and the least clearance on the way."""
    walls = ClearanceField(world, world.occupied)
    sensor = RangeSensor("laser", SE2(), bearings, 0.0, 0.0, reach, DT)
    navigator = explore.build(context(sensor), a_star.build, pure_pursuit.build)
    mapper = OccupancyMapper(True, False, FOOTPRINT.inscribed_radius)
    pose, nearest, seen = start, math.inf, []
    command = None
    for k in range(round(limit / DT)):
        ranges = cast_rays(world, world.occupied, pose.position, bearings + pose.theta, reach)
        observation = Observation(k * DT, lidar=Scan(k * DT, ranges, bearings, reach))
        mapper.update(Belief(pose), observation)
        command = navigator.command(State.of(Belief(pose), MapperView(mapper)), observation, None)
        seen += [trace["frontiers"] for trace in [command.trace] if "frontiers" in trace]
        if not isinstance(command, Drive):
            break
        pose = pose @ command.twist.step(DT)
        nearest = min(nearest, float(walls.footprint(FOOTPRINT.at(pose))))
    return command, mapper.grid(), nearest, seen


ALL_AROUND = np.linspace(-math.pi, math.pi, 180, endpoint=False)
AHEAD = np.linspace(-math.radians(100), math.radians(100), 200)


@pytest.mark.parametrize(
    ("bearings", "reach"), [(ALL_AROUND, 6.0), (ALL_AROUND, 1.2), (AHEAD, 3.0)], ids=["far", "near", "ahead"]
)
def test_two_rooms_are_explored_without_contact(bearings: np.ndarray, reach: float) -> None:
    """Oracle: the world: it ends by itself, every free cell is known, hardly any called occupied, nothing was touched."""
    world = two_rooms()
    command, grid, nearest, seen = explored(world, SE2(0.5, 0.5, 0.4), bearings, reach)
    assert isinstance(command, Done)
    assert nearest > 0.0
    assert len(seen) > 2
    assert all(isinstance(points, Points) for points in seen)
    free = world.world_from_cell(np.argwhere(world.free))
    cells = grid.cell_from_world(free)
    values = grid.data[cells[:, 0], cells[:, 1]]
    assert np.mean(values >= 0) >= 0.995
    assert np.mean(values >= 65) <= 0.005


def test_a_closed_room_is_left_alone() -> None:
    """Oracle: by hand: behind a wall without a door nothing becomes known, and it ends all the same."""
    data = two_rooms().data.copy()
    data[:, 40] = 100
    world = OccupancyGrid(data, 0.05)
    command, grid, nearest, _ = explored(world, SE2(0.5, 0.5, 0.4), ALL_AROUND, 6.0)
    assert isinstance(command, Done)
    assert nearest > 0.0
    beyond = grid.cell_from_world([(x, y) for x in np.arange(2.2, 3.9, 0.1) for y in np.arange(0.2, 2.3, 0.1)])
    inside = beyond[grid.contains(beyond)]
    assert not np.any(grid.data[inside[:, 0], inside[:, 1]] >= 0)


def test_it_waits_for_a_map() -> None:
    """Oracle: by hand: it stands while there is nothing to decide on; built again it does the same again."""
    sensor = RangeSensor("laser", SE2(), ALL_AROUND, 0.0, 0.0, 6.0, DT)
    navigator = explore.build(context(sensor), a_star.build, pure_pursuit.build)
    mapper = OccupancyMapper(True, False, FOOTPRINT.inscribed_radius)
    command = navigator.command(State.of(Belief(SE2(0.5, 0.5)), MapperView(mapper)), Observation(0.0), None)
    assert isinstance(command, Drive)
    assert (command.twist.v, command.twist.omega) == (0.0, 0.0)
    world, commands = two_rooms(), []
    ranges = cast_rays(world, world.occupied, (0.5, 0.5), ALL_AROUND, 6.0)
    for _ in range(2):
        navigator = explore.build(context(sensor), a_star.build, pure_pursuit.build)
        mapper = OccupancyMapper(True, False, FOOTPRINT.inscribed_radius)
        for k in range(5):
            observation = Observation(k * DT, lidar=Scan(k * DT, ranges, ALL_AROUND, 6.0))
            mapper.update(Belief(SE2(0.5, 0.5)), observation)
            commands.append(navigator.command(State.of(Belief(SE2(0.5, 0.5)), MapperView(mapper)), observation, None).twist)  # type: ignore[union-attr]
    assert commands[:5] == commands[5:]


@pytest.mark.parametrize("wrong", [{"patience": 0.0}, {"margin": -0.1}, {"look_around": "perhaps"}, {"window": math.nan}])
def test_parameters_out_of_range(wrong: dict[str, object]) -> None:
    """Oracle: the message names the parameter."""
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        explore.build(context(None, **wrong), a_star.build, pure_pursuit.build)
