"""D* Lite: replanning that repairs the last search (Koenig and Likhachev, AAAI 2002, the optimized version, Fig. 4).

The search runs from the goal to the robot, so what changes near the robot leaves most of it valid. Costs are whole numbers
(`robocar.planners.search.grid_search`), so g and rhs are equal or they are not: there is no rounding to lose vertices by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import INSCRIBED, Array, Context, Costmap, Plan
from robocar.core.compiling import warm_up
from robocar.planners.search.grid_search import (
    CELL_SCALE,
    COL_STEPS,
    DIAGONAL,
    INFINITE,
    ROW_STEPS,
    STRAIGHT,
    Integer,
    doubled,
    endpoints,
    no_path,
    padded,
    path_through,
    search_trace,
)


@dataclass(frozen=True, slots=True)
class DStarLiteParameters:
    """
    Args:
        restart_fraction: when more than this share of the map's cells changes at once, the search starts over, which is then
            cheaper than repairing it.
    """

    restart_fraction: float = 0.25

    def __post_init__(self) -> None:
        if not 0.0 <= self.restart_fraction <= 1.0:
            raise ValueError(f"restart_fraction goes from 0 to 1, not {self.restart_fraction}")


@njit(cache=True)
def _place(
    i: Integer, k1: Integer, k2: Integer, u: Integer, keys: NDArray[np.int64], heap: NDArray[np.int32], slot: NDArray[np.int32]
) -> None:
    keys[i, 0], keys[i, 1] = k1, k2
    heap[i] = u
    slot[u] = i


@njit(cache=True)
def _sift(
    i: Integer,
    size: Integer,
    k1: Integer,
    k2: Integer,
    u: Integer,
    keys: NDArray[np.int64],
    heap: NDArray[np.int32],
    slot: NDArray[np.int32],
) -> None:
    """Puts vertex u with its key into the heap of `size` entries whose entry i is vacant."""
    while i > 0:
        p = (i - 1) >> 1
        if keys[p, 0] < k1 or (keys[p, 0] == k1 and keys[p, 1] <= k2):
            break
        _place(i, keys[p, 0], keys[p, 1], heap[p], keys, heap, slot)
        i = p
    child = 2 * i + 1
    while child < size:
        other = child + 1
        if other < size and (
            keys[other, 0] < keys[child, 0] or (keys[other, 0] == keys[child, 0] and keys[other, 1] < keys[child, 1])
        ):
            child = other
        if k1 < keys[child, 0] or (k1 == keys[child, 0] and k2 <= keys[child, 1]):
            break
        _place(i, keys[child, 0], keys[child, 1], heap[child], keys, heap, slot)
        i = child
        child = 2 * i + 1
    _place(i, k1, k2, u, keys, heap, slot)


@njit(cache=True)
def _remove(u: Integer, size: Integer, keys: NDArray[np.int64], heap: NDArray[np.int32], slot: NDArray[np.int32]) -> Integer:
    """Takes vertex u out of the heap; returns the heap's new size."""
    i = np.int64(slot[u])
    slot[u] = -1
    size -= 1
    if i < size:
        _sift(i, size, keys[size, 0], keys[size, 1], np.int64(heap[size]), keys, heap, slot)
    return size


@njit(cache=True, error_model="numpy")
def _distance(u: Integer, v: Integer, width: Integer) -> Integer:
    """The heuristic h(u, v): octile distance."""
    dr, dc = abs(u // width - v // width), abs(u % width - v % width)
    return CELL_SCALE * (STRAIGHT * abs(dr - dc) + DIAGONAL * min(dr, dc))


@njit(cache=True)
def _step_cost(u: Integer, d: Integer, width: Integer, cost: NDArray[np.uint8]) -> Integer:
    """c(u, v) for the neighbour v in direction d; INFINITE where the robot must not go."""
    v = u + ROW_STEPS[d] * width + COL_STEPS[d]
    if cost[u] >= INSCRIBED or cost[v] >= INSCRIBED:
        return INFINITE
    if d < 4:
        return int(STRAIGHT * (CELL_SCALE + np.int64(cost[u]) + cost[v]))
    if cost[u + ROW_STEPS[d] * width] >= INSCRIBED or cost[u + COL_STEPS[d]] >= INSCRIBED:
        return INFINITE
    return int(DIAGONAL * (CELL_SCALE + np.int64(cost[u]) + cost[v]))


@njit(cache=True)
def _best_step(u: Integer, width: Integer, cost: NDArray[np.uint8], g: NDArray[np.int64]) -> tuple[Integer, Integer]:
    """min over the neighbours s' of c(u, s') + g(s') and its direction (the first of equals), INFINITE and -1 for none."""
    best, direction = INFINITE, -1
    if cost[u] >= INSCRIBED:
        return best, direction
    for d in range(8):
        through = int(g[u + ROW_STEPS[d] * width + COL_STEPS[d]])
        if through < best:
            through += _step_cost(u, d, width, cost)
            if through < best:
                best, direction = through, d
    return best, direction


@njit(cache=True)
def _update_vertex(
    u: Integer,
    size: Integer,
    start: Integer,
    km: Integer,
    width: Integer,
    g: NDArray,
    rhs: NDArray,
    keys: NDArray,
    heap: NDArray,
    slot: NDArray,
) -> Integer:
    """UpdateVertex: inconsistent vertices are in the heap with a current key, others are not; returns the heap's new size."""
    if g[u] == rhs[u]:
        if slot[u] >= 0:
            size = _remove(u, size, keys, heap, slot)
        return size
    k2 = min(g[u], rhs[u])
    k1 = k2 + _distance(start, u, width) + km
    i = np.int64(slot[u])
    if i < 0:
        i = size
        size += 1
    _sift(i, size, k1, k2, u, keys, heap, slot)
    return size


@njit(cache=True)
def _apply_changes(
    changed: NDArray[np.int64],
    stale: NDArray[np.bool_],
    start: Integer,
    goal: Integer,
    km: Integer,
    width: Integer,
    cost: NDArray[np.uint8],
    g: NDArray[np.int64],
    rhs: NDArray[np.int64],
    keys: NDArray[np.int64],
    heap: NDArray[np.int32],
    slot: NDArray[np.int32],
    size: Integer,
) -> Integer:
    """Recomputes rhs where steps have changed, at the changed cells and around them; returns the heap's new size.

    A changed cell is an end of its eight steps and beside four diagonal ones, all of whose ends are among its neighbours. Where
    cells change side by side, as they do under an inflated obstacle, each vertex is recomputed once.
    """
    for cell in changed:
        for d in range(9):
            u = cell if d == 8 else cell + ROW_STEPS[d] * width + COL_STEPS[d]
            stale[u] = True
    for cell in changed:
        for d in range(9):
            u = cell if d == 8 else cell + ROW_STEPS[d] * width + COL_STEPS[d]
            if not stale[u]:
                continue
            stale[u] = False
            if u != goal:
                rhs[u] = _best_step(u, width, cost, g)[0]
            size = _update_vertex(u, size, start, km, width, g, rhs, keys, heap, slot)
    return size


@njit(cache=True)
def _compute_shortest_path(
    start: Integer,
    goal: Integer,
    km: Integer,
    width: Integer,
    cost: NDArray[np.uint8],
    g: NDArray[np.int64],
    rhs: NDArray[np.int64],
    keys: NDArray[np.int64],
    heap: NDArray[np.int32],
    slot: NDArray[np.int32],
    size: Integer,
) -> tuple[Integer, NDArray[np.int32]]:
    """ComputeShortestPath; returns the heap's new size and the cells in the order of their expansions."""
    expanded = np.empty(256, dtype=np.int32)
    n_expanded = 0
    while size > 0:
        k2_start = min(g[start], rhs[start])
        k1_start = k2_start + km
        k1, k2 = keys[0, 0], keys[0, 1]
        if (k1 > k1_start or (k1 == k1_start and k2 >= k2_start)) and rhs[start] == g[start]:
            break
        u = np.int64(heap[0])
        k2_new = min(g[u], rhs[u])
        k1_new = k2_new + _distance(start, u, width) + km
        if k1 < k1_new or (k1 == k1_new and k2 < k2_new):
            _sift(0, size, k1_new, k2_new, u, keys, heap, slot)
            continue
        if n_expanded == len(expanded):
            expanded = doubled(expanded)
        expanded[n_expanded] = u
        n_expanded += 1
        g_old = g[u]
        if g_old > rhs[u]:
            g[u] = rhs[u]
            size = _remove(u, size, keys, heap, slot)
            for d in range(8):
                s = u + ROW_STEPS[d] * width + COL_STEPS[d]
                through_u = g[u] + _step_cost(u, d, width, cost)
                if through_u < rhs[s]:
                    rhs[s] = through_u
                    size = _update_vertex(s, size, start, km, width, g, rhs, keys, heap, slot)
        else:
            g[u] = INFINITE
            for d in range(9):
                s = u if d == 8 else u + ROW_STEPS[d] * width + COL_STEPS[d]
                # rhs(s) hangs on u where it was g_old away; u's own rhs does not, but its key does.
                if d < 8 and rhs[s] != g_old + _step_cost(u, d, width, cost):
                    continue
                if d < 8 and s != goal:
                    rhs[s] = _best_step(s, width, cost, g)[0]
                size = _update_vertex(s, size, start, km, width, g, rhs, keys, heap, slot)
    return size, expanded[:n_expanded].copy()


@njit(cache=True)
def _follow(start: Integer, goal: Integer, width: Integer, cost: NDArray[np.uint8], g: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells from start to goal by steepest descent, (n, 2) as (row, col) of the map inside the frame."""
    cells = np.empty((64, 2), dtype=np.int64)
    n = 0
    u = start
    while True:
        if n == len(cells):
            longer = np.empty((2 * n, 2), dtype=np.int64)
            longer[:n] = cells
            cells = longer
        cells[n, 0], cells[n, 1] = u // width - 1, u % width - 1
        n += 1
        if u == goal:
            return cells[:n].copy()
        d = _best_step(u, width, cost, g)[1]
        u += ROW_STEPS[d] * width + COL_STEPS[d]


class DStarLite:
    """Shortest paths on a changing costmap: `plan` compares the costmap with the last one and repairs the search.

    It starts over where the goal or the place of the grid changes, or too much at once (`DStarLiteParameters`). `Plan.cost` is
    the cost of the steps from the start's to the goal's cell [m], the same as A*'s; `Plan.work` and the heat map `search` are
    those of this replanning alone. Memory: 43 bytes a cell with the costmap that it keeps to compare.
    """

    def __init__(self, parameters: DStarLiteParameters | None = None) -> None:
        self.parameters = parameters or DStarLiteParameters()
        self._costmap: Costmap | None = None
        _warm_up()

    def plan(self, costmap: Costmap, start: Array, goal: Array) -> Plan:
        """Path from `start` to `goal`, both (2,) [m], through cell centres.

        Raises:
            OutsideMap, StartOccupied, GoalOccupied: see `grid_search.endpoints`; the search is kept for the next costmap.
            NoPathFound: start and goal are not connected; where a later costmap opens the way, it is found by repair.
        """
        start_cell, goal_cell = endpoints(costmap, start, goal)
        width = costmap.shape[1] + 2
        u, v = ((row + 1) * width + col + 1 for row, col in (start_cell, goal_cell))
        if self._costmap is None or not self._costmap.same_place(costmap) or v != self._goal:
            self._initialize(costmap, u, v)
        elif costmap is not self._costmap:
            changed = np.flatnonzero(costmap.data != self._costmap.data)
            if len(changed) > self.parameters.restart_fraction * costmap.data.size:
                self._initialize(costmap, u, v)
            else:
                self._repair(costmap, changed, u)
        else:
            self._move(u)
        self._costmap = costmap
        self._size, expanded = _compute_shortest_path(u, v, self._km, width, self._cost.ravel(), *self._search, self._size)
        cost = int(self._search[0][u])
        if cost >= INFINITE:
            raise no_path(start, goal, len(expanded))
        cells = _follow(u, v, width, self._cost.ravel(), self._search[0])
        # Cells that wait in the heap are the open ones; later entries win where a cell is listed twice.
        waiting = self._search[3][: self._size].copy()
        trace = search_trace(
            costmap,
            np.concatenate([waiting, expanded]),
            np.concatenate([np.full(len(waiting), -1), np.arange(len(expanded))]),
        )
        cost_in_metres = cost / (STRAIGHT * CELL_SCALE) * costmap.resolution
        return Plan(path_through(costmap, cells, start, goal), cost_in_metres, {"expansions": len(expanded)}, trace)

    def _initialize(self, costmap: Costmap, start: int, goal: int) -> None:
        """Initialize of the paper: nothing is known but rhs(goal) = 0."""
        self._cost = padded(costmap)
        n = self._cost.size
        g, rhs = np.full(n, INFINITE), np.full(n, INFINITE)
        keys, heap, slot = np.empty((n, 2), dtype=np.int64), np.empty(n, dtype=np.int32), np.full(n, -1, dtype=np.int32)
        self._search = (g, rhs, keys, heap, slot)
        self._stale = np.zeros(n, dtype=np.bool_)
        self._goal, self._last_start, self._km = goal, start, 0
        rhs[goal] = 0
        self._size = _update_vertex(goal, 0, start, 0, costmap.shape[1] + 2, *self._search)

    def _move(self, start: int) -> None:
        """Keys in the heap become lower bounds: km grows by as much as h may have fallen."""
        self._km += _distance(self._last_start, start, self._cost.shape[1])
        self._last_start = start

    def _repair(self, costmap: Costmap, changed: NDArray[np.intp], start: int) -> None:
        """Takes the costs of the changed cells, flat indices of the map, into the search."""
        self._move(start)
        rows, cols = np.divmod(changed, costmap.shape[1])
        self._cost[rows + 1, cols + 1] = costmap.data[rows, cols]
        width = self._cost.shape[1]
        cells = (rows + 1) * width + cols + 1
        self._size = _apply_changes(
            cells, self._stale, start, self._goal, self._km, width, self._cost.ravel(), *self._search, self._size
        )


@warm_up
def _warm_up() -> None:
    """A plan and a repair."""
    planner = DStarLite()
    for costs in ([[0] * 8], [[0] * 7 + [1]]):
        planner.plan(Costmap(np.array(costs), 1.0), np.array([0.5, 0.5]), np.array([1.5, 0.5]))


def build(context: Context) -> DStarLite:
    """D* Lite with the context's parameter `restart_fraction`."""
    return DStarLite(context.parameters_of(DStarLiteParameters))
