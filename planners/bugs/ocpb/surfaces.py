"""What surfaces a robot has seen from anywhere, on a hash table of small cells."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array

_CELL = 0.05  # [m]
FREE = np.int64(-(2**62))
_BEYOND = (0.10, 0.20, 0.30)  # [m] past an end: a surface that goes on is there


class Surfaces:
    """Cells of 5 cm in which some scan has hit something."""

    def __init__(self) -> None:
        self.table = np.full(4096, FREE)
        self._used = 0

    def remember(self, hits: Array) -> None:
        """Takes in surface points (n, 2) [m]."""
        if 2 * (self._used + len(hits)) > len(self.table):
            larger = np.full(4 * (len(self.table) + len(hits)), FREE)
            _move(self.table, larger)
            self.table = larger
        self._used += _put(self.table, hits)

    def hold(self, x: float, y: float) -> bool:
        """Whether something was seen in that cell or one beside it."""
        return _near(self.table, x, y)


@njit(cache=True)
def goes_on(table: NDArray[np.int64], x: float, y: float, ux: float, uy: float, beyond: float) -> bool:
    """Whether a surface that seems to end at (x, y) was seen, from elsewhere, to go on along (ux, uy), from `beyond` [m] on."""
    if ux == 0.0 and uy == 0.0:
        return False
    seen = True
    for d in _BEYOND:
        seen &= _near(table, x + (beyond + d) * ux, y + (beyond + d) * uy)
    return seen


@njit(cache=True)
def _slot(table: NDArray[np.int64], key: int) -> int:
    """Where a key is, or may be put. The table always has free slots, so the search ends."""
    n = len(table)
    k = (key * 0x9E3779B1 & 0x7FFFFFFFFFFF) % n
    for _ in range(n):
        if table[k] == key or table[k] == FREE:
            break
        k = (k + 1) % n
    return k


@njit(cache=True)
def _key(x: float, y: float) -> int:
    return math.floor(x / _CELL) * 1048576 + math.floor(y / _CELL)


@njit(cache=True)
def _put(table: NDArray[np.int64], hits: Array) -> int:
    """Puts points in; how many cells are new."""
    new = 0
    for i in range(len(hits)):
        if abs(hits[i, 0]) + abs(hits[i, 1]) < 1e4:
            key = _key(hits[i, 0], hits[i, 1])
            k = _slot(table, key)
            new += table[k] != key
            table[k] = key
    return new


@njit(cache=True)
def _move(table: NDArray[np.int64], larger: NDArray[np.int64]) -> None:
    for key in table:
        if key != FREE:
            larger[_slot(larger, key)] = key


@njit(cache=True)
def _near(table: NDArray[np.int64], x: float, y: float) -> bool:
    for i in range(-1, 2):
        for k in range(-1, 2):
            key = _key(x + i * _CELL, y + k * _CELL)
            if table[_slot(table, key)] == key:
                return True
    return False
