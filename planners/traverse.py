"""Where a critical-point bug has been and what it has seen: T, SG and D of Das, Dutta and Debnath 2020 (section 2.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit

from planners.open_points import OpenPoint
from robocar.core import Array

SAME = 0.12  # [m] open points nearer to each other, and places, are one
_SAME_SIDE = math.cos(math.radians(50.0))  # ... whose free sides look the same way
_PASSED = 0.4  # [m] an end that was not sure is done with this near to the way driven


@dataclass(slots=True, eq=False)
class SubGoal:
    """An entry of SG, and with its distance of D.

    Args:
        point: (2,) [m]; distance: to the goal [m]; open_point: that it belongs to.
        place: from where it was seen, an index into T.
        open: neither visited nor refused.
    """

    point: Array
    distance: float
    open_point: OpenPoint
    place: int
    open: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """An entry of T: a point that the robot has been to, and the one that it came from (-1 for the first)."""

    point: Array
    parent: int


class Traverse:
    """T as a tree of places, the way driven between them, and the sub-goals seen from them."""

    def __init__(self) -> None:
        self.places: list[Place] = []  # T
        self.subgoals: list[SubGoal] = []  # SG and D
        self.at = -1  # the last place
        self._trail: list[Array] = []
        self._ends: list[tuple[float, float, float, float, float]] = []  # of the sub-goals: open point, its normal, its side
        self._table = np.empty((0, 5))
        self._been = np.empty((0, 2))
        self._passed = np.empty((0, 2))

    def pass_by(self, point: Array) -> None:
        """The robot is here."""
        if not self._trail or math.dist(self._trail[-1], point) > SAME:
            self._trail.append(point)
            self._passed = np.array(self._trail)

    def arrive(self, point: Array) -> None:
        """The robot decides here: a point in T."""
        near = [k for k, place in enumerate(self.places) if math.dist(place.point, point) < SAME]
        if near:
            self.at = min(near, key=lambda k: math.dist(self.places[k].point, point))
        else:
            self.places.append(Place(point, self.at))
            self.at = len(self.places) - 1
            self._been = self.points()

    def visited(self, target: Array, sure: bool) -> bool:
        """Whether T holds the point; one whose open point was not sure is done with once the robot has passed near it."""
        x, y = target
        return _any_near(self._been, x, y, SAME) or (not sure and _any_near(self._passed, x, y, _PASSED))

    def subgoal_of(self, point: OpenPoint, radius: float, goal: Array) -> SubGoal:
        """The sub-goal that the same open point has already given, or a new one."""
        target = point.subgoal(radius)
        if len(self._table) != len(self._ends):
            self._table = np.array(self._ends)
        k = _same_end(self._table, *_end(point), SAME, _SAME_SIDE)
        if k < 0:
            return SubGoal(target, math.hypot(goal[0] - target[0], goal[1] - target[1]), point, self.at)
        known = self.subgoals[k]
        if known.open:  # the last look counts
            known.point, known.open_point, known.place = target, point, self.at
            self._table[k] = self._ends[k] = _end(point)
        return known

    def keep(self, subgoal: SubGoal) -> None:
        """A safe one: into SG and D, if it is new."""
        if subgoal not in self.subgoals:  # which one it is, not what it is equal to
            self.subgoals.append(subgoal)
            self._ends.append(_end(subgoal.open_point))

    def best_left(self, centre: Array) -> SubGoal | None:
        """The sub-goal that remains with the shortest way back to where it was seen and on to the goal, as the crow flies."""
        best, shortest = None, math.inf
        for subgoal in self.subgoals:
            if subgoal.open and (subgoal.place == self.at or self.visited(subgoal.point, subgoal.open_point.sure)):
                subgoal.open = False  # not to be reached from where it was seen
            if subgoal.open:
                points = [centre, *(self.places[k].point for k in reversed(self.way(subgoal.place))), subgoal.point]
                length = sum(math.dist(a, b) for a, b in pairwise(points)) + subgoal.distance
                if length < shortest:
                    best, shortest = subgoal, length
        return best

    def way(self, place: int) -> list[int]:
        """Places from the last one to `place` in the tree of where it came from; the next one is at the end of the list."""
        up, down = self._ancestors(self.at), self._ancestors(place)
        common = next(k for k in up if k in down)
        return [*down[: down.index(common) + 1], *reversed(up[1 : up.index(common)])]

    def _ancestors(self, place: int) -> list[int]:
        chain = [place]
        while self.places[chain[-1]].parent >= 0:
            chain.append(self.places[chain[-1]].parent)
        return chain

    def points(self) -> Array:
        """T, (n, 2) [m]."""
        return np.array([place.point for place in self.places]).reshape(-1, 2)


def _end(point: OpenPoint) -> tuple[float, float, float, float, float]:
    """Position, normal and side of an open point."""
    x, y, side = float(point.position[0]), float(point.position[1]), float(point.side)
    return x, y, -side * math.sin(point.bearing), side * math.cos(point.bearing), side


@njit(cache=True)
def _same_end(ends: Array, x: float, y: float, nx: float, ny: float, side: float, near: float, cosine: float) -> int:
    """The first row of `ends` that is the same end as this one, or -1."""
    for k in range(len(ends)):
        there = ends[k, 4] == side and math.hypot(ends[k, 0] - x, ends[k, 1] - y) < near
        if there and ends[k, 2] * nx + ends[k, 3] * ny > cosine:
            return k
    return -1


@njit(cache=True)
def _any_near(points: Array, x: float, y: float, near: float) -> bool:
    """Whether one of the points (n, 2) is nearer than this."""
    nearest = math.inf
    for k in range(len(points)):
        nearest = min(nearest, math.hypot(points[k, 0] - x, points[k, 1] - y))
    return nearest < near


def warm_up() -> None:
    """Compiles what the control loop needs."""
    _same_end(np.zeros((1, 5)), 0.0, 0.0, 1.0, 0.0, 1.0, SAME, _SAME_SIDE)
    _any_near(np.zeros((1, 2)), 0.0, 0.0, SAME)
