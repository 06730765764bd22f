"""Sub-goals of open points, all at once and compiled: which are new, visited, within reach (Das, Dutta and Debnath 2020, 2.3)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array
from robocar.core.compiling import warm_up
from robocar.planners.bugs.ocpb.surfaces import FREE, Surfaces, goes_on
from robocar.planners.bugs.view import ROOM_TO_TURN, first_touched, free_way, narrow_gap, room_at

SAME = 0.12  # [m] open points nearer to each other, and places, are one
_SAME_SIDE = math.cos(math.radians(50.0))  # ... whose free sides look the same way
_PASSED = 0.4  # [m] an end that was not sure is done with this near to the way driven
_DRIVEN_BY, _RECENT = 0.35, 8  # [m] beside the way driven, but for so many of its last points (`SAME` apart)
_AS_SHARP, _SHARP = 1.2, 0.02  # a look counts if its stretch is at most this much longer, [m]

# What is kept of a sub-goal: its open point, that one's normal and side, the stretch in which it lies, whether it is sure; the
# sub-goal itself, its distance to the goal, from which place it was seen, whether it is neither visited nor refused.
(X, Y, NX, NY, SIDE, BEFORE, BEYOND, UX, UY, SURE, TX, TY, LEFT, PLACE, OPEN) = range(15)
COLUMNS = 15
# What `consider` returns: the sub-goal, where to drive first, its distance to the goal, whether others come first, its number.
(_PX, _PY, _WX, _WY, DISTANCE, LATER, _NUMBER) = range(7)


class Needs(NamedTuple):
    """Room that the robot needs.

    Args:
        radius: of the virtual circle [m].
        driving: of the circle that drives: the virtual one less half the safety constant [m].
        body: of the robot's own circle [m].
        width: of the narrowest gap that it passes [m].
    """

    radius: float
    driving: float
    body: float
    width: float


class Memory(NamedTuple):
    """What the robot has done and seen.

    Args:
        been: T, the sub-goals visited, (n, 2) [m].
        passed: points of the way driven, (m, 2) [m].
        surfaces: `Surfaces.table`.
    """

    been: Array
    passed: Array
    surfaces: NDArray[np.int64]


@njit(cache=True)
def consider(
    open_points: Array, virtual: NDArray[np.bool_], threatened: bool, table: Array, count: int, at: int, memory: Memory,
    hits: Array, x: float, y: float, gx: float, gy: float, needs: Needs,
) -> tuple[Array, int]:  # fmt: skip
    """Candidates (k, 7) and the new number of rows of `table`, which has room for as many more as there are open points."""
    out, found, known = np.empty((len(open_points), 7)), 0, count
    new, been, passed = np.zeros(COLUMNS), memory.been, memory.passed
    goal = math.hypot(gx - x, gy - y)
    for i in range(len(open_points)):
        _row(open_points[i], needs.radius, gx, gy, new)
        k, row = -1, new
        if not virtual[i]:
            k = same_end(table[:known], new)
            if k >= 0:
                row = table[k]
                if row[OPEN] == 0.0:
                    continue
                if new[BEFORE] + new[BEYOND] <= _AS_SHARP * (row[BEFORE] + row[BEYOND]) + _SHARP:
                    row[: LEFT + 1] = new[: LEFT + 1]
        elif new[LEFT] > goal and not threatened:
            continue  # rather than go back round what moves it lets it pass
        tx, ty, sure = row[TX], row[TY], row[SURE] > 0.0
        goes = not sure and goes_on(memory.surfaces, row[X], row[Y], row[UX], row[UY], row[BEYOND])
        if goes or visited(been, passed, tx, ty, sure):
            row[OPEN] = 0.0
            continue
        wx, wy = way_to(hits, been, x, y, tx, ty, needs)
        if math.isnan(wx):
            continue  # D takes what can be reached from here; from elsewhere it may be
        if not virtual[i]:
            if k < 0:
                k, count = count, count + 1
                table[k] = new
            table[k, PLACE] = at
        out[found, _PX], out[found, _PY], out[found, _WX], out[found, _WY] = tx, ty, wx, wy
        out[found, DISTANCE], out[found, _NUMBER] = row[LEFT], k
        out[found, LATER] = 1.0 if comes_later(passed, tx, ty, sure) else 0.0
        found += 1
    return out[:found], count


@njit(cache=True)
def _row(point: Array, radius: float, gx: float, gy: float, row: Array) -> None:
    """A row of `open_point_rows` as a sub-goal (eq. 4, 5)."""
    row[X], row[Y], row[SIDE], row[SURE] = point[0], point[1], point[4], point[5]
    row[NX], row[NY] = -point[4] * math.sin(point[2]), point[4] * math.cos(point[2])
    row[BEFORE], row[BEYOND], row[UX], row[UY] = point[6], point[7], point[8], point[9]
    row[TX], row[TY] = row[X] + radius * row[NX], row[Y] + radius * row[NY]
    row[LEFT], row[OPEN] = math.hypot(gx - row[TX], gy - row[TY]), 1.0


@njit(cache=True)
def same_end(table: Array, new: Array) -> int:
    """The nearest row of `table` that is the same end as this one, or -1: on the same side, its free side the same way, and each
    within `SAME` of the stretch in which the other lies; one that is done with only if it is not the vaguer of the two."""
    best, nearest = -1, math.inf
    for k in range(len(table)):
        row = table[k]
        if row[SIDE] != new[SIDE] or row[NX] * new[NX] + row[NY] * new[NY] <= _SAME_SIDE:
            continue
        apart = math.hypot(row[X] - new[X], row[Y] - new[Y])
        there = apart < SAME or off_stretch(new, row[X], row[Y]) < SAME
        if (there or (row[OPEN] > 0.0 and off_stretch(row, new[X], new[Y]) < SAME)) and apart < nearest:
            best, nearest = k, apart
    return best


@njit(cache=True)
def off_stretch(end: Array, x: float, y: float) -> float:
    """Distance of a point from the stretch in which an end lies [m]."""
    dx, dy = x - end[X], y - end[Y]
    t = min(max(dx * end[UX] + dy * end[UY], -end[BEFORE]), end[BEYOND])
    return math.hypot(dx - t * end[UX], dy - t * end[UY])


@njit(cache=True)
def visited(been: Array, passed: Array, x: float, y: float, sure: bool) -> bool:
    """Whether T holds the point; one whose open point was not sure is done with once the robot has passed near it."""
    return any_near(been, x, y, SAME) or (not sure and any_near(passed, x, y, _PASSED))


@njit(cache=True)
def comes_later(passed: Array, x: float, y: float, sure: bool) -> bool:
    """Whether a sub-goal is tried only where no other is left: its end is not sure, or the robot has driven by before. By the end
    that it is going round just now it has driven a moment ago: that does not count."""
    return not sure or any_near(passed, x, y, SAME) or any_near(passed[:-_RECENT], x, y, _DRIVEN_BY)


@njit(cache=True)
def any_near(points: Array, x: float, y: float, near: float) -> bool:
    """Whether one of the points (n, 2) is nearer than this."""
    found = False
    for k in range(len(points)):
        found |= (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 < near * near
    return found


@njit(cache=True)
def fits(hits: Array, x: float, y: float, tx: float, ty: float, needs: Needs) -> bool:
    """SAFE_POINT: whether the robot can drive straight to a point, turn there, and passes gaps wider than it needs only."""
    if room_at(hits, tx, ty) < needs.body + ROOM_TO_TURN:
        return False
    heading, length = math.atan2(ty - y, tx - x), math.hypot(tx - x, ty - y)
    return free_way(hits, x, y, heading, needs.driving, length) >= length and math.isinf(
        narrow_gap(hits, x, y, heading, length, needs.width, needs.body)
    )


@njit(cache=True)
def way_to(hits: Array, been: Array, x: float, y: float, tx: float, ty: float, needs: Needs) -> tuple[float, float]:
    """Where to drive to get to a point; nan where it cannot be reached.

    There, if the virtual circle, less half the safety constant, gets there straight. Else beside the corner that is in its way,
    at `radius` from it, if both parts of that way fit and T does not hold that place. Else there, if the outline fits.
    """
    heading, length, radius = math.atan2(ty - y, tx - x), math.hypot(tx - x, ty - y), needs.radius
    direct = fits(hits, x, y, tx, ty, needs)
    k = first_touched(hits, x, y, heading, 0.5 * (radius + needs.body), length)
    if k >= 0:
        c, s = math.cos(heading), math.sin(heading)
        side = 1.0 if c * (hits[k, 1] - y) - s * (hits[k, 0] - x) > 0.0 else -1.0
        px, py = hits[k, 0] + side * radius * s, hits[k, 1] - side * radius * c
        if (
            not any_near(been, px, py, 0.5 * SAME)
            and math.hypot(x - px, y - py) > 0.5 * SAME
            and math.hypot(tx - px, ty - py) > 0.5 * SAME
            and fits(hits, x, y, px, py, needs)
            and fits(hits, px, py, tx, ty, needs)
        ):
            return px, py
    return (tx, ty) if direct else (math.nan, math.nan)


@warm_up
def prepare() -> None:
    """Compiles what the control loop needs."""
    hits, nothing = np.array([[1.0, 0.5], [1.0, -0.5]]), np.empty((0, 2))
    point = np.array([[1.0, 0.5, 0.4, 1.1, 1.0, 1.0, 0.0, 0.1, 1.0, 0.0]])
    table, surfaces = np.zeros((4, COLUMNS)), np.full(64, FREE)
    needs, memory = Needs(0.2, 0.1, 0.15, 0.4), Memory(nothing, nothing, surfaces)
    for count in (0, 1):
        consider(point, np.zeros(1, dtype=np.bool_), False, table, count, 0, memory, hits, 0.0, 0.0, 3.0, 0.0, needs)
    way_to(hits, nothing, 0.0, 0.0, 1.0, 0.5, needs)
    visited(nothing, nothing, 0.0, 0.0, True)
    comes_later(nothing, 0.0, 0.0, True)
    Surfaces().remember(np.zeros((4000, 2)))
