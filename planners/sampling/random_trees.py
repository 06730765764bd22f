"""Rapidly-exploring random trees among obstacles given as cells, as circles, or both: the compiled part of `rrt`.

RRT and RRT-Connect stand here, with what every tree needs; RRT* is `rrt_star`.

Coordinates are those of the obstacles: cells for a costmap (`GridMap.grid_from_world`), any unit where there are only circles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.geometry.line_of_sight import segment_cost

_FEW = 64  # nodes up to which all are looked at
_MOST_BUCKETS = 256  # along each side
_HALVINGS = 4  # of a blocked step


class TreeObstacles(NamedTuple):
    """What the tree must not touch: the collision check of every planner here.

    Args:
        costs: blocked from 253 on, (rows, cols) uint8; (0, 0) where there is no grid. Outside of it everything is blocked.
        circles: x, y, radius, (n, 3): a point is free at the radius and beyond.
        bounds: lowest x, y and highest x, y that are sampled, (4,).
    """

    costs: NDArray[np.uint8]
    circles: Array
    bounds: Array


class Tree(NamedTuple):
    """Nodes (n, 2), their parents (n,), -1 for roots, and the costs of the way from their root (n,)."""

    nodes: Array
    parents: NDArray[np.int64]
    costs: Array


class Growth(NamedTuple):
    """What came of growing: the tree, the path's nodes from start to goal (k, 2), empty where none was found, and samples
    drawn."""

    tree: Tree
    path: Array
    samples: int


@njit(cache=True)
def edge_cost(obstacles: TreeObstacles, x0: float, y0: float, x1: float, y1: float) -> float:
    """Cost of a straight segment, inf where it touches an obstacle: the line integral of 1 + c / 252 on a grid, else its length.

    Exact: no sampling along the segment.
    """
    circles = obstacles.circles
    dx, dy = x1 - x0, y1 - y0
    squared = dx * dx + dy * dy
    for i in range(len(circles)):
        ex, ey = circles[i, 0] - x0, circles[i, 1] - y0
        share = 0.0
        if squared > 0.0:
            share = min(1.0, max(0.0, (ex * dx + ey * dy) / squared))
        gap_x, gap_y = ex - share * dx, ey - share * dy
        if gap_x * gap_x + gap_y * gap_y < circles[i, 2] * circles[i, 2]:
            return math.inf
    if obstacles.costs.size > 0:
        return segment_cost(obstacles.costs, x0, y0, x1, y1)
    return math.sqrt(squared)


@njit(cache=True)
def buckets(bounds: Array, size: float) -> tuple[Array, NDArray[np.int64]]:
    """Frame (lowest x, lowest y, side) and empty heads (rows, cols) of the squares that nodes are kept in."""
    width, height = bounds[2] - bounds[0], bounds[3] - bounds[1]
    size = max(size, max(width, height) / _MOST_BUCKETS, 1e-9)
    frame = np.array([bounds[0], bounds[1], size])
    heads = np.full((int(height / size) + 1, int(width / size) + 1), -1, dtype=np.int64)
    return frame, heads


@njit(cache=True)
def bucket_of(frame: Array, heads: NDArray, x: float, y: float) -> tuple[int, int]:
    row, col = int((y - frame[1]) / frame[2]), int((x - frame[0]) / frame[2])
    return min(max(row, 0), heads.shape[0] - 1), min(max(col, 0), heads.shape[1] - 1)


@njit(cache=True)
def insert(frame: Array, heads: NDArray, following: NDArray, i: int, x: float, y: float) -> None:
    """Puts node i into its square."""
    row, col = bucket_of(frame, heads, x, y)
    following[i], heads[row, col] = heads[row, col], i


@njit(cache=True)
def nearest(nodes: Array, n: int, frame: Array, heads: NDArray, following: NDArray, x: float, y: float) -> int:
    """The node nearest to a point; of equally near ones the first."""
    best, best_squared = 0, math.inf
    if n <= _FEW:
        for i in range(n):
            squared = (nodes[i, 0] - x) ** 2 + (nodes[i, 1] - y) ** 2
            if squared < best_squared:
                best, best_squared = i, squared
        return best
    row, col = bucket_of(frame, heads, x, y)
    rows, cols = heads.shape
    for ring in range(max(rows, cols)):
        # What lies in this ring and beyond is at least so far away (a point outside the squares is farther still).
        reach = (ring - 1) * frame[2]
        if reach > 0.0 and best_squared <= reach * reach:
            break
        for r in range(max(0, row - ring), min(rows, row + ring + 1)):
            whole = abs(r - row) == ring
            for c in range(col - ring, col + ring + 1, 1 if whole or ring == 0 else 2 * ring):
                if not 0 <= c < cols:
                    continue
                i = int(heads[r, c])
                while i >= 0:
                    squared = (nodes[i, 0] - x) ** 2 + (nodes[i, 1] - y) ** 2
                    if squared < best_squared or (squared == best_squared and i < best):
                        best, best_squared = i, squared
                    i = int(following[i])
    return best


@njit(cache=True)
def anywhere(bounds: Array, rng: np.random.Generator) -> tuple[float, float]:
    """A point drawn from the whole of the bounds."""
    x = bounds[0] + (bounds[2] - bounds[0]) * rng.random()
    y = bounds[1] + (bounds[3] - bounds[1]) * rng.random()
    return x, y


@njit(cache=True)
def extend(
    obstacles: TreeObstacles, x0: float, y0: float, x1: float, y1: float, step: float, adaptive: bool
) -> tuple[float, float, float]:
    """A step from a node towards a point: its end and cost, inf where it is blocked; then shorter ones if `adaptive`."""
    length = math.hypot(x1 - x0, y1 - y0)
    share = 1.0 if length <= step else step / length
    for _ in range(1 + (_HALVINGS if adaptive else 0)):
        x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        if share == 1.0:
            x, y = x1, y1
        cost = edge_cost(obstacles, x0, y0, x, y)
        if cost < math.inf:
            return x, y, cost
        share *= 0.5
    return x0, y0, math.inf


@njit(cache=True)
def way(nodes: Array, parents: NDArray, last: int) -> Array:
    """Nodes from the root to `last`, (k, 2)."""
    path, n, i = np.empty((len(parents), 2)), 0, last
    while i >= 0 and n < len(path):
        path[n] = nodes[i]
        n, i = n + 1, parents[i]
    return path[:n][::-1].copy()


@njit(cache=True)
def grow(
    obstacles: TreeObstacles, start: Array, goal: Array, step: float, tolerance: float, goal_bias: float, max_samples: int,
    adaptive: bool, rng: np.random.Generator,
) -> Growth:  # fmt: skip
    """RRT (LaValle 1998; Table 1 of Izaty and Lubis): until a node within `tolerance` of the goal has a free way to it."""
    bounds, size = obstacles.bounds, max_samples + 2
    nodes, costs = np.empty((size, 2)), np.zeros(size)
    parents, following = np.full(size, -1, dtype=np.int64), np.full(size, -1, dtype=np.int64)
    frame, heads = buckets(bounds, step)
    nodes[0] = start
    insert(frame, heads, following, 0, start[0], start[1])
    n, samples, reached = 1, 0, -1
    near = math.hypot(goal[0] - start[0], goal[1] - start[1]) <= tolerance
    if near and edge_cost(obstacles, start[0], start[1], goal[0], goal[1]) < math.inf:
        reached = 0
    while reached < 0 and samples < max_samples:
        samples += 1
        if rng.random() < goal_bias:
            x, y = goal[0], goal[1]
        else:
            x, y = anywhere(bounds, rng)
        i = nearest(nodes, n, frame, heads, following, x, y)
        x, y, cost = extend(obstacles, nodes[i, 0], nodes[i, 1], x, y, step, adaptive)
        if cost == math.inf or (x == nodes[i, 0] and y == nodes[i, 1]):
            continue
        nodes[n, 0], nodes[n, 1], parents[n], costs[n] = x, y, i, costs[i] + cost
        insert(frame, heads, following, n, x, y)
        if math.hypot(goal[0] - x, goal[1] - y) <= tolerance and edge_cost(obstacles, x, y, goal[0], goal[1]) < math.inf:
            reached = n
        n += 1
    path = np.empty((0, 2))
    if reached >= 0:
        if nodes[reached, 0] != goal[0] or nodes[reached, 1] != goal[1]:
            cost = edge_cost(obstacles, nodes[reached, 0], nodes[reached, 1], goal[0], goal[1])
            nodes[n], parents[n], costs[n] = goal, reached, costs[reached] + cost
            reached = n
            n += 1
        path = way(nodes, parents, reached)
    return Growth(Tree(nodes[:n].copy(), parents[:n].copy(), costs[:n].copy()), path, samples)


@njit(cache=True)
def _with_room(nodes: Array, parents: NDArray, following: NDArray, costs: Array) -> tuple[Array, NDArray, NDArray, Array]:
    """The arrays of two trees, (2, n, ...), with twice the room."""
    n = parents.shape[1]
    none = np.full((2, n), -1, dtype=np.int64)
    parents, following = np.concatenate((parents, none), axis=1), np.concatenate((following, none), axis=1)
    return (
        np.concatenate((nodes, np.empty((2, n, 2))), axis=1),
        parents,
        following,
        np.concatenate((costs, np.zeros((2, n))), axis=1),
    )


@njit(cache=True)
def connect(
    obstacles: TreeObstacles, start: Array, goal: Array, step: float, max_samples: int, adaptive: bool, rng: np.random.Generator
) -> Growth:
    """RRT-Connect (Kuffner and LaValle 2000): trees from both ends; each new node is connected to greedily by the other tree."""
    bounds, size = obstacles.bounds, 1024
    nodes, parents, costs = np.empty((2, size, 2)), np.full((2, size), -1, dtype=np.int64), np.zeros((2, size))
    following = np.full((2, size), -1, dtype=np.int64)
    frame, empty = buckets(bounds, step)
    heads = np.empty((2, *empty.shape), dtype=np.int64)
    heads[:] = -1
    counts = np.ones(2, dtype=np.int64)
    nodes[0, 0], nodes[1, 0] = start, goal
    for k in range(2):
        insert(frame, heads[k], following[k], 0, nodes[k, 0, 0], nodes[k, 0, 1])
    samples, a, met = 0, 0, False
    last = np.zeros(2, dtype=np.int64)
    while not met and samples < max_samples:
        samples += 1
        target_x, target_y = anywhere(bounds, rng)
        if samples == 1:  # first straight towards each other
            target_x, target_y = nodes[1, 0, 0], nodes[1, 0, 1]
        grown = False
        for k in (a, 1 - a):
            i = nearest(nodes[k], counts[k], frame, heads[k], following[k], target_x, target_y)
            # The second tree goes on until it meets the first one's new node, or something.
            for _ in range(1 if k == a else 1 << 30):
                x, y, cost = extend(obstacles, nodes[k, i, 0], nodes[k, i, 1], target_x, target_y, step, adaptive and k == a)
                if cost == math.inf or (x == nodes[k, i, 0] and y == nodes[k, i, 1]):
                    met = k != a and cost < math.inf
                    last[k] = i
                    break
                n = counts[k]
                if n == parents.shape[1]:
                    nodes, parents, following, costs = _with_room(nodes, parents, following, costs)
                nodes[k, n, 0], nodes[k, n, 1], parents[k, n], costs[k, n] = x, y, i, costs[k, i] + cost
                insert(frame, heads[k], following[k], n, x, y)
                counts[k] = n + 1
                i, last[k], grown = n, n, True
                if k != a and x == target_x and y == target_y:
                    met = True
                    break
            if not grown:
                break
            target_x, target_y = nodes[k, last[k], 0], nodes[k, last[k], 1]
        a = 1 - a
    first, second = counts[0], counts[1]
    all_parents = np.concatenate((parents[0, :first], np.where(parents[1, :second] < 0, -1, parents[1, :second] + first)))
    tree = Tree(
        np.concatenate((nodes[0, :first], nodes[1, :second])), all_parents, np.concatenate((costs[0, :first], costs[1, :second]))
    )
    path = np.empty((0, 2))
    if met:
        there = way(nodes[0], parents[0], last[0])
        back = way(nodes[1], parents[1], last[1])[::-1]
        path = np.concatenate((there, back[1:]))  # both end in the node where they met
    return Growth(tree, path, samples)


@njit(cache=True)
def shortcut(obstacles: TreeObstacles, path: Array, tries: int, rng: np.random.Generator) -> Array:
    """The path with straight segments between two random points of it wherever that costs less, (k, 2)."""
    points = path.copy()
    for _ in range(tries):
        n = len(points)
        if n < 3:
            break
        lengths = np.empty(n - 1)
        for i in range(n - 1):
            lengths[i] = math.hypot(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
        total = lengths.sum()
        s, t = total * rng.random(), total * rng.random()
        s, t = min(s, t), max(s, t)
        ends, segments = np.empty((2, 2)), np.empty(2, dtype=np.int64)
        for k in range(2):
            at, i = (s, t)[k], 0
            while i < n - 2 and at > lengths[i]:
                at -= lengths[i]
                i += 1
            share = min(1.0, at / lengths[i]) if lengths[i] > 0.0 else 0.0
            ends[k] = points[i] + share * (points[i + 1] - points[i])
            segments[k] = i
        a, b = segments
        if a == b:
            continue
        around = edge_cost(obstacles, ends[0, 0], ends[0, 1], points[a + 1, 0], points[a + 1, 1])
        around += edge_cost(obstacles, points[b, 0], points[b, 1], ends[1, 0], ends[1, 1])
        for i in range(a + 1, b):
            around += edge_cost(obstacles, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1])
        if not edge_cost(obstacles, ends[0, 0], ends[0, 1], ends[1, 0], ends[1, 1]) < around:
            continue
        new = np.concatenate((points[: a + 1], ends, points[b + 1 :]))
        # The two cut segments must stay free where rounding has moved their new ends.
        first = edge_cost(obstacles, points[a, 0], points[a, 1], ends[0, 0], ends[0, 1])
        last = edge_cost(obstacles, ends[1, 0], ends[1, 1], points[b + 1, 0], points[b + 1, 1])
        if first + last < math.inf:
            points = new
    return points
