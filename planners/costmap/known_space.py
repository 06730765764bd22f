"""Costmaps of a map in the making: where a robot can go by what is known so far."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core import INSCRIBED, NO_INFORMATION, SE2, Array, Costmap, OccupancyGrid
from robocar.planners.costmap.layered import CostmapParameters, inflate
from robocar.planners.search.grid_search import nearest_free

_OPEN = CostmapParameters(walled=False)  # a map in the making ends where it has been seen so far, not at a wall
_CLOSED = CostmapParameters(walled=False, allow_unknown=False)
UNSURE = 252
"""Cost of cells so near to the unknown that the robot's outline would reach into it: the highest that may be entered."""


def ways(grid: OccupancyGrid, radius: float, sure: NDArray[np.bool_] | None = None) -> Costmap:
    """Where a disc of `radius` [m] can go: through known free cells, which may well lie beside unknown ones.

    Args:
        sure: other cells than these cost the most that is not blocked, (rows, cols).
    """
    costs = np.where(grid.unknown, np.uint8(NO_INFORMATION), inflate(grid, radius, _OPEN).data)
    if sure is not None:
        costs[~sure & (costs < INSCRIBED)] = UNSURE
    return Costmap(costs, grid.resolution, grid.origin)


def surely_free(grid: OccupancyGrid, radius: float) -> NDArray[np.bool_]:
    """Where a disc of `radius` [m] touches nothing but known free cells, (rows, cols)."""
    return inflate(grid, radius, _CLOSED).data < INSCRIBED


def surroundings(grid: OccupancyGrid, pose: SE2, reach: float, radius: float, allow_unknown: bool = True) -> Costmap:
    """Where a disc of `radius` [m] touches nothing that is known, at most `reach` [m] away from the robot along x or y.

    Args:
        allow_unknown: whether it may touch what is not known.
    """
    return inflate(grid.around(pose.position, reach), radius, _OPEN if allow_unknown else _CLOSED)


def is_known(grid: OccupancyGrid, point: ArrayLike) -> bool:
    """Whether the map knows what is at a world point (2,) [m]."""
    row, col = (int(i) for i in grid.cell_from_world(point))
    return bool(grid.contains((row, col))) and grid.data[row, col] >= 0


def free_start(costmap: Costmap, pose: SE2) -> Array | None:
    """Where the robot is, or the nearest free cell where that seems to be blocked (2,) [m]."""
    cell = costmap.cell_from_world(pose.position)
    if costmap.contains(cell) and costmap.data[cell[0], cell[1]] < INSCRIBED:
        return pose.position
    return nearest_free(costmap, pose.position)
