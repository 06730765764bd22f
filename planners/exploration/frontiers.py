"""Frontiers: where what is known and can be driven ends.

Yamauchi, A Frontier-Based Approach for Autonomous Exploration (1997).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from robocar.core import INSCRIBED, Array, Costmap
from robocar.planners.search.grid_search import CELL_SCALE, COL_STEPS, DIAGONAL, INFINITE, ROW_STEPS, STRAIGHT

_TOUCHING = np.ones((3, 3), dtype=bool)  # cells that share a corner belong together


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """Unknown cells that belong together and border on cells that the robot can come to.

    Args:
        cells: (n, 2) as (row, col).
        viewpoint: the cell beside one of them that is the cheapest to come to, (row, col).
        cost: of the way there [m] (`robocar.planners.search.grid_search`).
        nearest: the unknown cell beside the viewpoint.
    """

    cells: NDArray[np.intp]
    viewpoint: tuple[int, int]
    cost: float
    nearest: tuple[int, int]


@njit(cache=True)
def _reach(costs: NDArray[np.uint8], row: int, col: int) -> NDArray[np.int64]:
    """Cost of the way from (row, col) to every cell, `INFINITE` where there is none (Dijkstra, 1959); see `grid_search`."""
    rows, cols = costs.shape
    way = np.full((rows, cols), INFINITE, dtype=np.int64)
    if costs[row, col] >= INSCRIBED:
        return way
    way[row, col] = 0
    heap = [(np.int64(0), np.int64(row * cols + col))]
    while len(heap) > 0:
        so_far, cell = heapq.heappop(heap)
        r, c = cell // cols, cell % cols
        if so_far > way[r, c]:
            continue
        for d in range(8):
            i, j = r + ROW_STEPS[d], c + COL_STEPS[d]
            if not (0 <= i < rows and 0 <= j < cols) or costs[i, j] >= INSCRIBED:
                continue
            if d >= 4 and (costs[i, c] >= INSCRIBED or costs[r, j] >= INSCRIBED):
                continue
            step = (STRAIGHT if d < 4 else DIAGONAL) * (CELL_SCALE + np.int64(costs[r, c]) + np.int64(costs[i, j]))
            if so_far + step < way[i, j]:
                way[i, j] = so_far + step
                heapq.heappush(heap, (so_far + step, np.int64(i * cols + j)))
    return way


def costs_of_ways(costmap: Costmap, start: tuple[int, int]) -> Array:
    """Cost of the cheapest way from a cell (row, col) to every cell, as A* finds it, (rows, cols) [m]; inf: there is none."""
    way = _reach(costmap.data, *start)
    unit = STRAIGHT * CELL_SCALE / costmap.resolution
    return np.where(way < INFINITE, way / unit, np.inf)


def find_frontiers(costmap: Costmap, unknown: NDArray[np.bool_], start: tuple[int, int], min_cells: int = 1) -> list[Frontier]:
    """Frontiers that can be reached from a cell (row, col), the cheapest to come to first.

    Args:
        costmap: unknown cells must be blocked in it.
        unknown: where there is something to find out, (rows, cols).
        min_cells: frontiers with fewer unknown cells are left out.
    """
    way = costs_of_ways(costmap, start)
    # For each unknown cell, the cheapest of its four neighbours.
    padded = np.pad(way, 1, constant_values=np.inf)
    around = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    cheapest = around.min(axis=0)
    labels = np.zeros(costmap.shape, dtype=np.int32)
    ndimage.label(unknown & np.isfinite(cheapest), _TOUCHING, output=labels)
    found = []
    for k, box in enumerate(ndimage.find_objects(labels), start=1):
        cells = np.argwhere(labels[box] == k) + np.array([box[0].start, box[1].start])
        if len(cells) < min_cells:
            continue
        best = int(np.argmin(cheapest[cells[:, 0], cells[:, 1]]))
        row, col = (int(i) for i in cells[best])
        side = int(np.argmin(around[:, row, col]))
        dr, dc = ((-1, 0), (1, 0), (0, -1), (0, 1))[side]
        found.append(Frontier(cells, (row + dr, col + dc), float(cheapest[row, col]), (row, col)))
    return sorted(found, key=lambda frontier: (frontier.cost, frontier.nearest))
