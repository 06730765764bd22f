"""Bug1: round every obstacle once, then leave it where it comes closest to the goal.

Lumelsky and Stepanov, Path-planning strategies for a point mobile automaton moving amidst unknown obstacles of arbitrary shape,
Algorithmica 2, 1987, section 3. The obstacle is grown by the virtual circle, so that the robot is a point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from robocar.core import Array, Context, GiveUp, Points
from robocar.core.trace import Drawable
from robocar.planners.bugs.bug import build_bug
from robocar.planners.bugs.motion import Boundary
from robocar.planners.bugs.view import HIT, LEAVE, LOOP, LOOP_LENGTH, BugView, Move, To
from robocar.planners.navigators.reactive import Reactive

_SIDE = 1  # the local direction, left or right, is arbitrary but fixed: the obstacle stays on the left hand
_OVERSHOOT = 1.0  # [m] past the place to leave at: it was missed


@dataclass(slots=True)
class _Round:
    """Once around an obstacle: where it was hit, and the place closest to the goal so far."""

    hit: Array
    boundary: Boundary
    closest: Array
    distance: float
    at: float = 0.0  # way from the hit point to the closest one [m]
    length: float = math.inf  # of the whole round, once it is known [m]


class Bug1:
    """The strategy. A goal that is not to be seen from the leave point is unreachable: it gives up."""

    def __init__(self) -> None:
        self._round: _Round | None = None

    def step(self, view: BugView) -> Move:
        """To the goal; where something is hit, once round it, and back to its closest place."""
        if self._round is None:
            if view.goal_is_open(HIT):
                return To(view.goal.position)
            boundary = Boundary(_SIDE, view.goal_heading - _SIDE * math.pi / 2)
            self._round = _Round(view.centre, boundary, view.centre, view.goal_distance)
        trip = self._round
        if math.isinf(trip.length):
            if view.goal_distance < trip.distance:
                trip.closest, trip.distance, trip.at = view.centre, view.goal_distance, trip.boundary.travelled
            if trip.boundary.travelled > LOOP_LENGTH and math.dist(view.centre, trip.hit) < LOOP:
                self._turn_back(trip)
            else:
                return trip.boundary.move(view)
        if math.dist(view.centre, trip.closest) < HIT:
            if not view.goal_is_open(LEAVE):
                return GiveUp("once round the obstacle, and its place closest to the goal does not lead there")
            self._round = None
            return To(view.goal.position)
        if trip.boundary.travelled > trip.length + _OVERSHOOT:
            return GiveUp("the place to leave the obstacle at is not there any more", "stuck")
        return trip.boundary.move(view)

    def _turn_back(self, trip: _Round) -> None:
        """The shorter way along the boundary to the closest place."""
        trip.length = trip.boundary.travelled
        if trip.at <= 0.5 * trip.length:
            trip.boundary = Boundary(_SIDE, trip.boundary.heading)
        else:
            trip.boundary = Boundary(-_SIDE, trip.boundary.heading + math.pi)

    def trace(self, view: BugView) -> dict[str, Drawable]:
        """The leave point so far."""
        if self._round is None:
            return {}
        return {"leave_point": Points(self._round.closest[None], radius=0.04)}


def build(context: Context) -> Reactive:
    """Bug1 for the context's robot."""
    return build_bug(context, Bug1())
