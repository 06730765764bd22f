"""Multiplicative multigrid: w to a component-wise residual, in time proportional to the number of cells.

Each cycle takes the relative residual (mean of the neighbours - w) / w to the coarse levels, multiplies w by one plus the
relative error found there (a positive factor, so w stays positive), and smooths by red-black Gauss-Seidel sweeps. The
coarse levels are re-weighted with the current w until it settles, as in iterative aggregation and disaggregation (Horton and
Leutenegger 1994), and know where it is not a solution yet, so that even the first cycle takes a large error for what it is.
No step subtracts numbers of different magnitude, so the error is small relative to w in *every* cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.harmonic.laplace.elimination import Elimination, dissection_order, eliminate
from robocar.planners.harmonic.laplace.levels import Level, coarser, first_level
from robocar.planners.harmonic.laplace.problem import LaplaceProblem
from robocar.planners.harmonic.laplace.relaxation import (
    correct_cells,
    gather_residual,
    linear_residual,
    multiply,
    prolong,
    relative_residual,
    restrict,
    smallest,
    smooth,
    spread,
    sweep,
)
from robocar.planners.harmonic.laplace.weights import Cells, follow, stale_nodes, stale_parents, weigh, weigh_first

DIRECT_SIZE = 400
"""Levels of at most this many nodes are solved directly."""

SMALLEST = 1e-280
"""Below this, products of neighbouring values would leave the range of doubles."""

SETTLED = 0.1
"""Coarse weights are kept once w changes by less than this fraction in a cycle. 0.02 to 0.3 take equally many cycles on room
maps, caves, offices and random obstacles."""

RESHAPED = 0.01
"""In a warm start, weights are renewed where w changes by factors that differ by more than this from node to node."""

SWEEPS = 3
"""Over the cells in each cycle."""


@dataclass(frozen=True, slots=True, eq=False)
class Cycles:
    """What a run of multigrid did: the component-wise residual after each cycle, (n,)."""

    residuals: Array
    converged: bool


@dataclass(slots=True, eq=False)
class Multigrid:
    """Coarse levels for one problem; their structure is set up once."""

    problem: LaplaceProblem
    parent: NDArray[np.int32] = field(init=False)
    share: NDArray[np.float32] = field(init=False)
    levels: list[Level] = field(init=False)
    _direct: Elimination | None = field(init=False, default=None)
    _order: NDArray[np.int32] = field(init=False)

    def __post_init__(self) -> None:
        level, self.parent = first_level(self.problem.inverse_degree)
        self.share = np.zeros(self.parent.shape, np.float32)
        self.levels = [level]
        while self.levels[-1].size > DIRECT_SIZE:
            level = coarser(self.levels[-1])
            if level.size > 0.8 * self.levels[-1].size:
                break
            self.levels.append(level)
        last = self.levels[-1]
        last.parent, last.share = np.empty(0, np.int32), np.empty(0, np.float32)
        self._order = dissection_order(last.blocks[:, 0], last.blocks[:, 1])

    def first_guess(self) -> Array | None:
        """w by nested iteration from the coarsest level up, padded (rows + 2, cols + 2); None where doubles are too short."""
        field_ = self.problem.start_field()
        self._reweigh(field_, conditioned=False)
        w = self._solve_last(self.levels[-1].goal)
        for k in range(len(self.levels) - 2, -1, -1):
            level = self.levels[k]
            if not w.min() > SMALLEST:
                return None
            w = w[level.parent]
            e_goal = level.goal
            sweep(level, w, e_goal, 3)
            for _ in range(8):
                relative = relative_residual(level, w)
                if np.max(np.abs(relative)) < 0.03:
                    break
                self._reweigh_from(k, w, True, [np.ones(level.size, np.uint8)])
                below = self.levels[k + 1]
                coarse = restrict(level, below, relative)
                multiply(w, self._correction(k + 1, coarse), level.parent)
                sweep(level, w, e_goal, 2)
        spread(field_, self.parent, w)
        smooth(field_, self.problem.inverse_degree, 2)
        return field_

    def improve(self, w: Array, tolerance: float, max_cycles: int, stale: Sequence[NDArray[np.uint8]] | None = None) -> Cycles:
        """Bring the guess `w`, padded, to |mean of neighbours - w| / w <= tolerance in every cell, in place.

        It gives up, with an infinite residual, where w leaves the range of doubles.

        Args:
            stale: for a warm start, the nodes of each level that have no weights yet, (n,); those of the others are about right.
        """
        residuals = []
        warm, change = stale is not None, np.inf
        inverse_degree = self.problem.inverse_degree
        smooth(w, inverse_degree, 1)  # residuals are gathered after sweeps only
        for _ in range(max_cycles):
            if change > SETTLED:
                if smallest(w, inverse_degree) <= SMALLEST:
                    return Cycles(np.array([*residuals, np.inf]), False)
                self._reweigh(w, True, stale)
            right, worst = gather_residual(w, inverse_degree, self.parent, self.share, self.levels[0].blocks)
            residuals.append(worst)
            if not np.isfinite(worst):
                return Cycles(np.array(residuals), False)
            if worst <= tolerance:
                return Cycles(np.array(residuals), True)
            e = self._correction(0, right)
            change = float(np.max(np.abs(e)))
            if warm and change > SETTLED:
                stale = self._follow(e)
            correct_cells(w, self.parent, e)
            smooth(w, inverse_degree, SWEEPS)
        return Cycles(np.array(residuals), False)

    def _follow(self, e: Array) -> list[NDArray[np.uint8]]:
        """Let the weights follow a change of w by the factors 1 + e; the nodes of each level where they must be renewed.

        On coarse levels, any child's factor stands for all: where children differ much, they are renewed, and so is the parent.
        """
        stale = []
        for k, level in enumerate(self.levels):
            if k > 0:
                below, e = e, np.empty(level.size)
                e[self.levels[k - 1].parent] = below
            stale.append(stale_nodes(level.indptr, level.indices, e, RESHAPED))
            follow(level.log_weight, e)
        return stale

    def _reweigh(self, w: Array, conditioned: bool, stale: Sequence[NDArray[np.uint8]] | None = None) -> None:
        """Weigh all levels with w; where `stale` is given, only its nodes of level 1, of the levels above, and their parents."""
        first = self.levels[0]
        if stale is None:
            stale = [np.ones(first.size, np.uint8)]
        cells = Cells.of(w, self.problem.inverse_degree, self.parent, self.share)
        weigh_first(cells, first, conditioned, 2.0 / 3.0, stale[0])
        self._reweigh_from(0, np.ones(first.size), conditioned, stale)

    def _reweigh_from(self, k: int, w: Array, conditioned: bool, stale: Sequence[NDArray[np.uint8]]) -> None:
        """Weigh the levels above k, whose walk is to be conditioned on w (n,); `stale` as above, from level k on."""
        nodes = stale[0]
        for level in range(k, len(self.levels) - 1):
            fine, coarse = self.levels[level], self.levels[level + 1]
            nodes = stale_parents(fine.parent, nodes, coarse.size)
            if level + 1 - k < len(stale):
                nodes |= stale[level + 1 - k]
            # a wall beside a strip of 2^k cells lies (2^k + 1) / 2 from its middle: the conductance to it falls as the strip
            # widens
            width = 2.0 ** (level + 1)
            weigh(fine, coarse, w, conditioned, (width + 1.0) / (2.0 * width + 1.0), nodes)
            w = np.ones(coarse.size)
        last = self.levels[-1]
        self._direct = eliminate(last.indptr, last.indices, last.probability, last.goal, np.maximum(last.loss, 0.0), self._order)

    def _solve_last(self, right: Array) -> Array:
        assert self._direct is not None
        return self._direct.solve(right)

    def _correction(self, k: int, right: Array) -> Array:
        """Approximate e = P e + right on level k: two W-cycles without pre-smoothing."""
        if k == len(self.levels) - 1:
            return self._solve_last(right)
        e = self._cycle(k, np.zeros(self.levels[k].size), right, right)
        level = self.levels[k]
        residual = linear_residual(level, e, right)
        return self._cycle(k, e, right, residual)

    def _cycle(self, k: int, e: Array, right: Array, residual: Array) -> Array:
        level, below = self.levels[k], self.levels[k + 1]
        prolong(e, self._correction(k + 1, restrict(level, below, residual)), level.parent)
        sweep(level, e, right, 2)
        return e
