"""Where a robot that has lost itself may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robocar.core import Array, Landmark, OccupancyGrid

_MARGIN = 1.0  # [m] around the landmarks, where there is no map


class Area:
    """The free cells of the map; without a map, the rectangle around the landmarks and a metre more."""

    def __init__(self, prior: OccupancyGrid | None, landmarks: Sequence[Landmark]) -> None:
        self._grid = prior if prior is not None and prior.free.any() else None
        if self._grid is not None:
            self._cells = np.argwhere(self._grid.free)
        else:
            places = np.array([mark.position[:2] for mark in landmarks], dtype=float).reshape(-1, 2)
            self._low, self._high = places.min(axis=0) - _MARGIN, places.max(axis=0) + _MARGIN

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """Points spread evenly, (count, 2) [m]."""
        if self._grid is None:
            return rng.uniform(self._low, self._high, (count, 2))
        cells = self._cells[rng.integers(len(self._cells), size=count)]
        return self._grid.world_from_cell(cells + rng.uniform(-0.5, 0.5, (count, 2)))

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (n, 2) [m] are inside, (n,)."""
        if self._grid is None:
            return np.all((points >= self._low) & (points <= self._high), axis=1)
        cells = self._grid.cell_from_world(points)
        inside = self._grid.contains(cells)
        inside[inside] = self._grid.free[cells[inside, 0], cells[inside, 1]]
        return inside
