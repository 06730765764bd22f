"""TangentBug: heads for the open point that promises the shortest way, follows boundaries only out of local minima.

Kamon, Rimon and Rivlin, TangentBug: a range-sensor-based navigation algorithm, International Journal of Robotics Research 17(9),
1998. The nodes of its local tangent graph are the open points; a robot with dimension goes to the sub-goals beside them. A node
is driven to before the next one is chosen, so that noise does not make the robot waver between two.
"""

from __future__ import annotations

import math

import numpy as np

from robocar.core import Array, Context, GiveUp, Points, wrap_angle
from robocar.core.trace import Drawable
from robocar.planners.bugs.bug import build_bug
from robocar.planners.bugs.motion import Boundary, nearer_side
from robocar.planners.bugs.view import ARRIVED, LOOP, LOOP_LENGTH, BugView, Move, To
from robocar.planners.navigators.reactive import Reactive

_CLOSER = 0.05  # [m] the improvement that counts
_FOLLOWED = 0.3  # [m] beyond the virtual circle: what is nearer belongs to the boundary that is followed


class TangentBug:
    """The strategy. Once round a boundary without a reason to leave it, there is no way: it gives up."""

    def __init__(self) -> None:
        self._node: Array | None = None
        self._boundary: Boundary | None = None
        self._nodes = np.empty((0, 2))

    def step(self, view: BugView) -> Move:
        """Motion to the goal over nodes that are closer to it; where there is none, along the boundary to where there is."""
        if view.goal_in_sight():
            self._node = self._boundary = None
            return To(view.goal.position)
        if self._node is not None:
            if math.dist(view.centre, self._node) > ARRIVED and not view.blocked:
                return To(self._node)
            self._node = None
        if view.fresh:
            self._nodes = self._visible(view)
        left = np.linalg.norm(self._nodes - view.goal.position, axis=1)
        if self._boundary is None:
            closer = self._nodes[left < view.goal_distance - _CLOSER]
            if len(closer):
                ways = np.linalg.norm(closer - view.centre, axis=1) + np.linalg.norm(closer - view.goal.position, axis=1)
                self._node = node = closer[int(ways.argmin())]
                return To(node)
            if view.goal_is_open(2.0 * ARRIVED):
                return To(view.goal.position)
            self._follow(view)
        assert self._boundary is not None
        self._followed = min(self._followed, self._sensed(view))
        reach = float(left.min(initial=math.inf))
        if reach < self._followed - _CLOSER:
            node = self._nodes[int(left.argmin())]
            self._boundary, self._node = None, node
            return To(node)
        if self._boundary.travelled > LOOP_LENGTH and math.dist(view.centre, self._hit) < LOOP:
            return GiveUp("once round the boundary, and nothing in sight was closer to the goal than the boundary is")
        return self._boundary.move(view)

    def _follow(self, view: BugView) -> None:
        """At a local minimum of the distance: along the boundary, to the side of the best node."""
        side = nearer_side(view)
        if len(self._nodes):
            ways = np.linalg.norm(self._nodes - view.centre, axis=1) + np.linalg.norm(self._nodes - view.goal.position, axis=1)
            turn = wrap_angle(view.heading_to(self._nodes[int(ways.argmin())]) - view.goal_heading)
            side = -1 if turn > 0.0 else 1
        self._boundary = Boundary(side, view.goal_heading - side * math.pi / 2)
        self._hit: Array = view.centre
        self._followed = math.inf

    def _visible(self, view: BugView) -> Array:
        """Nodes that can be driven to straight, (n, 2) [m]."""
        subgoals = [point.subgoal(view.circle.radius) for point in view.open_points()]
        return np.array([q for q in subgoals if view.reachable(q)]).reshape(-1, 2)

    def _sensed(self, view: BugView) -> float:
        """d_followed: from the goal to the nearest point of the boundary beside the robot [m]."""
        near = np.linalg.norm(view.hits - view.centre, axis=1) < view.circle.radius + _FOLLOWED
        return float(np.linalg.norm(view.hits[near] - view.goal.position, axis=1).min(initial=math.inf))

    def trace(self, view: BugView) -> dict[str, Drawable]:
        """Nodes of the local tangent graph."""
        return {"nodes": Points(self._nodes, radius=0.02)}


def build(context: Context) -> Reactive:
    """TangentBug for the context's robot."""
    return build_bug(context, TangentBug())
