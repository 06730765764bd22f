"""A* and Theta* in plain Python, with dicts and lists: oracles for the kernels of `robocar.planners.search`.

Cells are (row, col) of the map without a frame.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from numpy.typing import NDArray

from robocar.planners.geometry.line_of_sight import segment_cost

Cell = tuple[int, int]

STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
BUCKET = 2**20  # how far the f of one bucket goes
ROUNDING = 1.0 + 1e-12  # Theta*: costs that differ by less are equal


@dataclass
class Searched:
    """g, the parents and the order of the last expansion of each cell, in the sequence in which cells were generated."""

    g: dict[Cell, float]
    parent: dict[Cell, Cell]
    order: dict[Cell, int] = field(default_factory=dict)
    expanded: int = 0
    tied: bool = False


def is_free(costs: NDArray, cell: Cell) -> bool:
    return 0 <= cell[0] < costs.shape[0] and 0 <= cell[1] < costs.shape[1] and bool(costs[cell] < 253)


def neighbours(costs: NDArray, cell: Cell) -> Iterator[Cell]:
    """Free cells one step away, along the axes first; a diagonal step needs both cells beside it free."""
    row, col = cell
    for dr, dc in STEPS:
        if all(is_free(costs, other) for other in ((row + dr, col + dc), (row + dr, col), (row, col + dc))):
            yield row + dr, col + dc


def a_star(costs: NDArray, start: Cell, goal: Cell, lengths: tuple[int, int], h: Callable[[Cell], int]) -> Searched:
    """A* with whole numbers: of the lowest bucket of f, the cell that came last; a cell whose g falls is expanded again.

    It ends when no bucket is left that begins below the cost of the way found; ways that are not below it are dropped.

    Args:
        lengths: of a straight and of a diagonal step.
        h: the heuristic.
    """
    found = Searched({start: 0}, {})
    buckets: dict[int, list[Cell]] = {h(start) // BUCKET: [start]}
    best: float = math.inf
    while buckets and min(buckets) * BUCKET < best:
        lowest = min(buckets)
        cell = buckets[lowest].pop()
        if not buckets[lowest]:
            del buckets[lowest]
        if cell in found.order:
            continue
        found.order[cell] = found.expanded
        found.expanded += 1
        if cell == goal:
            best = found.g[cell]
            continue
        for other in neighbours(costs, cell):
            length = lengths[cell[0] != other[0] and cell[1] != other[1]]
            g = found.g[cell] + length * (504 + int(costs[cell]) + int(costs[other]))
            f = g + h(other)
            if g < found.g.get(other, math.inf) and f < best:
                found.g[other], found.parent[other] = g, cell
                found.order.pop(other, None)
                buckets.setdefault(int(f) // BUCKET, []).append(other)
    return found


def theta_star(costs: NDArray, start: Cell, goal: Cell, weight: float) -> Searched:
    """Theta* (Nash et al. 2007, Fig. 3): from a cell's parent straight to its neighbour (path 2), where that costs no more than
    by way of the cell (path 1). A neighbour that hangs on that parent already keeps it unless path 1 is cheaper.

    `tied` tells that two open cells had the same f (to rounding) when one of them was taken: which one is up to the heap.
    """
    found = Searched({start: 0.0}, {start: start})
    queue = [(0.0, start)]
    while queue:
        f, cell = heapq.heappop(queue)
        if cell in found.order:
            continue
        found.tied = found.tied or any(other not in found.order and other != cell and key < f + 1e-9 for key, other in queue)
        found.order[cell] = found.expanded
        found.expanded += 1
        if cell == goal:
            break
        parent = found.parent[cell]
        for other in neighbours(costs, cell):
            if other in found.order:
                continue
            known = found.g.get(other, math.inf)
            path_1 = found.g[cell] + math.dist(cell, other) * (1.0 + (int(costs[cell]) + int(costs[other])) / 504.0)
            path_2 = found.g[parent] + straight(costs, parent, other) if found.parent.get(other) != parent else math.inf
            if min(path_1, path_2) < known:
                found.g[other] = min(path_1, path_2)
                found.parent[other] = parent if path_2 <= path_1 * ROUNDING else cell
                heapq.heappush(queue, (found.g[other] + weight * math.dist(other, goal), other))
    return found


def straight(costs: NDArray, a: Cell, b: Cell) -> float:
    """Line integral between two centres [cells], inf where it is blocked; `test_theta_star.py` checks it by exact clipping."""
    return segment_cost(costs, a[1] + 0.5, a[0] + 0.5, b[1] + 0.5, b[0] + 0.5)
