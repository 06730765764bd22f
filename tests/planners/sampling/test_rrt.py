"""Random trees: exact collision checks, published queries with bounds, and what the variants promise."""

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import BudgetExhausted, Costmap, Segments
from robocar.planners.sampling.random_trees import Growth, TreeObstacles, edge_cost, shortcut
from robocar.planners.sampling.rrt import RRT, VARIANTS, RrtParameters, circle_world, costmap_world, path_cost, search

REFERENCES = Path(os.environ.get("ROBOCAR_DATA") or Path(__file__).resolve().parents[4] / "shared" / "data") / "references"
needs_references = pytest.mark.skipif(not REFERENCES.is_dir(), reason="no reference problems: set ROBOCAR_DATA")
PLAIN = RrtParameters(step=2.0, goal_tolerance=2.0, max_samples=20_000, shortcuts=0)


def scattered(seed: int, n: int = 12) -> TreeObstacles:
    """Circles in a square of 20, none near the corners (1, 1) and (19, 19)."""
    rng = np.random.default_rng(seed)
    circles = np.column_stack([rng.uniform(3, 17, (n, 2)), rng.uniform(0.5, 2.0, n)])
    return circle_world(circles, (0, 0), (20, 20))


def check_tree(world: TreeObstacles, grown: Growth, longest: float) -> None:
    """By its definition: every edge is free and at most a step long, and costs add up along the way from the root."""
    tree = grown.tree
    children = np.flatnonzero(tree.parents >= 0)
    assert len(children) > 0
    for i in children:
        parent = tree.parents[i]
        edge = edge_cost(world, *tree.nodes[parent], *tree.nodes[i])
        assert edge < math.inf
        assert math.dist(tree.nodes[parent], tree.nodes[i]) <= longest * (1 + 1e-12)
        assert tree.costs[i] == pytest.approx(tree.costs[parent] + edge, rel=1e-9)


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_segments_among_circles_are_checked_exactly(seed: int) -> None:
    """Oracle: 2000 points along the segment; where the nearest comes within their spacing of a radius, both answers are right."""
    rng = np.random.default_rng(seed)
    circles = np.column_stack([rng.uniform(0, 10, (4, 2)), rng.uniform(0.0, 2.0, 4)])
    a, b = rng.uniform(0, 10, (2, 2))
    points = a + np.linspace(0, 1, 2000)[:, None] * (b - a)
    room = (np.linalg.norm(points[:, None] - circles[:, :2], axis=2) - circles[:, 2]).min()
    cost = edge_cost(circle_world(circles, (0, 0), (10, 10)), *a, *b)
    assert cost == (pytest.approx(math.dist(a, b)) if room >= 0.0 else math.inf) or abs(room) < 0.01


def test_table_1_step_by_step() -> None:
    """By hand (Table 1 of the paper, all samples at the goal): nodes every 0.5 from (0, 0) to (2, 0), reached within 0.5."""
    world = circle_world(np.empty((0, 3)), (-1, -1), (3, 1))
    only_goal = RrtParameters(step=0.5, goal_tolerance=0.5, goal_bias=1.0, shortcuts=0)
    grown = search(world, (0, 0), (2, 0), only_goal, np.random.default_rng(0))
    np.testing.assert_allclose(grown.path, [[0, 0], [0.5, 0], [1, 0], [1.5, 0], [2, 0]])
    assert grown.samples == 3
    np.testing.assert_array_equal(grown.tree.parents, [-1, 0, 1, 2, 3])


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("adaptive", [True, False])
def test_trees_are_trees_and_paths_lead_through_their_nodes(variant: str, adaptive: bool) -> None:
    for seed in range(3):
        world = scattered(seed)
        p = replace(PLAIN, variant=variant, adaptive_step=adaptive, max_samples=1500)
        grown = search(world, (1, 1), (19, 19), p, np.random.default_rng(seed))
        check_tree(world, grown, p.step)
        np.testing.assert_array_equal(grown.path[[0, -1]], [[1, 1], [19, 19]])
        nodes = {tuple(node) for node in grown.tree.nodes}
        assert all(tuple(point) in nodes for point in grown.path)
        assert path_cost(world, grown.path) < math.inf


@pytest.mark.parametrize("variant", VARIANTS)
def test_equal_seeds_give_equal_trees(variant: str) -> None:
    p = replace(PLAIN, variant=variant, max_samples=1000)
    trees = [search(scattered(0), (1, 1), (19, 19), p, np.random.default_rng(seed)).tree.nodes for seed in (5, 5, 6)]
    assert np.array_equal(trees[0], trees[1])
    assert not np.array_equal(trees[0], trees[2])


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_new_nodes_hang_on_the_nearest_of_the_older_ones(seed: int) -> None:
    """Oracle: brute force. In the open a step goes straight at its sample, so its parent is the nearest node to the child too,
    unless the step was cut short; with steps that reach every sample it never is."""
    world = circle_world(np.empty((0, 3)), (0, 0), (10, 10))
    p = RrtParameters(step=20.0, goal_tolerance=1e-9, goal_bias=0.0, max_samples=300, shortcuts=0)
    tree = search(world, (5, 5), (1, 1), p, np.random.default_rng(seed)).tree
    for i in range(1, len(tree.nodes)):
        distances = np.linalg.norm(tree.nodes[:i] - tree.nodes[i], axis=1)
        assert tree.parents[i] == np.argmin(distances)


def test_buckets_find_the_nearest_node_too() -> None:
    """Oracle: brute force; small steps make many buckets, and every sample is reached from the nearest node by a whole step."""
    world = circle_world(np.empty((0, 3)), (0, 0), (10, 10))
    p = RrtParameters(step=0.2, goal_tolerance=1e-9, goal_bias=0.0, max_samples=3000, shortcuts=0, adaptive_step=False)
    rng = np.random.default_rng(3)
    tree = search(world, (5, 5), (1, 1), p, np.random.default_rng(3)).tree
    assert len(tree.nodes) == 3001
    for i in range(1, len(tree.nodes)):
        rng.random()  # the draw for the goal bias
        sample = 10.0 * np.array([rng.random(), rng.random()])
        distances = np.linalg.norm(tree.nodes[:i] - sample, axis=1)
        assert distances[tree.parents[i]] == pytest.approx(distances.min(), rel=1e-12)


def test_more_samples_never_make_rrt_star_worse() -> None:
    """Property: with the same seed a longer run goes on where the shorter one ended, and rewiring only lowers costs."""
    costs = []
    for samples in (500, 1000, 2000, 4000, 8000):
        p = RrtParameters(variant="rrt-star", step=3.0, max_samples=samples, shortcuts=0)
        grown = search(scattered(4), (1, 1), (19, 19), p, np.random.default_rng(0))
        costs.append(path_cost(scattered(4), grown.path))
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0]
    assert costs[-1] >= math.dist((1, 1), (19, 19))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), tries=st.integers(0, 100))
def test_shortcuts_keep_the_ends_and_never_cost_more(seed: int, tries: int) -> None:
    world = scattered(seed % 50)
    path = search(world, (1, 1), (19, 19), PLAIN, np.random.default_rng(seed)).path
    shorter = shortcut(world, path, tries, np.random.default_rng(seed))
    np.testing.assert_array_equal(shorter[[0, -1]], path[[0, -1]])
    assert path_cost(world, shorter) <= path_cost(world, path) * (1 + 1e-12)


def walled_off() -> Costmap:
    costs = np.zeros((40, 60), dtype=np.uint8)
    costs[:, 30] = 254
    return Costmap(costs, 0.1)


@pytest.mark.parametrize("variant", VARIANTS)
def test_without_a_way_the_budget_ends_and_the_tree_is_kept(variant: str) -> None:
    """The wall at x = 3.0 to 3.1 is never crossed by an edge."""
    planner = RRT(np.random.default_rng(0), RrtParameters(variant=variant, max_samples=700))
    with pytest.raises(BudgetExhausted, match=r"budget exhausted: no way from .* found with 700 samples") as error:
        planner.plan(walled_off(), (1.0, 1.0), (5.0, 1.0))
    assert isinstance(error.value, BudgetExhausted)
    tree = error.value.trace["tree"]
    assert isinstance(tree, Segments)
    assert len(tree.segments) > 100
    sides = tree.segments[:, :, 0] < 3.05
    assert (sides[:, 0] == sides[:, 1]).all()


def test_costs_are_those_of_the_grid_searches() -> None:
    """Analytic: in the open a plan costs its length, on cells of cost 126 one and a half times as much."""
    for cost in (0, 126):
        planner = RRT(np.random.default_rng(1), RrtParameters(shortcuts=0))
        plan = planner.plan(Costmap(np.full((50, 50), cost, dtype=np.uint8), 0.1), (0.55, 0.55), (4.5, 4.2))
        assert plan.cost == pytest.approx(plan.path.length * (1 + cost / 252), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("variant", "rrt-connected"),
        ("step", 0.0),
        ("step", math.nan),
        ("goal_tolerance", -1.0),
        ("max_samples", 0),
        ("goal_bias", 1.1),
        ("goal_bias", math.nan),
        ("shortcuts", -1),
    ],
)
def test_wrong_parameters_are_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        RrtParameters(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("circles", "low", "high"),
    [([[0, 0, -1]], (0, 0), (1, 1)), ([[0, math.nan, 1]], (0, 0), (1, 1)), ([], (0, 0), (0, 1)), ([], (0, 0), (math.inf, 1))],
)
def test_worlds_that_are_none_are_refused(circles: list, low: tuple, high: tuple) -> None:
    with pytest.raises(ValueError, match=r"circles|corners"):
        circle_world(circles, low, high)


# -- published problems --------------------------------------------------------------------------------------------------


def ompl_world() -> tuple[TreeObstacles, list[dict]]:
    """The circles, and the 100 queries with lower bounds: visibility graphs' where they are given, else the straight line's."""
    lines = (REFERENCES / "circle_obstacles.txt").read_text().splitlines()[2:]
    circles = [[float(word) for word in line.split()[1:4]] for line in lines if line.strip()]
    bounds = json.loads((REFERENCES / "circle_optimal_bounds.json").read_text())["ompl_circles"]
    assert len(circles) == bounds["n_circles"]
    ends: dict[int, dict] = {}
    for line in (REFERENCES / "circle_queries.txt").read_text().splitlines():
        if line.strip():
            k, name, x, y = line.split()
            ends.setdefault(int(k), {"query": int(k)})[name.rstrip(":")] = [float(x), float(y)]
    for query in ends.values():
        query["lower"] = math.dist(query["start"], query["goal"])
    for query in bounds["queries"]:
        ends[query["query"]] = query
    return circle_world(circles, bounds["box"][:2], bounds["box"][2:]), [ends[k] for k in sorted(ends)]


@needs_references
@pytest.mark.parametrize("variant", ["rrt", "rrt-connect"])
def test_ompl_s_circle_world(variant: str) -> None:
    """All 100 queries of OMPL's benchmark are solved, and no path is shorter than the shortest way's lower bound."""
    world, queries = ompl_world()
    assert len(queries) == 100
    for query in queries:
        p = replace(PLAIN, variant=variant, shortcuts=200)
        path = search(world, query["start"], query["goal"], p, np.random.default_rng(query["query"])).path
        assert query["lower"] * (1 - 1e-9) <= path_cost(world, path) < math.inf


@needs_references
def test_pythonrobotics_problems() -> None:
    """Solved with 20 000 samples at most in steps of 3 as in its example, never below the lower bound."""
    for name in ("pythonrobotics_rrt", "pythonrobotics_rrt_star"):
        problem = json.loads((REFERENCES / "circle_optimal_bounds.json").read_text())[name]
        world = pythonrobotics(problem)
        p = RrtParameters(step=3.0, goal_tolerance=3.0, max_samples=20_000)
        for seed in range(10):
            path = search(world, problem["start"], problem["goal"], p, np.random.default_rng(seed)).path
            assert problem["optimal_length_bounds"][0] * (1 - 1e-9) <= path_cost(world, path) < math.inf


def pythonrobotics(problem: dict) -> TreeObstacles:
    circles = np.array(problem["obstacles"], dtype=float)
    circles[:, 2] += problem["robot_radius"]
    low, high = problem["rand_area"]
    return circle_world(circles, (low, low), (high, high))


@needs_references
def test_rrt_star_comes_within_3_percent_of_the_optimum() -> None:
    """Oracle: the bounds of the shortest paths; 20 000 samples, without shortcuts."""
    world, queries = ompl_world()
    bounded = [query for query in queries if "upper" in query][:3]
    problems = [(world, q["start"], q["goal"], q["lower"], q["upper"]) for q in bounded]
    problem = json.loads((REFERENCES / "circle_optimal_bounds.json").read_text())["pythonrobotics_rrt_star"]
    problems.append((pythonrobotics(problem), problem["start"], problem["goal"], *problem["optimal_length_bounds"]))
    for world, start, goal, lower, upper in problems:
        p = RrtParameters(variant="rrt-star", step=5.0, max_samples=20_000, shortcuts=0)
        cost = path_cost(world, search(world, start, goal, p, np.random.default_rng(0)).path)
        assert lower * (1 - 1e-9) <= cost <= 1.03 * upper


def test_a_costmap_is_a_world() -> None:
    """By hand: through the wall nothing is free, beside it everything."""
    world = costmap_world(walled_off())
    assert edge_cost(world, 5.0, 5.0, 40.0, 5.0) == math.inf
    assert edge_cost(world, 5.0, 5.0, 5.0, 30.0) == pytest.approx(25.0)
