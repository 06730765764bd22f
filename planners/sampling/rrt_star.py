"""RRT*, the random tree that rewires itself (Karaman and Frazzoli, IJRR 30(7), 2011): the compiled part of `rrt`'s variant."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.sampling.random_trees import (
    Growth,
    Tree,
    TreeObstacles,
    anywhere,
    bucket_of,
    buckets,
    edge_cost,
    extend,
    insert,
    nearest,
    way,
)
from robocar.planners.search.grid_search import doubled

_ROUNDING = 1e-9  # an edge's cost and its length are both rounded: the cost may be smaller by this share


@njit(cache=True)
def _least(node: Array, x: float, y: float) -> float:
    """No edge between the two points costs less than this: where costs are added only to length, that is its length."""
    return (1.0 - _ROUNDING) * math.hypot(node[0] - x, node[1] - y)


@njit(cache=True)
def _nodes_around(
    nodes: Array, frame: Array, heads: NDArray, following: NDArray, x: float, y: float, radius: float, around: NDArray
) -> tuple[NDArray[np.int64], int]:
    """All nodes within the radius as the first of `around`, which grows where it must, and their number."""
    m = 0
    low_row, low_col = bucket_of(frame, heads, x - radius, y - radius)
    high_row, high_col = bucket_of(frame, heads, x + radius, y + radius)
    for r in range(low_row, high_row + 1):
        for c in range(low_col, high_col + 1):
            j = heads[r, c]
            while j >= 0:
                if (nodes[j, 0] - x) ** 2 + (nodes[j, 1] - y) ** 2 <= radius * radius:
                    if m == len(around):
                        around = doubled(around)
                    around[m] = j
                    m += 1
                j = following[j]
    return around, m


@njit(cache=True)
def _leave(child: NDArray, sibling: NDArray, parent: int, j: int) -> None:
    """Takes j out of the list of its parent's children."""
    if child[parent] == j:
        child[parent] = sibling[j]
        return
    before = child[parent]
    while sibling[before] != j:
        before = sibling[before]
    sibling[before] = sibling[j]


@njit(cache=True)
def _pass_on(
    costs: Array, edges: Array, parents: NDArray, child: NDArray, sibling: NDArray, root: int, stack: NDArray
) -> NDArray[np.int64]:
    """Gives the cost of `root` and of all that hang on it anew; returns the stack, which grows where it must."""
    stack[0], top = root, 1
    while top > 0:
        top -= 1
        i = stack[top]
        costs[i] = costs[parents[i]] + edges[i]
        j = child[i]
        while j >= 0:
            if top == len(stack):
                stack = doubled(stack)
            stack[top] = j
            top += 1
            j = sibling[j]
    return stack


@njit(cache=True)
def grow_star(
    obstacles: TreeObstacles, start: Array, goal: Array, step: float, goal_bias: float, max_samples: int,
    adaptive: bool, area: float, rng: np.random.Generator,
) -> Growth:  # fmt: skip
    """Algorithm 6: every new node takes the cheapest way from its neighbours and offers them its own; all samples are used.
    The goal is a node from its first sample on.

    Args:
        area: of the free space, for the radius of the neighbourhood (Theorem 38, d = 2): gamma sqrt(log n / n), at most `step`.
    """
    bounds, size = obstacles.bounds, max_samples + 1
    gamma = 1.1 * 2.0 * math.sqrt(1.5 * area / math.pi)
    nodes, costs, edges = np.empty((size, 2)), np.zeros(size), np.zeros(size)  # edges: costs of those to the parents
    parents, following = np.full(size, -1, dtype=np.int64), np.full(size, -1, dtype=np.int64)
    child, sibling = np.full(size, -1, dtype=np.int64), np.full(size, -1, dtype=np.int64)
    frame, heads = buckets(bounds, step)
    around, stack = np.empty(64, dtype=np.int64), np.empty(64, dtype=np.int64)
    nodes[0] = start
    insert(frame, heads, following, 0, start[0], start[1])
    n, at_goal = 1, 0 if start[0] == goal[0] and start[1] == goal[1] else -1
    for _ in range(max_samples):
        if at_goal < 0 and rng.random() < goal_bias:
            x, y = goal[0], goal[1]
        else:
            x, y = anywhere(bounds, rng)
        i = nearest(nodes, n, frame, heads, following, x, y)
        x, y, edge = extend(obstacles, nodes[i, 0], nodes[i, 1], x, y, step, adaptive)
        if edge == math.inf or (x == nodes[i, 0] and y == nodes[i, 1]):
            continue
        radius = min(step, gamma * math.sqrt(math.log(n + 1.0) / (n + 1.0)))
        around, m = _nodes_around(nodes, frame, heads, following, x, y, radius, around)
        # Edges are looked at only where they could be the cheapest way to the new node or from it.
        ways = np.full(m, math.nan)
        parent, cost = i, costs[i] + edge
        for k in range(m):
            j = around[k]
            if j == i and not costs[j] + math.hypot(nodes[j, 0] - x, nodes[j, 1] - y) < cost:
                ways[k] = math.inf  # the nearest node is not rewired where its edge costs no more than its length
            elif costs[j] + _least(nodes[j], x, y) < cost:
                ways[k] = edge_cost(obstacles, nodes[j, 0], nodes[j, 1], x, y)
                if costs[j] + ways[k] < cost:
                    parent, cost, edge = j, costs[j] + ways[k], ways[k]
        nodes[n, 0], nodes[n, 1], parents[n], costs[n], edges[n] = x, y, parent, cost, edge
        sibling[n], child[parent] = child[parent], n
        insert(frame, heads, following, n, x, y)
        if x == goal[0] and y == goal[1]:
            at_goal = n
        for k in range(m):
            j = around[k]
            if j == parent or not cost + _least(nodes[j], x, y) < costs[j]:
                continue
            if math.isnan(ways[k]):
                ways[k] = edge_cost(obstacles, nodes[j, 0], nodes[j, 1], x, y)
            if cost + ways[k] < costs[j]:
                _leave(child, sibling, int(parents[j]), j)
                parents[j], edges[j], sibling[j], child[n] = n, ways[k], child[n], j
                stack = _pass_on(costs, edges, parents, child, sibling, j, stack)
        n += 1
    path = np.empty((0, 2)) if at_goal < 0 else way(nodes, parents, at_goal)
    return Growth(Tree(nodes[:n].copy(), parents[:n].copy(), costs[:n].copy()), path, max_samples)
