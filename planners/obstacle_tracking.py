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

from planners.open_points import Panorama
from robocar.core import Array, frozen_array

_SEEN_THROUGH = 0.08  # [m] an earlier beam went at least this much farther than what stands there now
_NEWLY_TAKEN = 0.3  # share of an obstacle's points that stand where it was free, or stood where it is free now
_FIRST_LOOK_BACK, _LOOK_BACK = 0.35, 1.45  # [s] to the scans that are compared
_WINDOW = 1.05  # [s] of positions that give the velocity
_OFF_LINE = 0.12  # [m] from where it was expected: it has turned or stopped
_GATE = 0.35  # [m] an obstacle is looked for this near to where it is expected
_COAST = 1.5  # [s] an obstacle that is out of sight is still expected to go on
_SLOW = 0.04  # [m/s] is no motion
_TOO_FAST = 1.5  # [m/s] nothing here is
_FORGET = 3.0  # [s] out of sight


class Kind(Enum):
    """The paper's sets."""

    PROVISIONAL = "Tobs"
    STATIONARY = "Sobs"
    PROVISIONALLY_DYNAMIC = "TDobs"
    DYNAMIC = "Dobs"


@dataclass(slots=True)
class Tracked:
    """An obstacle that is followed over the scans.

    Args:
        position: the middle between its ends at `time`, (2,) [m].
        velocity: (2,) [m/s], zero unless it is dynamic.
        radius: of the circle around what was seen of it [m].
        ends: its two open points, (2, 2) [m].
        points: indices of its beams in the last panorama that showed it.
    """

    number: int
    time: float
    position: Array
    radius: float
    ends: Array
    points: NDArray[np.int64]
    kind: Kind = Kind.PROVISIONAL
    velocity: Array = field(default_factory=lambda: np.zeros(2))
    history: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=32))
    surface: deque[tuple[float, Array]] = field(default_factory=lambda: deque(maxlen=16))
    evidence: int = 0
    first_seen: float = 0.0

    @property
    def speed(self) -> float:
        """[m/s]"""
        return math.hypot(*self.velocity)

    def at(self, time: float) -> Array:
        """Where it is expected, (2,) [m]."""
        return self.position + (time - self.time) * self.velocity


class Obstacles:
    """Follows the obstacles around the robot: the paper's Tobs, Sobs, TDobs and Dobs.

    Args:
        max_obstacle_width: between the two ends; wider ones are taken for walls [m].
        max_distance: farther obstacles are not followed [m].
    """

    def __init__(self, max_obstacle_width: float, max_distance: float) -> None:
        self._max_width, self._max_distance = max_obstacle_width, max_distance
        self.forget()
        self._warm_up()
        self.forget()

    def forget(self) -> None:
        """A new episode."""
        self.tracked: list[Tracked] = []
        self._past: deque[Panorama] = deque(maxlen=16)
        self._count = 0

    def _warm_up(self) -> None:
        """Compiled here, not in the control loop: something passes by."""
        bearings = frozen_array(np.linspace(-math.pi, math.pi, 72, endpoint=False))
        panorama = Panorama(0.0, frozen_array(np.zeros(2)), bearings, frozen_array(np.full(72, 4.0)), 6.0, math.tau / 72)
        for k in range(12):
            ranges = np.full(72, 4.0)
            ranges[10 + 2 * k : 14 + 2 * k] = 1.0
            panorama = replace(panorama, time=0.1 * k, ranges=frozen_array(ranges))
            self.update(panorama)

    def of(self, kind: Kind) -> list[Tracked]:
        """The obstacles of one set."""
        return [obstacle for obstacle in self.tracked if obstacle.kind is kind]

    @property
    def dynamic(self) -> list[Tracked]:
        """Dobs, those that move."""
        return self.of(Kind.DYNAMIC)

    def update(self, panorama: Panorama) -> None:
        """Takes a scan in."""
        if not panorama.thin:
            return  # a sonar's cone does not show where an obstacle ends
        now = panorama.time
        clusters, beams = _clusters(
            panorama.bearings, panorama.ranges, panorama.spacing, self._max_width, self._max_distance, *panorama.origin
        )
        found = [tuple(row) for row in clusters.tolist()]
        left = list(range(len(found)))
        for obstacle in self.tracked:
            age = now - obstacle.time
            x, y = float(obstacle.position[0]), float(obstacle.position[1])
            if obstacle.kind is Kind.DYNAMIC:
                x, y = x + age * float(obstacle.velocity[0]), y + age * float(obstacle.velocity[1])
            best, nearest = -1, _GATE + 0.5 * obstacle.radius
            for k in left:
                distance = math.hypot(found[k][0] - x, found[k][1] - y)
                if distance < nearest:
                    best, nearest = k, distance
            if best >= 0:
                left.remove(best)
                self._follow(obstacle, panorama, found[best], beams, nearest)
        for k in left:
            self._count += 1
            x, y, radius, *ends, start, stop = found[k]
            self.tracked.append(
                Tracked(
                    self._count,
                    now,
                    np.array([x, y]),
                    radius,
                    np.array(ends).reshape(2, 2),
                    beams[int(start) : int(stop)],
                    history=deque([(now, x, y)], maxlen=32),
                    first_seen=now,
                )
            )
        self.tracked = [o for o in self.tracked if now - o.history[-1][0] < (_COAST if o.kind is Kind.DYNAMIC else _FORGET)]
        self._past.append(panorama)

    def _follow(
        self, obstacle: Tracked, panorama: Panorama, cluster: tuple[float, ...], beams: NDArray[np.int64], off: float
    ) -> None:
        """One more position of an obstacle, and what follows for its velocity and its set."""
        now = panorama.time
        x, y, radius, *ends, start, stop = cluster
        history = obstacle.history
        if obstacle.kind is Kind.DYNAMIC and off > _OFF_LINE + 0.5 * max(0.0, radius - obstacle.radius):
            while len(history) > 2:
                history.popleft()
        history.append((now, x, y))
        while now - history[0][0] > _WINDOW and len(history) > 3:
            history.popleft()
        obstacle.radius = max(radius, 0.98 * obstacle.radius) if abs(radius - obstacle.radius) < 0.2 else radius
        obstacle.points = beams[int(start) : int(stop)]
        obstacle.ends = np.array(ends).reshape(2, 2)
        px, py, vx, vy = _line(np.array(history))
        speed = math.hypot(vx, vy)
        span = now - history[0][0]
        points = _points(panorama, obstacle.points)
        taken = max(self._newly_taken(panorama, points), _vacated(panorama, obstacle)) if span >= 0.25 else 0.0
        obstacle.surface.append((now, points))
        moving = taken >= _NEWLY_TAKEN and _SLOW < speed < _TOO_FAST
        obstacle.evidence = min(obstacle.evidence + 1, 8) if moving else max(obstacle.evidence - 1, 0)
        if obstacle.kind is Kind.DYNAMIC:
            if obstacle.evidence == 0 or speed < 0.5 * _SLOW:
                obstacle.kind = Kind.STATIONARY
        elif obstacle.evidence >= 2:
            obstacle.kind = Kind.DYNAMIC
        elif obstacle.evidence == 1:
            obstacle.kind = Kind.PROVISIONALLY_DYNAMIC
        elif now - obstacle.first_seen >= _LOOK_BACK:
            obstacle.kind = Kind.STATIONARY
        if obstacle.kind is Kind.DYNAMIC:
            obstacle.position, obstacle.velocity = np.array([px, py]), np.array([vx, vy])
        else:
            obstacle.position, obstacle.velocity = np.array([x, y]), np.zeros(2)
        obstacle.time = now

    def _newly_taken(self, panorama: Panorama, points: Array) -> float:
        """Share of an obstacle's points that stand where an earlier scan saw through; the larger of two scans', one a third of a
        second old, one a second and a half."""
        share = 0.0
        for age in (_FIRST_LOOK_BACK, _LOOK_BACK):
            earlier = next((p for p in reversed(self._past) if panorama.time - p.time >= age), None)
            if earlier is not None and len(earlier.ranges) > 2:
                share = max(share, _seen_through(points, earlier.origin, earlier.bearings, earlier.ranges, _SEEN_THROUGH))
        return share


def _vacated(panorama: Panorama, obstacle: Tracked) -> float:
    """Share of an obstacle's earlier points that the scan now sees through, likewise."""
    share = 0.0
    for age in (_FIRST_LOOK_BACK, _LOOK_BACK):
        earlier = next((points for time, points in reversed(obstacle.surface) if panorama.time - time >= age), None)
        if earlier is not None:
            share = max(share, _seen_through(earlier, panorama.origin, panorama.bearings, panorama.ranges, _SEEN_THROUGH))
    return share


def _points(panorama: Panorama, beams: NDArray[np.int64]) -> Array:
    """Where these beams end, (k, 2) [m]."""
    return _ends_of(panorama.origin, panorama.bearings, panorama.ranges, beams)


@njit(cache=True)
def _ends_of(origin: Array, bearings: Array, ranges: Array, beams: NDArray[np.int64]) -> Array:
    points = np.empty((len(beams), 2))
    for k in range(len(beams)):
        points[k, 0] = origin[0] + ranges[beams[k]] * math.cos(bearings[beams[k]])
        points[k, 1] = origin[1] + ranges[beams[k]] * math.sin(bearings[beams[k]])
    return points


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


@njit(cache=True)
def _seen_through(points: Array, origin: Array, bearings: Array, ranges: Array, margin: float) -> float:
    """Share of points that lie at least `margin` nearer than what three neighbouring beams of another scan hit."""
    n, through = len(ranges), 0
    for k in range(len(points)):
        dx, dy = points[k, 0] - origin[0], points[k, 1] - origin[1]
        bearing = (math.atan2(dy, dx) - bearings[0]) % (2.0 * math.pi)
        low, high = 0, n  # the first beam beyond this bearing
        while low < high:
            mid = (low + high) // 2
            if bearings[mid] - bearings[0] < bearing:
                low = mid + 1
            else:
                high = mid
        nearest = math.inf
        for q in range(low - 2, low + 2):
            r = ranges[q % n]
            if not math.isnan(r):
                nearest = min(nearest, r)
        through += math.hypot(dx, dy) + margin < nearest
    return through / max(len(points), 1)


@njit(cache=True)
def _line(history: Array) -> tuple[float, float, float, float]:
    """Position at the last time and velocity of the straight line through (t, x, y), (n, 3), by least squares."""
    n = len(history)
    t0 = history[n - 1, 0]
    st = stt = sx = sy = sxt = syt = 0.0
    for k in range(n):
        t = history[k, 0] - t0
        st, stt = st + t, stt + t * t
        sx, sy = sx + history[k, 1], sy + history[k, 2]
        sxt, syt = sxt + t * history[k, 1], syt + t * history[k, 2]
    det = n * stt - st * st
    if det < 1e-9:
        return history[n - 1, 1], history[n - 1, 2], 0.0, 0.0
    vx, vy = (n * sxt - st * sx) / det, (n * syt - st * sy) / det
    return (sx - vx * st) / n, (sy - vy * st) / n, vx, vy
