"""Block iterations, the paper's future work: explicit decoupled group (EDG) and modified explicit group (MEG).

Both solve small groups of nodes at once instead of one node after the other:

* EDG (Abdullah 1991): the four nodes of a 2 x 2 block fall apart into two diagonal pairs on the half-sweep lattices; one
lattice is iterated, in
  pairs (r, c), (r + 1, c + 1);
* MEG (Othman and Abdullah 2000): 2 x 2 blocks of the quarter-sweep lattice.

Arms cut by walls do not couple the nodes of a group either, so every pattern of couplings has its own inverse.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit

from robocar.core import Array, BudgetExhausted, ParameterError
from robocar.planners.harmonic.laplace.lattice import LaplaceLattice, fill_in, make_lattice
from robocar.planners.harmonic.laplace.problem import LaplaceProblem
from robocar.planners.harmonic.laplace.relaxation import largest_residual
from robocar.planners.harmonic.laplace.solver import Potential
from robocar.planners.harmonic.laplace.sweeps import Sweeps, check_sweep


def block_sweep(
    problem: LaplaceProblem,
    group: Literal["EDG", "MEG"] = "MEG",
    omega: float = 1.0,
    tolerance: float = 1e-15,
    max_iterations: int = 1_000_000,
) -> Sweeps:
    """Solve by blocks, each over-relaxed by `omega` (1: block Gauss-Seidel).

    Raises:
        ParameterError, BudgetExhausted: as `robocar.planners.harmonic.laplace.sweeps.sweep`; an unknown group.
    """
    if group not in ("EDG", "MEG"):
        raise ParameterError(f"group is EDG or MEG, not {group!r}")
    scheme = "half" if group == "EDG" else "quarter"
    check_sweep(problem, scheme, tolerance)
    if not 0.0 < omega < 2.0:
        raise ParameterError(f"over-relaxation converges for omega between 0 and 2 (both excluded), not for {omega}")
    lattice = make_lattice(problem, scheme)
    values, changes = _iterate(lattice, group == "EDG", omega, tolerance, max_iterations)
    field = fill_in(problem, lattice, values)
    residual = largest_residual(field, problem.inverse_degree)
    return Sweeps(Potential(problem, field, None, group, np.array([residual])), len(changes), omega, changes)


def _iterate(lattice: LaplaceLattice, pairs: bool, omega: float, tolerance: float, max_iterations: int) -> tuple[Array, Array]:
    values = (lattice.state == 2).astype(float)
    inverses = pair_inverses() if pairs else ring_inverses()
    iteration = _iterate_pairs if pairs else _iterate_rings
    changes: list[float] = []
    while len(changes) < max_iterations:
        changes.append(iteration(values, lattice.state, lattice.arms, inverses, omega))
        if changes[-1] <= tolerance:
            return values, np.array(changes)
    raise BudgetExhausted(f"the largest change is {changes[-1]:.1e} after {max_iterations} iterations, not yet {tolerance}")


def pair_inverses() -> Array:
    """Inverses of [[4, -c], [-c, 4]] for the coupling c = 0, 1, (2, 2, 2)."""
    return np.stack([np.linalg.inv(np.array([[4.0, -c], [-c, 4.0]])) for c in (0, 1)])


def ring_inverses() -> Array:
    """Inverses of the 2 x 2 blocks' matrices for each of the 16 patterns of couplings, (16, 4, 4).

    Nodes are top left, top right, bottom left, bottom right; bits 0 to 3 of the pattern couple top, bottom, left, right.
    """
    inverses = np.empty((16, 4, 4))
    for pattern in range(16):
        matrix = 4.0 * np.eye(4)
        for bit, (i, j) in enumerate(((0, 1), (2, 3), (0, 2), (1, 3))):
            if pattern >> bit & 1:
                matrix[i, j] = matrix[j, i] = -1.0
        inverses[pattern] = np.linalg.inv(matrix)
    return inverses


@njit(cache=True)
def _iterate_pairs(u, state, arms, inverses, omega):
    """Pairs of nodes (r, c), (r + 1, c + 1) with r odd, row by row."""
    largest = 0.0
    rows, cols = state.shape
    for r in range(1, rows - 1, 2):
        for c in range(cols - 1):
            upper, lower = state[r, c] == 1, r + 1 < rows - 1 and state[r + 1, c + 1] == 1
            if not (upper or lower):
                continue
            together = upper and lower and arms[r, c] >> 3 & 1
            s0 = _rotated_sum(u, arms, r, c) - (u[r + 1, c + 1] if together else 0.0) if upper else 0.0
            s1 = _rotated_sum(u, arms, r + 1, c + 1) - (u[r, c] if together else 0.0) if lower else 0.0
            m = inverses[1 if together else 0]
            if upper:
                largest = max(largest, _relax(u, r, c, m[0, 0] * s0 + m[0, 1] * s1, omega))
            if lower:
                largest = max(largest, _relax(u, r + 1, c + 1, m[1, 0] * s0 + m[1, 1] * s1, omega))
    return largest


@njit(cache=True)
def _iterate_rings(u, state, arms, inverses, omega):
    """2 x 2 blocks of nodes, row by row."""
    largest = 0.0
    rows, cols = state.shape
    s = np.empty(4)
    for r in range(1, rows - 1, 2):
        for c in range(1, cols - 1, 2):
            pattern = 0
            if state[r, c] == 1 and state[r, c + 1] == 1 and arms[r, c] >> 3 & 1:
                pattern |= 1
            if state[r + 1, c] == 1 and state[r + 1, c + 1] == 1 and arms[r + 1, c] >> 3 & 1:
                pattern |= 2
            if state[r, c] == 1 and state[r + 1, c] == 1 and arms[r, c] >> 1 & 1:
                pattern |= 4
            if state[r, c + 1] == 1 and state[r + 1, c + 1] == 1 and arms[r, c + 1] >> 1 & 1:
                pattern |= 8
            for k in range(4):
                i, j = r + k // 2, c + k % 2
                s[k] = 0.0
                if state[i, j] == 1:
                    for arm in range(4):
                        if arms[i, j] >> arm & 1:
                            s[k] += u[i + (arm == 1) - (arm == 0), j + (arm == 3) - (arm == 2)]
            if pattern & 1:
                s[0] -= u[r, c + 1]
                s[1] -= u[r, c]
            if pattern & 2:
                s[2] -= u[r + 1, c + 1]
                s[3] -= u[r + 1, c]
            if pattern & 4:
                s[0] -= u[r + 1, c]
                s[2] -= u[r, c]
            if pattern & 8:
                s[1] -= u[r + 1, c + 1]
                s[3] -= u[r, c + 1]
            m = inverses[pattern]
            for k in range(4):
                i, j = r + k // 2, c + k % 2
                if state[i, j] == 1:
                    value = m[k, 0] * s[0] + m[k, 1] * s[1] + m[k, 2] * s[2] + m[k, 3] * s[3]
                    largest = max(largest, _relax(u, i, j, value, omega))
    return largest


@njit(cache=True)
def _rotated_sum(u, arms, r, c):
    total = 0.0
    for k in range(4):
        if arms[r, c] >> k & 1:
            total += u[r + (-1 if k < 2 else 1), c + (-1 if k % 2 == 0 else 1)]
    return total


@njit(cache=True)
def _relax(u, r, c, value, omega):
    new = omega * value + (1.0 - omega) * u[r, c]
    change = abs(new - u[r, c])
    u[r, c] = new
    return change
