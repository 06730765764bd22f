"""Whether the map that the robot was given proves that it cannot get to its goal.

The only place that says `no_path`. What was seen is no proof: echoes lie, what stands in a door goes away. Nor are cells, or an
outline with padding: a gap that is too tight for a planner may be wide enough for the robot.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from robocar.core import SE2, Array, GiveUp, Goal, OccupancyGrid, Unreachable
from robocar.core.compiling import warm_up
from robocar.core.distance import lattice_distance

_FINE = 0.02  # [m] nodes at least this close, where that makes no more than
_MAX_NODES = 4_000_000  # of them; more where the map itself has more cells
_TOUCHING = np.ones((3, 3), dtype=bool)


def unreachable(known: OccupancyGrid, places: ArrayLike, goal: Goal, radius: float, walled: bool = True) -> bool:
    """Whether no path leads a disc from any of the places to the goal, within its tolerance, off all occupied cells.

    True is a proof, False is none. Where there is a path, each of its points has a node of a lattice of side h nearby, at most
    h / sqrt(2) away, whose distance to the obstacles is at least the radius minus that, and nodes of neighbouring points touch.
    So where places and goal lie in different components of such nodes, there is no path. Unknown cells are free.

    Args:
        known: the map that the robot was given.
        places: where the robot may be, (n, 2) [m]; one where the disc does not fit proves that map or pose are wrong.
        radius: of the footprint's inscribed circle [m].
        walled: whether walls stand around the map; else the disc may go around it.
    """
    resolution, mask, origin = known.resolution, known.occupied, known.origin
    if not walled and not known.contains(known.cell_from_world(goal.position)):
        return False
    if not walled:
        rim = math.ceil(2.0 * radius / resolution) + 1
        mask, origin = np.pad(mask, rim), known.origin @ SE2(-rim * resolution, -rim * resolution)
    fine = 1
    while resolution / fine > _FINE and 4 * fine * fine * mask.size <= _MAX_NODES:
        fine *= 2
    spacing = resolution / fine
    slack = math.sqrt(0.5) * spacing
    if radius <= slack:
        return False
    # Rounding must not close what is just wide enough.
    labels, _ = ndimage.label(lattice_distance(mask, fine) * resolution >= radius - slack - 1e-9, _TOUCHING)  # type: ignore[misc]

    def near(point: Array, reach: float) -> set[int]:
        """Components with a node within `reach` [m] of a point."""
        x, y = origin.inverse().transform(point) / spacing
        cells = math.ceil(reach / spacing) + 1
        r0, c0 = max(0, math.floor(y) - cells), max(0, math.floor(x) - cells)
        window = labels[r0 : max(0, math.ceil(y) + cells + 1), c0 : max(0, math.ceil(x) + cells + 1)]
        rows, cols = np.mgrid[: window.shape[0], : window.shape[1]]
        close = np.hypot(rows + r0 - y, cols + c0 - x) * spacing <= reach + 1e-9
        return set(np.unique(window[close]).tolist()) - {0}

    ends = near(np.asarray(goal.position), goal.xy_goal_tolerance + slack)
    starts = [near(np.asarray(place, dtype=float), slack) for place in np.asarray(places, dtype=float).reshape(-1, 2)]
    return all(start and not start & ends for start in starts)


class Proof:
    """What a navigator may claim when it gives up.

    Args:
        known: the map that the robot was given, or None: then nothing is ever proved.
        radius: of the footprint's inscribed circle [m].
        walled: see `unreachable`.
    """

    def __init__(self, known: OccupancyGrid | None, radius: float, walled: bool = True) -> None:
        self._known, self._radius, self._walled = known, radius, walled
        self._first: Array | None = None
        _warm_up()

    def begin(self, place: Array) -> None:
        """The robot began here (2,) [m]: the first call counts. A pose that has drifted through a wall proves nothing."""
        self._first = place if self._first is None else self._first

    def judged(self, failure: GiveUp, place: Array, goal: Goal) -> GiveUp:
        """The claim of a navigator that has found no way from `place` (2,) [m]: `no_path` where the map proves it."""
        places = [place] if self._first is None else [place, self._first]
        if self._known is None or not unreachable(self._known, places, goal, self._radius, self._walled):
            return failure
        return GiveUp.because(Unreachable(f"{failure.reason}; the map proves that there is none", failure.trace))


@warm_up
def _warm_up() -> None:
    lattice_distance(np.zeros((2, 2), dtype=bool), 1)
