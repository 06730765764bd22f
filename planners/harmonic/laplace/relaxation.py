"""Gauss-Seidel sweeps, residuals and transfers of the multigrid solver, on nodes and on cells.

Red-black order: an update reads the other colour only, so threads change no result. Indices in the kernels that matter are
unsigned: compiled code then does without the check for negative ones, which costs more than the arithmetic.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.harmonic.laplace.levels import Level
from robocar.planners.harmonic.laplace.weights import CHUNKS, PARALLEL_SIZE

# ---------------------------------------------------------------- on nodes


def sweep(level: Level, e: Array, right: Array, sweeps: int) -> None:
    """Red-black Gauss-Seidel for e = P e + right, in place."""
    kernel = _sweep_parallel if level.size > PARALLEL_SIZE else _sweep_serial
    kernel(level.n_red, level.indptr, level.indices, level.probability, e, right, sweeps)


def linear_residual(level: Level, e: Array, right: Array) -> Array:
    """right + P e - e after a sweep: the black nodes were last and have none."""
    kernel = _residual_parallel if level.size > PARALLEL_SIZE else _residual_serial
    return kernel(level.n_red, level.indptr, level.indices, level.probability, e, right)


def restrict(fine: Level, coarse: Level, residual: Array) -> Array:
    """The balance of each node of `coarse`, (n,)."""
    kernel = _restrict_parallel if coarse.size > PARALLEL_SIZE else _restrict_serial
    return kernel(coarse.first_child, coarse.children, fine.share, residual)


@njit(cache=True, inline="always")
def _inflow(begin, end, indices, probability, e):
    """Sum of probability * e over the links begin:end of a node, mostly four."""
    if end == begin + np.uint32(4):
        return (
            probability[begin] * e[np.uint32(indices[begin])]
            + probability[begin + np.uint32(1)] * e[np.uint32(indices[begin + np.uint32(1)])]
        ) + (
            probability[begin + np.uint32(2)] * e[np.uint32(indices[begin + np.uint32(2)])]
            + probability[begin + np.uint32(3)] * e[np.uint32(indices[begin + np.uint32(3)])]
        )
    total = 0.0
    for a in range(begin, end):
        total += probability[a] * e[np.uint32(indices[a])]
    return total


@njit(cache=True)
def _update(begin, end, indptr, indices, probability, e, right):
    a = np.uint32(indptr[begin])
    for i in range(begin, end):
        stop = np.uint32(indptr[i + 1])
        e[i] = right[i] + _inflow(a, stop, indices, probability, e)
        a = stop


@njit(cache=True)
def _sweep_serial(n_red, indptr, indices, probability, e, right, sweeps):
    for _ in range(sweeps):
        _update(0, n_red, indptr, indices, probability, e, right)
        _update(n_red, len(e), indptr, indices, probability, e, right)


@njit(cache=True, parallel=True)
def _sweep_parallel(n_red, indptr, indices, probability, e, right, sweeps):
    n_black = len(e) - n_red
    for _ in range(sweeps):
        for k in prange(CHUNKS):
            _update(n_red * k // CHUNKS, n_red * (k + 1) // CHUNKS, indptr, indices, probability, e, right)
        for k in prange(CHUNKS):
            begin, end = n_red + n_black * k // CHUNKS, n_red + n_black * (k + 1) // CHUNKS
            _update(begin, end, indptr, indices, probability, e, right)


@njit(cache=True)
def _residual_range(begin, end, indptr, indices, probability, e, right, out):
    a = np.uint32(indptr[begin])
    for i in range(begin, end):
        stop = np.uint32(indptr[i + 1])
        out[i] = right[i] - e[i] + _inflow(a, stop, indices, probability, e)
        a = stop


@njit(cache=True)
def _residual_serial(n_red, indptr, indices, probability, e, right):
    out = np.zeros(len(e))
    _residual_range(0, n_red, indptr, indices, probability, e, right, out)
    return out


@njit(cache=True, parallel=True)
def _residual_parallel(n_red, indptr, indices, probability, e, right):
    out = np.zeros(len(e))
    for k in prange(CHUNKS):
        _residual_range(n_red * k // CHUNKS, n_red * (k + 1) // CHUNKS, indptr, indices, probability, e, right, out)
    return out


@njit(cache=True)
def _restrict_range(begin, end, first_child, children, share, residual, out):
    for node in range(begin, end):
        total = 0.0
        for k in range(np.uint32(first_child[node]), np.uint32(first_child[node + 1])):
            child = np.uint32(children[k])
            total += share[child] * residual[child]
        out[node] = total


@njit(cache=True)
def _restrict_serial(first_child, children, share, residual):
    out = np.empty(len(first_child) - 1)
    _restrict_range(0, len(out), first_child, children, share, residual, out)
    return out


@njit(cache=True, parallel=True)
def _restrict_parallel(first_child, children, share, residual):
    n = len(first_child) - 1
    out = np.empty(n)
    for k in prange(CHUNKS):
        _restrict_range(n * k // CHUNKS, n * (k + 1) // CHUNKS, first_child, children, share, residual, out)
    return out


@njit(cache=True)
def prolong(e, coarse, parent):
    """Add the coarse correction, in place."""
    for i in range(len(e)):
        e[i] += coarse[parent[i]]


def relative_residual(level: Level, w: Array) -> Array:
    """(P w + goal - w) / w, (n,)"""
    return _relative_residual(level.indptr, level.indices, level.probability, level.goal, w)


@njit(cache=True)
def _relative_residual(indptr, indices, probability, goal, w):
    out = np.empty(len(w))
    for i in range(len(w)):
        inflow = _inflow(np.uint32(indptr[i]), np.uint32(indptr[i + 1]), indices, probability, w)
        out[i] = (goal[i] + inflow) / w[i] - 1.0
    return out


@njit(cache=True)
def _factor(e):
    """1 + e where that is a sound step, and positive whatever e is."""
    return 1.0 + e if e >= -0.95 else 0.0025 / (-0.9 - e)


@njit(cache=True)
def multiply(w, coarse, parent):
    """Correct w on nodes by the relative error of their parents, in place."""
    for i in range(len(w)):
        w[i] *= _factor(coarse[parent[i]])


# ---------------------------------------------------------------- on cells of the padded grid


@njit(cache=True)
def spread(w, parent, nodes):
    """Give each unknown cell its node's value, in place."""
    for r in range(1, w.shape[0] - 1):
        for c in range(1, w.shape[1] - 1):
            if parent[r, c] >= 0:
                w[r, c] = nodes[parent[r, c]]


def correct_cells(w: Array, parent: NDArray, e: Array) -> None:
    """Correct w by the relative error of its nodes, in place."""
    (_correct_parallel if w.size > 4 * PARALLEL_SIZE else _correct_serial)(w, parent, e)


def smooth(w: Array, inverse_degree: Array, sweeps: int) -> None:
    """Red-black Gauss-Seidel, in place."""
    (_smooth_parallel if w.size > 4 * PARALLEL_SIZE else _smooth_serial)(w, inverse_degree, sweeps)


def gather_residual(w: Array, inverse_degree: Array, parent: NDArray, share: NDArray, blocks: NDArray) -> tuple[Array, float]:
    """Relative residuals after a sweep, gathered on level 1, (n,), and the largest of any cell (inf where w is not positive)."""
    kernel = _gather_parallel if len(blocks) > PARALLEL_SIZE else _gather_serial
    right, worst = kernel(w, inverse_degree, parent, share, blocks)
    return right, float(worst.max())


@njit(cache=True)
def _correct_rows(begin, end, w, parent, e):
    for r in range(begin, end):
        for c in range(1, w.shape[1] - 1):
            if parent[r, c] >= 0:
                w[r, c] *= _factor(e[parent[r, c]])


@njit(cache=True)
def _correct_serial(w, parent, e):
    _correct_rows(1, w.shape[0] - 1, w, parent, e)


@njit(cache=True, parallel=True)
def _correct_parallel(w, parent, e):
    for r in prange(1, w.shape[0] - 1):
        _correct_rows(r, r + 1, w, parent, e)


@njit(cache=True)
def _smooth_rows(begin, end, color, w, inverse_degree):
    for r in range(begin, end):
        for c in range(1 + (r + 1 + color) % 2, w.shape[1] - 1, 2):
            if inverse_degree[r, c] > 0:
                w[r, c] = inverse_degree[r, c] * (w[r - 1, c] + w[r + 1, c] + w[r, c - 1] + w[r, c + 1])


@njit(cache=True)
def _smooth_serial(w, inverse_degree, sweeps):
    for s in range(2 * sweeps):
        _smooth_rows(1, w.shape[0] - 1, s % 2, w, inverse_degree)


@njit(cache=True, parallel=True)
def _smooth_parallel(w, inverse_degree, sweeps):
    for s in range(2 * sweeps):
        for r in prange(1, w.shape[0] - 1):
            _smooth_rows(r, r + 1, s % 2, w, inverse_degree)


@njit(cache=True)
def _gather_range(begin, end, w, inverse_degree, parent, share, blocks, out):
    """Red cells only: black ones are swept last and have no residual."""
    cols = np.uint64(w.shape[1])
    one = np.uint64(1)
    values, degrees, parents, shares = w.ravel(), inverse_degree.ravel(), parent.ravel(), share.ravel()
    worst = 0.0
    for node in range(begin, end):
        corner = (np.uint64(2 * blocks[node, 0] + 1)) * cols + np.uint64(2 * blocks[node, 1] + 1)
        total = 0.0
        for i in (corner, corner + cols + one):
            if parents[i] == node:
                if not (values[i] > 0.0 and values[i] < np.inf):
                    worst = np.inf
                    continue
                mean = degrees[i] * (values[i - cols] + values[i + cols] + values[i - one] + values[i + one])
                relative = (mean - values[i]) / values[i]
                total += shares[i] * relative
                worst = max(worst, abs(relative))
        out[node] = total
    return worst


@njit(cache=True)
def _gather_serial(w, inverse_degree, parent, share, blocks):
    out = np.empty(len(blocks))
    worst = np.empty(1)
    worst[0] = _gather_range(0, len(blocks), w, inverse_degree, parent, share, blocks, out)
    return out, worst


@njit(cache=True, parallel=True)
def _gather_parallel(w, inverse_degree, parent, share, blocks):
    n = len(blocks)
    out = np.empty(n)
    worst = np.empty(CHUNKS)
    for k in prange(CHUNKS):
        begin, end = n * k // CHUNKS, n * (k + 1) // CHUNKS
        worst[k] = _gather_range(begin, end, w, inverse_degree, parent, share, blocks, out)
    return out, worst


@njit(cache=True)
def largest_residual(w, inverse_degree):
    """Largest |mean of the neighbours - w| / w over all unknown cells of the padded field; inf where w is not positive."""
    largest = 0.0
    for r in range(1, w.shape[0] - 1):
        for c in range(1, w.shape[1] - 1):
            if inverse_degree[r, c] > 0:
                if not w[r, c] > 0.0:
                    return np.inf
                mean = inverse_degree[r, c] * (w[r - 1, c] + w[r + 1, c] + w[r, c - 1] + w[r, c + 1])
                largest = max(largest, abs(mean - w[r, c]) / w[r, c])
    return largest


@njit(cache=True)
def smallest(w, inverse_degree):
    """Smallest w of any unknown cell; nan or less than 0 count as 0."""
    low = 1.0
    for r in range(w.shape[0]):
        for c in range(w.shape[1]):
            if inverse_degree[r, c] > 0:
                if not w[r, c] > 0.0:
                    return 0.0
                low = min(low, w[r, c])
    return low
