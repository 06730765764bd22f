"""Exact traversal of grid cells by segments and rays (Amanatides and Woo, 1987)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core.geometry import Array
from robocar.core.grid import GridMap


class Ray(NamedTuple):
    """Where the walk along a ray is: the state of the one traversal that all share.

    The parameter is in units of the direction's length: cells for a unit vector, 0 to 1 for a whole segment.

    Args:
        row, col: of the cell.
        entered: parameter at which the ray has entered it, 0 for the first.
        next_x, next_y: parameters at which the next vertical (x) and horizontal (y) cell border is crossed.
        delta_x, delta_y: from one such border to the next.
        step_row, step_col: 1 or -1.
    """

    row: int
    col: int
    entered: float
    next_x: float
    next_y: float
    delta_x: float
    delta_y: float
    step_row: int
    step_col: int


@njit(cache=True)
def start_ray(x: float, y: float, dx: float, dy: float) -> Ray:
    """The walk from (x, y) along (dx, dy), in grid coordinates (column, row in cells, see `GridMap.grid_from_world`)."""
    row, col = math.floor(y), math.floor(x)
    step_row, step_col = (1 if dy > 0.0 else -1), (1 if dx > 0.0 else -1)
    next_x = ((col + (step_col > 0)) - x) / dx if dx != 0.0 else math.inf
    next_y = ((row + (step_row > 0)) - y) / dy if dy != 0.0 else math.inf
    delta_x = abs(1.0 / dx) if dx != 0.0 else math.inf
    delta_y = abs(1.0 / dy) if dy != 0.0 else math.inf
    return Ray(row, col, 0.0, next_x, next_y, delta_x, delta_y, step_row, step_col)


@njit(cache=True)
def advance(ray: Ray) -> Ray:
    """On to the next cell, which shares an edge with this one. Exactly through a corner, the step along x comes first."""
    row, col, _, next_x, next_y, delta_x, delta_y, step_row, step_col = ray
    if next_x <= next_y:
        return Ray(row, col + step_col, next_x, next_x + delta_x, next_y, delta_x, delta_y, step_row, step_col)
    return Ray(row + step_row, col, next_y, next_x, next_y + delta_y, delta_x, delta_y, step_row, step_col)


@njit(cache=True)
def advance_to(ray: Ray, last_row: int, last_col: int) -> Ray:
    """`advance` on the way to a last cell, |last_row - row| + |last_col - col| steps away in the directions of the ray.

    The count of steps is exact, so rounding can at worst swap two of them, never miss the last cell.
    """
    row, col, _, next_x, next_y, delta_x, delta_y, step_row, step_col = ray
    if (next_x <= next_y and col != last_col) or row == last_row:
        return Ray(row, col + step_col, next_x, next_x + delta_x, next_y, delta_x, delta_y, step_row, step_col)
    return Ray(row + step_row, col, next_y, next_x, next_y + delta_y, delta_x, delta_y, step_row, step_col)


@njit(cache=True)
def traverse(x0: float, y0: float, x1: float, y1: float) -> NDArray[np.int64]:
    """Cells that the segment from (x0, y0) to (x1, y1) passes, in order.

    Args: grid coordinates (column, row in cells, see `GridMap.grid_from_world`).

    Returns:
        (n, 2) as (row, col), from the first to the last cell, consecutive cells sharing an edge. Where the segment runs exactly
        through a corner, the step along x comes first.
    """
    last_row, last_col = math.floor(y1), math.floor(x1)
    ray = start_ray(x0, y0, x1 - x0, y1 - y0)
    cells = np.empty((abs(last_col - ray.col) + abs(last_row - ray.row) + 1, 2), dtype=np.int64)
    cells[0, 0], cells[0, 1] = ray.row, ray.col
    for k in range(1, len(cells)):
        ray = advance_to(ray, last_row, last_col)
        cells[k, 0], cells[k, 1] = ray.row, ray.col
    return cells


@njit(cache=True)
def first_hit(blocked: NDArray[np.bool_], x0: float, y0: float, dx: float, dy: float, reach: float) -> float:
    """Distance in cells from (x0, y0) along the unit vector (dx, dy) to the first blocked cell; inf if beyond `reach`.

    Outside the grid nothing is blocked. A start inside a blocked cell gives 0.
    """
    rows, cols = blocked.shape
    ray = start_ray(x0, y0, dx, dy)
    while ray.entered <= reach:
        row, col = ray.row, ray.col
        if 0 <= row < rows and 0 <= col < cols:
            if blocked[row, col]:
                return ray.entered
        elif (row < 0 and ray.step_row < 0) or (row >= rows and ray.step_row > 0):
            return math.inf  # It has left the grid for good; so a ray without a limit ends, too.
        elif (col < 0 and ray.step_col < 0) or (col >= cols and ray.step_col > 0):
            return math.inf
        ray = advance(ray)
    return math.inf


@njit(cache=True)
def _first_hits(blocked: NDArray[np.bool_], origins: Array, directions: Array, reach: float) -> NDArray[np.float64]:
    distances = np.empty(len(origins))
    for i in range(len(origins)):
        distances[i] = first_hit(blocked, origins[i, 0], origins[i, 1], directions[i, 0], directions[i, 1], reach)
    return distances


def segment_cells(grid: GridMap, start: ArrayLike, end: ArrayLike) -> NDArray[np.int64]:
    """Cells (n, 2) as (row, col) that the segment between two world points (2,) [m] passes; some may lie outside the grid."""
    (x0, y0), (x1, y1) = grid.grid_from_world(start), grid.grid_from_world(end)
    return traverse(x0, y0, x1, y1)


def cast_rays(grid: GridMap, blocked: NDArray[np.bool_], origin: ArrayLike, angles: ArrayLike, max_range: float) -> Array:
    """Distances from one point to the first blocked cell along each direction.

    Args:
        grid: the place; its numbers do not matter.
        blocked: cells that stop a ray, (rows, cols).
        origin: world point (2,) [m].
        angles: directions in the world, (n,) [rad].
        max_range: rays end here [m].

    Returns:
        (n,) [m], inf where nothing is hit within `max_range`.
    """
    angles = np.asarray(angles, dtype=float) - grid.origin.theta
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    origins = np.broadcast_to(grid.grid_from_world(origin), directions.shape)
    return _first_hits(blocked, np.ascontiguousarray(origins), directions, max_range / grid.resolution) * grid.resolution
