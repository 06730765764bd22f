"""Whether a robot that navigates by safe directions gets on: what it knows of the way left, and when it waits or gives up."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from robocar.core import SE2, STOP, Drive, GiveUp, Goal, Text
from robocar.planners.safe_direction.memory import RollingMemory
from robocar.planners.safe_direction.method import DOUBT, DOUBT_SHARE, Decision, SafeDirectionParameters
from robocar.planners.safe_direction.view import Readings

_GROUND = 0.25  # [m] side of the squares that count as ground covered
_TURNING = 0.15  # [m/rad] what turning counts as, in metres of way
_CONFIRMED = 1.0  # [s] that what lengthens the way has to stay in sight to count: what moves goes away again
_FORGET_AGAIN, _FORGET_MOST = 0.5, 20  # [m, 1] way between two clearings of the memory for want of a way, and their number
_FORGET_PERIOD = 1.0  # [s] or the time between them, where the car stands
_AS_NEAR = 0.10  # [m] from the nearest place to a blocked goal, where that counts as reached


class SafeDirectionProgress:
    """Of one drive to one goal.

    Args:
        memory: what is forgotten for want of a way; None where nothing is remembered.
    """

    def __init__(self, parameters: SafeDirectionParameters, memory: RollingMemory | None) -> None:
        self._parameters, self._memory = parameters, memory
        self._before: SE2 | None = None
        self._driven = 0.0  # [m]
        self.new_goal()

    def new_goal(self) -> None:
        """The way driven goes on being counted."""
        self._ground: set[tuple[int, int]] = set()
        self._idle = 0.0  # [m] driven since the last new ground
        self._least = 0.0  # [m] lower bound of the way from where the count began to the goal
        self._bounds: deque[tuple[float, float]] = deque()  # of the last second: time, way to the goal plus way driven
        self._waiting_since: float | None = None
        self._forgotten, self._forgotten_at, self._forgot = 0, -math.inf, -math.inf

    @property
    def bound(self) -> float:
        """What the way left is at least [m], as known from before."""
        return self._least - self._driven

    def move(self, pose: SE2) -> None:
        """Counts the way driven and the ground covered."""
        if self._before is not None:
            turned = abs(math.remainder(pose.theta - self._before.theta, math.tau))
            self._idle += self._before.distance_to(pose) + _TURNING * turned
            self._driven += self._before.distance_to(pose)
        self._before = pose
        square = math.floor(pose.x / _GROUND), math.floor(pose.y / _GROUND)
        if square not in self._ground:
            self._ground.add(square)
            self._idle = 0.0

    def carry(self, decision: Decision, time: float) -> None:
        """Keeps the largest lower bound of the way to the goal, plus what was driven until then."""
        u = _way(decision)
        self._bounds.append((time, u + self._driven))
        while self._bounds[0][0] < time - _CONFIRMED:
            self._bounds.popleft()
        if self._bounds[0][0] <= time - 0.8 * _CONFIRMED:
            least = min(bound for _, bound in self._bounds)
            if math.isfinite(least):
                kept = u + self._driven >= self._least - DOUBT - DOUBT_SHARE * u
                self._least = max(self._least, least) if kept else least

    def trouble(
        self, pose: SE2, seen: Readings, decision: Decision, time: float, goal: Goal, moves: bool = False
    ) -> Drive | GiveUp | None:
        """A reason to stand or to give up, if there is one.

        Args:
            moves: whether something moves in sight. It goes away again: what it bars says nothing of what is remembered.
        """
        x, y = goal.position
        cell = seen.grid.cell_from_world(goal.position)
        buried = bool(seen.grid.contains(cell)) and bool(seen.occupied[tuple(cell)])
        apart = math.dist(pose.position, goal.position)
        if self._idle > self._parameters.patience:
            why = "the goal lies in an obstacle" if buried else "what is in sight does not lead on"
            return GiveUp(
                f"going in circles: {self._idle:.1f} m driven without new ground, {apart:.2f} m from the goal; {why}", "stuck"
            )
        if decision.choice is None:
            return _standing("what moves bars the way: waiting") if moves else self._no_way(time, goal)
        self._waiting_since = None
        # The smallest value is that of the free cell next to a blocked goal.
        if buried and _way(decision) <= float(decision.distance.min()) * seen.grid.resolution + _AS_NEAR:
            return GiveUp(
                f"the goal ({x:.2f}, {y:.2f}) lies in an obstacle; {apart:.2f} m from it is as near as the car gets", "stuck"
            )
        return None

    def _no_way(self, time: float, goal: Goal) -> Drive | GiveUp:
        again = self._driven - self._forgotten_at >= _FORGET_AGAIN or time - self._forgot >= _FORGET_PERIOD
        if self._memory is not None and self._forgotten < _FORGET_MOST and again:
            self._forgotten, self._forgotten_at, self._forgot = self._forgotten + 1, self._driven, time
            self._memory.forget()
            return _standing("no way: what was seen is forgotten")
        if self._waiting_since is None:
            self._waiting_since = time
        if time - self._waiting_since >= self._parameters.wait_time:
            x, y = goal.position
            return GiveUp(
                f"no way to the goal ({x:.2f}, {y:.2f}) in sight that is wide enough: obstacles all round, or too tight"
            )
        return _standing("no way in sight: waiting")


def _way(decision: Decision) -> float:
    """From the robot to the goal over the optimistic model [m]."""
    return float(decision.distance[int(decision.seen.y), int(decision.seen.x)]) * decision.seen.grid.resolution


def _standing(why: str) -> Drive:
    return replace(STOP, trace={"safe_direction": Text(why, "WARN")})
