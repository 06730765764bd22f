"""A solution on a map that has changed a little, as the start for the next one.

Far from a change, w changes by a factor that varies slowly: the coarse levels find it in few cycles, with the weights they had.
Next to a new wall w falls to a fraction of what it was, and cycles over the whole map that do little but repair this are spared
by solving a window around the change first, its rim held at the old values.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.harmonic.laplace.carry import carry
from robocar.planners.harmonic.laplace.multigrid import Multigrid
from robocar.planners.harmonic.laplace.problem import LaplaceProblem
from robocar.planners.harmonic.laplace.weights import beside

MARGIN = 16
"""A window reaches this many cells beyond the change, or twice the change's side where that is more."""

LARGEST_SHARE = 0.25
"""Of the map, in windows: above it, the cycles over the whole map are as cheap."""

WINDOW_TOLERANCE, WINDOW_CYCLES = 1e-2, 20
"""The rim is off by more than a closer solution would gain."""


def warm_start(levels: Multigrid, old: Multigrid, w: Array) -> tuple[Array, list[NDArray[np.uint8]]] | None:
    """A first guess from the solution of the map before the change, and the nodes of each of `levels` still to be weighed.

    None where the old solution is of no use. The other weights of `levels` are set to those of `old`.

    Args:
        old: levels that solved the map before the change, of the same shape, with the same goals.
        w: its solution, padded (rows + 2, cols + 2).
    """
    problem = levels.problem
    guess = w.copy()
    if not _adapt(guess, problem.inverse_degree, problem.goals):
        return None
    stale = carry(old, levels)
    first = levels.levels[0]
    for window in windows(problem.inverse_degree != old.problem.inverse_degree):
        _solve_window(problem, guess, window)
        nodes = levels.parent[window]
        stale[0][nodes[nodes >= 0]] = 1
    stale[0] |= beside(first.indptr, first.indices, stale[0])  # the walk leads there with the new w
    return guess, stale


def windows(changed: NDArray[np.bool_]) -> list[tuple[slice, slice]]:
    """Rectangles around what has changed, none over another's changes; none at all where they cover too much of the map."""
    grown = np.zeros(changed.shape, np.uint8)
    for rows, cols in _boxes(changed):
        margin = max(MARGIN, 2 * (rows.stop - rows.start), 2 * (cols.stop - cols.start))
        grown[max(0, rows.start - margin) : rows.stop + margin, max(0, cols.start - margin) : cols.stop + margin] = 1
    found = _boxes(grown)
    area = sum((rows.stop - rows.start) * (cols.stop - cols.start) for rows, cols in found)
    return found if area <= LARGEST_SHARE * changed.size else []


def _boxes(mask: NDArray) -> list[tuple[slice, slice]]:
    """Bounding boxes of the connected pieces of a mask."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return []
    top, left = int(rows[0]), int(cols[0])  # mostly a small part of the map: labels for all of it would take longer than the rest
    part = mask[top : int(rows[-1]) + 1, left : int(cols[-1]) + 1].astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(part, connectivity=8)
    return [(slice(top + int(y), top + int(y + h)), slice(left + int(x), left + int(x + w))) for x, y, w, h, _ in stats[1:]]


def _solve_window(problem: LaplaceProblem, w: Array, window: tuple[slice, slice]) -> None:
    """Solve inside a window of the padded field, in place, with w on its rim as given."""
    inverse_degree = problem.inverse_degree[window].copy()
    inverse_degree[[0, -1], :] = 0.0  # what is not sought and yet positive is a boundary value, as the goal is
    inverse_degree[:, [0, -1]] = 0.0
    if not inverse_degree.any():
        return
    inside = LaplaceProblem(inverse_degree, np.empty((0, 2), np.intp), problem.plain)
    field = w[window].copy()
    if np.isfinite(Multigrid(inside).improve(field, WINDOW_TOLERANCE, WINDOW_CYCLES).residuals[-1]):
        w[window] = field


@njit(cache=True)
def _adapt(w, inverse_degree, goals):
    """0 at new walls, and means of their neighbours at new free cells from the old ones inwards; whether all got a value."""
    todo = []
    for r in range(w.shape[0]):
        for c in range(w.shape[1]):
            if inverse_degree[r, c] == 0:
                w[r, c] = 0.0
            elif not w[r, c] > 0.0:
                todo.append((r, c))
    for k in range(len(goals)):
        w[goals[k, 0] + 1, goals[k, 1] + 1] = 1.0
    missing = len(todo)
    before = missing + 1
    while 0 < missing < before:
        before = missing
        missing = 0
        for r, c in todo:
            w[r, c] = inverse_degree[r, c] * (w[r - 1, c] + w[r + 1, c] + w[r, c - 1] + w[r, c + 1])
            missing += w[r, c] == 0.0
    return missing == 0
