"""The lattices of the sweep schemes, and their arms cut by walls (Saudi and Sulaiman, Figs 1 and 2).

| scheme  | nodes kept                  | arms lead to       | eq. | afterwards                             |
|---------|-----------------------------|--------------------|-----|----------------------------------------|
| full    | all                         | (+-1, 0), (0, +-1) | 6   |                                        |
| half    | a checkerboard              | (+-1, +-1)         | 7   | the others by eq. 10                   |
| quarter | every second row and column | (+-2, 0), (0, +-2) | 8   | cell centres by eq. 11, rest by eq. 10 |
| octo    | a checkerboard of these     | (+-2, +-2)         |     | others by eq. 12, then as for quarter  |

The lattice is shifted so that the goal is one of its nodes. An arm is *cut* where a wall stands in its way, and then holds the
wall's value 0 instead of the node's behind the wall: so walls thinner than the stencil never leak. A diagonal step is blocked
if its end or both cells beside it are walls; a step of two cells is blocked if either half is. What lies between two nodes of
a lattice but has no way to any (a corridor of one cell between the rows of the quarter lattice) stays at 0: the coarse schemes
are complete only where passages are wide enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.planners.harmonic.laplace.problem import LaplaceProblem

Scheme = Literal["full", "half", "quarter", "octo"]
STRIDE = {"full": 1, "half": 1, "quarter": 2, "octo": 2}
ROTATED = {"full": False, "half": True, "quarter": False, "octo": True}


@dataclass(frozen=True, slots=True, eq=False)
class LaplaceLattice:
    """Every `stride`-th row and column of the padded grid, inside a frame of walls of its own.

    Args:
        scheme: its name.
        first: padded row and column of lattice node (1, 1).
        state: 0 wall or no node, 1 unknown, 2 goal, (rows + 2, cols + 2) uint8.
        arms: bit k is set where arm k is not cut, (rows + 2, cols + 2) uint8. Arms: up, down, left, right; rotated: up-left,
            up-right, down-left, down-right.
    """

    scheme: Scheme
    first: tuple[int, int]
    state: NDArray[np.uint8]
    arms: NDArray[np.uint8]

    @property
    def stride(self) -> int:
        return STRIDE[self.scheme]

    @property
    def rotated(self) -> bool:
        return ROTATED[self.scheme]


def make_lattice(problem: LaplaceProblem, scheme: Scheme) -> LaplaceLattice:
    """The lattice of a scheme through the first goal cell."""
    state = (problem.inverse_degree > 0).astype(np.uint8)
    goals = problem.goals + 1
    state[goals[:, 0], goals[:, 1]] = 2
    stride = STRIDE[scheme]
    row, col = (int(v) for v in goals[0])
    first = (1 + (row - 1) % stride, 1 + (col - 1) % stride)
    checker = (row + col) // stride if ROTATED[scheme] else -1
    shift = (first[0] + first[1]) // stride
    lattice, arms = _cut(state, stride, first[0], first[1], ROTATED[scheme], (checker - shift) % 2 if checker >= 0 else -1)
    return LaplaceLattice(scheme, first, lattice, arms)


@njit(cache=True)
def _open(state, r, c, dr, dc):
    """Whether a step of one cell, straight or diagonal, meets no wall."""
    if state[r + dr, c + dc] == 0:
        return False
    return dr == 0 or dc == 0 or state[r + dr, c] > 0 or state[r, c + dc] > 0


@njit(cache=True)
def _cut(state, stride, first_row, first_col, rotated, checker):
    rows = (state.shape[0] - 1 - first_row + stride - 1) // stride
    cols = (state.shape[1] - 1 - first_col + stride - 1) // stride
    lattice = np.zeros((rows + 2, cols + 2), np.uint8)
    arms = np.zeros((rows + 2, cols + 2), np.uint8)
    for i in range(1, rows + 1):
        for j in range(1, cols + 1):
            if checker >= 0 and (i + j) % 2 != checker:
                continue
            r, c = first_row + (i - 1) * stride, first_col + (j - 1) * stride
            lattice[i, j] = state[r, c]
            if state[r, c] != 1:
                continue
            for k in range(4):
                if rotated:
                    dr, dc = (-1 if k < 2 else 1), (-1 if k % 2 == 0 else 1)
                else:
                    dr, dc = (k == 1) - (k == 0), (k == 3) - (k == 2)
                free = _open(state, r, c, dr, dc)
                if free and stride == 2:
                    free = _open(state, r + dr, c + dc, dr, dc)
                if free:
                    arms[i, j] |= np.uint8(1 << k)
    return lattice, arms


def fill_in(problem: LaplaceProblem, lattice: LaplaceLattice, values: NDArray) -> NDArray:
    """The whole padded field from the values at the lattice's nodes, by the direct steps of algorithms 2 and 3."""
    if lattice.scheme == "octo":
        quarter = make_lattice(problem, "quarter")
        values = values.copy()
        _fill_straight(values, quarter.state, quarter.arms, lattice.state)
        return fill_in(problem, quarter, values)
    field = problem.start_field()
    known = field > 0
    rows, cols = lattice.state.shape
    place = np.ix_(
        lattice.first[0] + lattice.stride * np.arange(rows - 2), lattice.first[1] + lattice.stride * np.arange(cols - 2)
    )
    inside = lattice.state[1:-1, 1:-1] > 0
    field[place] = np.where(inside, values[1:-1, 1:-1], field[place])
    known[place] |= inside
    state = (problem.inverse_degree > 0).astype(np.uint8)
    state[problem.goals[:, 0] + 1, problem.goals[:, 1] + 1] = 2
    if lattice.scheme == "quarter":
        _fill_rotated(field, state, known, lattice.first[0], lattice.first[1])
    everywhere = np.full(state.shape, 15, np.uint8)
    _fill_straight(field, state, everywhere, known.astype(np.uint8))
    return field


@njit(cache=True)
def _fill_straight(values, state, arms, known):
    """Eq. 10 (or 12 on a lattice of stride 2) at the nodes not yet known."""
    for r in range(1, state.shape[0] - 1):
        for c in range(1, state.shape[1] - 1):
            if state[r, c] == 1 and known[r, c] == 0:
                total = 0.0
                for k in range(4):
                    if arms[r, c] >> k & 1:
                        total += values[r + (k == 1) - (k == 0), c + (k == 3) - (k == 2)]
                values[r, c] = 0.25 * total


@njit(cache=True)
def _fill_rotated(field, state, known, first_row, first_col):
    """Eq. 11 at the cells in the middle of four nodes of the quarter lattice."""
    for r in range(1 + first_row % 2, state.shape[0] - 1, 2):
        for c in range(1 + first_col % 2, state.shape[1] - 1, 2):
            if state[r, c] == 1 and not known[r, c]:
                total = 0.0
                for dr in (-1, 1):
                    for dc in (-1, 1):
                        if _open(state, r, c, dr, dc):
                            total += field[r + dr, c + dc]
                field[r, c] = 0.25 * total
                known[r, c] = True
