"""A* on a costmap (Hart, Nilsson and Raphael, 1968).

Eight neighbours, no corner cutting, costs as `robocar.planners.search.grid_search` says.

The open list is a ring of buckets, each a third of a cell wide in f and emptied last in, first out (after Dial, 1969): no entry
is ever moved, and where many ways are equally long the search goes straight for the goal. Within a bucket a cell may be expanded
before its cost is final; it is then expanded again, and the search ends when no open cell's f is below the cost of the way found,
so the result is the same as with a sorted list.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
    doubled,
    endpoints,
    no_path,
    padded,
    path_through,
    search_trace,
)

_BUCKET_BITS = 20  # a bucket holds f to f + 2**20, 0.36 of a free cell: the fastest of 2**16, 2**18, 2**20


@dataclass(frozen=True, slots=True)
class AStarParameters:
    """
    Args:
        metric: `octile`: steps 1 and sqrt 2, heuristic the octile distance, which makes the path optimal; `thesis`: steps 10 and
            14, heuristic 10 (|drow| + |dcol|), which overestimates diagonals, so the path may be longer than the shortest
            (thesis, eq. 2.44 and Figs 2.16, 2.17).
        weight: of the heuristic: 0 is Dijkstra's algorithm, 1 is A*, above 1 the path costs at most `weight` times the optimum
            (octile).
    """

    metric: Literal["octile", "thesis"] = "octile"
    weight: float = 1.0

    def __post_init__(self) -> None:
        if self.metric not in ("octile", "thesis"):
            raise ValueError(f"metric is octile or thesis, not {self.metric!r}")
        if not 0.0 <= self.weight <= 100.0:
            raise ValueError(f"weight goes from 0 to 100, not {self.weight}")


@dataclass(frozen=True, slots=True, eq=False)
class GridSearch:
    """What a search from cell to cell found.

    Args:
        cells: of the path, (n, 2) as (row, col), or None.
        cost: of its steps [m].
        expanded: cells that were expanded, the same cell counted each time.
        opened: the cells that were generated, (m,), as flat indices of the padded grid.
        order: of their (last) expansions, (m,), -1 where there was none.
    """

    cells: NDArray[np.int64] | None
    cost: float
    expanded: int
    opened: NDArray[np.int32]
    order: NDArray[np.int32]


@njit(cache=True)
def _wider_ring(heads: NDArray[np.int64], first: int, last: int, distance: int) -> NDArray[np.int64]:
    """A ring with room for buckets `distance` apart, which holds the buckets `first` to `last` of the old one."""
    n = len(heads)
    while n <= distance:
        n *= 2
    ring = np.full(n, -1, dtype=np.int64)
    for bucket in range(first, last + 1):
        ring[bucket & (n - 1)] = heads[bucket & (len(heads) - 1)]
    return ring


@njit(cache=True, error_model="numpy")
def _search(
    cost: NDArray[np.uint8],
    width: int,
    start: int,
    goal: int,
    measure: tuple[int, int, int, int],
    g: NDArray[np.int64],
    reached_by: NDArray[np.uint8],
    order: NDArray[np.int32],
    opened: NDArray[np.int32],
) -> tuple[int, int]:
    """Fills g, reached_by (a direction), order (of expansions, -1: not expanded) and opened.

    Args:
        measure: costs of a straight and of a diagonal step, and what the heuristic takes for them.

    Returns:
        Numbers of expansions and of opened cells.
    """
    straight, diagonal, h_straight, h_diagonal = measure
    goal_row, goal_col = goal // width, goal % width
    steps = ROW_STEPS * width + COL_STEPS
    axis_free = np.zeros(5, dtype=np.bool_)  # of the four neighbours along the axes, the first one again at the end
    heads = np.full(64, -1, dtype=np.int64)  # of each bucket, the last entry; buckets lie on a ring, bucket b at b % 64
    entries = np.empty(1024, dtype=np.int32)  # cells
    following = np.empty(1024, dtype=np.int32)  # the next entry of the same bucket, or of the list of unused entries
    unused, n_entries, waiting = -1, 1, 1

    g[start] = 0
    opened[0] = start
    n_opened, n_expanded = 1, 0
    dr, dc = abs(start // width - goal_row), abs(start % width - goal_col)
    bucket = (h_straight * abs(dr - dc) + h_diagonal * min(dr, dc)) >> _BUCKET_BITS
    last_bucket = bucket
    heads[bucket & 63] = 0
    entries[0], following[0] = start, -1
    best = INFINITE  # cost of the best way to the goal so far
    while waiting > 0:
        while heads[bucket & (len(heads) - 1)] < 0:
            bucket += 1
        if bucket << _BUCKET_BITS >= best:
            break
        entry = heads[bucket & (len(heads) - 1)]
        heads[bucket & (len(heads) - 1)] = following[entry]
        following[entry] = unused
        unused = entry
        waiting -= 1
        u = np.int64(entries[entry])
        if order[u] >= 0:
            continue  # an entry from before the cell was reached more cheaply
        order[u] = n_expanded
        n_expanded += 1
        if u == goal:
            best = g[u]
            continue
        row, col = u // width, u % width
        base = CELL_SCALE + np.int64(cost[u])
        for d in range(8):
            if d >= 4 and not (axis_free[d - 4] and axis_free[d - 3]):
                continue
            v = u + steps[d]
            c = cost[v]
            if d < 4:
                axis_free[d] = c < INSCRIBED
                if d == 0:
                    axis_free[4] = axis_free[0]
            if c >= INSCRIBED:
                continue
            through_u = g[u] + (straight if d < 4 else diagonal) * (base + c)
            if through_u >= g[v]:
                continue
            dr, dc = abs(row + ROW_STEPS[d] - goal_row), abs(col + COL_STEPS[d] - goal_col)
            f = through_u + h_straight * abs(dr - dc) + h_diagonal * min(dr, dc)
            if f >= best:
                continue
            if g[v] == INFINITE:
                opened[n_opened] = v
                n_opened += 1
            g[v] = through_u
            reached_by[v] = d
            order[v] = -1
            if unused >= 0:
                entry = unused
                unused = np.int64(following[entry])
            else:
                if n_entries == len(entries):
                    entries, following = doubled(entries), doubled(following)
                entry = n_entries
                n_entries += 1
            b = f >> _BUCKET_BITS
            if max(last_bucket, b) - min(bucket, b) >= len(heads):
                heads = _wider_ring(heads, bucket, last_bucket, max(last_bucket, b) - min(bucket, b))
            bucket = min(bucket, b)  # f falls along a way where the heuristic overestimates
            last_bucket = max(last_bucket, b)
            entries[entry], following[entry] = v, heads[b & (len(heads) - 1)]
            heads[b & (len(heads) - 1)] = entry
            waiting += 1
    return n_expanded, n_opened


@njit(cache=True)
def _trace_back(width: int, start: int, goal: int, reached_by: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Cells from start to goal, (n, 2) as (row, col) of the map inside the frame."""
    length = 1
    u = goal
    while u != start:
        d = reached_by[u]
        u -= ROW_STEPS[d] * width + COL_STEPS[d]
        length += 1
    cells = np.empty((length, 2), dtype=np.int64)
    u = goal
    for i in range(length - 1, 0, -1):
        cells[i, 0], cells[i, 1] = u // width - 1, u % width - 1
        d = reached_by[u]
        u -= ROW_STEPS[d] * width + COL_STEPS[d]
    cells[0, 0], cells[0, 1] = start // width - 1, start % width - 1
    return cells


@njit(cache=True)
def _forget(g: NDArray[np.int64], order: NDArray[np.int32], opened: NDArray[np.int32]) -> None:
    """Undoes a search: the next one finds clean arrays without sweeping the whole map."""
    for u in opened:
        g[u] = INFINITE
        order[u] = -1


class AStar:
    """Shortest paths from scratch.

    `Plan.cost` is the cost of the steps from the start's to the goal's cell [m] (metric `thesis`: a straight step of 10 is one
    cell); `Plan.trace["search"]` is the heat map of the search. Memory: 18 bytes a cell, and 8 for each entry of the open list.
    """

    def __init__(self, parameters: AStarParameters | None = None) -> None:
        self.parameters = parameters = parameters or AStarParameters()
        if parameters.metric == "octile":
            straight, diagonal, h_straight, h_diagonal = STRAIGHT, DIAGONAL, STRAIGHT, DIAGONAL
        else:  # 10, 14, 10 (|drow| + |dcol|), 574 times over, so that the scale is that of the octile metric
            straight, diagonal, h_straight, h_diagonal = 5740, 8036, 5740, 2 * 5740
        self._unit = straight * CELL_SCALE
        scale = parameters.weight * CELL_SCALE
        self._measure = (straight, diagonal, round(scale * h_straight), round(scale * h_diagonal))
        self._shape = (0, 0)
        _warm_up()

    def plan(self, costmap: Costmap, start: Array, goal: Array) -> Plan:
        """Path from `start` to `goal`, both (2,) [m], through cell centres.

        Raises:
            OutsideMap, StartOccupied, GoalOccupied: see `grid_search.endpoints`.
            NoPathFound: every cell that can be reached from the start was searched.
        """
        start_cell, goal_cell = endpoints(costmap, start, goal)
        found = self.search(costmap, start_cell, goal_cell)
        if found.cells is None:
            raise no_path(start, goal, found.expanded)
        return Plan(
            path_through(costmap, found.cells, start, goal),
            found.cost,
            {"expansions": found.expanded},
            search_trace(costmap, found.opened, found.order),
        )

    def search(self, costmap: Costmap, start_cell: tuple[int, int], goal_cell: tuple[int, int]) -> GridSearch:
        """From cell to cell, (row, col); both must be free."""
        rows, cols = costmap.shape
        width = cols + 2
        if self._shape != costmap.shape:
            n = (rows + 2) * width
            self._shape = costmap.shape
            self._cost = padded(costmap)
            self._g = np.full(n, INFINITE, dtype=np.int64)
            self._reached_by = np.zeros(n, dtype=np.uint8)
            self._order = np.full(n, -1, dtype=np.int32)
            self._opened = np.empty(n, dtype=np.int32)
        self._cost[1:-1, 1:-1] = costmap.data
        start, goal = ((row + 1) * width + col + 1 for row, col in (start_cell, goal_cell))
        expanded, n_opened = _search(
            self._cost.ravel(), width, start, goal, self._measure, self._g, self._reached_by, self._order, self._opened
        )
        cost = int(self._g[goal])
        cells = _trace_back(width, start, goal, self._reached_by) if cost < INFINITE else None
        opened = self._opened[:n_opened].copy()
        order = self._order[opened]
        _forget(self._g, self._order, opened)
        return GridSearch(cells, cost / self._unit * costmap.resolution, expanded, opened, order)


@warm_up
def _warm_up() -> None:
    AStar().plan(Costmap(np.zeros((1, 2), dtype=np.uint8), 1.0), np.array([0.5, 0.5]), np.array([1.5, 0.5]))


def build(context: Context) -> AStar:
    """A* with the context's parameters `metric` and `weight`."""
    return AStar(context.parameters_of(AStarParameters))
