"""What a bug with a range sensor all round sees: open points, where the range jumps, and the sub-goals beside them.

Das, Dutta and Debnath, Operative Critical Point Bug, IJEECS 18(3), 2020, section 2: the virtual circle, open points by a jump
of the range between neighbouring beams, sub-goals beside them (eq. 1-5), and the offset of the axle (eq. 6).

What the paper leaves open, and how it is decided here:

* Noise, and walls seen at a grazing angle, whose range jumps from beam to beam with no end in sight: a jump is an open point only
  if the far reading lies beyond what a straight continuation of the near surface predicts, by four standard deviations. Along a
  straight surface 1 / range is a linear combination of the bearing's cosine and sine, so the prediction is a linear fit. Where
  the reading agrees with the prediction the surface may go on, or end: such points are kept, marked as not `sure`.
* Where between the last beam on the obstacle and the first off it the end lies: half-way, on the continuation of the surface. On
  a wall seen at a grazing angle that is a long stretch, and of a face that one beam alone has met the direction is not known:
  the stretch is kept with the point.
* Lost beams (nan) are skipped; where more than two in a row are missing, what lies between is unknown and makes no open point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from robocar.core import SE2, Array, Footprint, frozen_array
from robocar.planners.tracking.panorama import ScanPanorama

_SIGMAS = 4.0  # by which a reading must lie beyond the continued surface
_ALONE = 1.5  # the same for the last beam before an end, which may be the only one on another face of a corner
_FIT = 5  # beams of the near surface that are continued
_MISSING = 3.5  # beam spacings: farther apart, neighbours do not speak of what lies between them


@dataclass(frozen=True, slots=True)
class VirtualCircle:
    """Circle around the robot (section 2.1): its centre lies midway between the two farthest points of the outline.

    Args:
        radius: half the distance of these points and the safety constant, r [m].
        body: without the safety constant [m].
        driving: half the width of what the robot sweeps driving straight, and two thirds of the safety
            constant [m].
        offset: robot_from_centre, x and y [m]; the length is the paper's AC.
    """

    radius: float
    body: float
    driving: float
    offset: tuple[float, float]

    @classmethod
    def of(cls, footprint: Footprint, safety_constant: float) -> VirtualCircle:
        """Of an outline, with the safety constant in metres."""
        corners = footprint.vertices
        apart = np.linalg.norm(corners[:, None] - corners[None], axis=2)
        i, j = np.unravel_index(int(apart.argmax()), apart.shape)
        middle = 0.5 * (corners[i] + corners[j])
        # Of a body that is not symmetric some corner may lie outside the circle over its longest diagonal.
        body = float(np.linalg.norm(corners - middle, axis=1).max())
        half = float(np.abs(corners[:, 1] - middle[1]).max())
        return cls(body + safety_constant, body, half + 2.0 / 3.0 * safety_constant, (float(middle[0]), float(middle[1])))

    def centre(self, pose: SE2) -> Array:
        """Where the circle is, (2,) [m]."""
        return np.array(pose.apply(*self.offset))

    def axle(self, centre: Array, heading: float) -> Array:
        """Eq. 6: where the robot's origin has to be for the circle to be at `centre` with this heading, (2,) [m]."""
        return np.array(SE2(float(centre[0]), float(centre[1]), heading).apply(-self.offset[0], -self.offset[1]))


@dataclass(frozen=True, slots=True, eq=False)
class OpenPoint:
    """A visible end of an obstacle.

    Args:
        position: (2,) [m]; bearing [rad] and range [m] from the sensor.
        side: +1 where the free side is counter-clockwise of it (obstacle, then open), -1 where it is clockwise.
        sure: False where the surface may as well go on, seen at too grazing an angle to tell.
        before: how far before `position`, along `along`, the last beam met the surface [m]; beyond: how far beyond it the
            next beam would have, had the surface gone on [m]. The end lies in between.
        along: unit vector of the surface towards its end, (2,); zero where too little is seen of it.
    """

    position: Array
    bearing: float
    range: float
    side: int
    sure: bool = True
    before: float = 0.0
    beyond: float = 0.0
    along: tuple[float, float] = (0.0, 0.0)

    @property
    def normal(self) -> Array:
        """Towards the free side, perpendicular to the line from the sensor, (2,): the four cases of eq. 4 in one."""
        return self.side * np.array([-math.sin(self.bearing), math.cos(self.bearing)])

    def subgoal(self, radius: float) -> Array:
        """Eq. 5: beside the open point, at this distance on its free side, (2,) [m]."""
        return self.position + radius * self.normal


def find_open_points(panorama: ScanPanorama, range_jump: float, range_std: float) -> list[OpenPoint]:
    """All open points of a panorama, counter-clockwise (section 2.1, both kinds: obstacle to open, open to obstacle).

    Args:
        range_jump: the paper's delta d [m].
        range_std: of the sensor's noise [m].
    """
    return points_of(open_point_rows(panorama, range_jump, range_std))


def points_of(rows: Array) -> list[OpenPoint]:
    """The open points that these rows of `open_point_rows` are."""
    return [
        OpenPoint(frozen_array([x, y]), bearing, distance, int(side), sure > 0.0, before, beyond, (ux, uy))
        for x, y, bearing, distance, side, sure, before, beyond, ux, uy in rows.tolist()
    ]


def open_point_rows(panorama: ScanPanorama, range_jump: float, range_std: float) -> Array:
    """What `find_open_points` finds, (k, 10): x, y, bearing, range, side, sure, before, beyond, along's x and y."""
    seen = ~np.isnan(panorama.ranges)
    bearings, ranges = panorama.bearings[seen], panorama.ranges[seen]
    if len(ranges) < 3:
        return np.empty((0, 10))
    x, y = panorama.origin.tolist()
    apart = _MISSING * panorama.spacing
    return _jumps(bearings, ranges, x, y, panorama.max_range, apart, range_jump, range_std, panorama.thin)


@njit(cache=True)
def _jumps(
    bearings: Array, ranges: Array, x: float, y: float, max_range: float, apart: float, jump: float, std: float, thin: bool
) -> Array:
    """See `open_point_rows`; `ranges` without nan, inf where nothing is."""
    n = len(ranges)
    found = np.empty((n, 10))
    count = 0
    fit_b, fit_r = np.empty(_FIT), np.empty(_FIT)
    straight, expected, spread, half = True, 0.0, 0.0, 0.0
    for i in range(n):
        j = (i + 1) % n
        between = (bearings[j] - bearings[i]) % (2.0 * math.pi)
        if between > apart or between <= 0.0:
            continue
        near_i, near_j = min(ranges[i], max_range), min(ranges[j], max_range)
        if abs(near_j - near_i) <= jump:
            continue
        side = 1 if near_i < near_j else -1  # the free side, seen from the near one
        near, d, far = (i, near_i, near_j) if side == 1 else (j, near_j, near_i)
        if d <= 0.0:
            continue
        sure, beyond, lone = 1.0, d, False
        edge, at = bearings[near] + 0.5 * side * between, d
        if thin:
            # The surface up to the jump, from the last beam backwards: as many beams as lie on one straight line.
            m, k = 0, near
            while m < min(_FIT, n):
                if not 0.0 < ranges[k] < math.inf:
                    break
                fit_b[m] = (bearings[k] - bearings[near] + math.pi) % (2.0 * math.pi) - math.pi
                fit_r[m] = ranges[k]
                if abs(fit_b[m]) > m * apart:
                    break
                m, k = m + 1, (k - side) % n
            if m > 3:  # is the last beam alone on a face of its own?
                straight, expected, spread, _ = _continued(fit_b[1:m], fit_r[1:m], 0.0, std)
                lone = abs(1.0 / d - expected) > _ALONE * math.hypot(spread, std / (d * d))
            while m >= 2:
                straight, expected, spread, half = _continued(fit_b[:m], fit_r[:m], side * between, std)
                if straight:
                    break
                m -= 1
            if m >= 2:
                noise = _SIGMAS * math.hypot(spread, std / (far * far))
                if 1.0 / far > expected + noise or (far >= max_range and expected < 1.0 / far):
                    continue  # the surface goes on, or bends towards the sensor
                sure = 1.0 if 1.0 / far < expected - noise else 0.0
                beyond = min(1.0 / max(expected, 1e-6), far)
                if m < 3:
                    edge = bearings[near]  # too little of the surface is seen to continue it
                elif half > 0.0:
                    at = min(max(1.0 / half, d - 3.0 * std), 0.5 * (d + 1.0 / max(expected, 1e-6)) + 3.0 * std, far)
        px, py = at * math.cos(edge), at * math.sin(edge)
        ax, ay = px - d * math.cos(bearings[near]), py - d * math.sin(bearings[near])
        turn = bearings[near] + side * between
        bx, by = beyond * math.cos(turn) - px, beyond * math.sin(turn) - py
        length = math.hypot(ax + bx, ay + by)
        row = found[count]
        row[0], row[1], row[2], row[3], row[4], row[5] = x + px, y + py, edge, at, side, sure
        row[6], row[7] = math.hypot(ax, ay), math.hypot(bx, by)
        row[8], row[9] = ((ax + bx) / length, (ay + by) / length) if length > 1e-9 else (0.0, 0.0)
        if lone:  # which way that face goes one beam does not tell: it may end about as far away as it has begun
            k = (near - side) % n
            ax, ay = d * math.cos(bearings[near]), d * math.sin(bearings[near])
            ax, ay = ax - ranges[k] * math.cos(bearings[k]), ay - ranges[k] * math.sin(bearings[k])
            length = max(math.hypot(ax, ay), 1e-9)
            row[7], row[8], row[9] = length, ax / length, ay / length
        count += 1
    return found[:count]


@njit(cache=True)
def _continued(b: Array, r: Array, at: float, std: float) -> tuple[bool, float, float, float]:
    """A straight surface 1 / r = p cos b + q sin b through beams (b, r), continued to bearing `at`: whether they lie on one
    within their noise, its 1 / r there, that value's standard deviation, and its 1 / r half-way."""
    cc = cs = ss = cu = su = 0.0
    for k in range(len(b)):
        c, s, w = math.cos(b[k]), math.sin(b[k]), r[k] ** 4  # the noise of 1 / r is std / r^2
        cc, cs, ss, cu, su = cc + w * c * c, cs + w * c * s, ss + w * s * s, cu + w * c / r[k], su + w * s / r[k]
    det = cc * ss - cs * cs
    if det <= 1e-12 * (cc + ss) ** 2:
        return True, 1.0 / r[0], std / (r[0] * r[0]), 1.0 / r[0]
    p, q = (ss * cu - cs * su) / det, (cc * su - cs * cu) / det
    straight = True
    for k in range(len(b)):
        off = abs(1.0 / r[k] - p * math.cos(b[k]) - q * math.sin(b[k]))
        straight = straight and off <= _SIGMAS * max(std, 1e-3) / (r[k] * r[k])
    c, s = math.cos(at), math.sin(at)
    spread = std * math.sqrt(max(0.0, (ss * c * c - 2.0 * cs * c * s + cc * s * s) / det))
    return straight, p * c + q * s, spread, p * math.cos(0.5 * at) + q * math.sin(0.5 * at)
