"""The lattice of cells that a car drives on from centre to centre (thesis, section 4.3)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robocar.core import LETHAL, SE2, Array, Costmap, OccupancyGrid


class CarLattice:
    """The 30 cm cells: centred in the prior map, or, without one, with a cell centre under the start."""

    def __init__(self, cell_size: float, prior: OccupancyGrid | None, start: SE2, goal: Array) -> None:
        self.cell_size = cell_size
        if prior is not None:
            width, height = prior.size
            cols, rows = max(1, int(width / cell_size + 1e-9)), max(1, int(height / cell_size + 1e-9))
            margin = SE2(0.5 * (width - cols * cell_size), 0.5 * (height - rows * cell_size), 0.0)
            self.origin = prior.origin @ margin
            self.shape = rows, cols
        else:
            # Room on all sides: the world is unknown, and the way round an obstacle may lead away from the goal.
            reach = float(np.abs(goal - start.position).max()) + 3.0
            half = math.ceil(reach / cell_size)
            offset = -(half + 0.5) * cell_size
            self.origin = SE2(start.x + offset, start.y + offset, 0.0)
            self.shape = 2 * half + 1, 2 * half + 1

    def centre(self, cell: tuple[int, int]) -> tuple[float, float]:
        """World point in the middle of a cell (row, col) [m]."""
        row, col = cell
        return self.origin.apply((col + 0.5) * self.cell_size, (row + 0.5) * self.cell_size)

    def cell(self, point: Array) -> tuple[int, int]:
        """The cell (row, col) that a world point (2,) [m] lies in; it may lie outside the lattice."""
        x, y = self.origin.inverse_apply(float(point[0]), float(point[1]))
        return math.floor(y / self.cell_size), math.floor(x / self.cell_size)

    def outlines(self, cells: NDArray[np.bool_]) -> tuple[Array, ...]:
        """Outlines in the world of those cells (rows, cols) that are marked, each (5, 2) [m]."""
        corners = np.array([[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]])
        return tuple(self.origin.transform((cell[::-1] + corners) * self.cell_size) for cell in np.argwhere(cells))

    def costmap(self, blocked: NDArray[np.bool_]) -> Costmap:
        """The cells as a costmap for the search: free or lethal."""
        return Costmap(np.where(blocked, LETHAL, 0).astype(np.uint8), self.cell_size, self.origin)
