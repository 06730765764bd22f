"""Shortest paths of a disc against closed forms and a brute-force visibility graph."""

import math
import os
from pathlib import Path as FilePath

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra

from robocar.core import SE2, GridMap
from robocar.core.distance import ClearanceField, obstacle_distance, polygon_distance, pyramid, segment_clear
from robocar.core.geodesic import geodesic_distance, geodesic_path

DATA = FilePath(os.environ.get("ROBOCAR_DATA", FilePath(__file__).parents[2] / ".." / "shared" / "data"))


def visibility_graph_length(blocked: np.ndarray, start: tuple, goal: tuple, radius: float) -> float:
    """Shortest path in cells over all pairs of points around all corners, by scipy's Dijkstra.

    Each corner of each square is ringed by a polygon around the disc: 24 sides cost an arc at most 0.6 %. Disc and point keep a
    hair off: neither may touch, so a gap as wide as the disc is none.
    """
    ring = radius + 1e-4
    angles = (np.arange(24) + 0.5) * (2 * np.pi / 24)
    circle = ring / np.cos(np.pi / 24) * (1 + 1e-9) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cells = np.argwhere(blocked)
    corners = np.unique(np.concatenate([cells + offset for offset in ([0, 0], [0, 1], [1, 0], [1, 1])]), axis=0)[:, ::-1]
    tree = pyramid(blocked)
    around = (corners[:, None, :] + circle[None]).reshape(-1, 2)
    around = [p for p in around if segment_clear(tree, *p, *p, ring) and np.all(p >= 0) and np.all(p <= blocked.shape[::-1])]
    nodes = np.array([start, goal, *around])
    weights = np.zeros((len(nodes), len(nodes)))
    for i, p in enumerate(nodes):
        for j, q in enumerate(nodes[:i]):
            if segment_clear(tree, *p, *q, ring):
                weights[i, j] = np.linalg.norm(p - q)
    return float(dijkstra(weights, directed=False, indices=0)[1])


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 0.65, 1.0]))
@example(493252750, 1.0)  # the only way leads through a gap of two cells
def test_against_a_visibility_graph(seed: int, radius: float) -> None:
    """Oracle: brute force. The graph's arcs are up to 0.6 % too long, so ours may be that much shorter, and 1 % longer."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((8, 9)) < 0.12
    free = np.argwhere(obstacle_distance(blocked, 1.0) > radius)
    assume(len(free) >= 2)
    start, goal = (tuple(float(v) for v in cell[::-1] + 0.5) for cell in rng.choice(free, 2, replace=False))
    length = geodesic_distance(GridMap(blocked, 1.0), blocked, start, goal, radius)
    expected = visibility_graph_length(blocked, start, goal, radius)
    assert 0.994 * expected <= length <= 1.01 * expected


@pytest.mark.parametrize("seed", range(6))
def test_larger_maps_against_a_visibility_graph(seed: int) -> None:
    """Oracle: brute force for (nearly) a point: one node just off every convex corner is enough."""
    rng = np.random.default_rng(seed)
    side, off = 40, 1e-4
    blocked = rng.random((side, side)) < (0.1, 0.2, 0.3)[seed % 3]
    blocked[:3, :3] = blocked[-3:, -3:] = False
    nodes = [(0.5, 0.5), (side - 0.5, side - 0.5)]
    for row, col in np.ndindex(side - 1, side - 1):
        four = blocked[row : row + 2, col : col + 2]
        if four.sum() == 1:
            (i, j) = np.argwhere(four)[0]
            nodes.append((col + 1 + (1 - 2 * j) * off, row + 1 + (1 - 2 * i) * off))
    tree, weights = pyramid(blocked), np.zeros((len(nodes), len(nodes)))
    for i, p in enumerate(nodes):
        for j, q in enumerate(nodes[:i]):
            if segment_clear(tree, *p, *q, 0.99 * off):
                weights[i, j] = math.dist(p, q)
    expected = dijkstra(weights, directed=False, indices=0)[1]
    length = geodesic_distance(GridMap(blocked, 1.0), blocked, *nodes[:2], off)
    assert expected - 1e-2 <= length <= 1.01 * expected


@pytest.mark.parametrize("radius", [0.0, 0.05, 0.3, 1.0, 2.5])
@pytest.mark.parametrize("scale", [0.05, 1.0])
def test_around_the_end_of_a_wall(radius: float, scale: float) -> None:
    """Oracle: two tangents, two arcs and the top of the wall, in closed form; on a shifted and rotated grid."""
    blocked = np.zeros((20, 20), dtype=bool)
    blocked[:10, 10] = True  # x in [10, 11], y up to 10
    grid = GridMap(blocked, scale, SE2(3, -2, 0.7))
    legs = arcs = 0.0
    for dx, dy in ((8, 7), (7, 7)):
        legs += math.sqrt(dx**2 + dy**2 - radius**2)
        arcs += radius * (math.atan2(dy, dx) + math.asin(radius / math.hypot(dx, dy)))
    start, goal = grid.origin.transform(np.array([[2.0, 3.0], [18.0, 3.0]]) * scale)
    assert geodesic_distance(grid, blocked, start, goal, radius * scale) == pytest.approx((legs + arcs + 1) * scale, rel=2e-4)


def test_straight_lines_are_exact() -> None:
    """Oracle: Euclid."""
    blocked = np.zeros((10, 10), dtype=bool)
    blocked[0] = True
    path = geodesic_path(GridMap(blocked, 0.1), blocked, [0.2, 0.3], [0.85, 0.7], 0.1)
    np.testing.assert_array_equal(path.points, [[0.2, 0.3], [0.85, 0.7]])
    assert geodesic_distance(GridMap(blocked, 0.1), blocked, [0.5, 0.5], [0.5, 0.5], 0.1) == 0.0


def serpentine(corridors: int, width: int, length: int) -> np.ndarray:
    """Corridors one above the other, joined at alternating ends, walls one cell thick."""
    blocked = np.ones((corridors * (width + 1) + 1, length), dtype=bool)
    for k in range(corridors):
        low = k * (width + 1) + 1
        blocked[low : low + width, 1:-1] = False
        if k > 0:
            blocked[low - 1, 1 : 1 + width] = k % 2 == 1
            blocked[low - 1, -1 - width : -1] = k % 2 == 0
    return blocked


def test_serpentine_in_closed_form() -> None:
    """Oracle: a point in corridors of 3 cells turns around the two corners of each wall's end: taut zigzag, computed by hand."""
    blocked = serpentine(4, 3, 40)
    # Walls at rows 4, 8, 12 end at x = 36, 4, 36 (openings 36..39, 1..4, 36..39).
    points = [(2.5, 2.5), (36, 4), (36, 5), (4, 8), (4, 9), (36, 12), (36, 13), (2.5, 14.5)]
    expected = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    assert geodesic_distance(GridMap(blocked, 1.0), blocked, points[0], points[-1], 0.0) == pytest.approx(expected, rel=2e-4)


@pytest.mark.parametrize(("radius", "passes"), [(0.9, True), (0.99, True), (1.0, False), (1.01, False)])
def test_a_gap_of_two_cells(radius: float, passes: bool) -> None:
    """Oracle: a disc passes a gap of two cells if its diameter is below two; the middle lies between the cells' centres."""
    blocked = np.zeros((12, 15), dtype=bool)
    blocked[:, 7] = True
    blocked[5:7, 7] = False
    length = geodesic_distance(GridMap(blocked, 1.0), blocked, [2.5, 6.0], [12.5, 6.0], radius)
    assert length == (10.0 if passes else math.inf)
    around = geodesic_distance(GridMap(blocked, 1.0), blocked, [2.5, 3.0], [12.5, 9.0], radius)
    assert math.isfinite(around) == passes


def test_diagonal_neighbours_leave_no_gap() -> None:
    """Oracle: closed squares that share a corner touch."""
    blocked = np.eye(6, dtype=bool)
    assert geodesic_distance(GridMap(blocked, 1.0), blocked, [1.5, 4.5], [4.5, 1.5], 0.0) == math.inf


@pytest.mark.parametrize(
    ("start", "goal", "radius"),
    [
        ((2.5, 2.5), (8, 8), 0.1),
        ((8, 8), (2.5, 2.5), 0.1),
        ((-1, 5), (8, 8), 0.1),
        ((8, 8), (5, 11), 0.1),
        ((4, 2.5), (8, 8), 1.5),
    ],
)
def test_no_path_from_where_the_disc_does_not_fit(start: tuple, goal: tuple, radius: float) -> None:
    """Oracle: by hand: inside a wall, outside the grid, too near to a wall."""
    blocked = np.zeros((10, 10), dtype=bool)
    blocked[2, 2] = True
    assert geodesic_path(GridMap(blocked, 1.0), blocked, start, goal, radius) is None


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(0, 0.16))
def test_the_path_is_free_and_symmetric(seed: int, radius: float) -> None:
    """Oracle: every stretch keeps its distance; there and back are equally long; a larger disc never has a shorter way."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((20, 24)) < 0.15
    blocked[:3, :3] = blocked[-3:, -3:] = False
    grid = GridMap(blocked, 0.1, SE2(*rng.uniform(-3, 3, 3)))
    ends = grid.world_from_cell([[0, 0], [19, 23]])
    path = geodesic_path(grid, blocked, *ends, radius)
    points = ends if path is None else path.points
    field = ClearanceField(grid, blocked)
    stretches = np.stack([points[:-1], points[1:]], axis=1)
    assert path is None or min(field.footprint(stretch) for stretch in stretches) >= radius
    np.testing.assert_allclose(points[[0, -1]], ends, atol=1e-12)
    there = math.inf if path is None else path.length
    assert geodesic_distance(grid, blocked, ends[1], ends[0], radius) == pytest.approx(there, rel=3e-4)
    assert geodesic_distance(grid, blocked, *ends, 0.7 * radius) <= there * 1.005


@pytest.mark.parametrize("name", ["arena", "lak105d", "room-32-32-4", "random-32-32-10"])
def test_published_octile_lengths_are_an_upper_bound(name: str) -> None:
    """Oracle: MovingAI's optimal octile lengths: any-angle is never longer, and at most 8.2 % shorter per open stretch.

    Octile paths keep off corners, so in narrow places the taut way is shorter still; Euclid's distance bounds it from below.
    """
    if not DATA.is_dir():
        pytest.skip(f"no test data at {DATA} (set ROBOCAR_DATA)")
    lines = (DATA / "movingai" / f"{name}.map").read_text().split()
    rows = [line for line in lines[lines.index("map") + 1 :] if line]
    blocked = np.array([[c not in ".G" for c in row] for row in rows])
    grid = GridMap(blocked, 1.0)
    (scenario,) = (DATA / "movingai").glob(f"{name}*.scen")
    queries = [line.split() for line in scenario.read_text().splitlines()[1:] if line.strip()]
    checked = 0
    for *_, x0, y0, x1, y1, optimum in queries[:: max(1, len(queries) // 15)]:
        start, goal = np.array([[float(x0), float(y0)], [float(x1), float(y1)]]) + 0.5
        length = geodesic_distance(grid, blocked, start, goal, 0.0)
        assert np.linalg.norm(goal - start) - 1e-9 <= length <= float(optimum) + 1e-2
        checked += 1
    assert checked >= 15


@pytest.mark.parametrize("radius", [-0.1, math.nan, math.inf])
def test_bad_radius(radius: float) -> None:
    with pytest.raises(ValueError, match="radius"):
        geodesic_distance(GridMap(np.zeros((3, 3)), 1.0), np.zeros((3, 3), dtype=bool), [0.5, 0.5], [1, 1], radius)


def test_polygon_distance_of_the_taut_path_touches_the_corner() -> None:
    """Oracle: a taut path around an obstacle touches it: its clearance equals the radius."""
    blocked = np.zeros((20, 20), dtype=bool)
    blocked[:10, 10] = True
    path = geodesic_path(GridMap(blocked, 1.0), blocked, [2.0, 3.0], [18.0, 3.0], 1.5)
    wall = [[10, 0], [11, 0], [11, 10], [10, 10]]
    nearest = min(polygon_distance(path.points[i : i + 2], wall) for i in range(len(path.points) - 1))
    assert nearest == pytest.approx(1.5, abs=1e-3)
