"""From a problem to its solution: multigrid by default, elimination where doubles or patience end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array, BudgetExhausted, ParameterError
from robocar.planners.harmonic.laplace.elimination import eliminate
from robocar.planners.harmonic.laplace.multigrid import Multigrid
from robocar.planners.harmonic.laplace.problem import LaplaceProblem
from robocar.planners.harmonic.laplace.warm import warm_start

REACHABLE = 4e-15
"""Smallest component-wise residual that doubles reach in every cell: a mean of four and a division round by some 1e-16 each."""

MAX_CYCLES = 60
WARM_CYCLES, WARM_RESIDUAL = 20, 1e-2
"""A warm start with a larger residual after so many cycles started too far off (another way round, say): a first guess of its
own is better then."""

MAX_FILL = 200_000_000
NARROW, NARROW_FILL = 16.0, 24
"""Maps whose passages are on average less than this many cells wide are eliminated at once, if the factors have at most this
many entries a cell."""

Method = Literal["auto", "multigrid", "elimination"]


@dataclass(frozen=True, slots=True, eq=False)
class Potential:
    """Probability to reach the goal, `w = mantissa * 2^exponent`.

    Args:
        problem: what was solved.
        mantissa: padded by the border wall, (rows + 2, cols + 2); w itself where `exponent` is None.
        exponent: like `mantissa`, which then lies in [0.5, 1) in free cells; None where w fits into doubles.
        method: what solved it.
        residuals: largest |mean of neighbours - w| / w of any cell after each cycle; of elimination the last only.
        levels: coarse levels that solved it, for a warm start of the next problem; None where none did.
    """

    problem: LaplaceProblem
    mantissa: Array
    exponent: NDArray[np.int32] | None
    method: str
    residuals: Array
    levels: Multigrid | None = None

    @property
    def residual(self) -> float:
        """Largest relative residual of any cell."""
        return float(self.residuals[-1])

    @property
    def w(self) -> Array:
        """(rows, cols); 0 where w is below 1e-308."""
        if self.exponent is None:
            return self.mantissa[1:-1, 1:-1]
        return np.asarray(np.ldexp(self.mantissa, self.exponent)[1:-1, 1:-1], dtype=float)

    @property
    def log2(self) -> Array:
        """log2 w, -inf at walls and cells that are cut off, (rows, cols)."""
        with np.errstate(divide="ignore"):
            values = np.log2(self.mantissa[1:-1, 1:-1])
        return values if self.exponent is None else np.where(values > -np.inf, values + self.exponent[1:-1, 1:-1], -np.inf)


def solve(
    problem: LaplaceProblem,
    tolerance: float = 1e-12,
    method: Method = "auto",
    guess: Potential | None = None,
    multigrid: Multigrid | None = None,
) -> Potential:
    """Solve for w.

    Args:
        tolerance: on |mean of the neighbours - w| / w in every cell.
        method: "auto" is multigrid, then elimination if w leaves the range of doubles or the cycles do not converge (mazes).
        guess: solution of a similar problem (the map has changed a little) to start multigrid from.
        multigrid: coarse levels of this very problem, to save their set-up.

    Raises:
        ParameterError: a tolerance that doubles cannot reach, an unknown method, or a multigrid of another problem.
        BudgetExhausted: multigrid did not converge and elimination would not fit into memory.
    """
    if not tolerance >= REACHABLE:
        raise ParameterError(f"tolerance {tolerance} is below what doubles reach in every cell; the smallest is {REACHABLE}")
    if method not in ("auto", "multigrid", "elimination"):
        raise ParameterError(f"method is auto, multigrid or elimination, not {method!r}")
    if multigrid is not None and multigrid.problem is not problem:
        raise ParameterError("the multigrid levels were set up for another problem")
    if not problem.unknowns.any():
        return Potential(problem, problem.start_field(), None, "trivial", np.zeros(1))
    if method == "auto" and _mean_width(problem.inverse_degree) < NARROW:
        potential = _solve_directly(problem, NARROW_FILL * int(np.count_nonzero(problem.inverse_degree)))
        if potential is not None and potential.residual <= tolerance:
            return potential
    if method != "elimination":
        levels = Multigrid(problem) if multigrid is None else multigrid
        start = _warm_start(levels, guess) if guess is not None else None
        if start is not None:
            w, stale = start
            cycles = levels.improve(w, tolerance, WARM_CYCLES, stale)
            residuals = cycles.residuals
            if not cycles.converged and residuals[-1] < WARM_RESIDUAL:
                cycles = levels.improve(w, tolerance, MAX_CYCLES - WARM_CYCLES)
                residuals = np.concatenate([residuals, cycles.residuals])
            if cycles.converged:
                return Potential(problem, w, None, "multigrid", residuals, levels)
        w = levels.first_guess()
        if w is not None:
            cycles = levels.improve(w, tolerance, MAX_CYCLES)
            if cycles.converged:
                return Potential(problem, w, None, "multigrid", cycles.residuals, levels)
            if method == "multigrid":
                raise BudgetExhausted(f"multigrid: residual {cycles.residuals[-1]:.1e} after {MAX_CYCLES} cycles")
        elif method == "multigrid":
            raise BudgetExhausted("w leaves the range of doubles; use elimination")
    potential = _solve_directly(problem, MAX_FILL)
    if potential is None:
        raise BudgetExhausted(f"elimination needs more than {MAX_FILL} entries: the map is too large, wide and winding")
    return potential


@njit(cache=True)
def _mean_width(inverse_degree):
    """Twice the unknown cells by the sides that face none: the width of a long corridor."""
    cells, sides = 0, 1
    for r in range(1, inverse_degree.shape[0] - 1):
        for c in range(1, inverse_degree.shape[1] - 1):
            if inverse_degree[r, c] > 0:
                cells += 1
                sides += (inverse_degree[r - 1, c] == 0) + (inverse_degree[r + 1, c] == 0)
                sides += (inverse_degree[r, c - 1] == 0) + (inverse_degree[r, c + 1] == 0)
    return 2.0 * cells / sides


def _warm_start(levels: Multigrid, guess: Potential) -> tuple[Array, list[NDArray[np.uint8]]] | None:
    old, problem = guess.problem, levels.problem
    if guess.levels is None or old.shape != problem.shape or not np.array_equal(old.goals, problem.goals):
        return None
    return warm_start(levels, guess.levels, guess.mantissa)


# ---------------------------------------------------------------- elimination of cells


def _solve_directly(problem: LaplaceProblem, max_fill: int) -> Potential | None:
    """Eliminate the cells from the farthest to the goal inwards.

    In this order each cell is left for nearer ones, so every cell keeps a way and a positive w, whatever underflows elsewhere;
    and the fill-in is the width of the front, a few cells in a maze. None where the factors would have more than `max_fill`
    entries.
    """
    number, indptr, indices, probability, goal, loss = _cell_graph(problem.inverse_degree, problem.start_field())
    order = _far_to_near(number, problem.goals, len(goal))
    factors = eliminate(indptr, indices, probability, goal, loss, order, max_fill)
    if factors is None:
        return None
    mantissa, exponent = factors.hitting()
    field = problem.start_field()
    powers = np.zeros(field.shape, np.int32)
    inside = number >= 0
    field[inside] = mantissa[number[inside]]
    powers[inside] = exponent[number[inside]]
    goals = problem.goals + 1
    field[goals[:, 0], goals[:, 1]] = 0.5
    powers[goals[:, 0], goals[:, 1]] = 1
    residual = _scaled_residual(field, powers, problem.inverse_degree)
    return Potential(problem, field, powers, "elimination", np.array([residual]))


@njit(cache=True)
def _cell_graph(inverse_degree, start):
    number = np.full(inverse_degree.shape, -1, np.int32)
    n = 0
    for r in range(inverse_degree.shape[0]):
        for c in range(inverse_degree.shape[1]):
            if inverse_degree[r, c] > 0:
                number[r, c] = n
                n += 1
    indptr = np.zeros(n + 1, np.int32)
    indices = np.empty(4 * n, np.int32)
    probability = np.empty(4 * n)
    goal = np.zeros(n)
    loss = np.zeros(n)
    size = 0
    for r in range(inverse_degree.shape[0]):
        for c in range(inverse_degree.shape[1]):
            i = number[r, c]
            if i < 0:
                continue
            free = 0
            for r2, c2 in ((r - 1, c), (r, c - 1), (r, c + 1), (r + 1, c)):
                if number[r2, c2] >= 0:
                    indices[size] = number[r2, c2]
                    probability[size] = inverse_degree[r, c]
                    size += 1
                    free += 1
                elif start[r2, c2] > 0:
                    goal[i] += inverse_degree[r, c]
                    free += 1
            # degree and free are whole numbers for absorbing walls: this difference is exact there
            loss[i] = max(0.0, 1.0 / inverse_degree[r, c] - free) * inverse_degree[r, c]
            indptr[i + 1] = size
    return number, indptr, indices[:size].copy(), probability[:size].copy(), goal, loss


@njit(cache=True)
def _far_to_near(number, goals, n):
    """Unknowns by falling number of steps to the goal."""
    cols = number.shape[1]
    flat = number.ravel()
    queue = np.empty(n + len(goals), np.int64)
    for k in range(len(goals)):
        queue[k] = (goals[k, 0] + 1) * cols + goals[k, 1] + 1
    size = len(goals)
    seen = np.zeros(n, np.bool_)
    order = np.empty(n, np.int32)
    count = 0
    for at in range(n + len(goals)):
        if at == size:
            break
        for offset in (-cols, -1, 1, cols):
            i = flat[queue[at] + offset]
            if i >= 0 and not seen[i]:
                seen[i] = True
                queue[size] = queue[at] + offset
                size += 1
                count += 1
                order[n - count] = i
    return order


@njit(cache=True)
def _scaled_residual(mantissa, exponent, inverse_degree):
    largest = 0.0
    for r in range(1, mantissa.shape[0] - 1):
        for c in range(1, mantissa.shape[1] - 1):
            if inverse_degree[r, c] > 0:
                if not mantissa[r, c] > 0.0:
                    return np.inf
                total = 0.0
                for r2, c2 in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                    if mantissa[r2, c2] > 0.0:
                        total += math.ldexp(mantissa[r2, c2], exponent[r2, c2] - exponent[r, c])
                largest = max(largest, abs(inverse_degree[r, c] * total - mantissa[r, c]) / mantissa[r, c])
    return largest
