"""Inflation: how near a cell is to an obstacle, as a cost."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import INSCRIBED, LETHAL


def inflation_kernel(
    resolution: float, inscribed_radius: float, margin: float, inflation_radius: float, cost_scaling_factor: float
) -> NDArray[np.uint8]:
    """Costs around one obstacle cell, (2 k + 1, 2 k + 1).

    With d the distance from a cell's centre to the nearest point of the obstacle's *square*: 253 up to the inscribed radius,
    where a robot centred there would touch; 252 on `margin` metres more; then (Nav2's inflation layer)
    252 exp(-cost_scaling_factor (d - inscribed_radius - margin)) up to `inflation_radius`; 0 beyond. Nav2 measures d between
    centres, which is up to 0.7 cells too far.
    """
    k = max(1, math.ceil(max(inflation_radius, inscribed_radius) / resolution))
    gap = np.maximum(np.abs(np.arange(-k, k + 1)) - 0.5, 0.0) * resolution
    distance = np.hypot(gap[:, None], gap[None, :])  # [m]
    decay = np.exp(-cost_scaling_factor * np.maximum(distance - inscribed_radius - margin, 0.0))
    kernel = np.where(distance <= inflation_radius, np.floor(252.0 * decay), 0.0)
    kernel[distance <= inscribed_radius * (1.0 + 1e-9)] = INSCRIBED
    kernel[k, k] = LETHAL
    return kernel.astype(np.uint8)


@njit(cache=True)
def inflate_window(solid: NDArray, kernel: NDArray, costs: NDArray, walled: bool, r0: int, r1: int, c0: int, c1: int) -> None:
    """Recomputes the costs of rows r0 to r1 and columns c0 to c1 (excluded).

    Costs fall with the distance, so the cost of the nearest obstacle is the largest: every obstacle cell in reach is stamped.

    Args:
        solid: 0, or 254 and 255 for obstacle cells, which keep that value, (rows, cols).
        kernel: see `inflation_kernel`.
        costs: result, (rows, cols).
        walled: whether obstacles stand all around the grid.
    """
    rows, cols = solid.shape
    k = kernel.shape[0] // 2
    for r in range(r0, r1):
        for c in range(c0, c1):
            costs[r, c] = solid[r, c]
            outside = 1 + min(min(r, rows - 1 - r), min(c, cols - 1 - c)) if walled else k + 1
            if outside <= k:
                costs[r, c] = max(costs[r, c], kernel[k, k + outside])
    for r in range(max(0, r0 - k), min(rows, r1 + k)):
        for c in range(max(0, c0 - k), min(cols, c1 + k)):
            if solid[r, c] < LETHAL:
                continue
            if 0 < r < rows - 1 and 0 < c < cols - 1:
                inside = min(min(solid[r - 1, c], solid[r + 1, c]), min(solid[r, c - 1], solid[r, c + 1]))
                if inside >= LETHAL:
                    continue  # one of its four neighbours is nearer to everything outside
            first, last = max(c0, c - k), min(c1, c + k + 1)
            for i in range(max(r0, r - k), min(r1, r + k + 1)):
                for j in range(first, last):
                    costs[i, j] = max(costs[i, j], kernel[i - r + k, j - c + k])
