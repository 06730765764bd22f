"""Where a critical-point bug has been and what it has seen: T, SG and D of Das, Dutta and Debnath 2020 (section 2.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robocar.core import Array
from robocar.planners.bugs.ocpb import sub_goals as sg
from robocar.planners.bugs.ocpb.sub_goals import SAME
from robocar.planners.bugs.ocpb.surfaces import Surfaces
from robocar.planners.bugs.view import BugView


@dataclass(frozen=True, slots=True, eq=False)
class SubGoal:
    """An entry of SG, and with its distance of D, as it is now.

    Args:
        point: (2,) [m]; distance: to the goal [m]; open_point: the position of that it belongs to, (2,) [m].
        sure: whether that is sure to be an end.
        place: from where it was seen, an index into T.
        open: neither visited nor refused.
    """

    point: Array
    distance: float
    open_point: Array
    sure: bool
    place: int
    open: bool


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A sub-goal in sight that fits and has not been visited.

    Args:
        point: (2,) [m]; way: where to drive first, the point itself or one beside a corner on the way there.
        distance: to the goal [m].
        later: whether sure ones that have not been driven by come first.
        subgoal: its number in SG; -1 beside a virtual obstacle.
    """

    point: Array
    way: Array
    distance: float
    later: bool
    subgoal: int


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """An entry of T: a point that the robot has been to, and the one that it came from (-1 for the first)."""

    point: Array
    parent: int


class Traverse:
    """T as a tree of places, the way driven between them, and the sub-goals seen from them."""

    def __init__(self) -> None:
        self.places: list[Place] = []  # T
        self.at = -1  # the last place
        self.surfaces = Surfaces()
        self._table = np.zeros((64, sg.COLUMNS))
        self._count = 0
        self._trail: list[Array] = []
        self._been = np.empty((0, 2))
        self._passed = np.empty((0, 2))

    # -- T -------------------------------------------------------------------------------------------------------------

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

    def points(self) -> Array:
        """T, (n, 2) [m]."""
        return np.array([place.point for place in self.places]).reshape(-1, 2)

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

    # -- SG and D ------------------------------------------------------------------------------------------------------

    @property
    def subgoals(self) -> list[SubGoal]:
        """SG."""
        return [self._value(row) for row in self._table[: self._count]]

    def _value(self, row: Array) -> SubGoal:
        point, end = row[sg.TX : sg.TY + 1].copy(), row[sg.X : sg.Y + 1].copy()
        return SubGoal(point, float(row[sg.LEFT]), end, bool(row[sg.SURE]), int(row[sg.PLACE]), bool(row[sg.OPEN]))

    @property
    def anything_open(self) -> bool:
        """Whether D still holds one that has been neither visited nor refused."""
        return bool(self._table[: self._count, sg.OPEN].any())

    def target(self, subgoal: int) -> Array:
        """Where a sub-goal lies, (2,) [m]."""
        return self._table[subgoal, sg.TX : sg.TY + 1].copy()

    def place_of(self, subgoal: int) -> int:
        """From where it was seen."""
        return int(self._table[subgoal, sg.PLACE])

    def close(self, subgoal: int) -> None:
        """It is visited, or refused."""
        self._table[subgoal, sg.OPEN] = 0.0

    def candidates(
        self, view: BugView, open_points: Array, virtual: NDArray[np.bool_], threatened: bool, gap_tolerance: float
    ) -> list[Candidate]:
        """Sub-goals of the open points in sight (rows of `open_point_rows`) that fit and are not visited, the best first; takes
        them into SG and D.

        Args:
            virtual: which of them belong to virtual obstacles; their sub-goals are not kept, and lead away from the goal only if
                `threatened`.
        """
        while len(self._table) < self._count + len(open_points):
            self._table = np.concatenate([self._table, np.zeros_like(self._table)])
        (x, y), (gx, gy), needs = view.centre.tolist(), view.goal.position.tolist(), _needs(view, gap_tolerance)
        memory = sg.Memory(self._been, self._passed, self.surfaces.table)
        found, self._count = sg.consider(
            open_points, virtual, threatened, self._table, self._count, self.at, memory, view.hits, x, y, gx, gy, needs
        )
        rows = sorted(found.tolist(), key=lambda row: (row[sg.LATER], row[sg.DISTANCE]))
        return [Candidate(np.array(r[:2]), np.array(r[2:4]), r[4], r[5] > 0.0, int(r[6])) for r in rows]

    def way_to(self, view: BugView, point: Array, gap_tolerance: float) -> Array | None:
        """Where to drive to get to a point in sight: there, or beside a corner on the way, (2,) [m]; None if neither fits."""
        (x, y), (px, py) = view.centre.tolist(), point.tolist()
        way = sg.way_to(view.hits, self._been, x, y, px, py, _needs(view, gap_tolerance))
        return None if math.isnan(way[0]) else np.array(way)

    def give_up_here(self) -> None:
        """Those seen from this place last that are still open are not to be reached from where they were seen; those that have
        been visited since are done with."""
        for row in self._table[: self._count]:
            if row[sg.OPEN] and (
                int(row[sg.PLACE]) == self.at or sg.visited(self._been, self._passed, row[sg.TX], row[sg.TY], row[sg.SURE] > 0.0)
            ):
                row[sg.OPEN] = 0.0

    def best_left(self, centre: Array, sure: bool) -> int:
        """The sub-goal of another place with the shortest way back to where it was seen and on to the goal, as the crow flies; -1
        for none. `sure`: of those whose ends are, and that have not been driven by."""
        best, shortest = -1, math.inf
        for k, row in enumerate(self._table[: self._count]):
            if not row[sg.OPEN] or int(row[sg.PLACE]) == self.at:
                continue
            x, y = row[sg.TX : sg.TY + 1].tolist()
            if sg.visited(self._been, self._passed, x, y, row[sg.SURE] > 0.0):
                continue
            if sure and sg.comes_later(self._passed, x, y, row[sg.SURE] > 0.0):
                continue
            points = [centre, *(self.places[i].point for i in reversed(self.way(int(row[sg.PLACE])))), (x, y)]
            length = sum(math.dist(a, b) for a, b in pairwise(points)) + float(row[sg.LEFT])
            if length < shortest:
                best, shortest = k, length
        return best


def _needs(view: BugView, gap_tolerance: float) -> sg.Needs:
    circle = view.circle
    return sg.Needs(circle.radius, circle.driving, circle.body, 2.0 * circle.radius * (1.0 + gap_tolerance))
