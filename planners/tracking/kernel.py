"""One step of `obstacle_tracking` over all obstacles at once, compiled: which cluster is which obstacle, its line, its set."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array

SEEN_THROUGH = 0.08  # [m] an earlier beam went at least this much farther than what stands there now
NEWLY_TAKEN = 0.3  # share of an obstacle's points that stand where it was free, or stood where it is free now
FIRST_LOOK_BACK, LOOK_BACK = 0.35, 1.45  # [s] to the scans that are compared
WINDOW = 1.05  # [s] of positions that give the velocity
OFF_LINE = 0.12  # [m] from where it was expected: it has turned or stopped
GATE = 0.35  # [m] an obstacle is looked for this near to where it is expected
COAST = 1.5  # [s] an obstacle that is out of sight is still expected to go on
SLOW = 0.04  # [m/s] is no motion
TOO_FAST = 1.5  # [m/s] nothing here is
FORGET = 3.0  # [s] out of sight
SETTLED = 0.25  # [s] of positions before motion is asked for

PROVISIONAL, STATIONARY, PROVISIONALLY_DYNAMIC, DYNAMIC = range(4)
NUMBER, TIME, X, Y, VX, VY, RADIUS, KIND, EVIDENCE, FIRST_SEEN, LAST_SEEN, POSITIONS, LOOKS = range(13)
AX, AY, BX, BY, START, STOP = range(13, 19)  # its ends, its points
COLUMNS = 19
HISTORY = 32  # positions kept of an obstacle
SURFACES = 16  # looks at an obstacle of which the points are kept
SCANS = 64  # scans whose points are kept


class Sight(NamedTuple):
    """A scan: where it was taken, (2,) [m], its beams' bearings in the world, (n,) [rad], and their ranges, (n,) [m]."""

    origin: Array
    bearings: Array
    ranges: Array


class Rows:
    """State of the obstacles that are followed, one a row, and the surface points of the last scans.

    Args of `step` and what it changes: `table` (rows, COLUMNS); `history` (rows, HISTORY, 3) of time, x, y, oldest first; `looks`
    (rows, SURFACES, 4) of time, scan, start and stop in `scans` (SCANS, beams, 2), oldest first.
    """

    def __init__(self) -> None:
        self.table = np.zeros((0, COLUMNS))
        self._history = np.zeros((0, HISTORY, 3))
        self._looks = np.zeros((0, SURFACES, 4))
        self._scans = np.zeros((SCANS, 0, 2))
        self._count = self._scan = 0

    def step(
        self,
        time: float,
        clusters: Array,
        points: Array,
        sight: Sight,
        earlier: tuple[Sight, Sight],
    ) -> None:
        """Takes in the clusters (k, 9) of a scan and the points (m, 2) they consist of.

        Args:
            sight: the scan.
            earlier: the two scans to compare with; empty ones for none.
        """
        if len(points) > self._scans.shape[1]:
            larger = np.zeros((SCANS, 2 * len(points), 2))
            larger[:, : self._scans.shape[1]] = self._scans
            self._scans = larger
        rows = len(self.table)
        table = np.zeros((rows + len(clusters), COLUMNS))
        history = np.zeros((rows + len(clusters), HISTORY, 3))
        looks = np.zeros((rows + len(clusters), SURFACES, 4))
        table[:rows], history[:rows], looks[:rows] = self.table, self._history, self._looks
        self._scans[self._scan % SCANS, : len(points)] = points
        kept, self._count = _step(
            table, history, looks, self._scans, rows, self._count, self._scan, time, clusters, sight, *earlier
        )
        self._scan += 1
        self.table, self._history, self._looks = table[:kept], history[:kept], looks[:kept]


@njit(cache=True)
def _step(
    table: Array, history: Array, looks: Array, scans: Array, rows: int, count: int, scan: int, now: float, clusters: Array,
    sight: Sight, recent: Sight, past: Sight,
) -> tuple[int, int]:  # fmt: skip
    """Rows that remain, and how many obstacles there have been."""
    taken = np.zeros(len(clusters), dtype=np.bool_)
    points = scans[scan % SCANS]
    for i in range(rows):
        row = table[i]
        age = now - row[TIME]
        x, y = row[X], row[Y]
        if row[KIND] == DYNAMIC:
            x, y = x + age * row[VX], y + age * row[VY]
        best, nearest = -1, GATE + 0.5 * row[RADIUS]
        for k in range(len(clusters)):
            distance = math.hypot(clusters[k, 0] - x, clusters[k, 1] - y)
            if not taken[k] and distance < nearest:
                best, nearest = k, distance
        if best < 0:
            continue
        taken[best] = True
        _put(row, history[i], clusters[best], now, nearest)
        share = 0.0
        seen = points[int(clusters[best, 7]) : int(clusters[best, 8])]
        if now - history[i, 0, 0] >= SETTLED:
            if len(recent.ranges) > 2:
                share = max(share, seen_through(seen, recent.origin, recent.bearings, recent.ranges, SEEN_THROUGH))
            if len(past.ranges) > 2:
                share = max(share, seen_through(seen, past.origin, past.bearings, past.ranges, SEEN_THROUGH))
            for back in (FIRST_LOOK_BACK, LOOK_BACK):
                for k in range(int(row[LOOKS]) - 1, -1, -1):
                    time, at, start, stop = looks[i, k]
                    if now - time >= back:
                        if scan - at < SCANS:
                            stood = scans[int(at) % SCANS][int(start) : int(stop)]
                            share = max(share, seen_through(stood, sight.origin, sight.bearings, sight.ranges, SEEN_THROUGH))
                        break
        _remember(row, looks[i], now, scan, clusters[best])
        _judge(row, history[i], now, share)
    for k in range(len(clusters)):
        if not taken[k]:
            count += 1
            row = table[rows]
            row[NUMBER], row[TIME], row[FIRST_SEEN], row[LAST_SEEN] = count, now, now, now
            row[X], row[Y], row[RADIUS] = clusters[k, 0], clusters[k, 1], clusters[k, 2]
            row[AX : STOP + 1] = clusters[k, 3:9]
            history[rows, 0, 0], history[rows, 0, 1], history[rows, 0, 2] = now, clusters[k, 0], clusters[k, 1]
            row[POSITIONS] = 1
            rows += 1
    kept = 0
    for i in range(rows):
        if now - table[i, LAST_SEEN] < (COAST if table[i, KIND] == DYNAMIC else FORGET):
            if kept < i:
                table[kept], history[kept], looks[kept] = table[i], history[i], looks[i]
            kept += 1
    return kept, count


@njit(cache=True)
def _put(row: Array, history: Array, cluster: Array, now: float, off: float) -> None:
    """One more position; those before a turn, and those too old for its line, are forgotten."""
    n, first = int(row[POSITIONS]), 0
    if row[KIND] == DYNAMIC and off > OFF_LINE + 0.5 * max(0.0, cluster[2] - row[RADIUS]):
        first = max(0, n - 2)
    if n == HISTORY and first == 0:
        first = 1
    while first < n and now - history[first, 0] > WINDOW and n + 1 - first > 3:
        first += 1
    for k in range(first, n):
        history[k - first] = history[k]
    n -= first
    history[n, 0], history[n, 1], history[n, 2] = now, cluster[0], cluster[1]
    row[POSITIONS], row[LAST_SEEN] = n + 1, now
    row[RADIUS] = max(cluster[2], 0.98 * row[RADIUS]) if abs(cluster[2] - row[RADIUS]) < 0.2 else cluster[2]
    row[AX : STOP + 1] = cluster[3:9]


@njit(cache=True)
def _remember(row: Array, looks: Array, now: float, scan: int, cluster: Array) -> None:
    n = int(row[LOOKS])
    if n == SURFACES:
        for k in range(1, n):
            looks[k - 1] = looks[k]
        n -= 1
    looks[n, 0], looks[n, 1], looks[n, 2], looks[n, 3] = now, scan, cluster[7], cluster[8]
    row[LOOKS] = n + 1


@njit(cache=True)
def _judge(row: Array, history: Array, now: float, share: float) -> None:
    """Velocity and set of an obstacle, of whose points this share stands where it was free, or stood where it is free now."""
    n = int(row[POSITIONS])
    x, y, vx, vy = line(history[:n])
    speed = math.hypot(vx, vy)
    moving = share >= NEWLY_TAKEN and SLOW < speed < TOO_FAST
    row[EVIDENCE] = min(row[EVIDENCE] + 1, 8) if moving else max(row[EVIDENCE] - 1, 0)
    if row[KIND] == DYNAMIC:
        if row[EVIDENCE] == 0 or speed < 0.5 * SLOW:
            row[KIND] = STATIONARY
    elif row[EVIDENCE] >= 2:
        row[KIND] = DYNAMIC
    elif row[EVIDENCE] == 1:
        row[KIND] = PROVISIONALLY_DYNAMIC
    elif now - row[FIRST_SEEN] >= LOOK_BACK:
        row[KIND] = STATIONARY
    if row[KIND] == DYNAMIC:
        row[X], row[Y], row[VX], row[VY] = x, y, vx, vy
    else:
        row[X], row[Y], row[VX], row[VY] = history[n - 1, 1], history[n - 1, 2], 0.0, 0.0
    row[TIME] = now


@njit(cache=True)
def ends_of(origin: Array, bearings: Array, ranges: Array, beams: NDArray[np.int64]) -> Array:
    """Where these beams end, (k, 2) [m]."""
    points = np.empty((len(beams), 2))
    for k in range(len(beams)):
        points[k, 0] = origin[0] + ranges[beams[k]] * math.cos(bearings[beams[k]])
        points[k, 1] = origin[1] + ranges[beams[k]] * math.sin(bearings[beams[k]])
    return points


@njit(cache=True)
def seen_through(points: Array, origin: Array, bearings: Array, ranges: Array, margin: float) -> float:
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
def line(history: Array) -> tuple[float, float, float, float]:
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
