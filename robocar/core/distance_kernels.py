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
    vertex = np.empty(cols, dtype=np.int64)  # columns of the parabolas of the lower envelope
    border = np.empty(cols + 1)  # where one parabola hands over to the next
    height = np.empty(cols)
    for row in range(rows):  # Second pass along the rows: lower envelope of the parabolas (q - p)^2 + f(p).
        count = 0
        for col in range(cols):
            f = squared[row, col] * squared[row, col]
            height[col] = f
            if f == math.inf:
                continue
            start = -math.inf
            while count > 0:
                last = vertex[count - 1]
                start = ((f + col * col) - (height[last] + last * last)) / (2.0 * (col - last))
                if start > border[count - 1]:
                    break
                count -= 1
                start = -math.inf
            vertex[count], border[count] = col, start
            count += 1
        if count == 0:
            continue
        border[count] = math.inf
        k = 0
        for col in range(cols):
            while border[k + 1] < col:
                k += 1
            squared[row, col] = (col - vertex[k]) ** 2 + height[vertex[k]]
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
    vertex = np.empty(nodes, dtype=np.int64)
    border = np.empty(nodes + 1)
    height = np.empty(nodes)
    for row in range(rows):
        count = 0
        for node in range(nodes):
            if node % 2 == 1:
                nearest = up[row, node // 2]
            else:
                nearest = min(up[row, max(0, node // 2 - 1)], up[row, min(cols - 1, node // 2)])
            if nearest >= far:
                continue
            f = float(nearest) * float(nearest)
            height[node] = f
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
            continue
        border[count] = math.inf
        k = 0
        for col in range(cols):
            node = 2 * col + 1
            while border[k + 1] < node:
                k += 1
            squared[row, col] = (node - vertex[k]) ** 2 + height[vertex[k]]
    return squared
