"""What the tests of the solver share: problems, and their solutions by rational arithmetic and by scipy's sparse LU."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from hypothesis import strategies as st

from robocar.planners.harmonic.laplace import LaplaceProblem


def exact(problem: LaplaceProblem) -> np.ndarray:
    """w of every unknown by Gaussian elimination in rational numbers, (rows, cols) of Fraction (dtype object)."""
    cells = [tuple(c) for c in np.argwhere(problem.unknowns)]
    number = {c: k for k, c in enumerate(cells)}
    goals = {tuple(g) for g in problem.goals}
    rows = []
    for r, c in cells:
        row: dict[int, Fraction] = {number[r, c]: Fraction(round(2**20 / float(problem.inverse_degree[r + 1, c + 1])), 2**20)}
        right = Fraction(0)
        for n in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            if n in number:
                row[number[n]] = Fraction(-1)
            right += n in goals
        rows.append((row, right))
    for k in range(len(rows)):
        pivot_row, pivot_right = rows[k]
        for i in range(k + 1, len(rows)):
            row, right = rows[i]
            if k in row:
                factor = row.pop(k) / pivot_row[k]
                for j, value in pivot_row.items():
                    if j > k:
                        row[j] = row.get(j, Fraction(0)) - factor * value
                rows[i] = (row, right - factor * pivot_right)
    w = np.zeros(problem.shape, dtype=object)
    solution: list[Fraction] = [Fraction(0)] * len(rows)
    for k in range(len(rows) - 1, -1, -1):
        row, right = rows[k]
        solution[k] = (right - sum(value * solution[j] for j, value in row.items() if j > k)) / row[k]
        w[cells[k]] = solution[k]
    return w


def sparse_lu(problem: LaplaceProblem) -> np.ndarray:
    """w by scipy's direct solver, (rows, cols)."""
    cells = np.argwhere(problem.unknowns)
    number = np.full(problem.inverse_degree.shape, -1)
    number[tuple((cells + 1).T)] = np.arange(len(cells))
    start = problem.start_field()
    entries = []
    right = np.zeros(len(cells))
    for dr, dc in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = number[cells[:, 0] + 1 + dr, cells[:, 1] + 1 + dc]
        entries += [(i, j, -1.0) for i, j in enumerate(beside) if j >= 0]
        right += start[cells[:, 0] + 1 + dr, cells[:, 1] + 1 + dc]
    degrees = 1.0 / problem.inverse_degree[tuple((cells + 1).T)]
    i, j, values = zip(*entries, *((k, k, d) for k, d in enumerate(degrees)), strict=True)
    w = np.zeros(problem.shape)
    w[tuple(cells.T)] = sla.splu(sp.csc_array((values, (i, j)), shape=(len(cells),) * 2)).solve(right)
    return w


def relative_error(potential, reference: np.ndarray) -> float:
    inside = potential.problem.unknowns
    return float(np.abs(potential.w[inside] / reference[inside] - 1.0).max())


def two_rooms(n: int) -> tuple[np.ndarray, tuple[int, int]]:
    blocked = np.zeros((n, n), dtype=bool)
    blocked[:, n // 2] = True
    blocked[n // 5 : n // 5 + n // 10, n // 2] = False
    blocked[n // 2, n // 2 + n // 8 :] = True
    blocked[n // 4 : n // 3, n // 4 : n // 3] = True
    return blocked, (n - n // 8, n // 8)


random_problem = st.builds(
    lambda seed, rows, cols, share: (np.random.default_rng(seed).random((rows, cols)) < share, seed),
    st.integers(0, 2**32 - 1),
    st.integers(1, 7),
    st.integers(2, 7),
    st.sampled_from([0.0, 0.2, 0.4]),
)
