"""Where a critical-point bug has been and what it has seen: T, SG and D of Das, Dutta and Debnath 2020 (section 2.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

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

    def pass_by(self, point: Array) -> None:
        """The robot is here."""
        if not self._trail or math.dist(self._trail[-1], point) > SAME:
            self._trail.append(point)

    def arrive(self, point: Array) -> None:
        """The robot decides here: a point in T."""
        near = [k for k, place in enumerate(self.places) if math.dist(place.point, point) < SAME]
        if near:
            self.at = min(near, key=lambda k: math.dist(self.places[k].point, point))
        else:
            self.places.append(Place(point, self.at))
            self.at = len(self.places) - 1

    def visited(self, target: Array, sure: bool) -> bool:
        """Whether T holds the point; one whose open point was not sure is done with once the robot has passed near it."""
        if not sure and any(math.dist(point, target) < _PASSED for point in self._trail):
            return True
        return any(math.dist(place.point, target) < SAME for place in self.places)

    def subgoal_of(self, point: OpenPoint, radius: float, goal: Array) -> SubGoal:
        """The sub-goal that the same open point has already given, or a new one."""
        target = point.subgoal(radius)
        for known in self.subgoals:
            same = known.open_point
            there = math.dist(same.position, point.position) < SAME
            if there and same.side == point.side and float(same.normal @ point.normal) > _SAME_SIDE:
                if known.open:  # the last look counts
                    known.point, known.open_point, known.place = target, point, self.at
                return known
        return SubGoal(target, math.dist(target, goal), point, self.at)

    def keep(self, subgoal: SubGoal) -> None:
        """A safe one: into SG and D."""
        if subgoal not in self.subgoals:  # which one it is, not what it is equal to
            self.subgoals.append(subgoal)

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
