"""Covering the occupied cells of a grid by few rectangles, so that a map becomes few boxes.

Rectangles may overlap, unlike those of a partition (`dm_control.locomotion.arenas.covering`), so each is as large as it can be: a
thick box pushes a car out the right way, and the seams between boxes lie inside others.

It is the greedy algorithm for set cover (Chvatal, 1979) over all maximal rectangles: take the one that covers most cells still
to be covered, again and again, then drop those that later ones have made redundant. On random grids the count is within a few
percent of the fewest (`tests/sim/test_cover.py` compares with the exact optimum). Leaving out cells whose neighbours are all
occupied was tried and saves nothing (a cave of 512 x 512 cells: 10 018 rectangles instead of 10 011): the ragged edge decides
the count, not the inside.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import MapFormatError

Rectangles = NDArray[np.int64]


def cover(blocked: NDArray[np.bool_], most: int | None = None) -> Rectangles:
    """Few rectangles whose union is exactly the blocked cells.

    Args:
        blocked: (rows, cols).
        most: maps that need more rectangles are refused before they are computed.

    Returns:
        (n, 4) as (first row, first col, last row + 1, last col + 1), each maximal: none can grow without meeting a cell
        that is not blocked. The same grid gives the same rectangles in the same order.

    Raises:
        ValueError: not two-dimensional.
        MapFormatError: more than `most`.
    """
    blocked = np.ascontiguousarray(blocked, dtype=np.bool_)
    if blocked.ndim != 2:
        raise ValueError(f"blocked cells need rows and columns, not shape {blocked.shape}")
    if most is not None and (least := _corners(blocked) // 4) > most:  # a rectangle has four
        raise MapFormatError(f"the map's walls need {least} boxes or more, at most {most} are simulated")
    candidates = _maximal_rectangles(blocked)
    return _without_redundant(_greedy(candidates, blocked.copy()), blocked.shape)


@njit(cache=True)
def _corners(blocked: NDArray[np.bool_]) -> int:
    """Convex corners of the blocked area: points at which one cell of four is blocked, or two across."""
    rows, cols = blocked.shape
    count = 0
    for row in range(rows + 1):
        for col in range(cols + 1):
            a = row > 0 and col > 0 and blocked[row - 1, col - 1]
            b = row > 0 and col < cols and blocked[row - 1, col]
            c = row < rows and col > 0 and blocked[row, col - 1]
            d = row < rows and col < cols and blocked[row, col]
            around = int(a) + int(b) + int(c) + int(d)
            count += 1 if around == 1 else 2 if around == 2 and a == d else 0
    return count


@njit(cache=True)
def _maximal_rectangles(blocked: NDArray[np.bool_]) -> Rectangles:
    """All rectangles of blocked cells that cannot grow to any side, (n, 4).

    Row by row as the lower side of a histogram: a stack of rising heights yields each rectangle that cannot grow left, right
    or up; it is maximal if the next row does not continue it. At most one per cell.
    """
    rows, cols = blocked.shape
    found = np.empty((rows * cols, 4), dtype=np.int64)
    count = 0
    height = np.zeros(cols + 1, dtype=np.int64)  # of the blocked column that ends here; the last stays 0
    continued = np.zeros(cols + 1, dtype=np.int64)  # blocked cells of the next row up to a column
    stack_start = np.empty(cols + 1, dtype=np.int64)
    stack_height = np.empty(cols + 1, dtype=np.int64)
    for row in range(rows):
        for col in range(cols):
            height[col] = height[col] + 1 if blocked[row, col] else 0
            below = row + 1 < rows and blocked[row + 1, col]
            continued[col + 1] = continued[col] + (1 if below else 0)
        top = 0
        for col in range(cols + 1):
            start = col
            while top > 0 and stack_height[top - 1] > height[col]:
                top -= 1
                start = stack_start[top]
                if continued[col] - continued[start] < col - start:
                    found[count, 0] = row + 1 - stack_height[top]
                    found[count, 1] = start
                    found[count, 2] = row + 1
                    found[count, 3] = col
                    count += 1
            if height[col] > 0 and (top == 0 or stack_height[top - 1] < height[col]):
                stack_start[top] = start
                stack_height[top] = height[col]
                top += 1
    return found[:count].copy()


@njit(cache=True)
def _greedy(candidates: Rectangles, left: NDArray[np.bool_]) -> Rectangles:
    """Rectangles in the order in which each covers most of what is left, (n, 4); `left` (rows, cols) is all False afterwards.

    A gain only ever shrinks, so it is counted again only when its candidate's turn comes; candidates wait in one list per gain.
    """
    gains = (candidates[:, 2] - candidates[:, 0]) * (candidates[:, 3] - candidates[:, 1])
    first = np.full((gains.max() if len(gains) else 0) + 1, -1, dtype=np.int64)
    following = np.empty(len(candidates), dtype=np.int64)
    for k in range(len(candidates)):
        following[k] = first[gains[k]]
        first[gains[k]] = k
    chosen = np.empty((len(candidates), 4), dtype=np.int64)
    count = 0
    for gain in range(len(first) - 1, 0, -1):
        while first[gain] >= 0:
            k = first[gain]
            first[gain] = following[k]
            r0, c0, r1, c1 = candidates[k]
            now = 0
            for row in range(r0, r1):
                for col in range(c0, c1):
                    now += left[row, col]
            if now == gain:
                left[r0:r1, c0:c1] = False
                chosen[count] = candidates[k]
                count += 1
            elif now > 0:
                following[k] = first[now]
                first[now] = k
    return chosen[:count].copy()


@njit(cache=True)
def _without_redundant(rectangles: Rectangles, shape: tuple[int, int]) -> Rectangles:
    """The rectangles without those whose cells others cover as well, the last chosen looked at first, (n, 4)."""
    times = np.zeros(shape, dtype=np.int32)
    for r0, c0, r1, c1 in rectangles:
        times[r0:r1, c0:c1] += 1
    keep = np.ones(len(rectangles), dtype=np.bool_)
    for k in range(len(rectangles) - 1, -1, -1):
        r0, c0, r1, c1 = rectangles[k]
        if np.all(times[r0:r1, c0:c1] > 1):
            keep[k] = False
            times[r0:r1, c0:c1] -= 1
    return rectangles[keep]
