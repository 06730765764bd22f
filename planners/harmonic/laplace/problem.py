"""Laplace's equation on the free cells of a grid, as the question where a random walk ends.

A walker stands on a free cell and steps to one of the four neighbours with equal probability. `w` is the probability that it
reaches the goal before a wall: 1 at the goal, 0 in walls, and the mean of the four neighbours in between. The paper's
potential (Saudi and Sulaiman, eq. 2, walls high and goal low) is u = 1 - w. Floating-point numbers resolve w where u has long
become 1: far from the goal w falls like exp(-pi length / width), and doubles keep the *relative* precision of small numbers,
not of their distance from 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core import Array, GoalOccupied, NoPathFound, OutsideMap, ParameterError


@dataclass(frozen=True, slots=True, eq=False)
class LaplaceProblem:
    """Cells that take part, and what each of them asks for.

    `(n_i + k_i) w_i = sum of w over the n_i free neighbours`, w = 1 at the goal. The loss k_i is the conductance of the walls
    beside the cell plus `leak`. Walls with conductance 1 absorb (Dirichlet, the paper's), with 0 they reflect (Neumann; Karnik
    et al. 2002), in between they do both (Robin). Only Neumann walls make w = 1 everywhere: `leak`, the rate at which walks
    die in the open, gives them a slope.

    Args:
        inverse_degree: 1 / (n_i + k_i) at free cells connected to the goal; 0 at walls, goal and cells cut off, (rows + 2,
        cols + 2). goals: (k, 2) as (row, col).
        plain: every wall absorbs fully and nothing leaks.
    """

    inverse_degree: Array
    goals: NDArray[np.intp]
    plain: bool

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)"""
        rows, cols = self.inverse_degree.shape
        return rows - 2, cols - 2

    @property
    def unknowns(self) -> NDArray[np.bool_]:
        """Cells whose w is sought, (rows, cols)."""
        return self.inverse_degree[1:-1, 1:-1] > 0

    def start_field(self) -> Array:
        """0 everywhere but 1 at the goal, padded by the border wall, (rows + 2, cols + 2)."""
        field = np.zeros(self.inverse_degree.shape)
        field[self.goals[:, 0] + 1, self.goals[:, 1] + 1] = 1.0
        return field

    def require_connected(self, cell: tuple[int, int]) -> None:
        """Raises NoPathFound where no way leads from `cell` (row, col) to the goal."""
        row, col = cell
        rows, cols = self.shape
        if not (0 <= row < rows and 0 <= col < cols):
            raise OutsideMap(f"cell {tuple(cell)} lies outside the grid of {rows} x {cols} cells")
        at_goal = bool(np.any(np.all(self.goals == (row, col), axis=1)))
        if not at_goal and self.inverse_degree[row + 1, col + 1] == 0:
            raise NoPathFound(f"no free way leads from cell {tuple(cell)} to the goal at {tuple(int(i) for i in self.goals[0])}")


def laplace_problem(
    blocked: ArrayLike, goal: ArrayLike, wall_conductance: float | ArrayLike = 1.0, leak: float = 0.0
) -> LaplaceProblem:
    """Set up the equations for a map.

    The border of the map is a wall, whether the map draws one or not (of the mean conductance where that varies from wall to
    wall).

    Args:
        blocked: cells that are walls, (rows, cols) bool.
        goal: one cell (2,) or several (k, 2) as (row, col).
        wall_conductance: 1 absorbing (Dirichlet) to 0 reflecting (Neumann); one number, or (rows, cols) with one for each wall.
        leak: loss in each free cell, in units of the conductance between two cells.

    Raises:
        ParameterError: no goal, a conductance outside [0, 1], a negative leak, or nothing that absorbs (w would be 1 everywhere).
        OutsideMap, GoalOccupied: the goal is not a free cell of the map.
    """
    walls = np.ascontiguousarray(blocked, dtype=bool)
    if walls.ndim != 2 or walls.size == 0:
        raise ParameterError(f"a map needs rows and columns, not shape {walls.shape}")
    goals = _checked_goals(walls, goal)
    if not (np.isfinite(leak) and leak >= 0):
        raise ParameterError(f"leak must be a number from 0 up, not {leak}")
    conductance = np.asarray(wall_conductance, dtype=float)
    if not np.all((conductance >= 0) & (conductance <= 1)):
        raise ParameterError("wall_conductance goes from 0 (reflecting, Neumann) to 1 (absorbing, Dirichlet)")
    if conductance.ndim and conductance.shape != walls.shape:
        raise ParameterError(f"wall_conductance is one number or of the map's shape {walls.shape}, not {conductance.shape}")
    labels: NDArray[np.int32]
    _, labels = cv2.connectedComponents((~walls).astype(np.uint8), connectivity=4)  # type: ignore[assignment]
    chosen = np.zeros(int(labels.max()) + 1, dtype=bool)
    chosen[labels[goals[:, 0], goals[:, 1]]] = True
    state = np.zeros((walls.shape[0] + 2, walls.shape[1] + 2), dtype=np.uint8)
    state[1:-1, 1:-1] = chosen[labels] & ~walls
    state[goals[:, 0] + 1, goals[:, 1] + 1] = 2
    if conductance.ndim:
        padded = np.pad(conductance, 1, constant_values=float(conductance[walls].mean()) if walls.any() else 1.0)
    else:
        padded = np.full((1, 1), float(conductance))
    inverse_degree, loss = _inverse_degrees(state, padded, float(leak))
    if loss == 0 and np.any(state == 1):
        raise ParameterError("nothing absorbs the walk: w = 1 everywhere; raise wall_conductance or leak above 0")
    inverse_degree.flags.writeable = False
    return LaplaceProblem(inverse_degree, goals, bool(np.all(conductance == 1) and leak == 0))


def _checked_goals(walls: NDArray[np.bool_], goal: ArrayLike) -> NDArray[np.intp]:
    goals = np.asarray(goal)
    if goals.size == 0 or goals.ndim not in (1, 2) or goals.shape[-1] != 2 or goals.dtype.kind not in "iu":
        raise ParameterError(f"a goal is a cell (row, col) of whole numbers, or several (k, 2); not {goal!r}")
    goals = goals.reshape(-1, 2).astype(np.intp)
    rows, cols = walls.shape
    for row, col in goals:
        if not (0 <= row < rows and 0 <= col < cols):
            raise OutsideMap(f"goal cell ({row}, {col}) lies outside the grid of {rows} x {cols} cells")
        if walls[row, col]:
            raise GoalOccupied(f"goal cell ({row}, {col}) is a wall")
    return goals


@njit(cache=True)
def _inverse_degrees(state, conductance, leak):
    """1 / (free neighbours + loss) at the cells of state 1, and the total loss."""
    rows, cols = state.shape
    uniform = conductance.size == 1
    inverse_degree = np.zeros(state.shape)
    total = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if state[r, c] != 1:
                continue
            degree, loss = 0.0, leak
            for r2, c2 in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                if state[r2, c2] > 0:
                    degree += 1.0
                elif uniform:
                    loss += conductance[0, 0]
                else:
                    loss += conductance[r2, c2]
            inverse_degree[r, c] = 1.0 / (degree + loss)
            total += loss
    return inverse_degree, total
