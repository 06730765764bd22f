"""How difficult a world of the BARN benchmark is.

Source: Perille, Truong, Xiao and Stone, "Benchmarking Metric Ground Navigation" (SSRR 2020), section on difficulty metrics. Each
but the last is taken at every cell of the reference path and averaged; cells count as blocked where the benchmark's robot does
not fit (`ROOM`). The constants (8 and 16 directions, 4 axes, 3 cells) are those of the code that the authors published.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from robocar.formats.barn import CELL_SIZE, FIELD_CORNER, BarnWorld

FIELD = 30  # cells a side
ROOM = 0.30
"""Clearance that the benchmark's robot needs [m]."""

_REACH = 3  # [cells] that dispersion looks at
_AXES = ((0, 1), (1, 1), (1, 0), (1, -1))
_ROUND = (
    (0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2),
    (0, -1), (-1, -2), (-1, -1), (-2, -1), (-1, 0), (-2, 1), (-1, 1), (-1, 2),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Difficulty:
    """Means over a path.

    Args:
        closest_obstacle: distance from a cell's centre to that of the nearest blocked one [m].
        visibility: distance to the first blocked cell, or to beyond the field, in the mean over 8 directions [m].
        dispersion: of 16 directions in the order of their angle, how many differ from the one before in whether they are free for
            3 cells: twice the number of ways that lead off, 0 to 16.
        characteristic_dimension: way that is free to both sides along the narrowest of 4 axes [m].
        tortuosity: length of the path over the distance of its ends.
    """

    closest_obstacle: float
    visibility: float
    dispersion: float
    characteristic_dimension: float
    tortuosity: float


def difficulty(world: BarnWorld, path: ArrayLike) -> Difficulty:
    """Of a world and its reference path, (n, 2) [m]; what of it lies outside the field does not count.

    Raises:
        ValueError: fewer than two points of the path lie in the field, or where the robot does not fit.
    """
    centres = np.stack(np.meshgrid(*(np.arange(FIELD) * CELL_SIZE,) * 2, indexing="ij"), axis=-1) + np.array(FIELD_CORNER)
    blocked = np.zeros((FIELD, FIELD), dtype=bool)
    for x, y, radius in world.cylinders.tolist():
        blocked |= np.hypot(*(centres - (x, y)).transpose(2, 0, 1)) - radius < ROOM - 1e-6
    cells = np.rint((np.asarray(path, dtype=float).reshape(-1, 2) - FIELD_CORNER) / CELL_SIZE).astype(int)
    return of_cells(blocked, cells[np.all((cells >= 0) & (cells < FIELD), axis=1)], CELL_SIZE)


def of_cells(blocked: NDArray[np.bool_], path: ArrayLike, size: float = 1.0) -> Difficulty:
    """The same on any grid.

    Args:
        blocked: cells where the robot does not fit, (rows, cols).
        path: cells (row, col), (n, 2).
        size: of a cell [m].

    Raises:
        ValueError: the path has fewer than two cells, ends where it begins, or enters blocked cells.
    """
    cells = np.asarray(path, dtype=int).reshape(-1, 2)
    if len(cells) < 2 or np.array_equal(cells[0], cells[-1]):
        raise ValueError(f"a path from one cell to another is needed, not {len(cells)} cells that end where they begin")
    inside = np.all((cells >= 0) & (cells < blocked.shape), axis=1)
    if not inside.all() or blocked[tuple(cells.T)].any():
        wrong = cells[~inside] if not inside.all() else cells[blocked[tuple(cells.T)]]
        raise ValueError(f"cell {tuple(wrong[0].tolist())} of the path is blocked or outside the grid {blocked.shape}")
    walls = np.argwhere(blocked)
    nearest = KDTree(walls).query(cells)[0] if len(walls) else np.full(len(cells), math.inf)
    means = [[_visibility(blocked, r, c), _dispersion(blocked, r, c), _narrowest(blocked, r, c)] for r, c in cells.tolist()]
    visibility, dispersion, narrowest = np.mean(means, axis=0).tolist()
    length = float(np.linalg.norm(np.diff(cells, axis=0), axis=1).sum())
    return Difficulty(
        closest_obstacle=float(np.mean(nearest)) * size,
        visibility=visibility * size,
        dispersion=dispersion,
        characteristic_dimension=narrowest * size,
        tortuosity=length / math.dist(cells[0], cells[-1]),
    )


def _free_steps(blocked: NDArray[np.bool_], row: int, col: int, step: tuple[int, int], most: int) -> tuple[int, bool]:
    """How many steps, at most `most`, end in free cells of the grid; and whether a blocked one ended them."""
    for k in range(most):
        row, col = row + step[0], col + step[1]
        if not (0 <= row < blocked.shape[0] and 0 <= col < blocked.shape[1]):
            return k, False
        if blocked[row, col]:
            return k, True
    return most, False


def _visibility(blocked: NDArray[np.bool_], row: int, col: int) -> float:
    far = sum(blocked.shape)
    steps = [step for axis in _AXES for step in (axis, (-axis[0], -axis[1]))]
    return sum((1 + _free_steps(blocked, row, col, step, far)[0]) * math.hypot(*step) for step in steps) / len(steps)


def _dispersion(blocked: NDArray[np.bool_], row: int, col: int) -> int:
    # A step between the diagonals and the axes counts for two.
    hit = [_free_steps(blocked, row, col, step, -(-_REACH // max(map(abs, step))))[1] for step in _ROUND]
    return sum(a != b for a, b in zip(hit, hit[1:] + hit[:1], strict=True))


def _narrowest(blocked: NDArray[np.bool_], row: int, col: int) -> float:
    far = sum(blocked.shape)
    ways = []
    for axis in _AXES:
        there, back = (_free_steps(blocked, row, col, step, far)[0] for step in (axis, (-axis[0], -axis[1])))
        ways.append((there + back) * math.hypot(*axis))
    return min(ways)
