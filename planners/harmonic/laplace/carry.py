"""Weights taken over from the levels of a map that has changed a little.

Nodes are numbered by where they lie, so those that stay keep their order, and what lies between two changes moves as one piece.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.planners.harmonic.laplace.multigrid import Multigrid


def carry(old: Multigrid, new: Multigrid) -> list[NDArray[np.uint8]]:
    """Copy the weights of `old` to the nodes of `new` that are the same and have the same neighbours; `old` is left as it is.

    Args:
        old: weighed, of a map of the same shape with the same goals.
        new: its weights are set where they can be taken over, and undefined elsewhere.

    Returns:
        The nodes of each level that are still to be weighed, (n,) uint8. Parents of such nodes are among them.
    """
    inverse_degree = new.problem.inverse_degree
    changed = np.flatnonzero(inverse_degree != old.problem.inverse_degree)  # much faster than nonzero in two dimensions
    np.copyto(new.share, old.share)
    new.share.ravel()[changed] = 0.0
    row, col = np.divmod(changed, inverse_degree.shape[1])
    rows, cols = new.problem.shape
    blocks = np.zeros(((rows + 1) // 2, (cols + 1) // 2), np.uint8)
    blocks[(row - 1) // 2, (col - 1) // 2] = 1
    below, stale = np.empty(0, np.int32), np.empty(0, np.uint8)
    found = []
    for k, level in enumerate(new.levels):
        if k < len(old.levels):
            stale = _carry(blocks, below, stale, level.arrays, old.levels[k].arrays)
            below = level.parent
            blocks = _coarser_blocks(blocks)
        else:
            stale = np.ones(level.size, np.uint8)
        found.append(stale)
    return found


@njit(cache=True)
def _coarser_blocks(changed):
    """2 x 2 blocks of which one has changed."""
    rows, cols = changed.shape
    out = np.zeros(((rows + 1) // 2, (cols + 1) // 2), np.uint8)
    for r in range(rows):
        for c in range(cols):
            out[r // 2, c // 2] |= changed[r, c]
    return out


@njit(cache=True)
def _in_changed_blocks(changed, blocks, indptr, indices):
    """1 at nodes of changed blocks, 2 at neighbours of these, 0 elsewhere, (n,) uint8."""
    n = len(blocks)
    out = np.empty(n, np.uint8)
    for i in range(n):
        out[i] = changed[np.uint32(blocks[i, 0]), np.uint32(blocks[i, 1])]
    for i in range(n):
        if out[i] == 1:
            for a in range(indptr[i], indptr[i + 1]):
                if out[indices[a]] == 0:
                    out[indices[a]] = 2
    return out


@njit(cache=True)
def _carry(changed, below, stale_below, new, old):
    """`carry` on one level.

    Args:
        changed: its blocks that have, (rows, cols) uint8.
        below, stale_below: nodes of the finer level: their parents here, (m,), and whether they are still to be weighed.
        new, old: `LevelArrays`.
    """
    n, old_n = len(new.blocks), len(old.blocks)
    indptr, old_indptr = new.indptr, old.indptr
    state = _in_changed_blocks(changed, new.blocks, indptr, new.indices)
    old_state = _in_changed_blocks(changed, old.blocks, old_indptr, old.indices)
    for i in range(len(below)):
        if stale_below[i] and state[below[i]] == 0:
            state[below[i]] = 2
    with_share = len(new.share) == n and len(old.share) == old_n  # the last level has none
    i, j = 0, 0
    while i < n:
        if state[i] == 1:
            i += 1
            continue
        while old_state[j] == 1:
            j += 1
        # j is what i was: nodes of unchanged blocks are the same ones in the same order
        begin, shift = i, j - i
        while i < n and state[i] == 0 and old_state[i + shift] == 0:
            i += 1
        j = i + shift
        if i > begin:
            new.goal[begin:i] = old.goal[begin + shift : j]
            new.loss[begin:i] = old.loss[begin + shift : j]
            new.log_weight[begin:i] = old.log_weight[begin + shift : j]
            new.probability[indptr[begin] : indptr[i]] = old.probability[old_indptr[begin + shift] : old_indptr[j]]
            if with_share:
                new.share[begin:i] = old.share[begin + shift : j]
        elif i < n:
            state[i] = 2
            i += 1
            j += 1
    return (state > 0).astype(np.uint8)
