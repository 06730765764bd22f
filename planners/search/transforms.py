"""Distance, obstacle and path transform: the numbers that cells carry in the methods of Jarvis and of Zelinsky.

The distance transform holds each free cell's way to the goal (Jarvis 1993), the obstacle transform its distance to the nearest
obstacle, and the path transform the cheapest way where nearness to obstacles costs (Zelinsky, Int. J. Robotics Research 13(4),
1994). All values are in cells; a cell's centre lies at (row + 0.5, column + 0.5).
"""

from __future__ import annotations

import math
from typing import Literal, TypeAlias, get_args

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core import Array
from robocar.core.distance import distance_transform as exact_distance
from robocar.planners.search.grid_search import COL_STEPS, ROW_STEPS
from robocar.planners.search.wavefront import eikonal, wave

Metric: TypeAlias = Literal["jarvis", "octile", "euclidean"]
METRICS: tuple[Metric, ...] = get_args(Metric)
Seeds: TypeAlias = tuple[NDArray[np.int64], Array]
"""Cells (n, 2) as (row, col) from which a wave starts, and the values (n,) that they have from the start."""

_DIAGONAL = {"jarvis": 1.0, "octile": math.sqrt(2.0)}
_NEAR = 5  # [cells] around the goal, where the eikonal equation's first-order solution is at its worst and the exact one is known


def distance_transform(
    blocked: ArrayLike, goal: ArrayLike, metric: Metric = "octile", until: tuple[int, int] | None = None
) -> Array:
    """Way from every free cell to the goal through free cells.

    Args:
        blocked: (rows, cols) bool.
        goal: (row, col) of the goal's cell as whole numbers, or of a point in continuous coordinates. Outside the grid nothing is
            blocked, and the way there enters through the outermost cells, of which those that face the goal should be free.
        metric: `jarvis`: each of the eight neighbours is one step away (the paper's natural numbers); `octile`: sqrt(2) to the
            diagonal ones, exact shortest grid paths; both without cutting corners. `euclidean`: viscosity solution of the eikonal
            equation |grad u| = 1 (first-order upwind scheme: Sethian 1996), which has no favourite directions.
        until: a cell (row, col); the wave stops when it and all cells that are nearer to the goal are final.

    Returns:
        (rows, cols) [cells]; inf where blocked, unreachable or beyond `until`.

    Raises:
        ValueError: not a grid, a goal that is not two finite numbers, or a metric that does not exist.
    """
    mask = _mask(blocked)
    return spread(mask, goal_seeds(mask, goal, metric), metric, until)


def goal_seeds(blocked: NDArray[np.bool_], goal: ArrayLike, metric: Metric) -> Seeds:
    """Where the wave of a goal starts on a grid, and with which distances: at the goal, or at the edge of the grid that faces it.

    Args and errors: see `distance_transform`. The goal's cell may be blocked: the wave starts nowhere then.
    """
    point = np.asarray(goal, dtype=float)
    if point.shape != (2,) or not np.all(np.isfinite(point)):
        raise ValueError(f"the goal takes a row and a column, finite numbers, not {goal}")
    if metric not in METRICS:
        raise ValueError(f"metric {metric!r} is none of {', '.join(METRICS)}")
    rows, cols = blocked.shape
    if np.asarray(goal).dtype.kind in "iu":
        point = point + 0.5  # a cell: its centre
    row, col = math.floor(point[0]), math.floor(point[1])
    if 0 <= row < rows and 0 <= col < cols:
        cells = np.array([[row, col]])
        if metric == "euclidean":
            near = _DISC + (row, col)  # noqa: RUF005
            near = near[np.hypot(*(near + 0.5 - point).T) <= _NEAR]
            inside = np.all((near >= 0) & (near < (rows, cols)), axis=1)
            if not blocked[tuple(near[inside].T)].any():
                cells = near[inside]
        cells = cells[~blocked[tuple(cells.T)]]
    else:
        cells = _facing(np.ascontiguousarray(blocked), row, col)
    if metric == "euclidean":
        return cells, np.hypot(cells[:, 0] + 0.5 - point[0], cells[:, 1] + 0.5 - point[1])
    steps = np.abs(cells - (row, col))
    return cells, steps.max(axis=1) + (_DIAGONAL[metric] - 1.0) * steps.min(axis=1)


def spread(blocked: NDArray[np.bool_], seeds: Seeds, metric: Metric, until: tuple[int, int] | None = None) -> Array:
    """The wave of `distance_transform` from given cells, none of them blocked."""
    rows, cols = blocked.shape
    cells, values = seeds
    order = np.argsort(values, kind="stable")
    padded = np.ones((rows + 2, cols + 2), dtype=np.bool_)
    padded[1:-1, 1:-1] = blocked
    flat = (cells[order, 0] + 1) * (cols + 2) + cells[order, 1] + 1
    stop = -1 if until is None or blocked[until] else (until[0] + 1) * (cols + 2) + until[1] + 1
    if metric == "euclidean":
        front = eikonal(padded.ravel(), cols + 2, flat, values[order], stop)
    else:
        front = wave(padded.ravel(), cols + 2, _NO_COSTS, _DIAGONAL[metric], flat, values[order], stop)
    return front.reshape(rows + 2, cols + 2)[1:-1, 1:-1]


def obstacle_transform(blocked: ArrayLike, metric: Metric = "euclidean") -> Array:
    """Distance from every cell's centre to that of the nearest blocked cell; outside the grid nothing is blocked.

    Args:
        blocked: (rows, cols) bool.
        metric: `euclidean`: exact (Felzenszwalb and Huttenlocher 2012; OpenCV's transform depends in its last bit on where in
            memory the cells lie, and equal seeds would give different runs); `jarvis`: in steps to eight neighbours, the natural
            numbers of the paper's Fig. 4; `octile`.

    Returns:
        (rows, cols) [cells]; 0 where blocked, inf where nothing is.
    """
    mask = _mask(blocked)
    if not mask.any():
        return np.full(mask.shape, math.inf)
    if metric == "euclidean":
        return exact_distance(mask)
    if metric not in METRICS:
        raise ValueError(f"metric {metric!r} is none of {', '.join(METRICS)}")
    cells = np.argwhere(mask)
    # All cells may be crossed: the nearest obstacle is never behind another one, nor is a corner cut.
    return spread(np.zeros_like(mask), (cells, np.zeros(len(cells))), metric)


def grown(blocked: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Obstacles grown (Jarvis): the cells whose centre is nearer than `radius` [cells] to that of a blocked one.

    The same as `obstacle_transform(blocked) < radius`, but a growth of a few cells costs less this way.
    """
    if not 0.0 <= radius < math.inf:
        raise ValueError(f"obstacles grow by a finite radius, not negative, not {radius}")
    return _grown(np.ascontiguousarray(blocked), radius)


def path_transform(blocked: ArrayLike, goal: tuple[int, int], weight: float, safe_distance: float) -> Array:
    """Zelinsky's path transform: the cheapest way from every free cell to the goal, where each cell near an obstacle costs.

    Zelinsky 1994: PT(c) = min over paths p from c to the goal of length(p) + weight * sum over p's cells c_i of obstacle(c_i).
    As discomfort obstacle(c) we take (1 - o(c) / X)^3 for o(c) < X and 0 beyond, with o the (euclidean) obstacle transform and X
    the `safe_distance`: 1 at an obstacle, and falling steeply. Steps are octile, the goal's own cell does not count. The
    transform has no local minimum but the goal: descent (`descend`) finds the cheapest path.

    Args:
        blocked: (rows, cols) bool.
        goal: (row, col) of its cell, on the grid.
        weight: alpha of the paper, >= 0; 0 gives the octile distance transform.
        safe_distance: X [cells], > 0.

    Returns:
        (rows, cols) [cells]; inf where blocked or unreachable.

    Raises:
        ValueError: not a grid, a goal outside it, or numbers out of range.
    """
    mask = _mask(blocked)
    rows, cols = mask.shape
    if not (0 <= goal[0] < rows and 0 <= goal[1] < cols):
        raise ValueError(f"the goal's cell {goal} lies outside the grid of {rows} x {cols} cells")
    if not 0.0 <= weight <= 1e4:
        raise ValueError(f"weight goes from 0 to 10000, not {weight}")
    if not 0.0 < safe_distance < math.inf:
        raise ValueError(f"safe_distance must be a positive number of cells, not {safe_distance}")
    costs = np.zeros((rows + 2, cols + 2))
    costs[1:-1, 1:-1] = weight * np.maximum(1.0 - obstacle_transform(mask) / safe_distance, 0.0) ** 3
    padded = np.ones((rows + 2, cols + 2), dtype=np.bool_)
    padded[1:-1, 1:-1] = mask
    start = np.array([] if mask[goal] else [(goal[0] + 1) * (cols + 2) + goal[1] + 1], dtype=np.int64)
    front = wave(padded.ravel(), cols + 2, costs.ravel(), _DIAGONAL["octile"], start, np.zeros(len(start)), -1)
    return front.reshape(rows + 2, cols + 2)[1:-1, 1:-1]


def descend(values: Array, cell: tuple[int, int], diagonal: float = math.sqrt(2.0)) -> NDArray[np.int64]:
    """Path of steepest decrease over a transform: from cell to cell of the eight neighbours, no corner cut, down to a minimum.

    Args:
        values: (rows, cols), inf where blocked.
        cell: (row, col) to start from.
        diagonal: length of a diagonal step; 1 takes the neighbour with the smallest value, as the paper's Fig. 3 does.

    Returns:
        Cells (n, 2) as (row, col), `cell` first; only that where nothing around it is lower.
    """
    return _descend(np.array(values, dtype=float, order="C"), cell[0], cell[1], diagonal)


def nearest_blocked(blocked: NDArray[np.bool_], cell: tuple[int, int]) -> float:
    """One value of the euclidean `obstacle_transform` [cells]; inf where nothing is blocked."""
    return math.sqrt(_least_squared(np.ascontiguousarray(blocked), cell[0], cell[1]))


_NO_COSTS = np.zeros(0)
_DISC = np.argwhere(np.ones((2 * _NEAR + 1, 2 * _NEAR + 1))) - _NEAR


def _mask(blocked: ArrayLike) -> NDArray[np.bool_]:
    mask = np.array(blocked, dtype=np.bool_, order="C")
    if mask.ndim != 2 or mask.size == 0:
        raise ValueError(f"blocked cells need rows and columns, not shape {mask.shape}")
    return mask


@njit(cache=True)
def _facing(blocked: NDArray, row: int, col: int) -> NDArray[np.int64]:
    """Free cells (n, 2) of those edges of a grid that face a cell outside."""
    rows, cols = blocked.shape
    cells = np.empty((2 * (rows + cols), 2), dtype=np.int64)
    n = 0
    for r, faces in ((0, row < 0), (rows - 1, row >= rows)):
        for c in range(cols if faces else 0):
            if not blocked[r, c]:
                cells[n] = r, c
                n += 1
    for c, faces in ((0, col < 0), (cols - 1, col >= cols)):
        for r in range(rows if faces else 0):
            if not blocked[r, c]:
                cells[n] = r, c
                n += 1
    return cells[:n]


@njit(cache=True)
def _least_squared(blocked: NDArray, row: int, col: int) -> float:
    least = math.inf
    for r in range(blocked.shape[0]):
        for c in range(blocked.shape[1]):
            if blocked[r, c]:
                least = min(least, float((r - row) ** 2 + (c - col) ** 2))
    return least


@njit(cache=True)
def _grown(blocked: NDArray, radius: float) -> NDArray[np.bool_]:
    rows, cols = blocked.shape
    result = np.zeros((rows, cols), dtype=np.bool_)
    if radius <= 0.0:
        return result
    # By row offset the half width of the disc. The root is compared, as by those who compare distances.
    reach = min(math.ceil(radius), rows + cols)
    half = np.full(reach + 1, -1, dtype=np.int64)
    for i in range(reach + 1):
        while half[i] < reach and math.sqrt(float(i * i + (half[i] + 1) ** 2)) < radius:
            half[i] += 1
    for row in range(rows):
        for col in range(cols):
            if not blocked[row, col]:
                continue
            for r in range(max(0, row - reach), min(rows, row + reach + 1)):
                width = half[abs(r - row)]
                for c in range(max(0, col - width), min(cols, col + width + 1)):
                    result[r, c] = True
    return result


@njit(cache=True)
def _descend(values: NDArray, row: int, col: int, diagonal: float) -> NDArray[np.int64]:
    rows, cols = values.shape
    cells = np.empty((values.size, 2), dtype=np.int64)
    cells[0] = row, col
    n = 1
    while n < len(cells):  # values fall from cell to cell, so none is visited twice
        here = values[row, col]
        best, slope = -1, 0.0
        for k in range(8):
            r, c = row + ROW_STEPS[k], col + COL_STEPS[k]
            if not (0 <= r < rows and 0 <= c < cols) or not values[r, c] < here:
                continue
            if k >= 4 and (values[row, c] == math.inf or values[r, col] == math.inf):
                continue
            fall = (here - values[r, c]) / (1.0 if k < 4 else diagonal) if here < math.inf else -values[r, c]
            if best < 0 or fall > slope:
                best, slope = k, fall
        if best < 0:
            break
        row, col = row + ROW_STEPS[best], col + COL_STEPS[best]
        cells[n] = row, col
        n += 1
    return cells[:n]
