"""PointBug: from one sudden point to the next, always the one whose direction is nearest to the goal's.

Buniyamin, Wan Ngah, Sariff and Mohamad, A simple local path planning algorithm for autonomous mobile robots, International
Journal of Systems Applications, Engineering and Development 5(2), 2011. Its sudden points are open points; a robot with dimension
goes to the sub-goals beside them.
"""

from __future__ import annotations

import math

import numpy as np

from robocar.core import Array, Context, GiveUp, Points, wrap_angle
from robocar.core.trace import Drawable
from robocar.planners.bugs.bug import build_bug
from robocar.planners.bugs.open_points import OpenPoint, find_open_points
from robocar.planners.bugs.view import ARRIVED, BugParameters, BugView, Move, Stand, To
from robocar.planners.navigators.reactive import Reactive
from robocar.planners.tracking.panorama import Lookout, ScanPanorama

_SAME = 0.10  # [m] sub-goals nearer to each other are one
_AGAIN = 3  # times at the same sub-goal: it goes in circles


class PointBug:
    """The strategy. Where there is no sudden point left, or where it comes to the same one again and again, it is `stuck`."""

    def __init__(self, looks: int) -> None:
        self._lookout = Lookout(looks)
        self._target: Array | None = None
        self.visited: list[Array] = []
        self.open_points: list[OpenPoint] = []

    def step(self, view: BugView) -> Move:
        """To the goal if nothing stands in the way, else look and choose."""
        if view.goal_in_sight() and not view.blocked:
            self._target = None
            return To(view.goal.position)
        if self._target is not None and math.dist(view.centre, self._target) > ARRIVED and not view.blocked:
            return To(self._target)
        self._target = None
        panorama = self._lookout.look(view.panorama) if view.fresh else None
        if panorama is None:
            return Stand()
        self._target = self.choose(view, self._candidates(view, panorama))
        if self._target is None:
            return GiveUp(self.reason, "stuck")
        self.visited.append(self._target)
        return To(self._target)

    reason = "no sudden point leads on"

    def _candidates(self, view: BugView, panorama: ScanPanorama) -> Array:
        """Sub-goals of what is seen, (n, 2) [m]."""
        p = view.parameters
        found = find_open_points(panorama, p.range_jump, p.range_std)
        self.open_points = [point for point in found if point.sure] or found
        return np.array([point.subgoal(view.circle.radius) for point in self.open_points]).reshape(-1, 2)

    def choose(self, view: BugView, candidates: Array) -> Array | None:
        """The one whose bearing is nearest to the goal's; not the last one, nor one where it has been too often."""
        turns = [abs(wrap_angle(view.heading_to(q) - view.goal_heading)) for q in candidates]
        for k in np.argsort(turns, kind="stable"):
            last = bool(self.visited) and math.dist(self.visited[-1], candidates[k]) < _SAME
            if not last and self.times_at(candidates[k]) < _AGAIN:
                return candidates[k]
        return None

    def times_at(self, point: Array) -> int:
        """How often it has been there."""
        return sum(math.dist(point, visited) < _SAME for visited in self.visited)

    def trace(self, view: BugView) -> dict[str, Drawable]:
        """Open points and where it has been."""
        drawn: dict[str, Drawable] = {
            "open_points": Points(np.array([p.position for p in self.open_points]).reshape(-1, 2), color=(230, 60, 60)),
            "visited": Points(np.array(self.visited).reshape(-1, 2), color=(120, 120, 120)),
        }
        return drawn


def build(context: Context) -> Reactive:
    """PointBug for the context's robot."""
    return build_bug(context, PointBug(context.parameters_of(BugParameters).looks))
