"""Wave fronts over a grid: the kernels of the transforms.

The waves run in a ring of buckets, one cell of distance each. No step is shorter than that, so nobody in the lowest bucket can
improve another one there, and a cell is final when its bucket's turn comes: exact like Dijkstra's algorithm, without a heap
(Denardo and Fox, Shortest-Route Methods: 1. Reaching, Pruning, and Buckets, Operations Research 27(1), 1979).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.planners.search.grid_search import doubled

_SLACK = 1e-9  # [cells] by which a value has to fall to count as improved
_FINE = 2.0  # buckets of the eikonal wave per cell of distance: fewer would have more values corrected, more cost more rounds
_RING = 8  # buckets in use at once: a step raises u by at most 1


@njit(cache=True)
def wave(
    blocked: NDArray, cols: int, costs: NDArray, diagonal: float, seeds: NDArray, values: NDArray, stop: int
) -> NDArray[np.float64]:
    """Cost of reaching every cell: steps of 1 and `diagonal` to the eight neighbours, plus the costs of the cells entered.

    Args:
        blocked, costs: flat, of a grid inside a frame of blocked cells; no costs if empty.
        seeds, values: flat places, sorted by their values.
        stop: a flat place; the wave ends when it is final; -1: never.
    """
    # Nothing falls below minus infinity: blocked cells need no test of their own.
    total = np.where(blocked, -math.inf, math.inf)
    ring = 4
    while ring < diagonal + (costs.max() if len(costs) else 0.0) + 3.0:
        ring *= 2
    ring -= 1  # a mask: its buckets are a power of two
    first = np.full(ring + 1, -1, dtype=np.int64)
    # Each entry is a cell and the next entry of its bucket. A step improves a cell at most once, so there are at most nine each.
    room = 9 * len(blocked) + len(seeds)
    entries, following = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32)
    steps = np.array([1, cols, -1, -cols, cols + 1, cols - 1, -cols - 1, 1 - cols])
    weighted = len(costs) > 0
    used, waiting, seed = 0, 0, 0
    level = int(values[0]) if len(seeds) else 0
    while waiting > 0 or seed < len(seeds):
        if waiting == 0:
            level = int(values[seed])
        while seed < len(seeds) and int(values[seed]) <= level:
            cell = seeds[seed]
            if values[seed] < total[cell]:
                total[cell] = values[seed]
                entries[used], following[used] = cell, first[level & ring]
                first[level & ring] = used
                used += 1
                waiting += 1
            seed += 1
        entry = first[level & ring]
        first[level & ring] = -1
        while entry >= 0:
            cell = entries[entry]
            entry = following[entry]
            waiting -= 1
            here = total[cell]
            if int(here) != level:  # it has been improved since, and dealt with
                continue
            for k in range(8):
                other = cell + steps[k]
                reached = here + (1.0 if k < 4 else diagonal)
                if weighted:
                    reached += costs[other]
                if reached >= total[other]:
                    continue
                if k >= 4:
                    row_step = cols if steps[k] > 1 else -cols
                    if total[cell + row_step] < 0.0 or total[other - row_step] < 0.0:
                        continue
                total[other] = reached
                slot = int(reached) & ring
                entries[used], following[used] = other, first[slot]
                first[slot] = used
                used += 1
                waiting += 1
        level += 1
        if stop >= 0 and total[stop] < level:
            break
    return np.abs(total)


@njit(cache=True)
def eikonal(blocked: NDArray, cols: int, seeds: NDArray, values: NDArray, stop: int) -> NDArray[np.float64]:
    """First-order upwind solution of |grad u| = 1; arguments as for `wave`.

    Within a bucket values may still fall. A cell whose value does hands that on, so the result is the scheme's one solution,
    whatever the order.
    """
    u = np.full(len(blocked), math.inf)
    told = np.full(len(blocked), math.inf)  # what a cell's neighbours know
    first, last = np.full(_RING, -1, dtype=np.int64), np.full(_RING, -1, dtype=np.int64)
    entries, following = np.empty(4 * len(blocked), dtype=np.int32), np.empty(4 * len(blocked), dtype=np.int32)
    steps = np.array([1, cols, -1, -cols])
    used, waiting, seed = 0, 0, 0
    level = int(_FINE * values[0]) if len(seeds) else 0
    while waiting > 0 or seed < len(seeds):
        if waiting == 0:
            level = max(level, int(_FINE * values[seed]))
        while seed < len(seeds) and int(_FINE * values[seed]) <= level:
            if values[seed] < u[seeds[seed]]:
                u[seeds[seed]] = values[seed]
                if used == len(entries):
                    entries, following = doubled(entries), doubled(following)
                _append(seeds[seed], level % _RING, used, entries, following, first, last)
                used, waiting = used + 1, waiting + 1
            seed += 1
        slot = level % _RING
        while first[slot] >= 0:
            cell = entries[first[slot]]
            first[slot] = following[first[slot]]
            waiting -= 1
            if u[cell] >= told[cell] - _SLACK:
                continue
            told[cell] = u[cell]
            for step in steps:
                other = cell + step
                if blocked[other] or u[other] <= u[cell]:
                    continue
                a, b = min(u[other - 1], u[other + 1]), min(u[other - cols], u[other + cols])
                if abs(a - b) >= 1.0:
                    reached = min(a, b) + 1.0
                else:
                    reached = 0.5 * (a + b + math.sqrt(2.0 - (a - b) ** 2))
                if reached < u[other] - _SLACK:
                    u[other] = reached
                    if used == len(entries):
                        entries, following = doubled(entries), doubled(following)
                    _append(other, max(level, int(_FINE * reached)) % _RING, used, entries, following, first, last)
                    used, waiting = used + 1, waiting + 1
        level += 1
        if stop >= 0 and _FINE * u[stop] < level:
            break
    return u


@njit(cache=True)
def _append(cell: int, slot: int, used: int, entries: NDArray, following: NDArray, first: NDArray, last: NDArray) -> None:
    """Puts a cell at the end of a bucket."""
    entries[used], following[used] = cell, -1
    if first[slot] < 0:
        first[slot] = used
    else:
        following[last[slot]] = used
    last[slot] = used
