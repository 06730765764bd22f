"""Critical-PointBug: from one critical point to the next, always the unvisited sub-goal that is nearest to the goal.

Das, Dutta and Debnath's forerunner of the Operative Critical Point Bug (reference 22 of IJEECS 18(3), 2020), for a point robot
among static obstacles: it does not ask whether it fits through a gap. A robot with dimension goes to the sub-goals beside the
open points; what does not let it through stops it, and that sub-goal is done with.
"""

from __future__ import annotations

import math

import numpy as np

from robocar.core import Array, Context
from robocar.planners.bugs.bug import build_bug
from robocar.planners.bugs.point_bug import PointBug
from robocar.planners.bugs.view import BugParameters, BugView
from robocar.planners.navigators.reactive import Reactive


class CriticalPointBug(PointBug):
    """The strategy: PointBug's motion with another choice. Where every sub-goal in sight has been visited, it is `stuck`."""

    reason = "every sub-goal in sight has been visited"

    def choose(self, view: BugView, candidates: Array) -> Array | None:
        """The critical point: nearest to the goal and not yet visited."""
        left = [math.dist(q, view.goal.position) for q in candidates]
        for k in np.argsort(left, kind="stable"):
            if self.times_at(candidates[k]) == 0:
                return candidates[k]
        return None


def build(context: Context) -> Reactive:
    """Critical-PointBug for the context's robot."""
    return build_bug(context, CriticalPointBug(context.parameters_of(BugParameters).looks))
