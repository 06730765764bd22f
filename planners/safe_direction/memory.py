"""What the variant with a memory remembers: the cells around the robot, on a grid of limited size that rolls along with it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import SE2, GridMap
from robocar.core.grid import cutout
from robocar.planners.safe_direction.view import Readings, offset, window

_HIT, _MOST, _FREE = 2, 4, -1  # evidence of one hit, its cap, and of a cell that was seen through and is empty


class RollingMemory:
    """Cells seen so far within half of `size` [m] of the robot, the latest scans counting most; farther ones are forgotten.

    A few looks through a cell take back what hits have marked. Cells beside a hit of the same scan are not taken back: a beam
    along a wall runs through cells of it, and walls would crumble.
    """

    def __init__(self, size: float, resolution: float) -> None:
        self.size, self.resolution = size, resolution
        self.forget()

    def forget(self) -> None:
        """Nothing is known any longer."""
        self._place: GridMap | None = None

    def merge(self, pose: SE2, seen: Readings) -> Readings:
        """All that is known around `pose` (world_from_robot), with a scan taken in, on the memory's own cells."""
        place = window(pose, 0.5 * self.size, self.resolution)
        if self._place is None:
            evidence = np.zeros(place.shape, dtype=np.int8)
        else:
            evidence = cutout(self._evidence, *offset(place, self._place), place.shape)
        row, col = offset(seen.grid, place)
        rows, cols = seen.grid.shape
        _learn(evidence, seen.free, seen.occupied, row, col, rows, cols)
        self._place, self._evidence = place, evidence
        free, occupied = evidence < 0, evidence > 0
        for edge in (np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]):
            free[edge] = occupied[edge] = False  # the way round outside stays open
        return Readings(place, free, occupied, *(place.grid_from_world(pose.position).tolist()))


@njit(cache=True)
def _learn(evidence: NDArray, free: NDArray, occupied: NDArray, row: int, col: int, rows: int, cols: int) -> None:
    height, width = evidence.shape
    for i in range(rows):
        for j in range(cols):
            r, c = row + i, col + j
            if not (0 <= r < height and 0 <= c < width):
                continue
            if occupied[i, j]:
                evidence[r, c] = min(_MOST, max(evidence[r, c], 0) + _HIT)
            elif free[i, j]:
                if evidence[r, c] <= 0:
                    evidence[r, c] = _FREE
                    continue
                beside = False
                for k in range(max(0, i - 1), min(rows, i + 2)):
                    for m in range(max(0, j - 1), min(cols, j + 2)):
                        beside = beside or occupied[k, m]
                if not beside:
                    evidence[r, c] = evidence[r, c] - 1 if evidence[r, c] > 1 else _FREE
