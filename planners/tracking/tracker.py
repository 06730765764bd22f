"""Which obstacles move, where to and how fast.

Das, Dutta and Debnath, Operative Critical Point Bug, IJEECS 18(3), 2020, section 2.3 (OBSTACLE_DETECTION) and eq. 7.

What the paper leaves open, and how it is decided here:

* *Small change* of an obstacle's open points is no sign of motion by itself: as the robot drives, other parts of a standing
  obstacle come into sight. An obstacle is provisionally dynamic if, in addition, part of it now stands where an earlier scan saw
  through, or the scan now sees through where part of it stood, and definitely so if that is seen again.
* Only obstacles whose both ends are open points and that are at most `max_obstacle_width` wide are followed: walls do not move.
  One that comes out from close behind another is not seen to move before it stands free: only the guard knows of it until then.
* Eq. 7 over two scans of noisy ends is too rough: the velocity is the slope of a straight line through the last second of
  positions (the middle between the ends).
* An obstacle that turns (assumption A6: it stops, turns, goes on) leaves this line: the older positions are forgotten. One that
  stops becomes stationary when its speed has fallen.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array, frozen_array
from robocar.core.compiling import warm_up
from robocar.planners.tracking import kernel as kernel
from robocar.planners.tracking.panorama import ScanPanorama

_NOTHING = kernel.Sight(frozen_array(np.zeros(2)), frozen_array(np.zeros(0)), frozen_array(np.zeros(0)))


class Kind(Enum):
    """The paper's sets."""

    PROVISIONAL = "Tobs"
    STATIONARY = "Sobs"
    PROVISIONALLY_DYNAMIC = "TDobs"
    DYNAMIC = "Dobs"


_KINDS = {
    kernel.PROVISIONAL: Kind.PROVISIONAL,
    kernel.STATIONARY: Kind.STATIONARY,
    kernel.PROVISIONALLY_DYNAMIC: Kind.PROVISIONALLY_DYNAMIC,
    kernel.DYNAMIC: Kind.DYNAMIC,
}


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """An obstacle that is followed over the scans.

    Args:
        position: the middle between its ends at `time`, (2,) [m].
        radius: of the circle around what was seen of it [m].
        ends: its two open points, (2, 2) [m].
        velocity: (2,) [m/s], zero unless it is dynamic.
    """

    number: int
    time: float
    position: Array
    radius: float
    ends: Array
    kind: Kind = Kind.PROVISIONAL
    velocity: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def speed(self) -> float:
        """[m/s]"""
        return math.hypot(*self.velocity)

    def at(self, time: float) -> Array:
        """Where it is expected, (2,) [m]."""
        return self.position + (time - self.time) * self.velocity


class ObstacleTracker:
    """Follows the obstacles around the robot: the paper's Tobs, Sobs, TDobs and Dobs.

    Args:
        max_obstacle_width: between the two ends; wider ones are taken for walls [m].
        max_distance: farther obstacles are not followed [m].
    """

    def __init__(self, max_obstacle_width: float, max_distance: float) -> None:
        self._max_width, self._max_distance = max_obstacle_width, max_distance
        self._rows = kernel.Rows()
        self._past: deque[ScanPanorama] = deque(maxlen=16)
        self._dynamic: list[Tracked] | None = None
        _warm_up()

    @property
    def tracked(self) -> list[Tracked]:
        """All that are followed."""
        return [self._value(row) for row in self._rows.table]

    @property
    def dynamic(self) -> list[Tracked]:
        """Dobs, those that move."""
        if self._dynamic is None:
            self._dynamic = [self._value(row) for row in self._rows.table if row[kernel.KIND] == kernel.DYNAMIC]
        return self._dynamic

    def of(self, kind: Kind) -> list[Tracked]:
        """The obstacles of one set."""
        return [obstacle for obstacle in self.tracked if obstacle.kind is kind]

    def outlines(self, ring: Array) -> Array:
        """The circles around all that are followed; `ring`: points of a unit circle, (m, 2). (n, m, 2) [m]"""
        table = self._rows.table
        return table[:, None, kernel.X : kernel.Y + 1] + table[:, kernel.RADIUS, None, None] * ring

    def _value(self, row: Array) -> Tracked:
        return Tracked(
            int(row[kernel.NUMBER]),
            float(row[kernel.TIME]),
            row[kernel.X : kernel.Y + 1].copy(),
            float(row[kernel.RADIUS]),
            row[kernel.AX : kernel.BY + 1].reshape(2, 2).copy(),
            _KINDS[int(row[kernel.KIND])],
            row[kernel.VX : kernel.VY + 1].copy(),
        )

    def update(self, panorama: ScanPanorama) -> None:
        """Takes a scan in."""
        if not panorama.thin:
            return  # a sonar's cone does not show where an obstacle ends
        x, y = panorama.origin.tolist()
        clusters, beams = _clusters(
            panorama.bearings, panorama.ranges, panorama.spacing, self._max_width, self._max_distance, x, y
        )
        points = kernel.ends_of(panorama.origin, panorama.bearings, panorama.ranges, beams)
        earlier = (self._before(panorama.time, kernel.FIRST_LOOK_BACK), self._before(panorama.time, kernel.LOOK_BACK))
        sight = kernel.Sight(panorama.origin, panorama.bearings, panorama.ranges)
        self._rows.step(panorama.time, clusters, points, sight, earlier)
        self._past.append(panorama)
        self._dynamic = None

    def _before(self, now: float, age: float) -> kernel.Sight:
        """The last scan that is so old."""
        for panorama in reversed(self._past):
            if now - panorama.time >= age:
                return kernel.Sight(panorama.origin, panorama.bearings, panorama.ranges)
        return _NOTHING


@njit(cache=True)
def _clusters(
    bearings: Array, ranges: Array, spacing: float, max_width: float, max_distance: float, x0: float, y0: float
) -> tuple[Array, NDArray[np.int64]]:
    """Obstacles with two ends in sight, (k, 9): x, y, radius, the two ends, and where its beams start and stop in the second
    array."""
    n = len(ranges)
    out, beams = np.empty((n, 9)), np.empty(2 * n, dtype=np.int64)
    count = used = 0
    order = np.empty(n, dtype=np.int64)  # beams with an answer
    m = 0
    for i in range(n):
        if not math.isnan(ranges[i]):
            order[m] = i
            m += 1
    first = -1  # a beam before which the surface breaks
    for k in range(m):
        if _breaks(bearings, ranges, order[(k + m - 1) % m], order[k], spacing):
            first = k
            break
    if first < 0:
        return out[:0], beams[:0]
    k = 0
    while k < m:
        a = k
        i = order[(first + a) % m]
        k += 1
        while k < m and not _breaks(bearings, ranges, order[(first + k - 1) % m], order[(first + k) % m], spacing):
            k += 1
        b = k - 1
        j = order[(first + b) % m]
        before, after = order[(first + a - 1) % m], order[(first + b + 1) % m]
        if b - a < 1 or ranges[i] > max_distance or ranges[j] > max_distance:
            continue
        if not (ranges[before] > ranges[i] and ranges[after] > ranges[j]):
            continue  # something in front hides an end
        ax, ay = x0 + ranges[i] * math.cos(bearings[i]), y0 + ranges[i] * math.sin(bearings[i])
        bx, by = x0 + ranges[j] * math.cos(bearings[j]), y0 + ranges[j] * math.sin(bearings[j])
        if math.hypot(bx - ax, by - ay) > max_width:
            continue
        cx, cy = 0.5 * (ax + bx), 0.5 * (ay + by)
        radius, start = 0.0, used
        for q in range(a, b + 1):
            p = order[(first + q) % m]
            px, py = x0 + ranges[p] * math.cos(bearings[p]), y0 + ranges[p] * math.sin(bearings[p])
            radius = max(radius, math.hypot(px - cx, py - cy))
            beams[used] = p
            used += 1
        if radius > max_width:
            used = start
            continue
        radius += 0.5 * spacing * min(ranges[i], ranges[j])
        out[count, 0], out[count, 1], out[count, 2] = cx, cy, radius
        out[count, 3], out[count, 4], out[count, 5], out[count, 6] = ax, ay, bx, by
        out[count, 7], out[count, 8] = start, used
        count += 1
    return out[:count], beams[:used]


@njit(cache=True)
def _breaks(bearings: Array, ranges: Array, i: int, j: int, spacing: float) -> bool:
    """Whether two neighbouring beams do not end on one surface."""
    a, b = ranges[i], ranges[j]
    if a == math.inf or b == math.inf:
        return True
    between = (bearings[j] - bearings[i]) % (2.0 * math.pi)
    if between > 3.5 * spacing:
        return True
    squared = a * a + b * b - 2.0 * a * b * math.cos(between)
    return squared > (0.12 + 2.0 * spacing * min(a, b)) ** 2


@warm_up
def _warm_up() -> None:
    """Something passes by."""
    tracker = ObstacleTracker(1.0, 5.0)
    bearings = frozen_array(np.linspace(-math.pi, math.pi, 72, endpoint=False))
    panorama = ScanPanorama(0.0, frozen_array(np.zeros(2)), bearings, frozen_array(np.full(72, 4.0)), 6.0, math.tau / 72)
    for k in range(12):
        ranges = np.full(72, 4.0)
        ranges[10 + 2 * k : 14 + 2 * k] = 1.0
        panorama = replace(panorama, time=0.1 * k, ranges=frozen_array(ranges))
        tracker.update(panorama)
