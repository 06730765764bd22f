"""Direct solution of e = P e + r by censoring a random walk, without a single subtraction.

Eliminating a state means to watch the walk only while it is elsewhere: a step into the state becomes the step that leaves it
at last. All numbers are probabilities; the pivot 1 - p_ii is the sum of the ways out (Grassmann, Taksar and Heyman 1985) and
not a difference. The result is therefore accurate in every component *relatively*, however small it is (O'Cinneide 1993),
which no norm-wise stable method promises.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array


@dataclass(frozen=True, slots=True, eq=False)
class Elimination:
    """Factors of I - P in elimination order: state k keeps its ways out `up` to, and its ways in `low` from, later states.

    Args:
        order: state eliminated at each step, (n,).
        start: row k's entries are start[k]:start[k + 1], (n + 1,).
        later: steps of the later states, (nnz,).
        up, low: probabilities k -> later, later -> k, (nnz,).
        pivot: probability to leave k for good, (n,).
        goal: probability that the censored walk steps from k to the goal, (n,).
    """

    order: NDArray[np.int32]
    start: NDArray[np.int64]
    later: NDArray[np.int32]
    up: Array
    low: Array
    pivot: Array
    goal: Array

    def solve(self, right: Array) -> Array:
        """e = P e + right, (n,)."""
        return _solve(self.order, self.start, self.later, self.up, self.low, self.pivot, right)

    def hitting(self) -> tuple[Array, NDArray[np.int64]]:
        """Probability to reach the goal from each state: mantissas in [0.5, 1) and binary exponents, (n,); 0, 0 without a way."""
        return _hitting(self.order, self.start, self.later, self.up, self.pivot, self.goal)


def eliminate(
    indptr: NDArray,
    indices: NDArray,
    probability: Array,
    goal: Array,
    loss: Array,
    order: NDArray[np.int32],
    max_fill: int = 2**40,
) -> Elimination | None:
    """Factor a walk on a symmetric graph.

    Args:
        indptr, indices, probability: steps between states in CSR form; the pattern is symmetric, without diagonal.
        goal, loss: probability to step to the goal, and to die, in each state, (n,). Each row sums to 1 with them.
        order: elimination order, (n,).
        max_fill: entries that the factors may have; None is returned where they would have more.
    """
    order = order.astype(np.int32)
    start, later, up, low, pivot, to_goal = _factor(indptr, indices, probability, goal, loss, order, max_fill)
    if len(start) == 0:
        return None
    return Elimination(order, start, later, up, low, pivot, to_goal)


def dissection_order(rows: NDArray, cols: NDArray) -> NDArray[np.int32]:
    """Nested dissection of states that lie on a grid and step to neighbours only (George 1973).

    The lines whose number is divisible by 2^k separate the squares of side 2^k - 1 between them, so a state comes the later the
    higher the power of two in its row or column.
    """
    row_power = _power_of_two(np.asarray(rows) + 1)
    col_power = _power_of_two(np.asarray(cols) + 1)
    return np.lexsort((cols, rows, row_power >= col_power, np.maximum(row_power, col_power))).astype(np.int32)


def _power_of_two(n: NDArray) -> NDArray:
    return np.log2((n & -n).astype(float)).astype(np.int64)


@njit(cache=True)
def _structure(indptr, indices, order, max_fill):
    """Later neighbours of each step after fill-in, each row sorted (elimination tree)."""
    n = len(order)
    step = np.empty(n, np.int32)
    for k in range(n):
        step[order[k]] = k
    start = np.zeros(n + 1, np.int64)
    later = np.empty(max(16, 4 * n), np.int32)
    mark = np.full(n, -1, np.int32)
    first_child = np.full(n, -1, np.int32)
    sibling = np.full(n, -1, np.int32)
    size = 0
    for k in range(n):
        begin = size
        mark[k] = k
        i = order[k]
        if size + n > len(later):
            later = np.concatenate((later, np.empty(len(later) + n, np.int32)))
        for a in range(indptr[i], indptr[i + 1]):
            j = step[indices[a]]
            if j > k and mark[j] != k:
                mark[j] = k
                later[size] = j
                size += 1
        child = first_child[k]
        while child >= 0:
            for a in range(start[child], start[child + 1]):
                j = later[a]
                if mark[j] != k:
                    mark[j] = k
                    later[size] = j
                    size += 1
            child = sibling[child]
        later[begin:size].sort()
        start[k + 1] = size
        if size > max_fill:
            return np.empty(0, np.int64), later[:0], step
        if size > begin:
            parent = later[begin]
            sibling[k] = first_child[parent]
            first_child[parent] = k
    return start, later[:size].copy(), step


@njit(cache=True)
def _factor(indptr, indices, probability, goal, loss, order, max_fill):
    start, later, step = _structure(indptr, indices, order, max_fill)
    n = len(order) if len(start) > 0 else 0
    up = np.zeros(len(later))
    low = np.zeros(len(later))
    pivot = np.empty(n)
    to_goal = np.empty(n)
    to_loss = np.empty(n)
    work_up = np.zeros(n)
    work_low = np.zeros(n)
    # steps whose next later state is k hang in a list at k; cursor points at that entry
    head = np.full(n, -1, np.int32)
    following = np.full(n, -1, np.int32)
    cursor = start[:n].copy()
    for k in range(n):
        i = order[k]
        to_goal[k] = goal[i]
        to_loss[k] = loss[i]
        for a in range(indptr[i], indptr[i + 1]):
            j = step[indices[a]]
            if j > k:
                work_up[j] = probability[a]
                for b in range(indptr[indices[a]], indptr[indices[a] + 1]):
                    if indices[b] == i:
                        work_low[j] = probability[b]
        m = head[k]
        while m >= 0:
            upcoming = following[m]
            c = cursor[m]
            leave = low[c] / pivot[m]  # k -> m, then out of m for good
            enter = up[c] / pivot[m]
            to_goal[k] += leave * to_goal[m]
            to_loss[k] += leave * to_loss[m]
            for a in range(c + 1, start[m + 1]):
                j = later[a]
                work_up[j] += leave * up[a]
                work_low[j] += enter * low[a]
            cursor[m] = c + 1
            if c + 1 < start[m + 1]:
                following[m] = head[later[c + 1]]
                head[later[c + 1]] = m
            m = upcoming
        total = to_goal[k] + to_loss[k]
        for a in range(start[k], start[k + 1]):
            j = later[a]
            up[a] = work_up[j]
            low[a] = work_low[j]
            work_up[j] = 0.0
            work_low[j] = 0.0
            total += up[a]
        pivot[k] = total
        if start[k] < start[k + 1]:
            following[k] = head[later[start[k]]]
            head[later[start[k]]] = k
    return start, later, up, low, pivot, to_goal


@njit(cache=True)
def _solve(order, start, later, up, low, pivot, right):
    n = len(order)
    e = np.empty(n)
    for k in range(n):
        e[k] = right[order[k]]
    for k in range(n):
        value = e[k] / pivot[k]
        if value != 0.0:
            for a in range(start[k], start[k + 1]):
                e[later[a]] += low[a] * value
    for k in range(n - 1, -1, -1):
        total = e[k]
        for a in range(start[k], start[k + 1]):
            total += up[a] * e[later[a]]
        e[k] = total / pivot[k]
    out = np.empty(n)
    for k in range(n):
        out[order[k]] = e[k]
    return out


@njit(cache=True)
def _hitting(order, start, later, up, pivot, goal):
    n = len(order)
    mantissa = np.zeros(n)
    exponent = np.zeros(n, np.int64)
    m = np.zeros(n)
    x = np.zeros(n, np.int64)
    lowest = np.int64(-(1 << 60))
    for k in range(n - 1, -1, -1):
        top = np.int64(0) if goal[k] > 0 else lowest
        for a in range(start[k], start[k + 1]):
            if up[a] > 0 and m[later[a]] > 0 and x[later[a]] > top:
                top = x[later[a]]
        if top == lowest:
            continue
        total = math.ldexp(goal[k], -int(top)) if top > -1000 else 0.0
        for a in range(start[k], start[k + 1]):
            shift = x[later[a]] - top
            if shift > -1000:
                total += up[a] * math.ldexp(m[later[a]], int(shift))
        value = total / pivot[k]

        f, s = math.frexp(value)
        m[k] = f
        x[k] = top + s
    for k in range(n):
        mantissa[order[k]] = m[k]
        exponent[order[k]] = x[k]
    return mantissa, exponent
