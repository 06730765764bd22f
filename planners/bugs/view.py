"""What a bug knows when it decides, and what it can decide: free ways of a disc among the points that a scan hits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numba import njit

from robocar.core import SE2, Array, GiveUp, Goal
from robocar.core.trace import Drawable
from robocar.planners.bugs.open_points import OpenPoint, VirtualCircle, find_open_points
from robocar.planners.tracking.panorama import ScanPanorama

ARRIVED = 0.03  # [m] at a sub-goal
HIT = 0.12  # [m] a way that is free no farther has hit an obstacle; from ...
LEAVE = 0.25  # [m] on it may be left again
LOOP = 0.15  # [m] this near to where it began, a boundary has been followed all round, after ...
LOOP_LENGTH = 0.8  # [m]
ROOM_TO_TURN = 0.01  # [m] around the body
_SQUEEZE = 0.98  # what lies inside a disc already counts as touching it, and no more


@dataclass(frozen=True, slots=True)
class BugParameters:
    """One set for all bugs; names are Nav2's where it has them.

    Args:
        safety_constant: added to the half of the largest diagonal to give the virtual circle's radius r [m].
        range_jump: delta d, the jump of the range that makes an open point [m].
        range_std: of the sensor's noise [m].
        gap_tolerance: a gap is wide enough from 2 r times one plus this on.
        desired_linear_vel: towards points [m/s]; boundary_vel: along boundaries [m/s].
        rotate_to_heading_angular_vel: [rad/s].
        looks: scans, taken standing, that a decision is made from.
        detection_distance: gaps of 2 r have to be seen from this far; it decides how many beams are needed [m].
    """

    safety_constant: float = 0.03
    range_jump: float = 0.2
    range_std: float = 0.01
    gap_tolerance: float = 0.05
    desired_linear_vel: float = 0.4
    boundary_vel: float = 0.2
    rotate_to_heading_angular_vel: float = 1.2
    looks: int = 3
    detection_distance: float = 0.75

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            zero_is_fine = name in ("range_std", "gap_tolerance")
            if not (math.isfinite(value) and (value > 0 or (zero_is_fine and value == 0))):
                raise ValueError(f"{name} must be positive, not {value}")


@dataclass(frozen=True, slots=True, eq=False)
class BugView:
    """What a bug knows when it decides.

    Args:
        time: [s]; pose: of the robot; centre: of its virtual circle, (2,) [m].
        panorama: the last scan; hits: its surface points, (m, 2) [m]; fresh: whether it is new.
        goal: where to go.
        blocked: whether the guard has stopped the last motion.
    """

    time: float
    pose: SE2
    centre: Array
    panorama: ScanPanorama
    hits: Array
    fresh: bool
    goal: Goal
    blocked: bool
    circle: VirtualCircle
    parameters: BugParameters

    @property
    def goal_distance(self) -> float:
        """d_min [m]."""
        return math.dist(self.centre, self.goal.position)

    @property
    def goal_heading(self) -> float:
        """[rad]"""
        return self.heading_to(self.goal.position)

    @property
    def passing_radius(self) -> float:
        """Half the safety constant is left for noise, so that a wall at the virtual circle's edge does not block it [m]."""
        return self.circle.body + 0.5 * self.parameters.safety_constant

    def heading_to(self, point: Array) -> float:
        """[rad]"""
        return math.atan2(point[1] - self.centre[1], point[0] - self.centre[0])

    def free_way(self, heading: float, length: float, radius: float | None = None) -> float:
        """How far the circle (or a disc of `radius`) can go before it meets a surface, at most `length` [m]."""
        x, y = self.centre
        return free_way(self.hits, x, y, heading, self.passing_radius if radius is None else radius, length)

    def goal_in_sight(self) -> bool:
        """Whether nothing that is seen stands in the straight way to where the goal counts as reached."""
        return self.goal_is_open(math.inf)

    def goal_is_open(self, length: float) -> bool:
        """Whether the next `length` of the straight way to the goal is free [m]."""
        enough = min(length, self.goal_distance - 0.8 * self.goal.xy_goal_tolerance)
        return enough <= 0.0 or self.free_way(self.goal_heading, enough) >= enough

    def reachable(self, point: Array, slack: float = 0.0) -> bool:
        """Whether the outline can drive straight to `point` (2,) and turn there; `slack`: with so much less room [m]."""
        (x, y), (px, py) = self.centre, point
        if room_at(self.hits, px, py) < self.circle.body + ROOM_TO_TURN - slack:
            return False
        length = math.hypot(px - x, py - y)
        return free_way(self.hits, x, y, math.atan2(py - y, px - x), self.circle.driving - slack, length) >= length

    def open_points(self) -> list[OpenPoint]:
        """The sure ones of the last scan."""
        found = find_open_points(self.panorama, self.parameters.range_jump, self.parameters.range_std)
        return [point for point in found if point.sure]


@dataclass(frozen=True, slots=True, eq=False)
class To:
    """Turn, then drive straight until the virtual circle's centre is at `point` (2,) [m]."""

    point: Array


@dataclass(frozen=True, slots=True)
class Along:
    """Turn to `heading` [rad], then drive straight at `speed` [m/s]; decided anew at every scan."""

    heading: float
    speed: float


@dataclass(frozen=True, slots=True)
class Stand:
    """Stand still and look."""


Move: TypeAlias = To | Along | Stand | GiveUp


class Strategy(Protocol):
    """What makes one bug different from another."""

    def step(self, view: BugView) -> Move:
        """The next motion; asked at every scan, while one is under way too."""
        ...

    def trace(self, view: BugView) -> dict[str, Drawable]:
        """What it wants to be seen now."""
        ...


@njit(cache=True)
def free_way(points: Array, x: float, y: float, heading: float, radius: float, length: float) -> float:
    """How far a disc at (x, y) can move along `heading` [rad] before it touches one of the points (n, 2), at most `length` [m].

    A point inside the disc blocks the directions towards it only.
    """
    c, s = math.cos(heading), math.sin(heading)
    free = length
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        along, lateral = c * dx + s * dy, c * dy - s * dx
        if 0.0 < along < free + radius and abs(lateral) < radius:
            r2 = min(radius * radius, _SQUEEZE * _SQUEEZE * (dx * dx + dy * dy))
            if r2 > lateral * lateral:
                free = min(free, max(0.0, along - math.sqrt(r2 - lateral * lateral)))
    return free


@njit(cache=True)
def first_touched(points: Array, x: float, y: float, heading: float, radius: float, length: float) -> int:
    """Which of the points (n, 2) the disc of `free_way` touches first; -1 where it meets none."""
    free, first = length, -1
    for i in range(len(points)):
        way = free_way(points[i : i + 1], x, y, heading, radius, free)
        if way < free:
            free, first = way, i
    return first


@njit(cache=True)
def room_at(points: Array, x: float, y: float) -> float:
    """Distance from (x, y) to the nearest of the points (n, 2) [m], inf where there is none."""
    nearest = math.inf
    for i in range(len(points)):
        nearest = min(nearest, (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2)
    return math.sqrt(nearest)


@njit(cache=True)
def narrow_gap(points: Array, x: float, y: float, heading: float, length: float, width: float, passed: float) -> float:
    """How far along a straight way it first passes between two points less than `width` [m] apart; inf where it never does.

    SAFE_POINT (section 2.3) asks for the distance of facing open points. Here all pairs of surface points, one on either side of
    the way, are asked, since of an obliquely seen door the two open points lie farther apart than its jambs. A gap nearer than
    `passed` [m] is one that the robot is in already; beyond the end of the way, it still is one.
    """
    c, s = math.cos(heading), math.sin(heading)
    near = np.empty((len(points), 2))
    count = 0
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        along, lateral = c * dx + s * dy, c * dy - s * dx
        if -width < along < length + passed + width and abs(lateral) < width:
            near[count, 0], near[count, 1] = along, lateral
            count += 1
    first = math.inf
    for i in range(count):
        a, left = near[i]
        if left <= 0.0:
            continue
        for k in range(count):
            b, right = near[k]
            if right > 0.0 or (a - b) ** 2 + (left - right) ** 2 >= width * width:
                continue
            crossing = (b * left - a * right) / (left - right)
            if passed < crossing <= length + passed and crossing < first:
                first = crossing
    return first


@njit(cache=True)
def first_free(
    points: Array, x: float, y: float, start: float, side: int, span: float, radius: float, length: float, step: float
) -> float:
    """The first heading from `start` on, turning by `side`, in which the disc can move `length`; nan where none
    in `span` [rad] is."""
    for k in range(int(span / step) + 1):
        heading = start + side * k * step
        if free_way(points, x, y, heading, radius, length) >= length:
            return heading
    return math.nan
