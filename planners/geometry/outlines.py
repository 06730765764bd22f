"""The costmap seen from the robot: how far its outline can go along an arc, or turn, and with how much room to spare."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import SE2, Array, Costmap, Footprint
from robocar.planners.geometry.collision import footprint_free

SLIP = 0.005
"""[m] the outline is kept at least this far off what it could touch: a skid-steered car strays so far from an arc that it slowly
drives, or brakes on (`docs/doors.md`)."""

_CRAMPED = (0.75, 0.5, 0.25, 0.1)  # of `SLIP`
_SLIM = 0.75  # of the outline
_STRAY = 0.2  # of the way that the robot makes at most in a control period, how far its corners stray in it
_SWING = 0.002  # [m] a corner swings aside between two looks at an arc or turn
_STEP = 0.02  # [m] between two looks, at most half a cell
_NOTHING = np.zeros((1, 1), dtype=np.uint8)
_NOTHING.flags.writeable = False


@njit(cache=True)
def free_arc(
    costs: NDArray, x: float, y: float, theta: float, curvature: float, length: float, n: int, vertices: Array, walled: bool
) -> tuple[float, float]:
    """The share of an arc (backwards where `length` is negative) along which the outline stays free, 0 to exactly 1, and the
    highest cost that the robot's centre meets there, both from `n` looks. Pose, lengths in cells, curvature in 1 / cells."""
    rows, cols = costs.shape
    sign = 1.0 if length >= 0.0 else -1.0
    length = abs(length)
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
def free_turn(costs: NDArray, x: float, y: float, theta: float, angle: float, n: int, vertices: Array, walled: bool) -> bool:
    """Whether the outline stays free while turning on the spot by `angle` [rad], from `n` looks."""
    free = True
    for i in range(1, n + 1):
        free = free and footprint_free(costs, x, y, theta + angle * i / n, vertices, walled)
    return free


@dataclass(frozen=True, slots=True, eq=False)
class CostmapView:
    """The costmap seen from the robot.

    Args:
        x, y, theta: the pose in grid coordinates [cells, cells, rad].
        outline: to keep free, (n, 2) [cells]; None where the car seems to stand in an obstacle.
        reach: of the outline's corners [m].
        roomy: whether the outline has room for errors of driving, not for slip alone.
        walled: see `Costmap`.
        touching: whether the car seems to stand in an obstacle, so that the outline is slim or None.
    """

    costs: NDArray[np.uint8]
    resolution: float
    x: float
    y: float
    theta: float
    outline: Array | None
    reach: float
    roomy: bool = True
    walled: bool = False
    touching: bool = False

    def free_arc(self, curvature: float, length: float) -> tuple[float, float]:
        """How far along the arc [1/m, m] the car can go [m], exactly |length| where nothing is in the way, and the highest cost
        there."""
        if self.outline is None:
            return abs(length), 252.0
        r = self.resolution
        n = max(math.ceil(abs(length) / min(_STEP, 0.5 * r)), self._looks(curvature * length))
        share, highest = free_arc(self.costs, self.x, self.y, self.theta, curvature * r, length / r, n, self.outline, self.walled)
        # A share, since a length in cells and back loses a bit: what is free would now and then seem shorter than was asked for.
        return abs(length) * share, highest

    def free_turn(self, angle: float) -> bool:
        if self.outline is None:
            return True
        return free_turn(self.costs, self.x, self.y, self.theta, angle, self._looks(angle), self.outline, self.walled)

    def _looks(self, turn: float) -> int:
        """How many it takes while the heading changes by `turn` [rad]: what a corner passes in between stays unseen."""
        return max(1, math.ceil(abs(turn) * self.reach / _SWING))


class Outlines:
    """The robot's outline with room around it: roomy, or tight, with `SLIP` only.

    Those that are free where the robot stands are kept free on its way. Nearer to something than `SLIP` it keeps the distance
    that it has, about. The slim one lets it drive out of what it touches only in its belief, or by a misplaced echo.

    Args:
        padding: of the roomy outline, at least `SLIP` [m].
        stride: the way that the robot makes at most in a control period: the roomy outline has room for what it strays [m].
    """

    def __init__(self, footprint: Footprint, padding: float, stride: float = 0.0) -> None:
        margins = (max(padding, SLIP, _STRAY * stride), SLIP, *(share * SLIP for share in _CRAMPED), 0.0)
        self._outlines = [np.array(footprint.padded(margin).vertices) for margin in margins]  # (n, 2) [m]
        self._outlines.append(_SLIM * footprint.vertices)
        self.roomy = self._outlines[0]
        """(n, 2) [m]"""
        self._reach = footprint.circumscribed_radius
        self._resolution, self._in_cells = 1.0, self._outlines

    def views(self, costmap: Costmap | None, pose: SE2) -> list[CostmapView]:
        """The place with each outline to keep free there, roomy ones first; None is a world without obstacles."""
        if costmap is None:
            return [CostmapView(_NOTHING, 1.0, pose.x, pose.y, pose.theta, self._outlines[0], self._reach)]
        resolution = costmap.resolution
        if resolution != self._resolution:
            self._resolution, self._in_cells = resolution, [outline / resolution for outline in self._outlines]
        at = costmap.origin.inverse() @ pose
        x, y, costs, walled = at.x / resolution, at.y / resolution, costmap.data, costmap.walled

        def view(outline: Array | None) -> CostmapView:
            roomy = outline is self._in_cells[0]
            touching = outline is None or outline is self._in_cells[-1]
            return CostmapView(costs, resolution, x, y, at.theta, outline, self._reach, roomy, walled, touching)

        free = (outline for outline in self._in_cells if footprint_free(costs, x, y, at.theta, outline, walled))
        widest = next(free, None)
        return [view(widest), view(self._in_cells[1])] if widest is self._in_cells[0] else [view(widest)]
