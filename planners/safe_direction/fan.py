"""The fan of directions, its safest and its shortest one, and the direction between them that is driven (Trihatmo, eq. 1-17)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from robocar.core import Array

_STEP = 0.5  # l of eq. 2 [cells], at most the distance of two neighbouring centres
_TIE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Fan:
    """Vectors p_k around the robot (eq. 1).

    Args:
        headings: in the map frame, ascending, (n,) [rad].
        lengths: |p_k|, to the first cell that is blocked, at most the range, (n,) [m].
        totals: N(p_k) of eq. 3, (n,) [m^2]: the sum over steps of length l of the cells' clearance, times l, so that it does not
            depend on l; 0 where the way is blocked at once.
        closed: whether it goes all round, so that the last direction is the first one's neighbour.
    """

    headings: Array
    lengths: Array
    totals: Array
    closed: bool

    def nearest(self, heading: float) -> int:
        """Index of the direction nearest to a heading [rad]."""
        return _nearest(self.headings, heading)


@dataclass(frozen=True, slots=True)
class Choice:
    """Where to go from here.

    Args:
        heading: theta_target in the map frame [rad] (eq. 7, 12, 16).
        length: |p_L|, how far it is free that way [m] (eq. 8).
        safe, shortest: headings of p_SF and p_D [rad].
        alpha: in force; 0 where the shortest direction is safe enough (eq. 15, 16).
        ratio: N(p_D) / N(p_SF).
        turn: whether the shortest direction lies outside the sector: turn there and do not advance (eq. 10-13).
    """

    heading: float
    length: float
    safe: float
    shortest: float
    alpha: float
    ratio: float
    turn: bool = False


def directions(heading: float, width: float, count: int) -> Array:
    """`count` headings over a sector of `width` around `heading` [rad]; over a full circle the last one is not the first."""
    whole = width >= math.tau - 1e-6
    return heading + np.linspace(-0.5 * width, 0.5 * width, count, endpoint=not whole)


def fan(
    headings: Array,
    clearance: Array,
    position: tuple[float, float],
    reach: float,
    resolution: float,
    closed: bool,
    limit: float = math.inf,
) -> Fan:
    """Contact distances and totals of the directions (eq. 2, 3).

    Args:
        headings: (n,) [rad].
        clearance: distance of each cell to the nearest obstacle of the pessimistic model, obstacles grown by the robot's size,
            (rows, cols) [cells]; 0 or less where blocked. Outside the grid all is blocked.
        position: of the robot in grid coordinates (column, row) [cells].
        reach: r_max [m].
        resolution: of the grid [m].
        closed: whether the directions go all round.
        limit: up to which cells count for N [m].
    """
    lengths, totals = _walk(clearance, *position, headings, reach / resolution, min(limit, reach) / resolution)
    return Fan(headings, lengths * resolution, totals * resolution**2, closed)


def safe_direction(found: Fan, shortest: float, width: float, barrier: float) -> int:
    """Index of p_SF, the direction with the largest N (eq. 4).

    It is looked for within `width` [rad] around the shortest direction. With half a circle P keeps a component of at least
    1 - alpha along p_D: the distance transform falls on whatever way is chosen, which the paper's rule alone does not promise for
    a sensor that looks all round. It is also looked for on this side of what stands nearer than `barrier` [m]: the middle between
    two ways past a post leads into the post.
    """
    return _safest(found.headings, found.lengths, found.totals, found.closed, shortest, width, barrier)


def choose(
    found: Fan, shortest: float, outside: bool, alpha: float, delta: float, width: float = math.tau, barrier: float = 0.0
) -> Choice:
    """theta_target and |p_L| (eq. 5-17).

    Args:
        found: the fan over the pessimistic model.
        shortest: theta_S, the heading of the shortest way [rad].
        outside: whether it lies outside the sector (eq. 10).
        alpha: the safety factor, 0 (shortest) to 1 (safest).
        delta: how large N(p_D) / N(p_SF) has to be for alpha to be 0 (eq. 15); 1: never.
        width, barrier: see `safe_direction`; the paper's rule by default.
    """
    if outside:  # eq. 12 and 13
        return Choice(shortest, 0.0, shortest, shortest, alpha, math.nan, turn=True)
    d, s = found.nearest(shortest), safe_direction(found, shortest, width, barrier)
    ratio = float(found.totals[d] / found.totals[s]) if found.totals[s] > 0.0 else 1.0
    safe = float(found.headings[s])
    if ratio > delta or s == d:  # eq. 15 to 17
        alpha = 0.0
    # eq. 5 to 7
    px = alpha * math.cos(safe) + (1.0 - alpha) * math.cos(shortest)
    py = alpha * math.sin(safe) + (1.0 - alpha) * math.sin(shortest)
    heading = math.atan2(py, px) if math.hypot(px, py) > _TIE else safe
    return Choice(heading, float(found.lengths[found.nearest(heading)]), safe, shortest, alpha, ratio)


def shortest_direction(distance: Array, x: float, y: float, goal: tuple[float, float], reach: float) -> float | None:
    """theta_S: the direction in which the distance transform falls most over what lies in sight.

    The paper takes the neighbour with the smallest value (Fig. 3), which knows eight directions only. Here the way straight ahead
    plus the value where it ends is compared for all points that a straight way reaches through free cells, in 360 directions. A
    goal in sight has its own direction.

    Args:
        distance: `transforms.distance_transform` over the optimistic model, (rows, cols) [cells], inf where blocked.
        x, y, goal: robot and goal in grid coordinates (column, row) [cells].
        reach: how far straight ways are followed [cells].

    Returns:
        Heading in the grid's frame [rad]; None where no point in sight has a way to the goal.
    """
    gx, gy = goal
    apart = math.hypot(gx - x, gy - y)
    if apart <= reach and _clear(distance, x, y, gx, gy):
        return math.atan2(gy - y, gx - x)
    k = _best_ray(distance, x, y, reach)
    return None if k < 0 else math.remainder(k * math.tau / _RAYS, math.tau)


_RAYS = 360


@njit(cache=True)
def _turned(heading: float, other: float) -> float:
    """From `other` to `heading`, in [-pi, pi) [rad]."""
    return (heading - other + math.pi) % math.tau - math.pi


@njit(cache=True)
def _nearest(headings: Array, heading: float) -> int:
    """Index of the first of the headings that are nearest to one."""
    best, least = 0, math.inf
    for k in range(len(headings)):
        away = abs(_turned(headings[k], heading))
        if away < least:
            best, least = k, away
    return best


@njit(cache=True)
def _safest(headings: Array, lengths: Array, totals: Array, closed: bool, shortest: float, width: float, barrier: float) -> int:
    start, n = _nearest(headings, shortest), len(headings)
    needed = min(barrier, lengths[start])
    best = start
    for sense in (1, -1):
        for k in range(1, n):
            i = start + sense * k
            if not closed and not 0 <= i < n:
                break
            i %= n
            if abs(_turned(headings[i], shortest)) > 0.5 * width + _TIE or lengths[i] < needed - _TIE:
                break
            if totals[i] > totals[best] * (1.0 + _TIE):
                best = i
    return best


@njit(cache=True)
def _walk(clearance: Array, x: float, y: float, headings: Array, reach: float, limit: float) -> tuple[Array, Array]:
    """Contact distances and totals in cells."""
    rows, cols = clearance.shape
    lengths, totals = np.zeros(len(headings)), np.zeros(len(headings))
    steps = int(reach / _STEP)
    for k in range(len(headings)):
        dx, dy = _STEP * math.cos(headings[k]), _STEP * math.sin(headings[k])
        total, i = 0.0, 1
        while i <= steps:
            row, col = math.floor(y + i * dy), math.floor(x + i * dx)
            if not (0 <= row < rows and 0 <= col < cols) or not clearance[row, col] > 0.0:
                break
            if i * _STEP <= limit:
                total += clearance[row, col]
            i += 1
        lengths[k], totals[k] = (i - 1) * _STEP, total * _STEP
    return lengths, totals


@njit(cache=True)
def _clear(distance: Array, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether a straight way leads through cells with a finite value; in steps of a quarter cell."""
    rows, cols = distance.shape
    n = int(4.0 * math.hypot(x1 - x0, y1 - y0)) + 1
    for i in range(n + 1):
        row, col = math.floor(y0 + (y1 - y0) * i / n), math.floor(x0 + (x1 - x0) * i / n)
        if not (0 <= row < rows and 0 <= col < cols) or distance[row, col] == math.inf:
            return False
    return True


@njit(cache=True)
def _best_ray(distance: Array, x: float, y: float, reach: float) -> int:
    """Of `_RAYS` rays the one with the point of the smallest way straight there plus its value, -1 if none has a finite one."""
    rows, cols = distance.shape
    best, shortest = -1, math.inf
    for k in range(_RAYS):
        c, s = math.cos(k * math.tau / _RAYS), math.sin(k * math.tau / _RAYS)
        for i in range(1, int(reach) + 1):
            px, py = x + i * c, y + i * s
            row, col = math.floor(py), math.floor(px)
            if not (0 <= row < rows and 0 <= col < cols) or distance[row, col] == math.inf:
                break
            # Between the centres of four cells the value is interpolated; near obstacles one of them may have none.
            r, q = math.floor(py - 0.5), math.floor(px - 0.5)
            if r < 0 or q < 0 or r + 1 >= rows or q + 1 >= cols:
                break
            v, h = py - 0.5 - r, px - 0.5 - q
            value = (1.0 - v) * ((1.0 - h) * distance[r, q] + h * distance[r, q + 1])
            value += v * ((1.0 - h) * distance[r + 1, q] + h * distance[r + 1, q + 1])
            if i + value < shortest:
                best, shortest = k, i + value
    return best
