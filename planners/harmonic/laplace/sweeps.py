"""The paper's iterations: full-, half-, quarter- and octo-sweep Jacobi, Gauss-Seidel and SOR (Saudi and Sulaiman, eqs 10 to 15).

Nodes are visited in two colours instead of row by row: the updates of a colour do not depend on each other, so they run on
vectors, and several iterations pass over the rows together. The rate of convergence is the same (consistent ordering; Young
1954).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import eigh_tridiagonal

from robocar.core import Array, BudgetExhausted, ParameterError
from robocar.planners.harmonic.laplace.lattice import STRIDE, LaplaceLattice, Scheme, fill_in, make_lattice
from robocar.planners.harmonic.laplace.problem import LaplaceProblem
from robocar.planners.harmonic.laplace.relaxation import largest_residual
from robocar.planners.harmonic.laplace.solver import Potential

REACHABLE = 1e-15
"""Smallest threshold on the change in an iteration, the paper's; over-relaxation needs more, see `reachable`."""

STALLED = 2000
"""Iterations without a smaller change than ever before, at the level of rounding, after which none is to be expected."""

UNWATCHED = 19
"""Iterations between two looks at the largest change."""

Iteration = Literal["jacobi", "gauss-seidel", "sor"]


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """What an iteration found.

    Args:
        potential: on all cells, its `residuals` the largest relative one of any cell.
        iterations: k of the paper's table 1.
        omega: the weight that was used.
        changes: largest change of any node in each iteration, nan where it was not looked at, (iterations,).
    """

    potential: Potential
    iterations: int
    omega: float
    changes: Array


def sweep(
    problem: LaplaceProblem,
    scheme: Scheme = "quarter",
    iteration: Iteration = "sor",
    omega: float | None = None,
    tolerance: float | None = None,
    max_iterations: int = 1_000_000,
) -> Sweeps:
    """Solve by the paper's algorithms 1 to 3, in the formulation w = 1 - u.

    Args:
        scheme: which nodes iterate; the others follow directly.
        omega: weight of SOR in (0, 2), by default the best one (`best_omega`).
        tolerance: stop when no node changes by more (eq. 18, maximum norm), absolutely as in the paper; by default its 1e-15, or
            what doubles reach with this omega.

    Raises:
        ParameterError: omega outside (0, 2) or with an iteration that has none, a tolerance that doubles cannot reach, a
            problem with walls that reflect or with several goals, which the paper's lattices do not know.
        BudgetExhausted: `max_iterations` did not suffice, or the changes have come down to rounding errors above the tolerance.
    """
    check_sweep(problem, scheme, REACHABLE if tolerance is None else tolerance)
    if iteration not in ("jacobi", "gauss-seidel", "sor"):
        raise ParameterError(f"iteration is jacobi, gauss-seidel or sor, not {iteration!r}")
    if iteration != "sor" and omega is not None:
        raise ParameterError(f"{iteration} has no weight omega; sor has")
    if omega is not None and not 0.0 < omega < 2.0:
        raise ParameterError(f"SOR converges for omega between 0 and 2 (both excluded), not for {omega}")
    lattice = make_lattice(problem, scheme)
    weight = 1.0 if iteration != "sor" else best_omega(problem, scheme) if omega is None else float(omega)
    if tolerance is None:
        tolerance = reachable(weight)
    elif tolerance < reachable(weight):
        raise ParameterError(f"tolerance {tolerance} is below what doubles reach with omega {weight}: {reachable(weight):.1e}")
    u, changes = _iterate(lattice, weight, iteration == "jacobi", tolerance, max_iterations)
    field = fill_in(problem, lattice, u)
    residual = largest_residual(field, problem.inverse_degree)
    name = f"{scheme}-sweep {iteration}"
    return Sweeps(Potential(problem, field, None, name, np.array([residual])), len(changes), weight, changes)


def best_omega(problem: LaplaceProblem, scheme: Scheme = "quarter", accuracy: float = 0.02) -> float:
    """2 / (1 + sqrt(1 - rho^2)) with rho the spectral radius of the Jacobi iteration (Young 1954).

    rho is the largest Ritz value of a Lanczos run, which ends when 1 - rho changes by less than the fraction `accuracy` while
    the run grows by half.
    """
    check_sweep(problem, scheme, REACHABLE)
    lattice = make_lattice(problem, scheme)
    nodes = lattice.state == 1
    if not nodes.any():
        return 1.0
    # a start vector without symmetries, the same each time
    vector = np.where(nodes, 1.0 + 0.1 * np.random.default_rng(0).random(nodes.shape), 0.0)
    vector /= np.linalg.norm(vector)
    previous = np.zeros_like(vector)
    diagonal: list[float] = []
    beside: list[float] = []
    beta = 0.0
    rho, gap, check_at = 0.0, math.inf, 20
    for k in range(1, 20 * max(nodes.shape)):
        following = _jacobi_product(vector, lattice.state, lattice.arms, lattice.rotated) - beta * previous
        diagonal.append(float(np.vdot(following, vector)))
        following -= diagonal[-1] * vector
        beta = float(np.linalg.norm(following))
        if k == check_at or beta < 1e-13:
            last = (k - 1, k - 1)
            rho = (
                eigh_tridiagonal(diagonal, beside, select="i", select_range=last, eigvals_only=True)[0] if k > 1 else diagonal[0]
            )
            if beta < 1e-13 or gap - (1.0 - rho) <= accuracy * (1.0 - rho):
                break
            gap, check_at = 1.0 - rho, check_at * 3 // 2
        beside.append(beta)
        previous, vector = vector, following / beta
    rho = min(max(float(rho), 0.0), 1.0 - 1e-12)
    return 2.0 / (1.0 + math.sqrt(1.0 - rho * rho))


def reachable(omega: float) -> float:
    """Smallest threshold on the change in an iteration that SOR meets in doubles: 1e-15, or 1.5 eps / sqrt(2 - omega).

    Rounding kicks every value by some eps / 2 next to the goal, where w is near 1. A mode that SOR multiplies by l with
    |l| = omega - 1 then keeps changing, with a variance of 2 / (1 + Re l) of the kick's: 2 / (2 - omega) where l is near
    1 - omega. The largest change of a million nodes is about six such standard deviations.
    """
    return max(REACHABLE, 1.5 * float(np.finfo(float).eps) / math.sqrt(2.0 - omega))


def check_sweep(problem: LaplaceProblem, scheme: str, tolerance: float) -> None:
    """Raises ParameterError where the sweep schemes do not apply or the tolerance is out of reach."""
    if scheme not in STRIDE:
        raise ParameterError(f"scheme is one of {', '.join(STRIDE)}, not {scheme!r}")
    if not tolerance >= REACHABLE:
        raise ParameterError(f"tolerance {tolerance} is below what doubles reach; the smallest is {REACHABLE}")
    if not problem.plain or len(problem.goals) != 1:
        raise ParameterError("the sweep schemes need walls that absorb, no leak and one goal cell")


@njit(cache=True)
def _jacobi_product(vector, state, arms, rotated):
    out = np.zeros(vector.shape)
    for r in range(1, state.shape[0] - 1):
        for c in range(1, state.shape[1] - 1):
            if state[r, c] == 1:
                total = 0.0
                for k in range(4):
                    if arms[r, c] >> k & 1:
                        if rotated:
                            total += vector[r + (-1 if k < 2 else 1), c + (-1 if k % 2 == 0 else 1)]
                        else:
                            total += vector[r + (k == 1) - (k == 0), c + (k == 3) - (k == 2)]
                out[r, c] = 0.25 * total
    return out


# ---------------------------------------------------------------- iterations on nodes packed by colour
#
# Nodes of one colour lie side by side: node (r, c) at index c // 2 of row r. On a straight lattice the colours are those of a
# checkerboard, in layers 0 and 1; on a rotated one rows alternate, and the layers hold its even and odd rows. Both neighbours
# to the left and right of index k in the row of the other colour are then k - 1 + odd and k + odd, `odd` being the parity of c.


@dataclass(frozen=True, slots=True, eq=False)
class _Packing:
    """Runs of unknowns with all arms, and single ones with some cut; both sorted by (layer, row), where `*_start` points."""

    odd: NDArray[np.int64]  # (2, rows)
    spans: NDArray[np.int64]  # (n, 2) as begin, end
    span_start: NDArray[np.int64]  # (2, rows + 1)
    singles: NDArray[np.int64]  # (m, 2) as index, arms
    single_start: NDArray[np.int64]  # (2, rows + 1)


def _iterate(lattice: LaplaceLattice, omega: float, jacobi: bool, tolerance: float, max_iterations: int) -> tuple[Array, Array]:
    """Values at the lattice's nodes and the largest change of each iteration."""
    rows, cols = lattice.state.shape
    rotated = lattice.rotated
    goal_row, goal_col = (int(v) for v in np.argwhere(lattice.state == 2)[0])
    row = np.arange(rows)
    # in this layer and row the columns of the nodes are odd (1) or even (0)
    odd = np.stack([(goal_row + goal_col - row) % 2] * 2 if rotated else [row % 2, (1 - row) % 2])
    packing = _Packing(odd, *_pack(lattice.state, lattice.arms, odd, rotated))
    layers = np.zeros((2, rows, cols // 2 + 2))
    goal_layer = goal_row % 2 if rotated else (goal_row + goal_col) % 2
    layers[goal_layer, goal_row, goal_col // 2] = 1.0
    where = (packing.odd, packing.spans, packing.span_start, packing.singles, packing.single_start, rotated, omega)
    changes: list[float] = []
    last = least = math.inf
    least_at = 0
    while len(changes) < max_iterations:
        # far from the end only every twentieth change is looked at; small lattices converge too fast for that
        if not jacobi and last > 10 * tolerance and max_iterations - len(changes) > UNWATCHED and lattice.state.size > 40_000:
            _iterations(layers, *where, UNWATCHED)
            changes += [math.nan] * UNWATCHED
        last = float(_watched_iteration(layers, layers.copy() if jacobi else layers, *where))
        changes.append(last)
        if last <= tolerance:
            return _unpack(layers, lattice.state, odd, rotated), np.array(changes)
        if last < least:
            least, least_at = last, len(changes)
        if least < 1e-13 and len(changes) - least_at >= STALLED:
            raise BudgetExhausted(f"the changes have come down to rounding errors of {least:.1e}, not to {tolerance}")
    raise BudgetExhausted(f"the largest change is {last:.1e} after {max_iterations} iterations, not yet {tolerance}")


@njit(cache=True)
def _pack(state, arms, odd, rotated):
    rows, cols = state.shape
    spans = np.empty((state.size, 2), np.int64)
    singles = np.empty((state.size, 2), np.int64)
    n_spans, n_singles = 0, 0
    span_start = np.zeros((2, rows + 1), np.int64)
    single_start = np.zeros((2, rows + 1), np.int64)
    for layer in range(2):
        for r in range(rows):
            span_start[layer, r], single_start[layer, r] = n_spans, n_singles
            if rotated and r % 2 != layer:
                continue
            running = False
            for c in range(odd[layer, r], cols, 2):
                whole = state[r, c] == 1 and arms[r, c] == 15
                if whole and not running:
                    spans[n_spans, 0] = c // 2
                    n_spans += 1
                if whole:
                    spans[n_spans - 1, 1] = c // 2 + 1
                elif state[r, c] == 1:
                    singles[n_singles, 0], singles[n_singles, 1] = c // 2, arms[r, c]
                    n_singles += 1
                running = whole
        span_start[layer, rows], single_start[layer, rows] = n_spans, n_singles
    return spans[:n_spans].copy(), span_start, singles[:n_singles].copy(), single_start


@njit(cache=True)
def _unpack(layers, state, odd, rotated):
    values = np.zeros(state.shape)
    for layer in range(2):
        for r in range(state.shape[0]):
            if rotated and r % 2 != layer:
                continue
            for c in range(odd[layer, r], state.shape[1], 2):
                if state[r, c] > 0:
                    values[r, c] = layers[layer, r, c // 2]
    return values


@njit(cache=True)
def _update_run(target, a, b, c, d, quarter, keep):
    """u <- (omega / 4) (sum of the four arms) + (1 - omega) u (eqs 13 to 15)."""
    for k in range(len(target)):
        target[k] = quarter * ((a[k] + b[k]) + (c[k] + d[k])) + keep * target[k]


@njit(cache=True)
def _update_run_watched(target, a, b, c, d, quarter, keep):
    """The same, and the largest change. It cannot be vectorised and takes four times as long."""
    largest = 0.0
    for k in range(len(target)):
        value = quarter * ((a[k] + b[k]) + (c[k] + d[k])) + keep * target[k]
        largest = max(largest, abs(value - target[k]))
        target[k] = value
    return largest


@njit(cache=True)
def _update_row(layers, source, layer, r, odd, spans, span_start, singles, single_start, rotated, omega, watch):
    quarter, keep = 0.25 * omega, 1.0 - omega
    target = layers[layer, r]
    other = source[1 - layer]
    shift = odd[layer, r]
    largest = 0.0
    for s in range(span_start[layer, r], span_start[layer, r + 1]):
        b, e = spans[s, 0], spans[s, 1]
        left, right = slice(b - 1 + shift, e - 1 + shift), slice(b + shift, e + shift)
        if rotated:
            ends = (other[r - 1][left], other[r - 1][right], other[r + 1][left], other[r + 1][right])
        else:
            ends = (other[r - 1][b:e], other[r + 1][b:e], other[r][left], other[r][right])
        if watch:
            largest = max(largest, _update_run_watched(target[b:e], ends[0], ends[1], ends[2], ends[3], quarter, keep))
        else:
            _update_run(target[b:e], ends[0], ends[1], ends[2], ends[3], quarter, keep)
    for s in range(single_start[layer, r], single_start[layer, r + 1]):
        k, arms = singles[s, 0], singles[s, 1]
        total = 0.0
        for arm in range(4):
            if arms >> arm & 1:
                if rotated:
                    total += other[r + (-1 if arm < 2 else 1), k - 1 + shift + arm % 2]
                elif arm < 2:
                    total += other[r + (-1 if arm == 0 else 1), k]
                else:
                    total += other[r, k + shift + arm - 3]
        value = quarter * total + keep * target[k]
        largest = max(largest, abs(value - target[k]))
        target[k] = value
    return largest


@njit(cache=True)
def _watched_iteration(layers, source, odd, spans, span_start, singles, single_start, rotated, omega):
    """One iteration, and its largest change."""
    largest = 0.0
    for layer in range(2):
        for r in range(1, layers.shape[1] - 1):
            change = _update_row(layers, source, layer, r, odd, spans, span_start, singles, single_start, rotated, omega, True)
            largest = max(largest, change)
    return largest


@njit(cache=True)
def _iterations(layers, odd, spans, span_start, singles, single_start, rotated, omega, count):
    """Several iterations in one pass over the rows, each colour one row behind the other before it: the rows stay in the cache.

    A row is updated when the other colour's rows above, beside and below have just been, as if each colour had been done alone.
    """
    rows = layers.shape[1]
    for front in range(1, rows - 2 + 2 * count):
        for half in range(max(0, front - rows + 2), min(2 * count, front)):
            _update_row(
                layers, layers, half % 2, front - half, odd, spans, span_start, singles, single_start, rotated, omega, False
            )
