"""Round obstacles. Oracles: dense polygons, geometry by hand, and the geodesic on a fine raster of the same discs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import FREE, OCCUPIED, SE2, Footprint, OccupancyGrid
from robocar.core.discs import Discs, disc_geodesic
from robocar.core.distance import polygon_distance
from robocar.core.geodesic import geodesic_distance

CAR = Footprint.rectangle(0.12, 0.08, 0.09)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_distance_is_that_of_dense_polygons(seed: int) -> None:
    """A polygon of 400 corners lies within r (1 / cos(pi / 400) - 1) < 4e-5 r of its circle."""
    rng = np.random.default_rng(seed)
    discs = np.column_stack([rng.uniform(-1, 1, (6, 2)), rng.uniform(0.0, 0.4, 6)])
    corners = CAR.at(SE2(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-3, 3)))
    angles = np.linspace(0, math.tau, 400, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    expected = min(polygon_distance(corners, centre + max(r, 1e-9) * circle) for *centre, r in discs)
    assert Discs(discs).distance(corners) == pytest.approx(expected, abs=5e-5)


def test_no_discs_are_infinitely_far() -> None:
    assert Discs(np.empty((0, 3))).distance(CAR.vertices) == math.inf
    with pytest.raises(ValueError, match="radii"):
        Discs([[0, 0, -1]])


@settings(max_examples=50, deadline=None)
@given(r=st.floats(0.05, 0.5), radius=st.floats(0.0, 0.3), offset=st.floats(-0.7, 0.7), turn=st.floats(-3, 3))
def test_round_a_single_disc(r: float, radius: float, offset: float, turn: float) -> None:
    """By hand: two tangents and the arc between them, the shorter way round; straight where the disc is not in the way."""
    start, goal, centre = (SE2(0.3, -0.2, turn).transform(p) for p in ([-1.0, 0.0], [1.5, 0.0], [0.0, offset]))
    grown = r + radius
    if abs(offset) >= grown:
        expected = 2.5
    else:
        near, far = math.hypot(1.0, offset), math.hypot(1.5, offset)
        spread = math.atan2(1.0, abs(offset)) + math.atan2(1.5, abs(offset))  # angle from start over the centre to goal
        expected = math.sqrt(near**2 - grown**2) + math.sqrt(far**2 - grown**2)
        expected += grown * max(spread - math.acos(grown / near) - math.acos(grown / far), 0.0)
    assert disc_geodesic([[*centre, r]], start, goal, radius) == pytest.approx(expected, rel=1e-9)


def raster(discs: np.ndarray, resolution: float) -> OccupancyGrid:
    """Every cell that a disc covers in part, of the square from -0.2 to 1.2."""
    n = round(1.4 / resolution)
    edges = -0.2 + resolution * np.arange(n)
    x, y = np.meshgrid(edges, edges)
    blocked = np.zeros((n, n), dtype=bool)
    for cx, cy, r in discs:
        nearest_x, nearest_y = np.clip(cx, x, x + resolution), np.clip(cy, y, y + resolution)
        blocked |= np.hypot(nearest_x - cx, nearest_y - cy) < r
    return OccupancyGrid(np.where(blocked, OCCUPIED, FREE).astype(np.int8), resolution, SE2(-0.2, -0.2))


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_among_many_discs_a_fine_raster_agrees(seed: int) -> None:
    """The raster's obstacles contain the discs and exceed them by at most a cell's diagonal."""
    rng = np.random.default_rng(seed)
    discs = np.column_stack([rng.uniform(0.1, 0.9, (14, 2)), rng.uniform(0.02, 0.10, 14)])
    start, goal, radius, resolution = np.array([0.0, 0.0]), np.array([1.0, 1.0]), 0.03, 0.01
    exact = disc_geodesic(discs, start, goal, radius)
    wider = disc_geodesic(discs + np.array([0.0, 0.0, math.sqrt(2) * resolution]), start, goal, radius)
    grid = raster(discs, resolution)
    on_raster = geodesic_distance(grid, grid.occupied, start, goal, radius)
    assert exact <= on_raster + 1e-9
    assert on_raster <= 1.01 * wider
    assert disc_geodesic(discs, goal, start, radius) == pytest.approx(exact)


def test_where_there_is_no_way() -> None:
    angles = np.arange(12) * math.tau / 12
    ring = np.stack([np.cos(angles), np.sin(angles), np.full(12, 0.2)], axis=1)  # gaps of 0.1176 m
    assert disc_geodesic(ring, [0, 0], [3, 0], 0.0587) < math.inf
    assert disc_geodesic(ring, [0, 0], [3, 0], 0.0589) == math.inf
    assert disc_geodesic(ring, [1, 0], [3, 0], 0.01) == math.inf  # starts in a disc
    assert disc_geodesic(ring, [0, 0], [1, 0.15], 0.1) == math.inf  # ends too near to one
    assert disc_geodesic(np.concatenate([ring, [[0, 0, 3.5]]]), [-4, 0], [4, 0], 0.01) > 8.0  # discs within discs


def test_nothing_in_the_way() -> None:
    assert disc_geodesic(np.empty((0, 3)), [0, 0], [3, 4], 0.1) == 5.0
    assert disc_geodesic([[9, 9, 1]], [1, 2], [1, 2], 0.1) == 0.0
    with pytest.raises(ValueError, match="finite"):
        disc_geodesic([[9, 9, 1]], [math.nan, 0], [1, 1], 0.1)
