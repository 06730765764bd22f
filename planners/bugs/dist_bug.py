"""DistBug: leaves an obstacle as soon as what it sees promises to bring it closer to the goal than ever.

Kamon and Rivlin, Sensory-based motion planning with global proofs, IEEE Transactions on Robotics and Automation 13(6), 1997: with
F the free distance in the direction of the goal, the boundary is left where d(x, goal) - F <= d_min - STEP. The obstacle is grown
by the virtual circle, so that the robot is a point.
"""

from __future__ import annotations

import math

import numpy as np

from robocar.core import Array, Context, GiveUp, Lines
from robocar.core.trace import Drawable
from robocar.planners.bugs.bug import build_bug
from robocar.planners.bugs.motion import Boundary, nearer_side
from robocar.planners.bugs.view import HIT, LEAVE, LOOP, LOOP_LENGTH, BugView, Move, To
from robocar.planners.navigators.reactive import Reactive

_STEP = 0.2  # [m] the improvement that leaving has to promise


class DistBug:
    """The strategy. Back at the hit point without a reason to leave, there is no way: it gives up."""

    def __init__(self) -> None:
        self._boundary: Boundary | None = None

    def step(self, view: BugView) -> Move:
        """To the goal; where something is hit, along it, starting to the side that takes the smaller turn."""
        if self._boundary is None:
            if view.goal_is_open(HIT):
                return To(view.goal.position)
            side = nearer_side(view)
            self._boundary = Boundary(side, view.goal_heading - side * math.pi / 2)
            self._hit: Array = view.centre
            self._closest = view.goal_distance
        self._closest = min(self._closest, view.goal_distance)
        free = view.free_way(view.goal_heading, view.goal_distance)
        if view.goal_in_sight() or (free >= LEAVE and view.goal_distance - free <= self._closest - _STEP):
            self._boundary = None
            return To(view.goal.position)
        if self._boundary.travelled > LOOP_LENGTH and math.dist(view.centre, self._hit) < LOOP:
            return GiveUp("once round the obstacle, and no place on it led closer to the goal")
        return self._boundary.move(view)

    def trace(self, view: BugView) -> dict[str, Drawable]:
        """The way that is free towards the goal."""
        free = view.free_way(view.goal_heading, view.goal_distance)
        end = view.centre + free * (view.goal.position - view.centre) / max(view.goal_distance, 1e-9)
        return {"free_distance": Lines((np.array([view.centre, end]),))}


def build(context: Context) -> Reactive:
    """DistBug for the context's robot."""
    return build_bug(context, DistBug())
