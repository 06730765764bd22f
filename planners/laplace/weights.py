"""Weights of the coarse levels: a walk conditioned on reaching the goal, gathered over the nodes of the finer level."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from planners.laplace.levels import Level, outside
from robocar.core import Array

PARALLEL_SIZE = 300_000
"""Loops over fewer nodes than this run on one thread: on a busy machine, waiting for the others costs more than they save."""

CHUNKS = 32
"""Pieces of a parallel loop. Pieces write to places of their own, so their order and number change no result."""


def weigh_first(
    w: Array, inverse_degree: Array, parent: NDArray, level: Level, share: NDArray, conditioned: bool, loss_scale: float
) -> None:
    """Set the walk of level 1: conditioned on w (loss 0), or with w = 1 the plain one that walls absorb."""
    kernel = _weigh_first_parallel if level.size > PARALLEL_SIZE else _weigh_first_serial
    kernel(
        w, inverse_degree, parent, level.blocks, level.indptr, level.indices, level.probability, level.goal, level.loss,
        level.log_weight, share, conditioned, loss_scale,
    )  # fmt: skip


@njit(cache=True)
def _weigh_first(
    begin_node,
    end_node,
    w,
    inverse_degree,
    parent,
    blocks,
    indptr,
    indices,
    probability,
    goal,
    loss,
    log_weight,
    share,
    conditioned,
    loss_scale,
):
    for node in range(begin_node, end_node):
        r, c = 2 * blocks[node, 0] + 1, 2 * blocks[node, 1] + 1
        scale = 0.0
        for k in range(4):
            r1, c1 = r + k // 2, c + k % 2
            if parent[r1, c1] == node:
                scale = max(scale, w[r1, c1] if conditioned else 1.0)
        begin, end = indptr[node], indptr[node + 1]
        for a in range(begin, end):
            probability[a] = 0.0
        to_goal = 0.0
        to_wall = 0.0
        total = 0.0
        at = begin - 1
        previous = np.int32(-1)
        for k in range(8):
            r1, c1, r2, c2 = outside(k)
            r1, c1, r2, c2 = r + r1, c + c1, r + r2, c + c2
            if parent[r1, c1] == node:
                other = parent[r2, c2]
                mine = w[r1, c1] / scale if conditioned else 1.0
                theirs = w[r2, c2] / scale if conditioned else 1.0
                if other >= 0:
                    if other != previous or k % 2 == 0:
                        at += 1
                    probability[at] += 0.5 * mine * theirs
                    total += 0.5 * mine * theirs
                previous = other
            else:
                previous = np.int32(-1)
        for k in range(4):
            r1, c1 = r + k // 2, c + k % 2
            if parent[r1, c1] != node:
                continue
            degree = 1.0 / inverse_degree[r1, c1]
            mine = w[r1, c1] / scale if conditioned else 1.0
            free = 0
            for m in range(4):
                r2, c2 = r1 + (m == 0) - (m == 1), c1 + (m == 2) - (m == 3)
                if parent[r2, c2] >= 0:
                    free += 1
                elif w[r2, c2] > 0:  # no unknown and yet not 0: the goal
                    free += 1
                    to_goal += mine * (w[r2, c2] / scale if conditioned else 1.0)
            if not conditioned:
                to_wall += max(0.0, degree - free) * loss_scale
            share[r1, c1] = degree * mine * mine
        total += to_goal + to_wall
        if total == 0.0:  # cannot be reached unless the walk got lost by underflow
            total = 1.0
        for a in range(begin, end):
            probability[a] /= total
        goal[node] = to_goal / total
        loss[node] = to_wall / total
        log_weight[node] = np.log2(total) + 2.0 * np.log2(scale)
        for k in range(4):
            r1, c1 = r + k // 2, c + k % 2
            if parent[r1, c1] == node:
                share[r1, c1] /= total


@njit(cache=True)
def _weigh_first_serial(
    w, inverse_degree, parent, blocks, indptr, indices, probability, goal, loss, log_weight, share, conditioned, loss_scale
):
    _weigh_first(
        0,
        len(blocks),
        w,
        inverse_degree,
        parent,
        blocks,
        indptr,
        indices,
        probability,
        goal,
        loss,
        log_weight,
        share,
        conditioned,
        loss_scale,
    )


@njit(cache=True, parallel=True)
def _weigh_first_parallel(
    w, inverse_degree, parent, blocks, indptr, indices, probability, goal, loss, log_weight, share, conditioned, loss_scale
):
    n = len(blocks)
    for k in prange(CHUNKS):
        _weigh_first(
            n * k // CHUNKS, n * (k + 1) // CHUNKS,
            w, inverse_degree, parent, blocks, indptr, indices, probability, goal, loss, log_weight, share, conditioned,
            loss_scale,
        )  # fmt: skip


def weigh(fine: Level, coarse: Level, w: Array, conditioned: bool, loss_scale: float) -> None:
    """Set the walk of `coarse` from that of `fine`, conditioned on w (n,) of `fine` (ones where it is conditioned already)."""
    kernel = _weigh_parallel if coarse.size > PARALLEL_SIZE else _weigh_serial
    kernel(
        w, fine.parent, fine.indptr, fine.indices, fine.probability, fine.goal, fine.loss, fine.log_weight, fine.share,
        coarse.first_child, coarse.children, coarse.indptr, coarse.indices, coarse.probability, coarse.goal, coarse.loss,
        coarse.log_weight, conditioned, loss_scale,
    )  # fmt: skip


@njit(cache=True)
def _weigh(
    begin_node, end_node, w, parent, indptr, indices, probability, goal, loss, log_weight, share,
    first_child, children, coarse_indptr, coarse_indices, coarse_probability, coarse_goal, coarse_loss, coarse_log_weight,
    conditioned, loss_scale,
):  # fmt: skip
    for node in range(begin_node, end_node):
        top = -np.inf
        for k in range(first_child[node], first_child[node + 1]):
            i = children[k]
            top = max(top, log_weight[i] + 2.0 * np.log2(w[i]))
        begin, end = coarse_indptr[node], coarse_indptr[node + 1]
        for a in range(begin, end):
            coarse_probability[a] = 0.0
        total = 0.0
        to_goal = 0.0
        to_wall = 0.0
        for k in range(first_child[node], first_child[node + 1]):
            i = children[k]
            weight = np.exp2(log_weight[i] + 2.0 * np.log2(w[i]) - top)
            out = goal[i] / w[i]
            to_goal += weight * goal[i] / w[i]
            for a in range(indptr[i], indptr[i + 1]):
                j = indices[a]
                step = probability[a] * (w[j] / w[i])
                out += step
                if parent[j] == node:
                    continue
                total += 0.5 * weight * step
                for b in range(begin, end):
                    if coarse_indices[b] == parent[j]:
                        coarse_probability[b] += 0.5 * weight * step
                        break
            if not conditioned:
                to_wall += weight * loss[i] * loss_scale
                out += loss[i]
            share[i] = weight * out
        total += to_goal + to_wall
        if total == 0.0:
            total = 1.0
        for a in range(begin, end):
            coarse_probability[a] /= total
        coarse_goal[node] = to_goal / total
        coarse_loss[node] = to_wall / total
        coarse_log_weight[node] = top + np.log2(total)
        for k in range(first_child[node], first_child[node + 1]):
            share[children[k]] /= total


@njit(cache=True)
def _weigh_serial(
    w, parent, indptr, indices, probability, goal, loss, log_weight, share,
    first_child, children, coarse_indptr, coarse_indices, coarse_probability, coarse_goal, coarse_loss, coarse_log_weight,
    conditioned, loss_scale,
):  # fmt: skip
    _weigh(
        0, len(first_child) - 1, w, parent, indptr, indices, probability, goal, loss, log_weight, share,
        first_child, children, coarse_indptr, coarse_indices, coarse_probability, coarse_goal, coarse_loss, coarse_log_weight,
        conditioned, loss_scale,
    )  # fmt: skip


@njit(cache=True, parallel=True)
def _weigh_parallel(
    w, parent, indptr, indices, probability, goal, loss, log_weight, share,
    first_child, children, coarse_indptr, coarse_indices, coarse_probability, coarse_goal, coarse_loss, coarse_log_weight,
    conditioned, loss_scale,
):  # fmt: skip
    n = len(first_child) - 1
    for k in prange(CHUNKS):
        _weigh(
            n * k // CHUNKS, n * (k + 1) // CHUNKS, w, parent, indptr, indices, probability, goal, loss, log_weight, share,
            first_child, children, coarse_indptr, coarse_indices, coarse_probability, coarse_goal, coarse_loss, coarse_log_weight,
            conditioned, loss_scale,
        )  # fmt: skip
