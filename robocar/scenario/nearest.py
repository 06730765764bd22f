"""The answer to a start or a goal that does not fit: the nearest pose that does."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from robocar.core import SE2, Array, GridMap

MOST_TRIALS = 5000
"""Cells that are tried in full: where the robot is too long for every corridor, all of them would be."""
_FIRST_RING = 32  # cells


def nearest_free(
    grid: GridMap, point: Array, heading: float | None, room: Callable[[Array], Array], fits: Callable[[SE2], bool]
) -> str:
    """`; the nearest free pose is (x, y, theta)`: the centre of the nearest cell where it fits, as it can be typed.

    Args:
        grid: the map.
        point: where it was wanted, (2,) [m]; heading: that it must fit in [rad], None where that is not asked for.
        room: a quick answer for many points (n, 2) [m]: those of no positive room are not tried.
        fits: whether the robot fits there.
    """
    tried = 0
    for centres in _rings(grid, point):
        for centre in centres[room(centres) > 0.0]:
            x, y = (float(f"{value:.6g}") for value in centre)  # as it is printed
            if fits(SE2(x, y, heading or 0.0)):
                pose = f"({x:g}, {y:g})" if heading is None else f"({x:g}, {y:g}, {heading:g})"
                return f"; the nearest free pose is {pose}, {math.dist((x, y), point):.2g} m away"
            tried += 1
            if tried == MOST_TRIALS:
                return ""
    return "; there is no free pose on this map"


def _rings(grid: GridMap, point: Array) -> Iterator[Array]:
    """Centres of all cells, (n, 2) [m], the nearest first, in rings that double: mostly the first one is enough."""
    middle = np.clip(grid.cell_from_world(point), 0, np.array(grid.shape) - 1)
    start = math.dist(grid.world_from_cell(middle), point)
    inner, ring = -1.0, _FIRST_RING
    while True:
        low, high = np.maximum(middle - ring, 0), np.minimum(middle + ring + 1, grid.shape)
        whole = bool((low == 0).all() and (high == grid.shape).all())
        cells = np.stack(np.meshgrid(*(np.arange(*ends) for ends in zip(low, high, strict=True)), indexing="ij"), axis=-1)
        centres = grid.world_from_cell(cells.reshape(-1, 2))
        away = np.linalg.norm(centres - point, axis=1)
        # Cells beyond the window may be as near as its edge is, so the ring ends there.
        outer = math.inf if whole else max(ring * grid.resolution - start, 0.0)
        chosen = np.flatnonzero((away > inner) & (away <= outer))
        yield centres[chosen[np.argsort(away[chosen], kind="stable")]]
        if whole:
            return
        inner, ring = outer, 2 * ring
