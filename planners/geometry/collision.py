"""Does the robot's outline touch an obstacle of the costmap?"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import LETHAL, Array


@njit(cache=True)
def footprint_free(costs: NDArray, x: float, y: float, theta: float, vertices: Array, walled: bool = False) -> bool:
    """Whether no lethal or unknown cell overlaps the footprint.

    Exact for convex outlines: two convex shapes are apart exactly if an edge of one of them separates them (separating axis
    theorem).

    Args:
        costs: (rows, cols).
        x, y, theta: the robot's pose in grid coordinates [cells, cells, rad].
        vertices: of its outline, counter-clockwise, (n, 2) [cells].
        walled: whether the place outside the grid is lethal (`Costmap.walled`); else it is free.
    """
    rows, cols = costs.shape
    n = len(vertices)
    c, s = math.cos(theta), math.sin(theta)
    corners = np.empty((n, 2))
    for i in range(n):
        corners[i, 0] = x + c * vertices[i, 0] - s * vertices[i, 1]
        corners[i, 1] = y + s * vertices[i, 0] + c * vertices[i, 1]
    left, right, low, high = corners[:, 0].min(), corners[:, 0].max(), corners[:, 1].min(), corners[:, 1].max()
    if walled and (left < 0.0 or low < 0.0 or right > cols or high > rows):
        return False
    first_col, last_col = max(0, math.floor(left)), min(cols - 1, math.ceil(right) - 1)
    first_row, last_row = max(0, math.floor(low)), min(rows - 1, math.ceil(high) - 1)
    for row in range(first_row, last_row + 1):
        for col in range(first_col, last_col + 1):
            if costs[row, col] < LETHAL:
                continue
            apart = False
            for i in range(n):
                ax, ay = corners[i]
                bx, by = corners[(i + 1) % n]
                # The square's corner farthest inwards of this edge; inwards is left of the edge.
                nx, ny = -(by - ay), bx - ax
                inner_x = col + 1.0 if nx > 0.0 else float(col)
                inner_y = row + 1.0 if ny > 0.0 else float(row)
                if (inner_x - ax) * nx + (inner_y - ay) * ny <= 0.0:
                    apart = True
                    break
            if not apart:
                return False
    return True
