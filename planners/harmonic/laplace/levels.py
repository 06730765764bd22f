"""Coarse levels of the multigrid solver: connected pieces of 2 x 2 blocks, and the walk between them.

A level is a random walk e = P e + residual between nodes. Its weights are those of the walk *conditioned* on reaching the goal
(Doob's h-transform): between cells i and j runs the conductance w_i w_j. In these weights the unknown is the relative error of
w, which is of size one everywhere, and the solution e = 1 is known to every level, however fast w itself falls off.

Two pieces of one block that a wall separates stay two nodes, so nothing ever leaks through a thin wall. Conductances between
blocks count half: a piecewise constant correction makes links twice too stiff (Braess 1995).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array


class LevelArrays(NamedTuple):
    """The arrays of a `Level`, for compiled functions."""

    blocks: NDArray[np.int32]
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

    @property
    def arrays(self) -> LevelArrays:
        """As they are now: `coarser` sets `parent` and `share` anew."""
        return LevelArrays(
            self.blocks, self.indptr, self.indices, self.probability, self.goal, self.loss, self.log_weight, self.parent,
            self.share, self.first_child, self.children,
        )  # fmt: skip


def _empty_level(blocks, n_red, indptr, indices, first_child, children) -> Level:
    n = len(blocks)
    none = np.empty(0, np.int32)
    return Level(
        blocks, int(n_red), indptr, indices, np.empty(len(indices)), np.empty(n), np.empty(n), np.empty(n),
        none, np.empty(0, np.float32), first_child, children,
    )  # fmt: skip


# ---------------------------------------------------------------- level 1, from cells


def first_level(inverse_degree: Array) -> tuple[Level, NDArray[np.int32]]:
    """Nodes over a grid of cells, and the node of each cell (rows + 2, cols + 2), -1 where nothing is sought."""
    parent, blocks, n_red = _number_cells(inverse_degree)
    indptr, indices = _cell_links(parent, blocks)
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


@njit(cache=True)
def _cell_links(parent, blocks):
    """Links to the left, right, top and bottom, (n + 1,) and (nnz,).

    At most one a side: where a block has two nodes, each of its sides shows one cell only.
    """
    n = len(blocks)
    cols = np.int64(parent.shape[1])
    parents = parent.ravel()
    # a side: its two cells, and their neighbours outside
    inner = ((0, cols), (1, cols + 1), (0, 1), (cols, cols + 1))
    outer = ((-1, cols - 1), (2, cols + 2), (-cols, 1 - cols), (2 * cols, 2 * cols + 1))
    indptr = np.empty(n + 1, np.int32)
    indices = np.empty(4 * n, np.int32)
    indptr[0] = 0
    at = np.uint64(0)
    for node in range(n):
        corner = (2 * blocks[node, 0] + 1) * cols + 2 * blocks[node, 1] + 1
        for side in range(4):
            other = np.int32(-1)
            for k in range(2):
                if parents[np.uint64(corner + inner[side][k])] == node:
                    other = max(other, parents[np.uint64(corner + outer[side][k])])
            indices[at] = other
            at += np.uint64(other >= 0)
        indptr[node + 1] = at
    return indptr, indices[:at].copy()


# ---------------------------------------------------------------- further levels, from nodes


def coarser(fine: Level) -> Level:
    """The next level; sets `parent` and `share` (not yet weighed) of `fine`."""
    fine.parent, blocks, n_red, first_child, children = _number_nodes(fine.blocks, fine.indptr, fine.indices)
    fine.share = np.empty(fine.size, np.float32)
    indptr, indices = _node_links(fine.parent, first_child, children, fine.indptr, fine.indices)
    return _empty_level(blocks, n_red, indptr, indices, first_child, children)


@njit(cache=True)
def _first_nodes(blocks):
    """First node of each block, -1 where there is none, -2 - node where the block has several, (rows, cols) even."""
    n = len(blocks)
    rows, cols = 0, 0
    for i in range(n):
        rows, cols = max(rows, blocks[i, 0] + 1), max(cols, blocks[i, 1] + 1)
    first = np.full((rows + rows % 2, cols + cols % 2), -1, np.int32)
    for i in range(n):  # nodes of one block follow each other
        known = first[blocks[i, 0], blocks[i, 1]]
        if known == -1:
            first[blocks[i, 0], blocks[i, 1]] = i
        elif known >= 0:
            first[blocks[i, 0], blocks[i, 1]] = -2 - known
    return first


@njit(cache=True)
def _leads_to(i, j, indptr, indices):
    found = False
    for a in range(np.uint32(indptr[i]), np.uint32(indptr[i + 1])):
        found |= indices[a] == j
    return found


@njit(cache=True)
def _number_nodes(blocks, indptr, indices):
    """Number the connected pieces of 2 x 2 blocks: red before black, by rows, then by their first node.

    Returns: the piece of each node, the pieces' blocks, how many are red, and their nodes in CSR form, in order.
    """
    n = len(blocks)
    first = _first_nodes(blocks)
    half_rows, half_cols = first.shape[0] // 2, first.shape[1] // 2
    parent = np.full(n, -1, np.int32)
    coarse = np.empty((n, 2), np.int32)
    first_child = np.empty(n + 1, np.int32)
    first_child[0] = 0
    children = np.empty(n, np.int32)
    count, size, n_red = 0, 0, 0
    for color in range(2):
        for r in range(half_rows):
            for c in range((r + color) % 2, half_cols, 2):
                i, j = first[2 * r, 2 * c], first[2 * r + 1, 2 * c + 1]  # red
                k, m = first[2 * r, 2 * c + 1], first[2 * r + 1, 2 * c]  # black: links lead here from i and j only
                if (
                    min(i, j, k, m) >= 0
                    and _leads_to(i, k, indptr, indices)
                    and _leads_to(i, m, indptr, indices)
                    and (_leads_to(j, k, indptr, indices) or _leads_to(j, m, indptr, indices))
                ):
                    for child in (i, j, k, m):  # in their order: the red ones first
                        parent[child] = count
                        children[size] = child
                        size += 1
                    coarse[count, 0], coarse[count, 1] = r, c
                    count += 1
                    first_child[count] = size
                    continue
                for start in (i, j, k, m):
                    if start == -1:
                        continue
                    leader = start if start >= 0 else -2 - start
                    row, col = blocks[leader, 0], blocks[leader, 1]
                    while leader < n and blocks[leader, 0] == row and blocks[leader, 1] == col:
                        if parent[leader] < 0:
                            size = _gather_piece(leader, count, blocks, indptr, indices, parent, children, size)
                            coarse[count, 0], coarse[count, 1] = r, c
                            count += 1
                            first_child[count] = size
                        leader += 1
        if color == 0:
            n_red = count
    return parent, coarse[:count].copy(), n_red, first_child[: count + 1].copy(), children


@njit(cache=True)
def _gather_piece(leader, number, blocks, indptr, indices, parent, children, begin):
    """Write the nodes that hang together with `leader` in its 2 x 2 block to children[begin:], in order; returns the end."""
    r, c = blocks[leader, 0] // 2, blocks[leader, 1] // 2
    parent[leader] = number
    children[begin] = leader
    at, end = begin, begin + 1
    while at < end:
        i = children[at]
        at += 1
        for a in range(indptr[i], indptr[i + 1]):
            j = indices[a]
            if parent[j] < 0 and blocks[j, 0] // 2 == r and blocks[j, 1] // 2 == c:
                parent[j] = number
                children[end] = j
                end += 1
    for at in range(begin + 1, end):
        child, k = children[at], at
        while k > begin and children[k - 1] > child:
            children[k] = children[k - 1]
            k -= 1
        children[k] = child
    return end


@njit(cache=True)
def _node_links(parent, first_child, children, indptr, indices):
    n = len(first_child) - 1
    coarse_indptr = np.empty(n + 1, np.int32)
    coarse_indptr[0] = 0
    coarse = np.empty(len(indices), np.int32)
    size = np.uint32(0)
    for node in range(n):
        begin = size
        for k in range(np.uint32(first_child[node]), np.uint32(first_child[node + 1])):
            i = np.uint32(children[k])
            for a in range(np.uint32(indptr[i]), np.uint32(indptr[i + np.uint32(1)])):
                other = parent[np.uint32(indices[a])]
                if other == node:
                    continue
                b = begin
                while b < size and coarse[b] != other:
                    b += np.uint32(1)
                if b == size:
                    coarse[size] = other
                    size += np.uint32(1)
        coarse_indptr[node + 1] = size
    return coarse_indptr, coarse[:size].copy()
