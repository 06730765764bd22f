"""Bug2: follows an obstacle until it meets the line from start to goal again, closer to the goal.

Lumelsky and Stepanov, Path-planning strategies for a point mobile automaton moving amidst unknown obstacles of arbitrary shape,
Algorithmica 2, 1987, section 4. The obstacle is grown by the virtual circle, so that the robot is a point.
"""

from __future__ import annotations

import math

import numpy as np

from robocar.core import Array, Context, GiveUp, Lines
from robocar.core.trace import Drawable
from robocar.planners.bugs.bug import build_bug
from robocar.planners.bugs.motion import Boundary
from robocar.planners.bugs.view import HIT, LEAVE, LOOP, LOOP_LENGTH, BugView, Move, To
from robocar.planners.navigators.reactive import Reactive

_SIDE = 1  # the local direction, left or right, is arbitrary but fixed: the obstacle stays on the left hand
_ON_LINE = 0.05  # [m]
_CLOSER = 0.1  # [m] to the goal than where the obstacle was hit


class Bug2:
    """The strategy. Back at the hit point without having met the line closer to the goal, there is no way: it gives up."""

    def __init__(self) -> None:
        self._start: Array | None = None
        self._boundary: Boundary | None = None
        self._offset = 0.0

    def step(self, view: BugView) -> Move:
        """To the goal; where something is hit, along it to the next place on the line that is closer to the goal."""
        if self._start is None:
            self._start = view.centre
        if self._boundary is None:
            if view.goal_is_open(HIT):
                return To(view.goal.position)
            self._boundary = Boundary(_SIDE, view.goal_heading - _SIDE * math.pi / 2)
            self._hit, self._hit_distance = view.centre, view.goal_distance
            self._offset = self._off_line(view)
        last, self._offset = self._offset, self._off_line(view)
        on_line = abs(self._offset) < _ON_LINE or last * self._offset < 0.0
        if on_line and view.goal_distance < self._hit_distance - _CLOSER and view.goal_is_open(LEAVE):
            self._boundary = None
            return To(view.goal.position)
        if self._boundary.travelled > LOOP_LENGTH and math.dist(view.centre, self._hit) < LOOP:
            return GiveUp("once round the obstacle, and the line to the goal was not met closer to it")
        return self._boundary.move(view)

    def _off_line(self, view: BugView) -> float:
        """Signed distance from the line through start and goal [m]."""
        assert self._start is not None
        line = view.goal.position - self._start
        length = max(float(np.hypot(*line)), 1e-9)
        dx, dy = view.centre - self._start
        return float(line[0] * dy - line[1] * dx) / length

    def trace(self, view: BugView) -> dict[str, Drawable]:
        """The m-line."""
        return {} if self._start is None else {"m_line": Lines((np.array([self._start, view.goal.position]),))}


def build(context: Context) -> Reactive:
    """Bug2 for the context's robot."""
    return build_bug(context, Bug2())
