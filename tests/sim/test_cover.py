"""The cover of a grid: oracles are brute force, dm_control's partition and the exact optimum by integer programming."""

from __future__ import annotations

import numpy as np
import pytest
from dm_control.locomotion.arenas.covering import make_walls
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.optimize import Bounds, LinearConstraint, milp

from robocar.formats.generated import cave, maze, rooms
from robocar.sim.cover import _maximal_rectangles, cover
from robocar.sim.wall_mesh import outline, wall_mesh

grids = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14))


class TextGrid:
    """What `make_walls` reads a grid from."""

    def __init__(self, blocked: np.ndarray) -> None:
        self._text = np.where(blocked, "*", " ")
        self.shape = blocked.shape

    def __getitem__(self, cell: tuple[int, int]) -> str:
        return self._text[cell]


def painted(rectangles: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Brute force: the cells of the rectangles."""
    cells = np.zeros(shape, dtype=bool)
    for r0, c0, r1, c1 in rectangles:
        assert 0 <= r0 < r1 <= shape[0]
        assert 0 <= c0 < c1 <= shape[1]
        cells[r0:r1, c0:c1] = True
    return cells


def maximal_by_brute_force(blocked: np.ndarray) -> set[tuple[int, ...]]:
    """Every rectangle tried: blocked throughout, and no larger one around it is."""
    rows, cols = blocked.shape
    full = {
        (r0, c0, r1, c1)
        for r0 in range(rows)
        for r1 in range(r0 + 1, rows + 1)
        for c0 in range(cols)
        for c1 in range(c0 + 1, cols + 1)
        if blocked[r0:r1, c0:c1].all()
    }
    grown = lambda r: {(r[0] - 1, *r[1:]), (r[0], r[1] - 1, *r[2:]), (*r[:2], r[2] + 1, r[3]), (*r[:3], r[3] + 1)}  # noqa: E731
    return {rectangle for rectangle in full if not grown(rectangle) & full}


def fewest(blocked: np.ndarray) -> int:
    """The optimum of the set cover by maximal rectangles, by integer programming (HiGHS)."""
    rectangles = np.array(sorted(maximal_by_brute_force(blocked)))
    rows, cols = np.nonzero(blocked)
    covers = (
        (rectangles[:, 0] <= rows[:, None])
        & (rows[:, None] < rectangles[:, 2])
        & (rectangles[:, 1] <= cols[:, None])
        & (cols[:, None] < rectangles[:, 3])
    )
    ones = np.ones(len(rectangles))
    found = milp(ones, constraints=LinearConstraint(covers.astype(float), lb=1), integrality=ones, bounds=Bounds(0, 1))
    return round(found.fun)


@settings(deadline=None)
@given(blocked=grids)
def test_the_rectangles_are_exactly_the_blocked_cells_and_each_is_maximal(blocked: np.ndarray) -> None:
    rectangles = cover(blocked)
    np.testing.assert_array_equal(painted(rectangles, blocked.shape), blocked)
    assert {tuple(r) for r in rectangles.tolist()} <= maximal_by_brute_force(blocked)


@settings(deadline=None)
@given(blocked=arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=8)))
def test_all_maximal_rectangles_are_found_once(blocked: np.ndarray) -> None:
    found = [tuple(r) for r in _maximal_rectangles(blocked).tolist()]
    assert sorted(found) == sorted(maximal_by_brute_force(blocked))


@settings(deadline=None)
@given(blocked=grids)
def test_no_rectangle_is_redundant(blocked: np.ndarray) -> None:
    rectangles = cover(blocked)
    without_each = [painted(np.delete(rectangles, k, axis=0), blocked.shape).sum() for k in range(len(rectangles))]
    assert all(cells < blocked.sum() for cells in without_each)


def test_count_is_close_to_the_optimum() -> None:
    rng = np.random.default_rng(0)
    random = [rng.random((10, 10)) < density for density in np.linspace(0.3, 0.9, 40)]
    best = np.array([fewest(blocked) for blocked in random])
    ours = np.array([len(cover(blocked)) for blocked in random])
    assert np.all(ours >= best)
    assert np.all(ours <= best + 2)
    assert ours.sum() <= 1.03 * best.sum()


@pytest.mark.parametrize(
    "make", [lambda rng: cave(96, 128, rng), lambda rng: maze(90, 70, 3, rng), lambda rng: rooms(80, 120, rng)]
)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_same_area_by_fewer_rectangles_than_dm_controls_partition(make, seed: int) -> None:
    blocked = make(np.random.default_rng(seed)).occupied
    theirs = [(w.start.y, w.start.x, w.end.y, w.end.x) for w in make_walls(TextGrid(blocked))]
    ours = cover(blocked)
    np.testing.assert_array_equal(painted(ours, blocked.shape), painted(np.array(theirs), blocked.shape))
    assert len(ours) < len(theirs)


def test_known_covers() -> None:
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)
    assert sorted(cover(cross).tolist()) == [[0, 1, 3, 2], [1, 0, 2, 3]]  # a partition needs three
    assert cover(np.ones((7, 3), dtype=bool)).tolist() == [[0, 0, 7, 3]]
    assert cover(np.zeros((4, 5), dtype=bool)).shape == (0, 4)


def test_views_and_transposes_are_covered_as_well() -> None:
    blocked = np.random.default_rng(3).random((20, 30)) < 0.6
    view = blocked.T[::-1, ::2]
    np.testing.assert_array_equal(painted(cover(view), view.shape), view)


def test_one_dimension_is_refused() -> None:
    with pytest.raises(ValueError, match="rows and columns"):
        cover(np.ones(5, dtype=bool))


@settings(deadline=None)
@given(blocked=grids)
def test_the_outline_encloses_the_blocked_area(blocked: np.ndarray) -> None:
    """Green's theorem: a closed outline with the inside on its left has the inside's signed area."""
    start, end = outline(blocked).transpose(1, 0, 2).astype(float)
    area = 0.5 * np.sum(start[:, 0] * end[:, 1] - end[:, 0] * start[:, 1])
    assert area == blocked.sum()
    padded = np.pad(blocked, 1)
    edges = np.count_nonzero(padded[1:] != padded[:-1]) + np.count_nonzero(padded[:, 1:] != padded[:, :-1])
    assert np.abs(end - start).sum() == edges


@settings(max_examples=50, deadline=None)
@given(blocked=grids, resolution=st.floats(0.01, 2.0), height=st.floats(0.1, 3.0))
def test_the_mesh_faces_outwards_and_encloses_the_walls(blocked: np.ndarray, resolution: float, height: float) -> None:
    """Gauss's theorem with the field (x, y, 0) / 2, whose divergence is 1: the flux through the sides is the volume."""
    rectangles = cover(blocked)
    vertices, triangles = wall_mesh(blocked, rectangles, resolution, height)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normals = 0.5 * np.cross(b - a, c - a)  # length: area
    flux = np.sum(normals[:, :2] * ((a + b + c) / 3)[:, :2]) / 2
    assert flux == pytest.approx(blocked.sum() * resolution**2 * height, abs=1e-9)
    tops = np.sum((rectangles[:, 2] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 1]))
    assert np.sum(normals[:, 2]) == pytest.approx(tops * resolution**2, abs=1e-9)
    assert np.all(normals[:, 2] >= 0)
