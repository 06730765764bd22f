"""Straight segments across the cells of a costmap: their cost, and whether the robot may drive them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import INSCRIBED, Array

# Crossings of two cell borders nearer than this, as a share of the segment, are one crossing of a corner.
_TIE = 1e-9


@njit(cache=True)
def segment_cost(cost: NDArray[np.uint8], x0: float, y0: float, x1: float, y1: float) -> float:
    """Line integral of 1 + c / 252 along a segment [cells], inf where it enters a blocked cell.

    The cells are walked exactly (Amanatides and Woo, 1987). Where the segment runs through a corner, both cells beside it must be
    free too: nothing squeezes between two obstacles, and a diagonal step of the grid costs what `grid_search` says.

    Args:
        cost: (rows, cols).
        x0, y0, x1, y1: the ends in grid coordinates (column, row in cells); outside the grid everything is blocked.
    """
    rows, cols = cost.shape
    col, row = math.floor(x0), math.floor(y0)
    last_col, last_row = math.floor(x1), math.floor(y1)
    if min(col, last_col) < 0 or max(col, last_col) >= cols or min(row, last_row) < 0 or max(row, last_row) >= rows:
        return math.inf
    dx, dy = x1 - x0, y1 - y0
    step_col = 1 if last_col > col else -1
    step_row = 1 if last_row > row else -1
    travelled, integral = 0.0, 0.0  # share of the segment, its integral
    while True:
        c = cost[row, col]
        if c >= INSCRIBED:
            return math.inf
        # Borders are counted, not accumulated: rounding does not grow along the segment and the last cell is never missed.
        next_x = ((col + (step_col > 0)) - x0) / dx if col != last_col else math.inf
        next_y = ((row + (step_row > 0)) - y0) / dy if row != last_row else math.inf
        crossing = min(1.0, next_x, next_y)
        integral += (crossing - travelled) * (1.0 + c / 252.0)
        travelled = crossing
        if col == last_col and row == last_row:
            return integral * math.hypot(dx, dy)
        if abs(next_x - next_y) <= _TIE:
            if cost[row, col + step_col] >= INSCRIBED or cost[row + step_row, col] >= INSCRIBED:
                return math.inf
            col += step_col
            row += step_row
        elif next_x < next_y:
            col += step_col
        else:
            row += step_row


@njit(cache=True)
def polyline_cost(cost: NDArray[np.uint8], points: Array) -> float:
    """Sum of `segment_cost` over a polyline (n, 2) in grid coordinates (column, row) [cells]."""
    total = 0.0
    for i in range(len(points) - 1):
        total += segment_cost(cost, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1])
    return total


@njit(cache=True)
def pull_taut(cost: NDArray[np.uint8], points: Array) -> Array:
    """The polyline without the corners that make it neither cheaper nor possible.

    Each corner taken out replaces two segments by a straight one that costs no more, so cost and length never grow.

    Args:
        points: (n, 2) in grid coordinates (column, row) [cells], free of collision.
    """
    kept = points.copy()
    n = len(kept)
    before = n + 1
    while n < before:
        before = n
        m = 1  # kept[:m] is done, kept[m - 1] its last corner
        for i in range(1, n - 1):
            ax, ay = kept[m - 1]
            bx, by = kept[i]
            cx, cy = kept[i + 1]
            around = segment_cost(cost, ax, ay, bx, by) + segment_cost(cost, bx, by, cx, cy)
            if not segment_cost(cost, ax, ay, cx, cy) <= around * (1.0 + 1e-12):
                kept[m] = kept[i]
                m += 1
        kept[m] = kept[n - 1]
        n = m + 1
        if n <= 2:
            break
    return kept[:n].copy()
