"""Ranges all round: panoramas of a laser or a ring of sonars, and the middle of several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from robocar.core import SE2, Array, Observation, ParameterError, Robot, Scan, frozen_array

_SAME_SURFACE = 0.05  # [m] beams whose ranges differ by less end on one surface
_STALE = 0.3  # [s] a sonar's last reading counts for this long


@dataclass(frozen=True, slots=True, eq=False)
class ScanPanorama:
    """Ranges all round, in the map frame.

    Args:
        time: of the scan [s].
        origin: where the sensor was, (2,) [m].
        bearings: ascending over one turn, (n,) [rad].
        ranges: (n,) [m]; inf: nothing in range; nan: lost.
        max_range: [m].
        spacing: between neighbouring beams as fitted [rad].
        thin: whether the beams are a laser's; a sonar's cone hears the nearest surface in it, so surfaces are not continued.
    """

    time: float
    origin: Array
    bearings: Array
    ranges: Array
    max_range: float
    spacing: float
    thin: bool = True

    @property
    def lost(self) -> bool:
        """Whether no beam at all came back with an answer."""
        return not np.any(~np.isnan(self.ranges))

    def hits(self) -> Array:
        """Surface points, (m, 2) [m]; a laser's ranges are means over up to five beams on the same surface."""
        return _hits(self.origin, self.bearings, self.ranges, self.thin)


class Surround:
    """Makes panoramas of a robot's laser or, if it has none, of its ring of sonars.

    Args:
        widest: largest angle between neighbouring beams that will do [rad].

    Raises:
        ParameterError: the robot does not look all round closely enough; the message says how many beams are needed.
    """

    def __init__(self, robot: Robot, widest: float) -> None:
        self._lidar = robot.lidar is not None
        if robot.lidar is not None:
            bearings = robot.lidar.bearings + robot.lidar.robot_from_sensor.theta
        else:
            bearings = np.array([sonar.robot_from_sensor.theta + b for sonar in robot.sonars for b in sonar.bearings])
        needed = math.ceil(math.tau / widest - 1e-9)
        around = np.sort(np.remainder(bearings, math.tau))
        gaps = np.diff(np.append(around, around[:1] + math.tau)) if len(around) else np.array([math.tau])
        if gaps.max() > widest + 1e-9:
            raise ParameterError(
                f"open points need at least {needed} beams all round, at most {math.degrees(widest):.1f} degrees apart; this "
                f"robot has {len(around)}, up to {math.degrees(gaps.max()):.1f} degrees apart; fit robot.lidar: scan360 or "
                "robot.sonars: ring"
            )
        self._spacing = float(np.median(gaps))
        self._heard: dict[tuple[float, float, float], Scan] = {}

    def panorama(self, observation: Observation, pose: SE2) -> ScanPanorama | None:
        """The world around as seen in this tick; None where the sensor has nothing new to say."""
        if self._lidar:
            return self._of_laser(observation.lidar, pose) if observation.lidar is not None else None
        if not observation.sonars:
            return None
        return self._of_sonars(observation, pose)

    def _of_laser(self, scan: Scan, pose: SE2) -> ScanPanorama:
        sensor = pose @ scan.robot_from_sensor
        bearings, ranges = scan.bearings, scan.ranges
        if np.any(np.diff(bearings) <= 0.0):
            order = np.argsort(bearings, kind="stable")
            bearings, ranges = bearings[order], ranges[order]
        return ScanPanorama(
            scan.time,
            frozen_array(sensor.position),
            frozen_array(bearings + sensor.theta),
            frozen_array(_checked(ranges, scan.max_range)),
            scan.max_range,
            self._spacing,
        )

    def _of_sonars(self, observation: Observation, pose: SE2) -> ScanPanorama:
        """The last echo of every sonar, as seen from the robot's origin."""
        for scan in observation.sonars:
            mount = scan.robot_from_sensor
            self._heard[mount.x, mount.y, mount.theta] = scan
        self._heard = {key: scan for key, scan in self._heard.items() if scan.time >= observation.time - _STALE}
        bearings, ranges = [], []
        for scan in self._heard.values():
            heard = _checked(scan.ranges, scan.max_range)
            for bearing, distance in zip(scan.bearings, heard, strict=True):
                reach = distance if math.isfinite(distance) else scan.max_range
                x, y = scan.robot_from_sensor.apply(reach * math.cos(bearing), reach * math.sin(bearing))
                bearings.append(math.atan2(y, x) + pose.theta)
                ranges.append(math.hypot(x, y) if math.isfinite(distance) else distance)
        order = np.argsort(bearings, kind="stable")
        return ScanPanorama(
            observation.time,
            frozen_array(pose.position),
            frozen_array(np.array(bearings)[order]),
            frozen_array(np.array(ranges)[order]),
            max(scan.max_range for scan in self._heard.values()),
            self._spacing,
            thin=False,
        )


class Lookout:
    """Collects the scans that a decision is made from, while the robot stands.

    Args:
        looks: how many.
    """

    def __init__(self, looks: int) -> None:
        self._looks = looks
        self._seen: list[ScanPanorama] = []

    def start(self) -> None:
        """Forgets what was seen from elsewhere."""
        self._seen.clear()

    def look(self, panorama: ScanPanorama) -> ScanPanorama | None:
        """Takes one more in; their `middle` when there are enough."""
        self._seen.append(panorama)
        if len(self._seen) < self._looks:
            return None
        seen, self._seen = middle(self._seen), []
        return seen


def middle(panoramas: Sequence[ScanPanorama]) -> ScanPanorama:
    """The last of them, each range replaced by the median over all that were taken from the same place; lost readings do not
    count. Standing still and looking a few times, the sensor's noise shrinks and lost beams come back."""
    last = panoramas[-1]
    same = [p for p in panoramas if p.ranges.shape == last.ranges.shape and math.dist(p.origin, last.origin) < 0.01]
    ranges = _medians(np.array([p.ranges for p in same]))
    return ScanPanorama(last.time, last.origin, last.bearings, frozen_array(ranges), last.max_range, last.spacing, last.thin)


@njit(cache=True)
def _medians(ranges: Array) -> Array:
    """Lower median of each column of (k, n), without its nan; nan where all are."""
    k, n = ranges.shape
    out, column = np.empty(n), np.empty(k)
    for j in range(n):
        m = 0
        for i in range(k):
            if not math.isnan(ranges[i, j]):
                column[m] = ranges[i, j]
                m += 1
        if m == 0:
            out[j] = math.nan
        elif m % 2 == 1:
            out[j] = np.sort(column[:m])[m // 2]
        else:  # a mean of two on one surface; between two surfaces there is none
            low, high = np.sort(column[:m])[m // 2 - 1], np.sort(column[:m])[m // 2]
            out[j] = 0.5 * (low + high) if high - low < 2.0 * _SAME_SURFACE else low
    return out


@njit(cache=True)
def _smoothed(ranges: Array) -> Array:
    """Means over as many as two beams on either side that lie on the same surface."""
    n, out = len(ranges), ranges.copy()
    for i in range(n):
        total, count = ranges[i], 1
        for k in range(1, 3):
            a, b = ranges[(i - k) % n], ranges[(i + k) % n]
            if not (abs(a - ranges[i]) < _SAME_SURFACE and abs(b - ranges[i]) < _SAME_SURFACE):  # nan and inf too
                break
            total, count = total + a + b, count + 2
        out[i] = total / count
    return out


@njit(cache=True)
def _hits(origin: Array, bearings: Array, ranges: Array, smooth: bool) -> Array:
    """Where the beams end that hit something, (m, 2)."""
    n, count = len(ranges), 0
    points = np.empty((n, 2))
    means = _smoothed(ranges) if smooth else ranges
    for i in range(n):
        if math.isfinite(ranges[i]):
            points[count, 0] = origin[0] + means[i] * math.cos(bearings[i])
            points[count, 1] = origin[1] + means[i] * math.sin(bearings[i])
            count += 1
    return points[:count]


def _checked(ranges: Array, max_range: float) -> Array:
    """Readings below zero are lost ones, those beyond the range saw nothing."""
    return np.where(ranges > max_range, np.inf, np.where(ranges > 0.0, ranges, np.nan))
