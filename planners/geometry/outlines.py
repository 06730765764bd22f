"""The costmap seen from the robot: how far its outline can go along an arc, or turn, and with how much room to spare."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import SE2, Array, Costmap, Footprint
from robocar.planners.geometry.collision import footprint_free

_SLIM = 0.75  # of the outline
_NOTHING = np.zeros((1, 1), dtype=np.uint8)
_NOTHING.flags.writeable = False


@njit(cache=True)
def free_arc(
    costs: NDArray, x: float, y: float, theta: float, curvature: float, length: float, step: float, vertices: Array, walled: bool
) -> tuple[float, float]:
    """The share of an arc (backwards where `length` is negative) along which the outline stays free, 0 to exactly 1, and the
    highest cost that the robot's centre meets there. Pose, lengths in cells, curvature in 1 / cells."""
    rows, cols = costs.shape
    sign = 1.0 if length >= 0.0 else -1.0
    length = abs(length)
    n = max(1, math.ceil(length / step))
    highest = 0.0
    for i in range(1, n + 1):
        s = sign * length * i / n
        turn = curvature * s
        if abs(turn) < 1e-9:
            forward, left = s, 0.5 * s * turn
        else:
            forward, left = math.sin(turn) / curvature, (1.0 - math.cos(turn)) / curvature
        px = x + forward * math.cos(theta) - left * math.sin(theta)
        py = y + forward * math.sin(theta) + left * math.cos(theta)
        if not footprint_free(costs, px, py, theta + turn, vertices, walled):
            return (i - 1) / n, highest
        row, col = math.floor(py), math.floor(px)
        if 0 <= row < rows and 0 <= col < cols:
            highest = max(highest, float(min(costs[row, col], np.uint8(252))))
    return 1.0, highest


@njit(cache=True)
def free_turn(costs: NDArray, x: float, y: float, theta: float, angle: float, vertices: Array, walled: bool) -> bool:
    """Whether the outline stays free while turning on the spot by `angle` [rad]."""
    n = max(1, math.ceil(abs(angle) / 0.05))
    free = True
    for i in range(1, n + 1):
        free = free and footprint_free(costs, x, y, theta + angle * i / n, vertices, walled)
    return free


@dataclass(frozen=True, slots=True, eq=False)
class CostmapView:
    """The costmap seen from the robot: pose in grid coordinates, outline in cells; None where the car seems to stand in an
    obstacle. `roomy`: whether the outline is padded, so that small errors of driving do no harm; `walled`: see `Costmap`."""

    costs: NDArray[np.uint8]
    resolution: float
    x: float
    y: float
    theta: float
    outline: Array | None
    roomy: bool = True
    walled: bool = False

    def free_arc(self, curvature: float, length: float) -> tuple[float, float]:
        """How far along the arc [1/m, m] the car can go [m], exactly |length| where nothing is in the way, and the highest cost
        there."""
        if self.outline is None:
            return abs(length), 252.0
        r = self.resolution
        share, highest = free_arc(
            self.costs, self.x, self.y, self.theta, curvature * r, length / r, min(0.5, 0.02 / r), self.outline, self.walled
        )
        # A share, since a length in cells and back loses a bit: what is free would now and then seem shorter than was asked for.
        return abs(length) * share, highest

    def free_turn(self, angle: float) -> bool:
        return self.outline is None or free_turn(self.costs, self.x, self.y, self.theta, angle, self.outline, self.walled)


class Outlines:
    """The robot's outline, roomy, exact and slim.

    The first one that is free where the robot stands is kept free on its way. The slim one lets it drive out of what it touches
    only in its belief, or by a misplaced echo.

    Args:
        padding: of the roomy outline [m].
    """

    def __init__(self, footprint: Footprint, padding: float) -> None:
        shares = (1.0 + padding / footprint.inscribed_radius, 1.0, _SLIM)
        self._outlines = [np.array(footprint.vertices * share) for share in shares]  # (n, 2) [m]
        self._resolution, self._in_cells = 1.0, self._outlines

    def views(self, costmap: Costmap | None, pose: SE2) -> list[CostmapView]:
        """The place with each outline that is free there, roomy ones first; None is a world without obstacles."""
        if costmap is None:
            return [CostmapView(_NOTHING, 1.0, pose.x, pose.y, pose.theta, self._outlines[0])]
        resolution = costmap.resolution
        if resolution != self._resolution:
            self._resolution, self._in_cells = resolution, [outline / resolution for outline in self._outlines]
        at = costmap.origin.inverse() @ pose
        x, y = at.x / resolution, at.y / resolution
        roomy, exact, slim = self._in_cells
        costs, walled = costmap.data, costmap.walled
        free = [outline for outline in (roomy, exact) if footprint_free(costs, x, y, at.theta, outline, walled)]
        if not free:
            free = [slim if footprint_free(costs, x, y, at.theta, slim, walled) else None]
        return [CostmapView(costs, resolution, x, y, at.theta, outline, outline is roomy, walled) for outline in free]
