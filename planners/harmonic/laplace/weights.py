"""Weights of the coarse levels: a walk conditioned on reaching the goal, gathered over the nodes of the finer level."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.harmonic.laplace.levels import Level

PARALLEL_SIZE = 300_000
"""Loops over fewer nodes than this run on one thread: on a busy machine, waiting for the others costs more than they save."""

CHUNKS = 32
"""Pieces of a parallel loop. Pieces write to places of their own, so their order and number change no result."""

GOAL_CONDUCTANCE = 0.85
"""Of the conductance to a goal on the next coarser level: about a goal the error changes with the logarithm of the distance, and
a larger block has its mean farther away. With 1.0, a cycle leaves 0.14 of the error, with 0.8 to 0.9 some 0.05."""

LARGEST_GAIN = 0.5
"""Of a node's conductance: a walk that gains more on a node than it loses to others would not end."""


@njit(cache=True)
def stale_nodes(indptr, indices, e, limit):
    """Nodes across whose links w changes by factors that differ by more than `limit`, (n,) uint8.

    A factor common to a node and its neighbours changes nothing about where the walk goes.
    """
    stale = np.zeros(len(e), np.uint8)
    for i in range(len(e)):
        low = high = e[i]
        for a in range(np.uint32(indptr[i]), np.uint32(indptr[i + 1])):
            other = e[np.uint32(indices[a])]
            low = min(low, other)
            high = max(high, other)
        stale[i] = not high - low <= limit * max(1.0 + low, 0.05)
    return stale


@njit(cache=True)
def follow(log_weight, e):
    """Let the conductances at nodes (n,) follow a change of w by the factors 1 + e, in place."""
    for i in range(len(e)):
        if abs(e[i]) > 1e-3:
            log_weight[i] += 2.0 * np.log2(max(1.0 + e[i], 0.05))


@njit(cache=True)
def beside(indptr, indices, mask):
    """Nodes one link away from those of `mask`, (n,) uint8."""
    out = np.zeros(len(mask), np.uint8)
    for i in range(len(mask)):
        if mask[i]:
            for a in range(indptr[i], indptr[i + 1]):
                out[indices[a]] = 1
    return out


@njit(cache=True)
def stale_parents(parent, stale, size):
    """Nodes of the next level with a stale child, (size,) uint8."""
    out = np.zeros(size, np.uint8)
    for i in range(len(stale)):
        if stale[i]:
            out[parent[i]] = 1
    return out


class Cells(NamedTuple):
    """The finest level, with a border of blocked cells: row after row, (cells,), for kernels that count along both.

    Args:
        cols: of a row.
        w: the present field.
        inverse_degree: 1 over the number of neighbours, 0 where nothing is sought.
        parent: node of level 1 of each cell, -1 for none, int32.
        share: weight of the cell in its node's balance, float32; is set.
    """

    cols: int
    w: Array
    inverse_degree: Array
    parent: NDArray[np.int32]
    share: NDArray[np.float32]

    @staticmethod
    def of(w: Array, inverse_degree: Array, parent: NDArray[np.int32], share: NDArray[np.float32]) -> Cells:
        """Views of contiguous arrays (rows + 2, cols + 2)."""
        return Cells(w.shape[1], w.reshape(-1), inverse_degree.reshape(-1), parent.reshape(-1), share.reshape(-1))


def weigh_first(cells: Cells, level: Level, conditioned: bool, loss_scale: float, stale: NDArray) -> None:
    """Set the walk of level 1 at `stale` nodes: conditioned on w, or with w = 1 the plain one that walls absorb.

    A walk conditioned on a w that is not the solution yet loses what w exceeds the mean of its neighbours by, and gains what it
    lacks. With this loss, which may be negative, e is the whole relative error of w, however large (Doob's transform by a
    function that is not harmonic); without it, only a small one's first order.
    """
    kernel = _weigh_first_parallel if level.size > PARALLEL_SIZE else _weigh_first_serial
    kernel(cells, level.arrays, conditioned, loss_scale, stale)


@njit(cache=True)
def _weigh_first(begin_node, end_node, cells, level, conditioned, loss_scale, stale):
    cols, one, stride = cells.cols, np.uint64(1), np.uint64(cells.cols)
    field, degrees, parents, shares = cells.w, cells.inverse_degree, cells.parent, cells.share
    blocks, indptr, probability, goal, loss = level.blocks, level.indptr, level.probability, level.goal, level.loss
    log_weight = level.log_weight
    # the k-th of eight pairs: a cell of the block, left, right, top and bottom, and its neighbour outside
    inner = (0, cols, 1, cols + 1, 0, 1, cols, cols + 1)
    outer = (-1, cols - 1, 2, cols + 2, -cols, 1 - cols, 2 * cols, 2 * cols + 1)
    for node in range(begin_node, end_node):
        if not stale[node]:
            continue
        corner = (2 * blocks[node, 0] + 1) * cols + 2 * blocks[node, 1] + 1
        scale = 0.0 if conditioned else 1.0
        if conditioned:
            for offset in (0, 1, cols, cols + 1):
                i = np.uint64(corner + offset)
                if parents[i] == node:
                    scale = max(scale, field[i])
        inverse = 1.0 / scale
        begin, end = np.uint64(indptr[node]), np.uint64(indptr[node + 1])
        for a in range(begin, end):
            probability[a] = 0.0
        to_goal = 0.0
        lost = 0.0
        total = 0.0
        at = begin
        previous = np.int32(-1)
        for k in range(8):
            i, j = np.uint64(corner + inner[k]), np.uint64(corner + outer[k])
            if parents[i] != node:
                previous = np.int32(-1)
                continue
            other = parents[j]
            flow = (field[i] * inverse) * (field[j] * inverse) if conditioned else 1.0
            if other >= 0:
                if other == previous and k % 2 == 1:
                    at -= one
                probability[at] += 0.5 * flow
                at += one
                total += 0.5 * flow
            elif field[j] > 0:  # no unknown and yet not 0: the goal
                to_goal += flow
            previous = other
        for k in range(4):
            i = np.uint64(corner + inner[k])
            if parents[i] != node:
                continue
            mine = field[i] * inverse if conditioned else 1.0
            degree = 1.0 / degrees[i]
            shares[i] = degree * mine * mine
            for offset in (1 if k < 2 else -1, cols if k % 2 == 0 else -cols):
                j = np.uint64(corner + inner[k] + offset)
                if parents[j] < 0 and field[j] > 0:  # the goal, in this very block
                    to_goal += mine * (field[j] * inverse) if conditioned else 1.0
            if conditioned:
                inflow = (field[i - one] + field[i + one] + field[i - stride] + field[i + stride]) * inverse
                lost += mine * (degree * mine - inflow)
            else:
                free = 0
                for offset in (-1, 1, -cols, cols):
                    j = np.uint64(corner + inner[k] + offset)
                    free += parents[j] >= 0 or field[j] > 0
                lost += max(0.0, degree - free) * loss_scale
        if conditioned:
            to_goal *= GOAL_CONDUCTANCE
            lost = max(lost, -LARGEST_GAIN * (total + to_goal))
        total += to_goal + lost
        if total == 0.0:  # cannot be reached unless the walk got lost by underflow
            total = 1.0
        share_of = 1.0 / total
        for a in range(begin, end):
            probability[a] *= share_of
        goal[node] = to_goal * share_of
        loss[node] = lost * share_of
        log_weight[node] = np.log2(total) + 2.0 * np.log2(scale)
        for k in range(4):
            i = np.uint64(corner + inner[k])
            if parents[i] == node:
                shares[i] *= share_of


@njit(cache=True)
def _weigh_first_serial(cells, level, conditioned, loss_scale, stale):
    _weigh_first(0, len(level.blocks), cells, level, conditioned, loss_scale, stale)


@njit(cache=True, parallel=True)
def _weigh_first_parallel(cells, level, conditioned, loss_scale, stale):
    n = len(level.blocks)
    for k in prange(CHUNKS):
        _weigh_first(n * k // CHUNKS, n * (k + 1) // CHUNKS, cells, level, conditioned, loss_scale, stale)


def weigh(fine: Level, coarse: Level, w: Array, conditioned: bool, loss_scale: float, stale: NDArray) -> None:
    """Set the walk of `coarse` at `stale` nodes from that of `fine`, conditioned on w (n,) of `fine` (ones: it is already)."""
    kernel = _weigh_parallel if coarse.size > PARALLEL_SIZE else _weigh_serial
    kernel(w, fine.arrays, coarse.arrays, conditioned, loss_scale, stale)


@njit(cache=True)
def _weigh(begin_node, end_node, w, fine, coarse, conditioned, loss_scale, stale):
    first_child, children, indptr, indices = coarse.first_child, coarse.children, fine.indptr, fine.indices
    share = fine.share
    for node in range(begin_node, end_node):
        if not stale[node]:
            continue
        top = -np.inf
        largest = 0.0
        first, stop = np.uint32(first_child[node]), np.uint32(first_child[node + 1])
        for k in range(first, stop):
            i = np.uint32(children[k])
            top = max(top, fine.log_weight[i])
            largest = max(largest, w[i])
        begin, end = np.uint32(coarse.indptr[node]), np.uint32(coarse.indptr[node + 1])
        for a in range(begin, end):
            coarse.probability[a] = 0.0
        total = 0.0
        to_goal = 0.0
        lost = 0.0
        for k in range(first, stop):
            i = np.uint32(children[k])
            relative = w[i] / largest
            weight = np.exp2(fine.log_weight[i] - top) * relative * relative
            inverse = 1.0 / w[i]
            out = fine.goal[i] * inverse
            to_goal += weight * out
            for a in range(np.uint32(indptr[i]), np.uint32(indptr[i + np.uint32(1)])):
                j = np.uint32(indices[a])
                step = fine.probability[a] * (w[j] * inverse)
                out += step
                other = fine.parent[j]
                if other == node:
                    continue
                step *= 0.5 * weight
                total += step
                for b in range(begin, end):
                    if coarse.indices[b] == other:
                        coarse.probability[b] += step
                        break
            if conditioned:
                lost += weight * (1.0 - out)
                out = max(out, 1.0)
            else:
                lost += weight * fine.loss[i] * loss_scale
                out += fine.loss[i]
            share[i] = weight * out
        if conditioned:
            to_goal *= GOAL_CONDUCTANCE
            lost = max(lost, -LARGEST_GAIN * (total + to_goal))
        total += to_goal + lost
        if total == 0.0:
            total = 1.0
        for a in range(begin, end):
            coarse.probability[a] /= total
        coarse.goal[node] = to_goal / total
        coarse.loss[node] = lost / total
        coarse.log_weight[node] = top + 2.0 * np.log2(largest) + np.log2(total)
        for k in range(first, stop):
            share[np.uint32(children[k])] /= total


@njit(cache=True)
def _weigh_serial(w, fine, coarse, conditioned, loss_scale, stale):
    _weigh(0, len(coarse.blocks), w, fine, coarse, conditioned, loss_scale, stale)


@njit(cache=True, parallel=True)
def _weigh_parallel(w, fine, coarse, conditioned, loss_scale, stale):
    n = len(coarse.blocks)
    for k in prange(CHUNKS):
        _weigh(n * k // CHUNKS, n * (k + 1) // CHUNKS, w, fine, coarse, conditioned, loss_scale, stale)
