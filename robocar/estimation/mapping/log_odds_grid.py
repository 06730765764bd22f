"""A grid of log-odds that grows with what is seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robocar.core import SE2, MapTooLarge, OccupancyGrid
from robocar.estimation.mapping.inverse_sensor import write_percent

MAX_CELLS = 1 << 27
"""Larger maps are refused before anything is allocated: at 6 bytes a cell, 0.8 GB."""

_LEAST_GROWTH = 2.0  # [m]
_GROWTH = 0.25  # of the side, so that a map that grows by millimetres is seldom copied


class LogOddsGrid:
    """Log-odds of occupancy on cells aligned with the map frame, 0 where nothing has been seen; row 0 has the lowest y.

    Six bytes a cell: the log-odds (float32), which reading has changed the cell last (uint8), and the last snapshot (int8).

    Args:
        resolution: side of a cell [m]; cell borders lie at its multiples.
        undecided: log-odds between -undecided and undecided are neither free nor occupied.
    """

    def __init__(self, resolution: float, undecided: float) -> None:
        self.resolution, self._undecided = resolution, undecided
        self.log_odds = np.zeros((0, 0), dtype=np.float32)
        self.stamp = np.zeros((0, 0), dtype=np.uint8)
        self._mark = 0
        self._first_row = self._first_col = 0  # of cell (0, 0), counted from the map frame's origin
        self._percent = np.zeros((0, 0), dtype=np.int8)
        self._dirty: tuple[int, int, int, int] | None = None  # rows r0 to r1, columns c0 to c1 (excluded)
        self._snapshot: OccupancyGrid | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)"""
        return self.log_odds.shape  # type: ignore[return-value]

    @property
    def nbytes(self) -> int:
        """Memory of all cells [B]."""
        return self.log_odds.nbytes + self.stamp.nbytes + self._percent.nbytes

    def local(self, pose: SE2) -> tuple[float, float, float]:
        """A pose of the map frame in grid coordinates: column, row [cells] and angle [rad]."""
        return pose.x / self.resolution - self._first_col, pose.y / self.resolution - self._first_row, pose.theta

    def touch(self, left: float, low: float, right: float, high: float) -> None:
        """Makes room for a box of the map frame [m], which the next reading may change.

        Raises:
            MapTooLarge: the map would have more than `MAX_CELLS` cells.
        """
        values = (left, low, right, high)  # and a cell around them, as points on a border round either way
        c0, r0, c1, r1 = (math.floor(v / self.resolution) + shift for v, shift in zip(values, (-1, -1, 2, 2), strict=True))
        self._cover(r0, r1, c0, c1)
        r0, r1, c0, c1 = r0 - self._first_row, r1 - self._first_row, c0 - self._first_col, c1 - self._first_col
        if self._dirty is not None:
            d = self._dirty
            r0, r1, c0, c1 = min(r0, d[0]), max(r1, d[1]), min(c0, d[2]), max(c1, d[3])
        self._dirty = r0, r1, c0, c1

    def next_mark(self) -> int:
        """The stamp of a new reading."""
        self._mark += 1
        if self._mark == 256:
            self.stamp[:] = 0
            self._mark = 1
        return self._mark

    def snapshot(self) -> OccupancyGrid | None:
        """Occupancy in percent, -1 where unknown or undecided; the same object until something changes, None before."""
        if self._dirty is not None:
            bound = self._undecided
            write_percent(self.log_odds, self._percent, -bound, bound, *self._dirty)
            origin = SE2(self._first_col * self.resolution, self._first_row * self.resolution)
            self._snapshot = OccupancyGrid(self._percent, self.resolution, origin)
            self._dirty = None
        return self._snapshot

    def _cover(self, r0: int, r1: int, c0: int, c1: int) -> None:
        """Grows so that rows r0 to r1 and columns c0 to c1 (excluded, counted from the map frame's origin) have a place."""
        rows, cols = self.shape
        top, right = self._first_row + rows, self._first_col + cols
        if self.log_odds.size and r0 >= self._first_row and r1 <= top and c0 >= self._first_col and c1 <= right:
            return
        if not self.log_odds.size:
            self._first_row, self._first_col, top, right = r0, c0, r0, c0

        def room(side: int) -> int:
            return math.ceil(max(_LEAST_GROWTH / self.resolution, _GROWTH * side))

        wanted = (min(r0, self._first_row), max(r1, top), min(c0, self._first_col), max(c1, right))
        grown = (
            r0 - room(rows) if r0 < self._first_row else self._first_row,
            r1 + room(rows) if r1 > top else top,
            c0 - room(cols) if c0 < self._first_col else self._first_col,
            c1 + room(cols) if c1 > right else right,
        )
        for box in (grown, wanted):  # without room to spare, where only that fits
            new_rows, new_cols = box[1] - box[0], box[3] - box[2]
            if new_rows * new_cols <= MAX_CELLS:
                break
        else:
            raise MapTooLarge(
                f"the map would have {new_cols} x {new_rows} cells ({new_cols * self.resolution:.4g} x "
                f"{new_rows * self.resolution:.4g} m), at most {MAX_CELLS} are allowed; a pose has gone astray, or choose a "
                f"coarser resolution than {self.resolution:g} m"
            )
        at = self._first_row - box[0], self._first_col - box[2]
        self.log_odds = _moved(self.log_odds, (new_rows, new_cols), at, 0)
        self.stamp = _moved(self.stamp, (new_rows, new_cols), at, 0)
        self._percent = _moved(self._percent, (new_rows, new_cols), at, -1)
        if self._dirty is not None:
            d = self._dirty
            self._dirty = d[0] + at[0], d[1] + at[0], d[2] + at[1], d[3] + at[1]
        self._first_row, self._first_col = box[0], box[2]


def _moved(old: NDArray, shape: tuple[int, int], at: tuple[int, int], fill: int) -> NDArray:
    new = np.full(shape, fill, dtype=old.dtype)
    new[at[0] : at[0] + old.shape[0], at[1] : at[1] + old.shape[1]] = old
    return new
