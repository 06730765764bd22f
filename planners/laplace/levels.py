"""Coarse levels of the multigrid solver: connected pieces of 2 x 2 blocks, and the walk between them.

A level is a random walk e = P e + residual between nodes. Its weights are those of the walk *conditioned* on reaching the goal
(Doob's h-transform): between cells i and j runs the conductance w_i w_j. In these weights the unknown is the relative error of
w, which is of size one everywhere, and the solution e = 1 is known to every level, however fast w itself falls off.

Two pieces of one block that a wall separates stay two nodes, so nothing ever leaks through a thin wall. Conductances between
blocks count half: a piecewise constant correction makes links twice too stiff (Braess 1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array


@dataclass(slots=True, eq=False)
class Level:
    """Nodes, first the `n_red` of even block row + column, then the black ones; links lead to the other colour only.

    Args:
        blocks: block of each node as (row, col), (n, 2) int32.
        indptr, indices: links in CSR form.
        probability: of each link, (nnz,).
        goal, loss: probability to step to the goal and into a wall, (n,).
        log_weight: log2 of the conductance that meets at each node, (n,).
        parent: node of the next level, (n,) int32, empty on the last.
        share: weight of the node in its parent's balance, (n,) float32, empty on the last.
        first_child, children: nodes of the finer level in CSR form (empty on level 1, whose children are cells).
    """

    blocks: NDArray[np.int32]
    n_red: int
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    probability: Array
    goal: Array
    loss: Array
    log_weight: Array
    parent: NDArray[np.int32]
    share: NDArray[np.float32]
    first_child: NDArray[np.int32]
    children: NDArray[np.int32]

    @property
    def size(self) -> int:
        return len(self.blocks)


def _empty_level(blocks, n_red, indptr, indices, first_child, children) -> Level:
    n = len(blocks)
    none = np.empty(0, np.int32)
    return Level(
        blocks, int(n_red), indptr, indices, np.zeros(len(indices)), np.zeros(n), np.zeros(n), np.zeros(n),
        none, np.empty(0, np.float32), first_child, children,
    )  # fmt: skip


# ---------------------------------------------------------------- level 1, from cells


def first_level(inverse_degree: Array) -> tuple[Level, NDArray[np.int32]]:
    """Nodes over a grid of cells, and the node of each cell (rows + 2, cols + 2), -1 where nothing is sought."""
    parent, blocks, n_red = _number_cells(inverse_degree)
    indptr = _count_cell_links(parent, blocks)
    indices = _fill_cell_links(parent, blocks, indptr)
    none = np.empty(0, np.int32)
    return _empty_level(blocks, n_red, indptr, indices, none, none), parent


@njit(cache=True)
def _number_cells(inverse_degree):
    rows, cols = inverse_degree.shape
    parent = np.full((rows, cols), -1, np.int32)
    half_rows, half_cols = (rows - 1) // 2, (cols - 1) // 2
    n = 0
    n_red = 0
    blocks = np.empty((2 * half_rows * half_cols, 2), np.int32)
    for color in range(2):
        for i in range(half_rows):
            r = 2 * i + 1
            for j in range((i + color) % 2, half_cols, 2):
                c = 2 * j + 1
                a, b = inverse_degree[r, c] > 0, inverse_degree[r, c + 1] > 0
                d, e = inverse_degree[r + 1, c] > 0, inverse_degree[r + 1, c + 1] > 0
                if not (a or b or d or e):
                    continue
                # only two cells that touch at a corner are not connected inside the block
                split = (a and e and not b and not d) or (b and d and not a and not e)
                blocks[n, 0], blocks[n, 1] = i, j
                if a:
                    parent[r, c] = n
                if b:
                    parent[r, c + 1] = n
                if split:
                    n += 1
                    blocks[n, 0], blocks[n, 1] = i, j
                if d:
                    parent[r + 1, c] = n
                if e:
                    parent[r + 1, c + 1] = n
                n += 1
        if color == 0:
            n_red = n
    return parent, blocks[:n].copy(), n_red


@njit(cache=True, inline="always")
def outside(k):
    """Offsets of the k-th pair (cell of a block, its neighbour outside): cell row, cell col, neighbour row, neighbour col."""
    if k < 2:
        return k, 0, k, -1
    if k < 4:
        return k - 2, 1, k - 2, 2
    if k < 6:
        return 0, k - 4, -1, k - 4
    return 1, k - 6, 2, k - 6


@njit(cache=True)
def _count_cell_links(parent, blocks):
    n = len(blocks)
    count = np.zeros(n + 1, np.int32)
    for node in range(n):
        r, c = 2 * blocks[node, 0] + 1, 2 * blocks[node, 1] + 1
        found = 0
        previous = np.int32(-1)
        for k in range(8):
            r1, c1, r2, c2 = outside(k)
            if parent[r + r1, c + c1] == node:
                other = parent[r + r2, c + c2]
                if other >= 0 and (other != previous or k % 2 == 0):
                    found += 1
                previous = other
            else:
                previous = np.int32(-1)
        count[node + 1] = found
    return np.cumsum(count).astype(np.int32)


@njit(cache=True)
def _fill_cell_links(parent, blocks, indptr):
    indices = np.empty(indptr[-1], np.int32)
    for node in range(len(blocks)):
        r, c = 2 * blocks[node, 0] + 1, 2 * blocks[node, 1] + 1
        at = indptr[node]
        previous = np.int32(-1)
        for k in range(8):
            r1, c1, r2, c2 = outside(k)
            if parent[r + r1, c + c1] == node:
                other = parent[r + r2, c + c2]
                if other >= 0 and (other != previous or k % 2 == 0):
                    indices[at] = other
                    at += 1
                previous = other
            else:
                previous = np.int32(-1)
    return indices


# ---------------------------------------------------------------- further levels, from nodes


def coarser(fine: Level) -> Level:
    """The next level; fills `parent` and `share` of `fine`."""
    parent, blocks, n_red = _number_nodes(fine.blocks, fine.indptr, fine.indices)
    fine.parent = parent
    fine.share = np.zeros(fine.size, np.float32)
    first_child = np.zeros(len(blocks) + 1, np.int32)
    np.cumsum(np.bincount(parent, minlength=len(blocks)), out=first_child[1:])
    children = np.argsort(parent, kind="stable").astype(np.int32)
    indptr, indices = _node_links(parent, first_child, children, fine.indptr, fine.indices)
    return _empty_level(blocks, n_red, indptr, indices, first_child, children)


@njit(cache=True)
def _number_nodes(blocks, indptr, indices):
    """Connected pieces of 2 x 2 blocks by union-find, numbered red before black and by rows."""
    n = len(blocks)
    root = np.arange(n).astype(np.int32)
    for i in range(n):
        for a in range(indptr[i], indptr[i + 1]):
            j = indices[a]
            if blocks[i, 0] // 2 == blocks[j, 0] // 2 and blocks[i, 1] // 2 == blocks[j, 1] // 2:
                x, y = i, j
                while root[x] != x:
                    root[x] = root[root[x]]
                    x = root[x]
                while root[y] != y:
                    root[y] = root[root[y]]
                    y = root[y]
                if x < y:
                    root[y] = x
                else:
                    root[x] = y
    leaders = np.empty(n, np.int32)
    count = 0
    for i in range(n):
        x = np.int32(i)
        while root[x] != x:
            x = root[x]
        root[i] = x
        if x == i:
            leaders[count] = i
            count += 1
    width = 0
    for i in range(n):
        width = max(width, blocks[i, 1] // 2 + 1)
    key = np.empty(count, np.int64)
    half = np.int64(1) << 60
    for k in range(count):
        r, c = blocks[leaders[k], 0] // 2, blocks[leaders[k], 1] // 2
        key[k] = np.int64(r) * width + c + (half if (r + c) % 2 == 1 else 0)
    rank = np.argsort(key, kind="mergesort")
    number = np.empty(n, np.int32)
    coarse = np.empty((count, 2), np.int32)
    n_red = 0
    for k in range(count):
        i = leaders[rank[k]]
        number[i] = k
        coarse[k, 0], coarse[k, 1] = blocks[i, 0] // 2, blocks[i, 1] // 2
        if (coarse[k, 0] + coarse[k, 1]) % 2 == 0:
            n_red += 1
    parent = np.empty(n, np.int32)
    for i in range(n):
        parent[i] = number[root[i]]
    return parent, coarse, n_red


@njit(cache=True)
def _node_links(parent, first_child, children, indptr, indices):
    n = len(first_child) - 1
    coarse_indptr = np.zeros(n + 1, np.int32)
    coarse = np.empty(len(indices), np.int32)
    size = 0
    for node in range(n):
        begin = size
        for k in range(first_child[node], first_child[node + 1]):
            i = children[k]
            for a in range(indptr[i], indptr[i + 1]):
                other = parent[indices[a]]
                if other == node:
                    continue
                known = False
                for b in range(begin, size):
                    known = known or coarse[b] == other
                if not known:
                    coarse[size] = other
                    size += 1
        coarse_indptr[node + 1] = size
    return coarse_indptr, coarse[:size].copy()
