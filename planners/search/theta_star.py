"""Theta*: any-angle paths on a costmap (Nash, Daniel, Koenig and Felner, 2007; JAIR 39, 2010).

Like A*, but a cell's parent may be any cell in line of sight: a neighbour's parent is tried before the neighbour itself. Segments
are walked cell by cell and cost the line integral of 1 + c / 252 (`robocar.planners.geometry.line_of_sight`), so dear cells are
weighed too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import INSCRIBED, Array, Context, Costmap, Path, Plan
from robocar.core.compiling import warm_up
from robocar.planners.geometry.line_of_sight import polyline_cost, pull_taut, segment_cost
from robocar.planners.search.a_star import AStar
from robocar.planners.search.grid_search import (
    CELL_SCALE,
    COL_STEPS,
    ROW_STEPS,
    STEP_LENGTHS,
    Integer,
    doubled,
    endpoints,
    no_path,
    padded,
    search_trace,
)

_ROUNDING = 1.0 + 1e-12  # of two equal costs that were added up in different ways, which one is lower means nothing


@dataclass(frozen=True, slots=True)
class ThetaStarParameters:
    """
    Args:
        weight: of the heuristic, the straight-line distance: 0 searches in all directions, above 1 is faster and less short.
    """

    weight: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.weight <= 100.0:
            raise ValueError(f"weight goes from 0 to 100, not {self.weight}")


@njit(cache=True)
def _push(keys: Array, nodes: NDArray[np.int32], size: int, key: float, node: int) -> None:
    """Adds a node to the binary heap in the first `size` entries of `keys` and `nodes`."""
    hole = size
    while hole > 0:
        parent = (hole - 1) >> 1
        if keys[parent] <= key:
            break
        keys[hole], nodes[hole] = keys[parent], nodes[parent]
        hole = parent
    keys[hole], nodes[hole] = key, node


@njit(cache=True)
def _pop(keys: Array, nodes: NDArray[np.int32], size: int) -> Integer:
    """Takes the node with the smallest key out of a heap of `size` entries."""
    top = nodes[0]
    size -= 1
    hole, child = 0, 1
    while child < size:
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= keys[size]:
            break
        keys[hole], nodes[hole] = keys[child], nodes[child]
        hole = child
        child = 2 * hole + 1
    keys[hole], nodes[hole] = keys[size], nodes[size]
    return np.int64(top)


@njit(cache=True)
def _search(
    cost: NDArray[np.uint8],
    start: int,
    goal: int,
    weight: float,
    g: Array,
    parent: NDArray[np.int32],
    order: NDArray[np.int32],
    opened: NDArray[np.int32],
) -> tuple[int, int]:
    """Fills g [cells], parent, order and opened; returns the numbers of expanded and of opened cells; `cost` is padded."""
    width = cost.shape[1]
    goal_row, goal_col = goal // width, goal % width
    axis_free = np.zeros(5, dtype=np.bool_)
    keys = np.empty(1024, dtype=np.float64)
    nodes = np.empty(1024, dtype=np.int32)
    keys[0], nodes[0] = 0.0, start
    size = 1
    g[start], parent[start] = 0.0, start
    opened[0] = start
    n_opened, n_expanded = 1, 0
    while size > 0:
        u = _pop(keys, nodes, size)
        size -= 1
        if order[u] >= 0:
            continue
        order[u] = n_expanded
        n_expanded += 1
        if u == goal:
            break
        row, col = u // width, u % width
        p = np.int64(parent[u])
        p_row, p_col = p // width, p % width
        for d in range(8):
            if d >= 4 and not (axis_free[d - 4] and axis_free[d - 3]):
                continue
            r, c = row + ROW_STEPS[d], col + COL_STEPS[d]
            free = cost[r, c] < INSCRIBED
            if d < 4:
                axis_free[d] = free
                if d == 0:
                    axis_free[4] = free
            v = r * width + c
            if not free or order[v] >= 0:
                continue
            around = g[u] + STEP_LENGTHS[d] * (1.0 + (np.float64(cost[row, col]) + cost[r, c]) / CELL_SCALE)
            # Path 2 of the paper: straight from the parent, in free space never dearer than path 1, across dear cells sometimes.
            # The segment is walked only where that can matter: not where v hangs on this parent already, nor where even a free
            # segment, which costs its length, would be too dear.
            straight = math.inf
            if g[v] == math.inf or parent[v] != p:
                least = g[p] + math.hypot(r - p_row, c - p_col)
                if least < g[v] and least <= around * _ROUNDING:
                    straight = g[p] + segment_cost(cost, p_col + 0.5, p_row + 0.5, c + 0.5, r + 0.5)
            through = min(straight, around)
            if through >= g[v]:
                continue
            if g[v] == math.inf:
                opened[n_opened] = v
                n_opened += 1
            g[v] = through
            parent[v] = p if straight <= around * _ROUNDING else u
            if size == len(keys):
                keys, nodes = doubled(keys), doubled(nodes)
            _push(keys, nodes, size, through + weight * math.hypot(r - goal_row, c - goal_col), v)
            size += 1
    return n_expanded, n_opened


class ThetaStar:
    """Any-angle paths that are never longer, and never cost more, than A*'s.

    Theta* alone does not promise that: it may commit to a parent too early. So A* is run too, both paths are pulled taut, and
    Theta*'s is taken where it is at least as good. `Plan.cost` is the line integral of 1 + c / 252 along the path [m];
    `Plan.work` counts both searches; the heat map is that of Theta*. Memory: 39 bytes a cell and the open list.
    """

    def __init__(self, parameters: ThetaStarParameters | None = None) -> None:
        self.parameters = parameters or ThetaStarParameters()
        self._a_star = AStar()
        self._shape = (0, 0)
        _warm_up()

    def plan(self, costmap: Costmap, start: Array, goal: Array) -> Plan:
        """Path from `start` to `goal`, both (2,) [m], with corners only where it turns.

        Raises:
            OutsideMap, StartOccupied, GoalOccupied: see `grid_search.endpoints`.
            NoPathFound: every cell that can be reached from the start was searched.
        """
        start_cell, goal_cell = endpoints(costmap, start, goal)
        a_star = self._a_star.search(costmap, start_cell, goal_cell)
        if a_star.cells is None:
            raise no_path(start, goal, a_star.expanded)
        width = costmap.shape[1] + 2
        if self._shape != costmap.shape:
            self._allocate(costmap)
        cost = self._cost
        cost[1:-1, 1:-1] = costmap.data
        first, last = ((row + 1) * width + col + 1 for row, col in (start_cell, goal_cell))
        expanded, n_opened = _search(cost, first, last, self.parameters.weight, self._g, self._parent, self._order, self._opened)
        corners = [last]
        while corners[-1] != first:
            corners.append(int(self._parent[corners[-1]]))
        opened = self._opened[:n_opened].copy()
        order = self._order[opened]
        self._g[opened], self._order[opened] = np.inf, -1  # clean for the next search, without sweeping the whole map
        # Both as polylines in the padded grid's coordinates, from the exact start to the exact goal.
        ends = costmap.grid_from_world(np.array([start, goal])) + 1.0
        centres = np.array([(u % width + 0.5, u // width + 0.5) for u in corners[::-1]])
        grid_path = np.concatenate([ends[:1], a_star.cells[1:-1, ::-1] + 1.5, ends[1:]]).astype(float)
        candidate = pull_taut(cost, np.concatenate([ends[:1], centres, ends[1:]]))
        best = pull_taut(cost, grid_path)
        if polyline_cost(cost, candidate) <= polyline_cost(cost, best) and _length(candidate) <= _length(grid_path):
            best = candidate
        points = costmap.origin.transform((best - 1.0) * costmap.resolution)
        points[0], points[-1] = start, goal
        return Plan(
            Path(points),
            polyline_cost(cost, best) * costmap.resolution,
            {"expansions": a_star.expanded + expanded},
            search_trace(costmap, opened, order),
        )

    def _allocate(self, costmap: Costmap) -> None:
        """Arrays of the search, kept for the next plan on a map of the same shape."""
        self._shape = costmap.shape
        self._cost = padded(costmap)
        n = self._cost.size
        self._g, self._parent = np.full(n, np.inf), np.empty(n, dtype=np.int32)
        self._order, self._opened = np.full(n, -1, dtype=np.int32), np.empty(n, dtype=np.int32)


def _length(points: Array) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


@warm_up
def _warm_up() -> None:
    ThetaStar().plan(Costmap(np.zeros((1, 2), dtype=np.uint8), 1.0), np.array([0.5, 0.5]), np.array([1.5, 0.5]))


def build(context: Context) -> ThetaStar:
    """Theta* with the context's parameter `weight`."""
    return ThetaStar(context.parameters_of(ThetaStarParameters))
