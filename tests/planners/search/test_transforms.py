"""Distance, obstacle and path transform. Oracles: scipy's Dijkstra on the steps written down naively, scipy's exact Euclidean
transform, Gauss-Seidel iteration of the eikonal scheme, analytic distances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from robocar.planners.search.transforms import (
    descend,
    distance_transform,
    grown,
    nearest_blocked,
    obstacle_transform,
    path_transform,
)

SEEDS = st.integers(0, 2**32 - 1)


def world(seed: int, share: float = 0.3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.random((rng.integers(1, 16), rng.integers(1, 16))) < share


def naive(blocked: np.ndarray, diagonal: float, costs: np.ndarray, goal: tuple[int, int]) -> np.ndarray:
    """Cheapest ways to the goal by scipy: steps to eight neighbours, no corner cut, plus the cost of the cell that is left."""
    rows, cols = blocked.shape
    sources, targets, lengths = [], [], []
    for r in range(rows):
        for c in range(cols):
            for dr in (-1, 0, 1):
                for dc in (-1, 0, 1):
                    a, b = r + dr, c + dc
                    if (dr, dc) == (0, 0) or not (0 <= a < rows and 0 <= b < cols):
                        continue
                    if blocked[r, c] or blocked[a, b] or blocked[r, b] or blocked[a, c]:
                        continue
                    sources.append(r * cols + c)
                    targets.append(a * cols + b)
                    lengths.append((diagonal if dr and dc else 1.0) + costs[r, c])
    graph = coo_array((lengths, (sources, targets)), shape=(rows * cols, rows * cols)).tocsr()
    found = dijkstra(graph.T.tocsr(), indices=goal[0] * cols + goal[1]).reshape(rows, cols)
    return np.where(blocked, math.inf, found) if not blocked[goal] else np.full(blocked.shape, math.inf)


@given(SEEDS, st.sampled_from([("jarvis", 1.0), ("octile", math.sqrt(2.0))]), st.data())
@settings(max_examples=120, deadline=None)
def test_grid_metrics_are_dijkstras(seed: int, metric: tuple, data: st.DataObject) -> None:
    blocked = world(seed)
    goal = data.draw(st.integers(0, blocked.shape[0] - 1)), data.draw(st.integers(0, blocked.shape[1] - 1))
    expected = naive(blocked, metric[1], np.zeros(blocked.shape), goal)
    np.testing.assert_allclose(distance_transform(blocked, goal, metric[0]), expected, atol=1e-9)


@given(SEEDS, st.floats(0.0, 30.0), st.floats(0.5, 6.0), st.data())
@settings(max_examples=120, deadline=None)
def test_path_transform_is_zelinskys_minimum(seed: int, weight: float, safe: float, data: st.DataObject) -> None:
    """Oracle: Dijkstra over length plus weight times the discomfort, which follows scipy's Euclidean transform."""
    blocked = world(seed)
    goal = data.draw(st.integers(0, blocked.shape[0] - 1)), data.draw(st.integers(0, blocked.shape[1] - 1))
    away = ndimage.distance_transform_edt(~blocked) if blocked.any() else np.full(blocked.shape, math.inf)
    costs = weight * np.clip(1.0 - np.asarray(away) / safe, 0.0, None) ** 3
    expected = naive(blocked, math.sqrt(2.0), costs, goal)
    np.testing.assert_allclose(path_transform(blocked, goal, weight, safe), expected, rtol=1e-5, atol=1e-5)


@given(SEEDS)
@settings(max_examples=60, deadline=None)
def test_obstacle_transform_is_exact(seed: int) -> None:
    """Oracle: scipy's Euclidean and chessboard transforms; the octile one by the pairwise distances."""
    blocked = world(seed, 0.15)
    blocked[0, 0] = True
    np.testing.assert_allclose(obstacle_transform(blocked), ndimage.distance_transform_edt(~blocked), rtol=1e-6)
    chess = ndimage.distance_transform_cdt(~blocked, "chessboard")
    np.testing.assert_array_equal(obstacle_transform(blocked, "jarvis"), chess)
    steps = np.abs(np.indices(blocked.shape)[:, :, :, None] - np.argwhere(blocked).T[:, None, None, :])  # (2, rows, cols, n)
    octile = (steps.max(axis=0) + (math.sqrt(2.0) - 1.0) * steps.min(axis=0)).min(axis=-1)
    np.testing.assert_allclose(obstacle_transform(blocked, "octile"), octile, atol=1e-9)


@given(SEEDS, st.one_of(st.floats(0.0, 20.0), st.sampled_from([0.0, 1.0, math.sqrt(2.0), 2.0, math.sqrt(5.0), 5.0])))
@settings(max_examples=100, deadline=None)
def test_growing_is_a_threshold_of_the_distance(seed: int, radius: float) -> None:
    """Oracle: scipy's Euclidean transform, bit for bit, also for radii that are distances of cells; and one value of it."""
    blocked = world(seed, 0.05)
    away = ndimage.distance_transform_edt(~blocked) if blocked.any() else np.full(blocked.shape, math.inf)
    np.testing.assert_array_equal(grown(blocked, radius), np.asarray(away) < radius)
    cell = tuple(int(i) for i in np.random.default_rng(seed).integers(blocked.shape))
    assert nearest_blocked(blocked, cell) == np.asarray(away)[cell]


def test_the_same_cells_elsewhere_in_memory_are_as_far_from_obstacles() -> None:
    """Property: bit for bit, wherever the mask begins; libraries that process whole words at once may round otherwise."""
    blocked = ~np.pad(np.ones((70, 55), dtype=bool), ((20, 35), (31, 39)))
    buffers = np.empty((64, blocked.size + 64), dtype=bool)
    found = []
    for k, buffer in enumerate(buffers):
        place = buffer[k : k + blocked.size].reshape(blocked.shape)
        place[:] = blocked
        found.append(obstacle_transform(place).tobytes())
    assert len(set(found)) == 1


def test_no_obstacle_is_infinitely_far() -> None:
    assert np.all(obstacle_transform(np.zeros((3, 4), dtype=bool)) == math.inf)


@given(SEEDS)
@settings(max_examples=40, deadline=None)
def test_eikonal_solves_its_scheme(seed: int) -> None:
    """Property: at every reached cell but the seeds the upwind equation holds; the others are not connected (scipy's labels)."""
    blocked = world(seed, 0.2)
    goal = tuple(int(i) for i in np.random.default_rng(seed).integers(blocked.shape))
    u = distance_transform(blocked, goal, "euclidean")
    labels, _ = ndimage.label(~blocked)
    np.testing.assert_array_equal(np.isfinite(u), (labels == labels[goal]) & (labels[goal] > 0) & ~blocked)
    padded = np.pad(np.where(blocked, math.inf, u), 1, constant_values=math.inf)
    a = np.minimum(padded[1:-1, :-2], padded[1:-1, 2:])
    b = np.minimum(padded[:-2, 1:-1], padded[2:, 1:-1])
    low, high = np.minimum(a, b), np.maximum(a, b)
    with np.errstate(invalid="ignore"):
        both = 0.5 * (a + b + np.sqrt(2.0 - (a - b) ** 2))
        scheme = np.where(high - low < 1.0, both, low + 1.0)
    centres = np.indices(blocked.shape) + 0.5
    off = np.hypot(centres[0] - goal[0] - 0.5, centres[1] - goal[1] - 0.5) > 5.0  # the goal's surroundings are seeds
    off[goal] = False
    check = np.isfinite(u) & off
    np.testing.assert_allclose(u[check], scheme[check], atol=1e-6)


def test_eikonal_distance_in_the_open_is_straight() -> None:
    """Analytic: within 2 % and half a cell; the octile metric is 8 % off at 22.5 degrees."""
    u = distance_transform(np.zeros((81, 81), dtype=bool), (40, 40), "euclidean")
    row, col = np.indices(u.shape)
    true = np.hypot(row - 40, col - 40)
    assert np.abs(u - true).max() < 0.02 * 57 + 0.5
    assert np.all(u >= true - 1e-9)


@pytest.mark.parametrize("metric", ["jarvis", "octile"])
def test_a_goal_outside_is_reached_through_the_edge(metric: str) -> None:
    """Oracle: the same world on a larger grid, whose rim is free, cut out."""
    rng = np.random.default_rng(3)
    big = np.zeros((40, 40), dtype=bool)
    big[11:29, 11:29] = rng.random((18, 18)) < 0.3
    inner = np.s_[10:30, 10:30]
    for goal in ((3, 20), (35, 36), (20, 2), (1, 1)):
        expected = distance_transform(big, goal, metric)[inner]  # type: ignore[arg-type]
        ours = distance_transform(big[inner], (goal[0] - 10, goal[1] - 10), metric)  # type: ignore[arg-type]
        np.testing.assert_allclose(ours, expected, atol=1e-9)


@given(SEEDS, st.sampled_from(["jarvis", "octile", "euclidean"]))
@settings(max_examples=60, deadline=None)
def test_a_wave_that_stops_early_is_right_so_far(seed: int, metric: str) -> None:
    """Oracle: the whole wave. The cell asked for and all nearer ones agree."""
    blocked, rng = world(seed, 0.2), np.random.default_rng(seed)
    goal, cell = (tuple(int(i) for i in rng.integers(blocked.shape)) for _ in range(2))
    whole = distance_transform(blocked, goal, metric)  # type: ignore[arg-type]
    early = distance_transform(blocked, goal, metric, until=cell)  # type: ignore[arg-type]
    nearer = whole <= whole[cell]
    np.testing.assert_allclose(early[nearer], whole[nearer], atol=1e-6)


@given(SEEDS)
@settings(max_examples=60, deadline=None)
def test_descent_is_a_shortest_path(seed: int) -> None:
    """Property: from every reachable cell it ends at the goal, and its length is the transform's value."""
    blocked = world(seed, 0.25)
    free = np.argwhere(~blocked)
    goal = tuple(int(i) for i in free[0]) if len(free) else (0, 0)
    values = distance_transform(blocked, goal, "octile")
    reached = [tuple(int(i) for i in cell) for cell in np.argwhere(np.isfinite(values))]
    for cell in reached:
        way = descend(values, cell)
        assert tuple(way[-1]) == goal
        assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() == pytest.approx(values[cell])


def test_bad_input_is_refused() -> None:
    free = np.zeros((4, 4), dtype=bool)
    with pytest.raises(ValueError, match="rows and columns"):
        distance_transform(np.zeros(3, dtype=bool), (0, 0))
    with pytest.raises(ValueError, match="finite numbers"):
        distance_transform(free, (math.nan, 0.0))
    with pytest.raises(ValueError, match="none of jarvis, octile, euclidean"):
        distance_transform(free, (0, 0), "manhattan")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="outside the grid"):
        path_transform(free, (4, 0), 1.0, 1.0)
    with pytest.raises(ValueError, match="weight"):
        path_transform(free, (0, 0), -1.0, 1.0)
    with pytest.raises(ValueError, match="safe_distance"):
        path_transform(free, (0, 0), 1.0, 0.0)
    for radius in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="finite radius"):
            grown(free, radius)
