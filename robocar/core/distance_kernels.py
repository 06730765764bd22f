"""Kernels of the distance transforms: squared distances of all cells of a grid, in time linear in the cells.

Felzenszwalb and Huttenlocher, Distance Transforms of Sampled Functions (2012), sections 2 and 3.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core.geometry import Array

Blocked = NDArray[np.bool_]


@njit(cache=True)
def _nearest_along(height: Array, first: int, step: int, vertex: NDArray[np.int64], border: Array, out: Array) -> None:
    """out[i] = min over q of (first + step i - q)^2 + height[q]: the lower envelope of the parabolas, left as it is where all
    heights are inf. `vertex` (n,) and `border` (n + 1,) are working memory: the parabolas of the envelope, and where one hands
    over to the next."""
    count = 0
    for node in range(len(height)):
        f = height[node]
        if f == math.inf:
            continue
        start = -math.inf
        while count > 0:
            last = vertex[count - 1]
            start = ((f + node * node) - (height[last] + last * last)) / (2.0 * (node - last))
            if start > border[count - 1]:
                break
            count -= 1
            start = -math.inf
        vertex[count], border[count] = node, start
        count += 1
    if count == 0:
        return
    border[count] = math.inf
    k = 0
    for i in range(len(out)):
        node = first + step * i
        while border[k + 1] < node:
            k += 1
        out[i] = (node - vertex[k]) ** 2 + height[vertex[k]]


@njit(cache=True)
def squared_to_centres(blocked: Blocked) -> Array:
    """Squared distance in cells of every cell to the nearest blocked one (centre to centre), inf where there is none."""
    rows, cols = blocked.shape
    squared = np.empty((rows, cols))
    # First pass along the columns: two sweeps suffice, as the input is binary. Row by row, as the cells lie in memory.
    for col in range(cols):
        squared[0, col] = 0.0 if blocked[0, col] else math.inf
    for row in range(1, rows):
        for col in range(cols):
            squared[row, col] = 0.0 if blocked[row, col] else squared[row - 1, col] + 1.0
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            squared[row, col] = min(squared[row, col], squared[row + 1, col] + 1.0)
    vertex, border, height = np.empty(cols, dtype=np.int64), np.empty(cols + 1), np.empty(cols)
    for row in range(rows):  # Second pass along the rows.
        for col in range(cols):
            height[col] = squared[row, col] * squared[row, col]
        _nearest_along(height, 0, 1, vertex, border, squared[row])
    return squared


@njit(cache=True)
def squared_to_squares(blocked: Blocked) -> Array:
    """Squared distance from the centre of every cell to the nearest blocked square, in half cells, inf where there is none.

    `squared_to_centres` of the lattice of half cells, of which only the nodes that are centres are kept: that whole lattice
    takes four times the memory. What lies above or below a centre is an odd number of half cells away, on the lines between
    columns as near as the nearer of both.
    """
    rows, cols = blocked.shape
    far = np.int32(2**30)
    up = np.empty((rows, cols), dtype=np.int32)  # half cells to the nearest blocked square in the same column
    for row in range(rows):
        for col in range(cols):
            if blocked[row, col]:
                up[row, col] = 0
            elif row == 0:
                up[row, col] = far
            else:
                up[row, col] = min(far, up[row - 1, col] + (1 if up[row - 1, col] == 0 else 2))
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            up[row, col] = min(up[row, col], up[row + 1, col] + (1 if up[row + 1, col] == 0 else 2))
    squared = np.full((rows, cols), math.inf)
    nodes = 2 * cols + 1
    vertex, border, height = np.empty(nodes, dtype=np.int64), np.empty(nodes + 1), np.empty(nodes)
    for row in range(rows):
        for node in range(nodes):
            if node % 2 == 1:
                nearest = up[row, node // 2]
            else:
                nearest = min(up[row, max(0, node // 2 - 1)], up[row, min(cols - 1, node // 2)])
            height[node] = math.inf if nearest >= far else float(nearest) * float(nearest)
        _nearest_along(height, 1, 2, vertex, border, squared[row])
    return squared
