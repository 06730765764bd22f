"""Theta*, and the segments that it is made of."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robocar.core import Costmap, NoPathFound
from robocar.planners.geometry.line_of_sight import polyline_cost, pull_taut, segment_cost
from robocar.planners.search.a_star import AStar
from robocar.planners.search.grid_search import padded
from robocar.planners.search.theta_star import ThetaStar, _search
from tests.planners.grids import costmaps, free_pair, random_costs
from tests.planners.search import search_reference as reference

A_STAR, THETA_STAR = AStar(), ThetaStar()


def exact_segment_cost(costs: np.ndarray, a: tuple[int, int], b: tuple[int, int]) -> float:
    """Brute force in rational arithmetic: clips the segment between two centres to every cell's square.

    A square that is touched in one point only blocks too where the segment runs through that corner between two cells.
    """
    (x0, y0), (x1, y1) = ((Fraction(2 * v + 1, 2) for v in point) for point in (a, b))
    dx, dy = x1 - x0, y1 - y0
    total = 0.0
    for row, col in np.ndindex(costs.shape):
        low, high = Fraction(0), Fraction(1)
        for p, d, cell in ((x0, dx, col), (y0, dy, row)):
            if d == 0:
                if not cell <= p <= cell + 1:
                    low, high = Fraction(1), Fraction(0)
            else:
                ends = sorted(((cell - p) / d, (cell + 1 - p) / d))
                low, high = max(low, ends[0]), min(high, ends[1])
        if low <= high:
            if costs[row, col] >= 253:
                return math.inf
            total += float(high - low) * math.hypot(dx, dy) * (1 + float(costs[row, col]) / 252)
    return total


@settings(max_examples=300, deadline=None)
@given(costmap=costmaps(), seed=st.integers(0, 2**32 - 1))
def test_segment_cost_is_the_line_integral(costmap: Costmap, seed: int) -> None:
    """Oracle: exact clipping against every cell, in rational arithmetic."""
    rng = np.random.default_rng(seed)
    rows, cols = costmap.shape
    a, b = ((int(rng.integers(cols)), int(rng.integers(rows))) for _ in range(2))
    found = segment_cost(costmap.data, a[0] + 0.5, a[1] + 0.5, b[0] + 0.5, b[1] + 0.5)
    expected = exact_segment_cost(costmap.data, a, b)
    assert found == pytest.approx(expected, rel=1e-9) or (a == b and found == expected)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_segment_cost_between_any_points(seed: int) -> None:
    """Oracle: the sum over fine samples, for ends anywhere in their cells."""
    rng = np.random.default_rng(seed)
    costs = rng.integers(0, 253, (9, 11)).astype(np.uint8)
    ends = rng.uniform(0, 1, (2, 2)) * [11, 9]
    n = 20000
    samples = ends[0] + (np.arange(n)[:, None] + 0.5) / n * (ends[1] - ends[0])
    cells = np.floor(samples).astype(int)
    expected = np.mean(1 + costs[cells[:, 1], cells[:, 0]] / 252.0) * np.linalg.norm(ends[1] - ends[0])
    assert segment_cost(costs, *ends.ravel()) == pytest.approx(expected, rel=2e-3)


def test_segments_outside_the_grid_are_blocked() -> None:
    costs = np.zeros((2, 2), dtype=np.uint8)
    assert segment_cost(costs, 0.5, 0.5, 2.5, 0.5) == math.inf
    assert segment_cost(costs, 0.5, -0.5, 0.5, 0.5) == math.inf


@settings(max_examples=250, deadline=None)
@given(costmap=costmaps(), seed=st.integers(0, 2**32 - 1))
def test_never_longer_and_never_dearer_than_a_star(costmap: Costmap, seed: int) -> None:
    """Oracle: A*'s path between the same points, its length and its line integral."""
    pair = free_pair(costmap, seed)
    assume(pair is not None)
    offsets = np.random.default_rng(seed).uniform(-0.45, 0.45, (2, 2))
    start, goal = costmap.origin.transform((np.array(pair)[:, ::-1] + 0.5 + offsets) * costmap.resolution)
    try:
        a_star = A_STAR.plan(costmap, start, goal)
    except NoPathFound:
        assume(False)
    plan = THETA_STAR.plan(costmap, start, goal)
    integral = polyline_cost(costmap.data, costmap.grid_from_world(a_star.path.points)) * costmap.resolution
    assert plan.path.length <= a_star.path.length * (1 + 1e-9)
    assert plan.cost <= integral * (1 + 1e-9)
    assert plan.cost == pytest.approx(
        polyline_cost(costmap.data, costmap.grid_from_world(plan.path.points)) * costmap.resolution, rel=1e-6, abs=1e-9
    )


def searched(costs: np.ndarray, start: tuple[int, int], goal: tuple[int, int], weight: float) -> reference.Searched:
    """The kernel's search."""
    cost = padded(Costmap(costs, 1.0))
    n, width = cost.size, cost.shape[1]
    g, parent, order, opened = (
        np.full(n, np.inf),
        np.empty(n, dtype=np.int32),
        np.full(n, -1, dtype=np.int32),
        np.empty(n, np.int32),
    )
    first, last = ((row + 1) * width + col + 1 for row, col in (start, goal))
    expanded, count = _search(cost, first, last, weight, g, parent, order, opened)

    def cell(flat: int) -> tuple[int, int]:
        return flat // width - 1, flat % width - 1

    cells = opened[:count].tolist()
    return reference.Searched(
        {cell(u): float(g[u]) for u in cells},
        {cell(u): cell(int(parent[u])) for u in cells},
        {cell(u): int(order[u]) for u in cells if order[u] >= 0},
        expanded,
    )


@pytest.mark.parametrize("weight", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("highest", [20, 250])
def test_it_searches_as_the_plain_search_does(weight: float, highest: int) -> None:
    """Oracle: the search with a heap and dicts: g, parents and order of expansions, where no two open cells have the same f."""
    rng, compared = np.random.default_rng(8), 0
    for seed in range(150):
        rows, cols = rng.integers(1, 25, 2).tolist()
        costs = random_costs(seed, rows, cols, float(rng.choice([0.0, 0.15, 0.3])), weighted=True)
        costs = np.where(costs < 253, costs % (highest + 1), costs).astype(np.uint8)
        pair = free_pair(Costmap(costs, 1.0), seed)
        if pair is None:
            continue
        start, goal = ((int(cell[0]), int(cell[1])) for cell in pair)
        expected = reference.theta_star(costs, start, goal, weight)
        if expected.tied:
            continue
        found = searched(costs, start, goal, weight)
        assert list(found.g) == list(expected.g)
        assert list(found.g.values()) == pytest.approx(list(expected.g.values()), rel=1e-12)
        assert (found.parent, found.order, found.expanded) == (expected.parent, expected.order, expected.expanded)
        compared += 1
    assert compared >= 60


def test_an_empty_map_is_crossed_on_the_straight_line() -> None:
    """Analytic: the path is the segment itself."""
    start, goal = np.array([0.3, 0.4]), np.array([17.2, 8.9])
    plan = THETA_STAR.plan(Costmap(np.zeros((10, 20)), 1.0), start, goal)
    assert len(plan.path.points) == 2
    assert plan.cost == pytest.approx(math.dist(start, goal))


def test_one_wall_is_rounded_at_its_end() -> None:
    """By hand: around the wall's two end corners along cell centres; 2 hypot(4, 5) + 2, while A* pays the octile length."""
    costs = np.zeros((9, 12), dtype=np.uint8)
    costs[:6, 5] = 254
    costmap = Costmap(costs, 1.0)
    start, goal = costmap.world_from_cell([(1, 0), (1, 10)])
    plan = THETA_STAR.plan(costmap, start, goal)
    expected = costmap.world_from_cell([(1, 0), (6, 4), (6, 6), (1, 10)])
    np.testing.assert_allclose(plan.path.points, expected)
    assert plan.path.length == pytest.approx(2 * math.hypot(4, 5) + 2)
    assert A_STAR.plan(costmap, start, goal).path.length == pytest.approx(8 * math.sqrt(2) + 4)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_pulling_taut_never_costs(seed: int) -> None:
    """Property: ends kept, corners a subset, cost and length do not grow."""
    rng = np.random.default_rng(seed)
    costs = rng.integers(0, 253, (12, 12)).astype(np.uint8)
    points = np.floor(rng.uniform(0, 12, (8, 2))) + 0.5
    taut = pull_taut(costs, points)
    assert {tuple(p) for p in taut} <= {tuple(p) for p in points}
    np.testing.assert_array_equal(taut[[0, -1]], points[[0, -1]])
    assert polyline_cost(costs, taut) <= polyline_cost(costs, points) * (1 + 1e-9)
    lengths = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in (taut, points)]
    assert lengths[0] <= lengths[1] * (1 + 1e-9)
