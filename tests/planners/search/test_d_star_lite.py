"""D* Lite against A* from scratch, after every change."""

import numpy as np
import pytest

from robocar.core import SE2, Costmap, GoalOccupied, NoPathFound, StartOccupied
from robocar.formats.generated import cave, maze, rooms
from robocar.planners.search.a_star import AStar
from robocar.planners.search.d_star_lite import DStarLite, DStarLiteParameters
from tests.planners.grids import random_costs

EDITS = 1000


def _maps() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(11)
    maps = {f"random {share} {weighted}": random_costs(7, 40, 55, share, weighted)
            for share in (0.1, 0.3) for weighted in (False, True)}  # fmt: skip
    for k in range(2):
        maps[f"cave {k}"] = np.where(cave(50, 60, rng).occupied, 254, 0)
        maps[f"rooms {k}"] = np.where(rooms(50, 60, rng).occupied, 254, 0)
        maps[f"maze {k}"] = np.where(maze(41, 41, 1 + k, rng).occupied, 254, 0)
    return {name: costs.astype(np.uint8) for name, costs in maps.items()}


MAPS = _maps()


def _edit(costs: np.ndarray, rng: np.random.Generator) -> None:
    """Blocks, frees or reprices a cell, a wall or a room's outline, in place."""
    rows, cols = costs.shape
    r, c = int(rng.integers(rows)), int(rng.integers(cols))
    height, width = (int(v) for v in rng.integers(1, 9, 2))
    value = [254, 253, 0, int(rng.integers(1, 253))][int(rng.integers(4))]
    shape = rng.integers(4)
    if shape == 0:
        costs[r, c] = value
    elif shape == 1:
        costs[r, c : c + width] = value
    elif shape == 2:
        costs[r : r + height, c] = value
    else:
        inside = costs[r + 1 : r + height - 1, c + 1 : c + width - 1].copy()
        costs[r : r + height, c : c + width] = value
        costs[r + 1 : r + height - 1, c + 1 : c + width - 1] = inside


def _outcome(planner, costmap: Costmap, start: np.ndarray, goal: np.ndarray) -> tuple[str, float, np.ndarray]:
    try:
        plan = planner.plan(costmap, start, goal)
    except (NoPathFound, StartOccupied, GoalOccupied) as error:
        return type(error).__name__, np.inf, np.array([start])
    return "path", plan.cost, plan.path.points


@pytest.mark.parametrize("name", list(MAPS))
def test_cost_equals_a_star_after_each_of_many_edits(name: str) -> None:
    """Oracle: A* from scratch; whole-number costs, so equality is exact. The start moves along the path, sometimes the goal
    moves."""
    rng = np.random.default_rng(len(name))
    costs = MAPS[name].copy()
    original = costs.copy()
    planner, oracle = DStarLite(), AStar()
    free = np.argwhere(costs < 253)
    start_cell, goal_cell = free[0], free[-1]
    expected, found, outcomes = [], [], []
    for edit in range(EDITS):
        for _ in range(int(rng.integers(1, 3))):
            _edit(costs, rng)
        if edit % 40 == 39:  # else the map fills up with walls
            costs = original.copy()
        if edit % 200 == 199:
            goal_cell = free[rng.integers(len(free))]
        costmap = Costmap(costs, 0.1, SE2(1.0, -2.0, 0.3))
        start, goal = costmap.world_from_cell([start_cell, goal_cell])
        outcome, cost, points = _outcome(planner, costmap, start, goal)
        outcomes.append(outcome)
        found.append((outcome, cost))
        expected.append(_outcome(oracle, costmap, start, goal)[:2])
        if outcome == "path" and edit % 3 == 0:
            start_cell = costmap.cell_from_world(points[min(2, len(points) - 1)])
        elif outcome == "StartOccupied" or (start_cell == goal_cell).all():
            start_cell = free[rng.integers(len(free))]
    assert found == expected
    assert outcomes.count("path") > EDITS // 4


def _corridor(open_: bool) -> Costmap:
    costs = np.zeros((9, 40), dtype=np.uint8)
    costs[:, 30] = 254
    costs[4, 30] = 0 if open_ else 254
    return Costmap(costs, 1.0)


def test_no_path_then_a_path_when_the_way_opens_again() -> None:
    """By hand: straight through the gap, 39 steps of 1 m."""
    planner = DStarLite()
    start, goal = np.array([0.5, 4.5]), np.array([39.5, 4.5])
    assert planner.plan(_corridor(True), start, goal).cost == 39.0
    for _ in range(2):
        with pytest.raises(NoPathFound, match="cells searched"):
            planner.plan(_corridor(False), start, goal)
    reopened = planner.plan(_corridor(True), start, goal)
    assert reopened.cost == 39.0
    assert 0 < reopened.work["expansions"] < 9 * 40


def test_nothing_new_costs_nothing() -> None:
    """Property: an equal costmap, and a start that moves on along the path, need no expansion."""
    planner = DStarLite()
    costmap = Costmap(MAPS["random 0.1 True"], 1.0)
    start, goal = costmap.world_from_cell(np.argwhere(~costmap.blocked)[[0, -1]])
    first = planner.plan(costmap, start, goal)
    assert first.work["expansions"] > 100
    again = planner.plan(Costmap(costmap.data.copy(), 1.0), start, goal)
    assert again.work["expansions"] == 0
    np.testing.assert_array_equal(again.path.points, first.path.points)
    assert planner.plan(costmap, first.path.points[3], goal).work["expansions"] == 0


def test_a_small_obstacle_ahead_is_repaired_not_searched_again() -> None:
    """Property the algorithm is for: far fewer expansions than the first search, for changes near the robot."""
    planner = DStarLite()
    rng = np.random.default_rng(0)
    costs = np.where(cave(200, 200, rng).occupied, 254, 0).astype(np.uint8)
    costmap = Costmap(costs, 1.0)
    free = np.argwhere(costs == 0)
    start, goal = costmap.world_from_cell(free[[0, -1]])
    first = planner.plan(costmap, start, goal)
    changed = costs.copy()
    row, col = costmap.cell_from_world(first.path.points[12])
    changed[row, col] = 254
    repaired = planner.plan(Costmap(changed, 1.0), start, goal)
    assert repaired.cost == AStar().plan(Costmap(changed, 1.0), start, goal).cost
    assert repaired.work["expansions"] < first.work["expansions"] / 10


@pytest.mark.parametrize(
    "other", [Costmap(np.zeros((9, 41)), 1.0), Costmap(np.zeros((9, 40)), 0.5), Costmap(np.zeros((9, 40)), 1.0, SE2(0.5))]
)
def test_another_place_starts_over(other: Costmap) -> None:
    """Oracle: A* on the new grid."""
    planner = DStarLite()
    start, goal = np.array([1.5, 4.2]), np.array([19.3, 4.2])
    planner.plan(Costmap(np.zeros((9, 40)), 1.0), start, goal)
    assert planner.plan(other, start, goal).cost == AStar().plan(other, start, goal).cost


@pytest.mark.parametrize("restart_fraction", [0.0, 1.0])
def test_restarting_and_repairing_agree(restart_fraction: float) -> None:
    """Oracle: A* from scratch after every cell has changed."""
    planner = DStarLite(DStarLiteParameters(restart_fraction=restart_fraction))
    costs = MAPS["random 0.1 True"]
    start, goal = Costmap(costs, 1.0).world_from_cell(np.argwhere(costs < 253)[[0, -1]])
    planner.plan(Costmap(costs, 1.0), start, goal)
    dearer = Costmap(np.where(costs < 200, costs + 50, costs), 1.0)
    assert planner.plan(dearer, start, goal).cost == AStar().plan(dearer, start, goal).cost


def test_an_obstacle_inside_the_inflation_is_named_and_does_not_spoil_the_search() -> None:
    """The robot stands at cost 253: the message says so; once it is out, planning goes on and agrees with A*."""
    planner = DStarLite()
    start, goal = np.array([2.5, 4.5]), np.array([39.5, 4.5])
    planner.plan(_corridor(True), start, goal)
    costs = _corridor(True).data.copy()
    costs[3:6, 2:5] = 253
    costs[4, 3] = 254
    near = Costmap(costs, 1.0)
    with pytest.raises(
        StartOccupied, match=r"nearer than the robot's inscribed radius.*nearest free cell is at \(1\.500, 4\.500\)"
    ):
        planner.plan(near, start, goal)
    out = np.array([1.5, 4.5])
    assert planner.plan(near, out, goal).cost == AStar().plan(near, out, goal).cost
