"""Where a robot is along a path, and what lies ahead of it there."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import INSCRIBED, Array
from robocar.planners.geometry.line_of_sight import segment_cost


@njit(cache=True)
def nearest_on_path(points: Array, segment: int, x: float, y: float, window: float) -> tuple[int, float, float]:
    """The point of the path (n, 2) nearest to (x, y), from `segment` on and at most `window` along the path ahead.

    The window keeps a path that comes back near itself from being cut short. It begins at the point of `segment` nearest to
    (x, y), so that a segment longer than the window can be left too.

    Returns:
        Its segment, its share of that segment in [0, 1], and its distance, in the unit of the points.
    """
    n = len(points)
    if n == 1:
        return 0, 0.0, math.hypot(points[0, 0] - x, points[0, 1] - y)
    best, best_segment, best_share = math.inf, segment, 0.0
    ahead = 0.0
    for i in range(segment, n - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        squared = dx * dx + dy * dy
        share = 0.0
        if squared > 0.0:
            share = min(1.0, max(0.0, ((x - points[i, 0]) * dx + (y - points[i, 1]) * dy) / squared))
        distance = math.hypot(points[i, 0] + share * dx - x, points[i, 1] + share * dy - y)
        if distance < best:
            best, best_segment, best_share = distance, i, share
        ahead += (1.0 - share if i == segment else 1.0) * math.sqrt(squared)
        if ahead > window:
            break
    return best_segment, best_share, best


@njit(cache=True)
def point_ahead(points: Array, segment: int, share: float, lookahead: float) -> tuple[float, float, float]:
    """The point `lookahead` along the path (n, 2) from a point of it, or the path's end; and the way left to the end.

    Returns:
        x, y and way, in the unit of the points.
    """
    n = len(points)
    x, y = points[n - 1, 0], points[n - 1, 1]
    left, found = 0.0, False
    for i in range(segment, n - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length = math.hypot(dx, dy)
        start = share if i == segment else 0.0
        if not found and length > 0.0 and left + (1.0 - start) * length >= lookahead:
            at = start + (lookahead - left) / length
            x, y = points[i, 0] + at * dx, points[i, 1] + at * dy
            found = True
        left += (1.0 - start) * length
    return x, y, left


@njit(cache=True)
def blocked_ahead(costs: NDArray[np.uint8], points: Array, segment: int) -> bool:
    """Whether the path (n, 2), in grid coordinates [cells], runs into blocked cells from `segment` on.

    A stretch that begins in blocked cells does not count as long as it leads out of them: the robot is there already.
    """
    free_so_far = False
    for i in range(segment, len(points) - 1):
        row, col = math.floor(points[i, 1]), math.floor(points[i, 0])
        if 0 <= row < costs.shape[0] and 0 <= col < costs.shape[1] and costs[row, col] < INSCRIBED:
            free_so_far = True
        if free_so_far and segment_cost(costs, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]) == math.inf:
            return True
    last = len(points) - 1
    row, col = math.floor(points[last, 1]), math.floor(points[last, 0])
    inside = 0 <= row < costs.shape[0] and 0 <= col < costs.shape[1]
    return not (inside and costs[row, col] < INSCRIBED)
