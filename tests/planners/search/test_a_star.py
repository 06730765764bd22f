"""A* against published optima and scipy's Dijkstra."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra

from robocar.core import LETHAL, Context, Costmap, ParameterError
from robocar.formats.movingai import load_movingai_map, load_scenarios
from robocar.planners.search.a_star import AStar, AStarParameters, build
from tests.planners.grids import costmaps, free_pair, step_graph
from tests.planners.search import search_reference as reference

SCENARIOS = [
    "arena.map.scen", "lak101d.map.scen", "lak105d.map.scen", "random-32-32-10-random-1.scen", "room-32-32-4-random-1.scen",
]  # fmt: skip
PLANNER = AStar()


def costmap_of(blocked: np.ndarray) -> Costmap:
    return Costmap(np.where(blocked, LETHAL, 0), 1.0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_movingai_scenario_has_the_published_length(data_dir: Path, name: str) -> None:
    """Oracle: optimal lengths of Sturtevant's benchmark set, printed with few digits: within 1e-2; free cells only, so cost is
    length."""
    folder = data_dir / "movingai"
    scenarios = load_scenarios(folder / name)
    grid = load_movingai_map(folder / (name.removesuffix(".scen") if ".map" in name else name.split("-random-1")[0] + ".map"))
    costmap = costmap_of(grid.occupied)
    plans = [PLANNER.plan(costmap, *costmap.world_from_cell([line.start_cell, line.goal_cell])) for line in scenarios]
    assert len(plans) > 50
    np.testing.assert_allclose([plan.cost for plan in plans], [line.optimal_length for line in scenarios], atol=1e-2)
    np.testing.assert_allclose([plan.path.length for plan in plans], [plan.cost for plan in plans], rtol=1e-7, atol=1e-12)


def test_env1_has_the_octile_optimum(data_dir: Path) -> None:
    """Oracle: references/env_octile.json, without corner cutting."""
    reference = json.loads((data_dir / "references" / "env_octile.json").read_text())["env1"]
    lines = (data_dir / "references" / "env1.txt").read_text().splitlines()
    blocked = np.array([line.split() for line in lines if set(line) <= set("01 ") and line.strip()], dtype=int) == 1
    assert list(blocked.shape) == reference["shape"]
    assert blocked.sum() == reference["occupied"]
    costmap = costmap_of(blocked)
    plan = PLANNER.plan(costmap, *costmap.world_from_cell([reference["start"], reference["goal"]]))
    assert plan.cost == pytest.approx(reference["octile_no_cut"], abs=1e-6)


@settings(max_examples=200, deadline=None)
@given(costmap=costmaps(), seed=st.integers(0, 2**32 - 1), weight=st.sampled_from([0.0, 0.5, 1.0]))
def test_cost_is_the_optimum(costmap: Costmap, seed: int, weight: float) -> None:
    """Oracle: scipy's Dijkstra on the steps written down naively."""
    pair = free_pair(costmap, seed)
    assume(pair is not None)
    source, target = (int(cell[0]) * costmap.shape[1] + int(cell[1]) for cell in pair)
    optimum = dijkstra(step_graph(costmap), indices=source)[target]
    found = AStar(AStarParameters(weight=weight)).search(costmap, tuple(pair[0]), tuple(pair[1]))
    assert (found.cells is None) == np.isinf(optimum)
    assert found.cells is None or found.cost == pytest.approx(optimum, rel=1e-7)


@settings(max_examples=100, deadline=None)
@given(costmap=costmaps(), seed=st.integers(0, 2**32 - 1), weight=st.sampled_from([1.3, 2.0, 7.0, 100.0]))
def test_weight_bounds_the_cost(costmap: Costmap, seed: int, weight: float) -> None:
    """Property of weighted A* (Pohl, 1970): at most `weight` times the optimum, and the path costs what the plan says (naive
    sum)."""
    pair = free_pair(costmap, seed)
    assume(pair is not None)
    graph = step_graph(costmap)
    cells = [int(cell[0]) * costmap.shape[1] + int(cell[1]) for cell in pair]
    optimum = dijkstra(graph, indices=cells[0])[cells[1]]
    assume(np.isfinite(optimum))
    found = AStar(AStarParameters(weight=weight)).search(costmap, tuple(pair[0]), tuple(pair[1]))
    assert found.cells is not None
    on_path = found.cells[:, 0] * costmap.shape[1] + found.cells[:, 1]
    assert found.cost == pytest.approx(sum(graph[a, b] for a, b in itertools.pairwise(on_path)), rel=1e-7)
    assert optimum * (1 - 1e-7) <= found.cost <= weight * optimum * (1 + 1e-7) + 1e-12


@settings(max_examples=200, deadline=None)
@given(
    costmap=costmaps(),
    seed=st.integers(0, 2**32 - 1),
    weight=st.sampled_from([0.0, 0.5, 1.0, 3.0, 100.0]),
    metric=st.sampled_from(["octile", "thesis"]),
)
def test_it_searches_as_the_plain_search_does(costmap: Costmap, seed: int, weight: float, metric: str) -> None:
    """Oracle: the search with buckets in a dict, exact: the way, its cost, the cells generated and the order of expansions."""
    pair = free_pair(costmap, seed)
    assume(pair is not None)
    assert pair is not None
    start, goal = ((int(cell[0]), int(cell[1])) for cell in pair)
    straight, diagonal, h_diagonal = (5741, 8119, 8119) if metric == "octile" else (5740, 8036, 11480)
    h_straight, h_diagonal = (round(weight * 504 * length) for length in (straight, h_diagonal))

    def h(cell: tuple[int, int]) -> int:
        short, long = sorted((abs(cell[0] - goal[0]), abs(cell[1] - goal[1])))
        return h_straight * (long - short) + h_diagonal * short

    expected = reference.a_star(costmap.data, start, goal, (straight, diagonal), h)
    found = AStar(AStarParameters(metric, weight)).search(costmap, start, goal)  # type: ignore[arg-type]
    assert found.expanded == expected.expanded
    rows, cols = np.divmod(found.opened, costmap.shape[1] + 2)
    assert list(zip((rows - 1).tolist(), (cols - 1).tolist(), strict=True)) == list(expected.g)
    assert found.order.tolist() == [expected.order.get(cell, -1) for cell in expected.g]
    assert (found.cells is None) == (goal not in expected.g)
    if found.cells is not None:
        assert found.cost == pytest.approx(expected.g[goal] / (504 * straight) * costmap.resolution, rel=1e-12, abs=0.0)
        way = [goal]
        while way[-1] != start:
            way.append(expected.parent[way[-1]])
        assert found.cells.tolist() == [list(cell) for cell in reversed(way)]


def test_a_large_weight_searches_far_across_the_ring_of_buckets() -> None:
    """Property: with weight 100 f falls by thousands of buckets on the way; the path must still be one (cost by the naive
    sum)."""
    rng = np.random.default_rng(1)
    blocked = rng.random((200, 200)) < 0.3
    blocked[0, :] = blocked[:, -1] = False
    costmap = costmap_of(blocked)
    start, goal = costmap.world_from_cell([(0, 0), (199, 199)])
    plan = AStar(AStarParameters(weight=100.0)).plan(costmap, start, goal)
    assert plan.cost == pytest.approx(plan.path.length, rel=1e-7)
    assert plan.work["expansions"] < PLANNER.plan(costmap, start, goal).work["expansions"]


def test_thesis_metric_counts_10_and_14() -> None:
    """By hand: 3 diagonal and 2 straight steps are 3 * 14 + 2 * 10 = 62 tenths of a cell."""
    plan = AStar(AStarParameters(metric="thesis")).plan(
        Costmap(np.zeros((4, 6)), 0.3), np.array([0.15, 0.15]), np.array([1.65, 1.05])
    )
    assert plan.cost == pytest.approx(6.2 * 0.3)


def test_thesis_heuristic_expands_less_and_may_pay_for_it() -> None:
    """Thesis, Figs 2.16 and 2.17: h = 10 (|drow| + |dcol|) overestimates diagonals; never better than the optimum, somewhere
    worse."""
    rng = np.random.default_rng(4)
    costs, optima, expanded = [], [], []
    thesis, dijkstra_ = AStar(AStarParameters(metric="thesis")), AStar(AStarParameters(metric="thesis", weight=0.0))
    for _ in range(60):
        costmap = costmap_of(rng.random((30, 30)) < 0.2)
        component = dijkstra(step_graph(costmap), indices=0)
        goals = np.flatnonzero(np.isfinite(component))
        if costmap.blocked[0, 0] or len(goals) < 100:
            continue
        cell = divmod(int(goals[-1]), 30)
        found, best = thesis.search(costmap, (0, 0), cell), dijkstra_.search(costmap, (0, 0), cell)
        costs.append(found.cost)
        optima.append(best.cost)
        expanded.append((found.expanded, best.expanded))
    ratio = np.array(costs) / np.array(optima)
    assert len(ratio) > 20
    assert np.all(ratio >= 1 - 1e-12)
    assert np.any(ratio > 1.001)
    assert sum(found for found, _ in expanded) < 0.5 * sum(best for _, best in expanded)


def test_the_way_in_the_open_is_found_without_looking_around() -> None:
    """Ties: on an empty map a good order expands little more than the path's own cells (100 of 10000 here)."""
    plan = PLANNER.plan(Costmap(np.zeros((100, 100)), 1.0), np.array([0.5, 30.5]), np.array([99.5, 70.5]))
    assert len(plan.path.points) == 100
    assert plan.work["expansions"] < 300


@pytest.mark.parametrize(
    ("parameters", "message"),
    [({"metric": "manhattan"}, "octile or thesis"), ({"weight": -1.0}, "from 0 to 100"), ({"weight": "big"}, "takes a float")],
)
def test_wrong_parameters_are_refused(parameters: dict, message: str) -> None:
    context = Context(None, None, None, (), parameters, np.random.default_rng(0), 0.05)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match=message):
        build(context)
