"""Grid traversal and ray casting against exact rational arithmetic and box intersections."""

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robocar.core import SE2, GridMap
from robocar.core.rays import advance, advance_to, cast_rays, first_hit, segment_cells, start_ray, traverse

sixteenths = st.integers(-160, 160)


def crossed_exactly(x0: Fraction, y0: Fraction, x1: Fraction, y1: Fraction) -> list[tuple[int, int]]:
    """Cells whose open interior the segment meets, sorted along it: cut at all borders, look at the middle of each piece."""
    cuts = {Fraction(0), Fraction(1)}
    for a, b in ((x0, x1), (y0, y1)):
        borders = range(math.floor(min(a, b)), math.floor(max(a, b)) + 2) if a != b else ()
        cuts |= {t for border in borders if 0 <= (t := (border - a) / (b - a)) <= 1}
    order = sorted(cuts)
    middles = [(s + t) / 2 for s, t in pairwise(order)]
    return [(math.floor(y0 + t * (y1 - y0)), math.floor(x0 + t * (x1 - x0))) for t in middles]


@given(sixteenths, sixteenths, sixteenths, sixteenths)
def test_traversal_against_rational_arithmetic(a: int, b: int, c: int, d: int) -> None:
    """Oracle: exact fractions. Sixteenths are exact in binary, and meet corners and borders often."""
    cells = [tuple(cell) for cell in traverse(a / 16, b / 16, c / 16, d / 16).tolist()]
    assert cells[0] == (math.floor(b / 16), math.floor(a / 16))
    assert cells[-1] == (math.floor(d / 16), math.floor(c / 16))
    steps = np.abs(np.diff(cells, axis=0)).sum(axis=1) if len(cells) > 1 else np.ones(0)
    assert np.all(steps == 1)
    assert len(set(cells)) == len(cells)
    positions = [cells.index(cell) for cell in crossed_exactly(*(Fraction(v, 16) for v in (a, b, c, d)))]
    assert positions == sorted(positions)


def walked_exactly(x: Fraction, y: Fraction, dx: Fraction, dy: Fraction, steps: int) -> list[tuple[int, int, Fraction]]:
    """Row, column and parameter of entry of the first cells of a ray; each border's parameter by its own exact division."""
    row, col = math.floor(y), math.floor(x)
    cells = [(row, col, Fraction(0))]
    for _ in range(steps):
        crossing_x = (col + (dx > 0) - x) / dx if dx else None
        crossing_y = (row + (dy > 0) - y) / dy if dy else None
        if crossing_y is None or (crossing_x is not None and crossing_x <= crossing_y):
            assert crossing_x is not None
            col, entered = col + (1 if dx > 0 else -1), crossing_x
        else:
            row, entered = row + (1 if dy > 0 else -1), crossing_y
        cells.append((row, col, entered))
    return cells


@given(sixteenths, sixteenths, *[st.sampled_from([0, 1, -1, 2, -2, 4, -4])] * 2)
def test_the_walk_is_the_exact_one_and_at_corners_x_comes_first(a: int, b: int, dx: int, dy: int) -> None:
    """Oracle: exact fractions. With slopes that are powers of two no number is rounded: entries are equal to the last bit, and
    of the many corners each is passed along x first."""
    assume(dx or dy)
    expected = walked_exactly(Fraction(a, 16), Fraction(b, 16), Fraction(dx), Fraction(dy), 24)
    ray = start_ray(a / 16, b / 16, float(dx), float(dy))
    bound = start_ray(a / 16, b / 16, float(dx), float(dy))
    last_row, last_col, _ = expected[-1]
    for row, col, entered in expected:
        assert (ray.row, ray.col, ray.entered) == (row, col, entered)
        assert (bound.row, bound.col) == (row, col)
        ray, bound = advance(ray), advance_to(bound, last_row, last_col)


@given(*[st.floats(-20, 20)] * 4)
def test_traversal_against_dense_sampling(x0: float, y0: float, x1: float, y1: float) -> None:
    """Oracle: 2000 points of the segment; samples within 1e-9 of a border may belong to either side."""
    t = np.linspace(0, 1, 2000)[:, None]
    points = (1 - t) * [y0, x0] + t * [y1, x1]
    clear = np.all(np.abs(points - np.round(points)) > 1e-9, axis=1)
    sampled = {tuple(cell) for cell in np.floor(points[clear]).astype(int).tolist()}
    assert sampled <= {tuple(cell) for cell in traverse(x0, y0, x1, y1).tolist()}


@pytest.mark.parametrize(
    ("segment", "expected"),
    [
        ((0.5, 0.5, 0.7, 0.2), [(0, 0)]),
        ((0.5, 0.5, 3.5, 0.5), [(0, 0), (0, 1), (0, 2), (0, 3)]),
        ((0.5, 0.5, 0.5, -1.5), [(0, 0), (-1, 0), (-2, 0)]),
        ((0.5, 0.5, 2.5, 2.5), [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2)]),
    ],
)
def test_traversal_by_hand(segment: tuple[float, ...], expected: list[tuple[int, int]]) -> None:
    """Oracle: drawn on paper; through a corner the step along x comes first."""
    assert [tuple(cell) for cell in traverse(*segment).tolist()] == expected


def box_hit(blocked: np.ndarray, x: float, y: float, dx: float, dy: float) -> float:
    """Smallest distance at which the ray enters any blocked box: slabs (Kay and Kajiya, 1986), all boxes."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rows, cols = np.nonzero(blocked)
        tx = np.stack([cols - x, cols + 1 - x]) / dx
        ty = np.stack([rows - y, rows + 1 - y]) / dy
    enter = np.maximum(np.maximum(tx.min(axis=0), ty.min(axis=0)), 0)
    leave = np.minimum(tx.max(axis=0), ty.max(axis=0))
    return float(np.min(np.where(enter < leave, enter, np.inf), initial=np.inf))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-3, 15), st.floats(-3, 12), st.floats(-3.1, 3.1))
def test_first_hit_against_all_boxes(seed: int, x: float, y: float, angle: float) -> None:
    """Oracle: brute force over every box. Irrational starts keep the ray off corners, where touching is a matter of taste."""
    blocked = np.random.default_rng(seed).random((9, 12)) < 0.15
    x, y, dx, dy = x + 1e-3 * math.sqrt(2), y + 1e-3 * math.sqrt(3), math.cos(angle), math.sin(angle)
    expected = box_hit(blocked, x, y, dx, dy)
    # Grazing a corner by less than rounding may go either way: the oracle says whether this ray does.
    turned = [box_hit(blocked, x, y, math.cos(angle + e), math.sin(angle + e)) for e in (-1e-9, 1e-9)]
    assert first_hit(blocked, x, y, dx, dy, math.inf) == pytest.approx(expected, abs=1e-9) or turned[0] != pytest.approx(
        turned[1]
    )


@pytest.mark.parametrize(("dx", "dy", "expected"), [(1, 0, 3.5), (-1, 0, math.inf), (0, 1, math.inf), (0, -1, 1.5)])
def test_first_hit_along_the_axes(dx: float, dy: float, expected: float) -> None:
    """Oracle: by hand; without a limit a ray into the open still ends."""
    blocked = np.zeros((5, 6), dtype=bool)
    blocked[2, 5] = blocked[0, 1] = True
    assert first_hit(blocked, 1.5, 2.5, dx, dy, math.inf) == expected


def test_reach_and_starts_inside() -> None:
    blocked = np.zeros((3, 10), dtype=bool)
    blocked[1, 8] = True
    assert first_hit(blocked, 0.5, 1.5, 1.0, 0.0, 7.5) == 7.5
    assert first_hit(blocked, 0.5, 1.5, 1.0, 0.0, 7.49) == math.inf
    assert first_hit(blocked, 8.3, 1.2, 1.0, 0.0, 1.0) == 0.0
    assert first_hit(blocked, -4.0, 1.5, 1.0, 0.0, 20.0) == 12.0


def test_rays_in_the_world_follow_a_shifted_and_rotated_grid() -> None:
    """Oracle: rays turn with the grid, so those in the turned grid equal those at home, and a wall's distance is known."""
    blocked = np.random.default_rng(3).random((30, 40)) < 0.05
    blocked[[0, -1], :] = blocked[:, [0, -1]] = True
    home, moved = GridMap(blocked, 0.1), GridMap(blocked, 0.1, SE2(-3, 5, 2.1))
    angles = np.linspace(-3, 3, 101)
    at_home = cast_rays(home, blocked, [2.03, 1.51], angles, 2.0)
    np.testing.assert_allclose(
        cast_rays(moved, blocked, moved.origin.transform([2.03, 1.51]), angles + 2.1, 2.0), at_home, atol=1e-9
    )
    expected = [box_hit(blocked, 20.3, 15.1, np.cos(a), np.sin(a)) * 0.1 for a in angles]
    np.testing.assert_allclose(at_home, np.where(np.array(expected) <= 2.0, expected, np.inf), atol=1e-9)


def test_segment_cells_in_the_world() -> None:
    """Oracle: by hand, on a grid whose x axis points up."""
    grid = GridMap(np.zeros((3, 4)), 0.5, SE2(1, 2, math.pi / 2))
    np.testing.assert_array_equal(segment_cells(grid, [0.9, 2.1], [0.9, 3.6]), [[0, 0], [0, 1], [0, 2], [0, 3]])
