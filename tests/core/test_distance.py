"""Distance transforms and clearances against scipy, brute force over all squares, and geometry on paper."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.optimize import linprog, minimize

from robocar.core import SE2, Footprint, GridMap
from robocar.core.distance import (
    ClearanceField,
    distance_transform,
    footprint_clearance,
    lattice_distance,
    obstacle_distance,
    polygon_distance,
    pyramid,
    segment_clear,
)

seeds = st.integers(0, 2**32 - 1)


def random_mask(seed: int, rows: int, cols: int, density: float = 0.1) -> np.ndarray:
    mask = np.random.default_rng(seed).random((rows, cols)) < density
    mask[seed % rows, seed % cols] = True
    return mask


def all_point_distances(blocked: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Point to every square, in cells; points as (x, y)."""
    rows, cols = np.nonzero(blocked)
    dx = np.maximum(np.maximum(cols - points[:, None, 0], points[:, None, 0] - cols - 1), 0)
    dy = np.maximum(np.maximum(rows - points[:, None, 1], points[:, None, 1] - rows - 1), 0)
    return np.hypot(dx, dy).min(axis=1)


@given(seeds, st.integers(1, 30), st.integers(1, 30), st.floats(0, 1))
def test_distance_transform_against_scipy(seed: int, rows: int, cols: int, density: float) -> None:
    """Oracle: scipy's exact EDT (another algorithm)."""
    blocked = random_mask(seed, rows, cols, density)
    np.testing.assert_array_equal(distance_transform(blocked), ndimage.distance_transform_edt(~blocked))
    np.testing.assert_allclose(distance_transform(blocked, 0.05), 0.05 * ndimage.distance_transform_edt(~blocked))


def test_distance_transform_on_a_large_map() -> None:
    """Oracle: scipy, at the size of the benchmark maps."""
    blocked = random_mask(5, 512, 480, 0.002)
    np.testing.assert_array_equal(distance_transform(blocked), ndimage.distance_transform_edt(~blocked))


def test_nothing_blocked_is_infinitely_far() -> None:
    empty = np.zeros((3, 5), dtype=bool)
    assert np.all(np.isinf(distance_transform(empty)))
    assert np.all(np.isinf(obstacle_distance(empty, 0.1)))
    assert footprint_clearance(GridMap(empty, 0.1), empty, [[0, 0], [1, 0], [0, 1]]) == math.inf
    assert segment_clear(pyramid(empty), 0.0, 0.0, 5.0, 3.0, 1.0)


@given(seeds, st.integers(1, 12), st.integers(1, 12), st.integers(1, 5))
def test_lattice_distance_against_all_squares(seed: int, rows: int, cols: int, subdivision: int) -> None:
    """Oracle: brute force over all squares, at every node."""
    blocked = random_mask(seed, rows, cols)
    i, j = np.indices((subdivision * rows + 1, subdivision * cols + 1))
    expected = all_point_distances(blocked, np.stack([j.ravel(), i.ravel()], axis=1) / subdivision)
    np.testing.assert_allclose(lattice_distance(blocked, subdivision).ravel(), expected, atol=1e-12)


@given(seeds, st.integers(1, 15), st.integers(1, 15))
def test_obstacle_distance_against_all_squares(seed: int, rows: int, cols: int) -> None:
    """Oracle: brute force over all squares, at the cells' centres; 0.5 cells beside an obstacle, not 1."""
    blocked = random_mask(seed, rows, cols)
    i, j = np.indices(blocked.shape)
    expected = all_point_distances(blocked, np.stack([j.ravel(), i.ravel()], axis=1) + 0.5).reshape(blocked.shape)
    np.testing.assert_allclose(obstacle_distance(blocked, 0.2), 0.2 * expected, atol=1e-12)


@given(seeds, st.integers(1, 40), st.integers(1, 40), st.floats(-4, 4))
def test_clearance_of_points_against_all_squares(seed: int, rows: int, cols: int, theta: float) -> None:
    """Oracle: brute force over all squares, inside and outside a shifted and rotated grid."""
    blocked = random_mask(seed, rows, cols, 0.05)
    grid = GridMap(blocked, 0.05, SE2(-1, 3, theta))
    local = np.random.default_rng(seed).uniform(-20, 60, (50, 2))
    points = grid.origin.transform(local * grid.resolution)
    np.testing.assert_allclose(
        ClearanceField(grid, blocked).points(points), 0.05 * all_point_distances(blocked, local), atol=1e-12
    )


def convex_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two convex hulls: 0 if a linear program finds a common point, else a quadratic program over the weights."""
    m, n = len(a), len(b)
    equal = np.vstack([np.hstack([a.T, -b.T]), np.r_[np.ones(m), np.zeros(n)], np.r_[np.zeros(m), np.ones(n)]])
    if linprog(np.zeros(m + n), A_eq=equal, b_eq=[0, 0, 1, 1]).status == 0:
        return 0.0
    start = np.r_[np.full(m, 1 / m), np.full(n, 1 / n)]
    difference = np.hstack([a.T, -b.T])
    result = minimize(
        lambda w: np.sum((difference @ w) ** 2),
        start,
        jac=lambda w: 2 * difference.T @ (difference @ w),
        bounds=[(0, 1)] * (m + n),
        constraints=[{"type": "eq", "fun": lambda w: equal[2:] @ w - 1, "jac": lambda w: equal[2:]}],
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 300},
    )
    return float(np.linalg.norm(difference @ result.x))


def random_polygon(rng: np.random.Generator, scale: float) -> np.ndarray:
    """Corners on an ellipse, counter-clockwise: convex."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 8)))
    return SE2(*rng.uniform(-3, 3, 3)).transform(np.stack([scale * np.cos(angles), 0.6 * scale * np.sin(angles)], axis=1))


@pytest.mark.parametrize("seed", range(30))
def test_polygon_distance_against_optimization(seed: int) -> None:
    """Oracle: linear and quadratic programming (scipy), overlapping and apart; and symmetry."""
    rng = np.random.default_rng(seed)
    a, b = random_polygon(rng, rng.uniform(0.2, 3)), random_polygon(rng, rng.uniform(0.2, 3))
    assert polygon_distance(a, b) == pytest.approx(convex_distance(a, b), abs=1e-4)
    assert polygon_distance(a, b) == pytest.approx(polygon_distance(b, a), abs=1e-12)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ([[3, 0], [4, 0], [4, 1], [3, 1]], 2.0),
        ([[2, 2], [3, 2], [3, 3], [2, 3]], math.sqrt(2)),
        ([[1, 0], [2, 0], [2, 1], [1, 1]], 0.0),
        ([[0.4, 0.4], [0.6, 0.4], [0.6, 0.6], [0.4, 0.6]], 0.0),
        ([[-5, 0.4], [5, 0.4], [5, 0.6], [-5, 0.6]], 0.0),
        ([[-5, -5], [5, -5], [5, 5], [-5, 5]], 0.0),
        ([[0.5, 1.25]], 0.25),
        ([[0.5, 0.5]], 0.0),
        ([[-1, 3], [3, -1.0]], 0.0),
        ([[1, 2], [2, 1]], math.sqrt(0.5)),
    ],
)
def test_distance_of_the_unit_square_by_hand(other: list, expected: float) -> None:
    """Oracle: drawn on paper: beside, diagonal, touching, inside, crossing, around, a point, a segment."""
    assert polygon_distance([[0, 0], [1, 0], [1, 1], [0, 1]], other) == pytest.approx(expected, abs=1e-12)


@given(seeds, st.floats(-4, 4), st.floats(-4, 4), st.floats(-8, 40), st.floats(-8, 40))
def test_footprint_clearance_against_all_squares(seed: int, theta: float, heading: float, x: float, y: float) -> None:
    """Oracle: `polygon_distance` (checked above) to every blocked square one by one."""
    blocked = random_mask(seed, 33, 21, 0.03)
    grid = GridMap(blocked, 0.1, SE2(2, -1, theta))
    footprint = Footprint.rectangle(front=0.35, rear=0.15, half_width=0.2)
    vertices = footprint.at(grid.origin @ SE2(x * 0.1, y * 0.1, heading))
    squares = [
        grid.origin.transform(np.array([[c, r], [c + 1, r], [c + 1, r + 1], [c, r + 1]]) * 0.1) for r, c in np.argwhere(blocked)
    ]
    expected = min(polygon_distance(vertices, square) for square in squares)
    assert footprint_clearance(grid, blocked, vertices) == pytest.approx(expected, abs=1e-9)


def test_clearance_in_a_corridor() -> None:
    """Oracle: by hand: walls at y = 0 and y = 2, a 0.4 m wide car: (2 - 0.4) / 2 in the middle, never negative."""
    blocked = np.zeros((22, 100), dtype=bool)
    blocked[[0, -1]] = True
    field = ClearanceField(GridMap(blocked, 0.1, SE2(-5, -0.1)), blocked)
    car = Footprint.rectangle(0.3, 0.3, 0.2)
    assert field.footprint(car.at(SE2(0, 1, 0))) == pytest.approx(0.8, abs=1e-12)
    assert field.footprint(car.at(SE2(0, 0.5, math.pi))) == pytest.approx(0.3, abs=1e-12)
    assert field.footprint(car.at(SE2(0, 1, math.pi / 2))) == pytest.approx(0.7, abs=1e-12)
    reach = 0.3 * math.sin(0.4) + 0.2 * math.cos(0.4)
    assert field.footprint(car.at(SE2(0, 1, 0.4))) == pytest.approx(1 - reach, abs=1e-12)
    assert field.footprint(car.at(SE2(0, 0.1, 0))) == 0.0


@given(seeds, st.floats(0, 6), *[st.floats(-5, 25)] * 4)
def test_segment_clear_against_all_squares(seed: int, radius: float, x0: float, y0: float, x1: float, y1: float) -> None:
    """Oracle: `polygon_distance` of the segment to every blocked square."""
    blocked = random_mask(seed, 19, 23, 0.03)
    segment = np.array([[x0, y0], [x1, y1]])
    squares = [np.array([[c, r], [c + 1, r], [c + 1, r + 1], [c, r + 1]]) for r, c in np.argwhere(blocked)]
    distance = min(polygon_distance(segment, square) for square in squares)
    tree = pyramid(blocked)
    assert segment_clear(tree, x0, y0, x1, y1, max(0.0, distance - 1e-9))
    assert not segment_clear(tree, x0, y0, x1, y1, distance + 1e-9)
    assert segment_clear(tree, x0, y0, x1, y1, radius) == (distance >= radius) or distance == pytest.approx(radius, abs=1e-9)


@pytest.mark.parametrize("blocked", [np.zeros(3, dtype=bool), np.zeros((0, 3), dtype=bool)])
def test_masks_have_rows_and_columns(blocked: np.ndarray) -> None:
    with pytest.raises(ValueError, match="rows and columns"):
        distance_transform(blocked)


def test_mask_and_grid_must_agree() -> None:
    with pytest.raises(ValueError, match="shape"):
        ClearanceField(GridMap(np.zeros((3, 4)), 1.0), np.zeros((4, 3), dtype=bool))
