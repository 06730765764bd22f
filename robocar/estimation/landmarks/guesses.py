"""Where a robot may be that sees what it sees: fresh particles for one that is lost.

Sensor resetting (Lenser and Veloso, Sensor Resetting Localization for Poorly Modelled Mobile Robots, 2000). One landmark at a
known bearing and range leaves a circle of poses, two leave a single one; the second may have been seen a moment ago.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robocar.core import SE2, Array, Detection
from robocar.estimation.landmarks.area import Area
from robocar.estimation.landmarks.sensor_models import Atlas

_MEMORY = 5.0  # [s] older sightings say nothing about a robot that may have been carried off since
_TRIES = 8  # poses drawn for each that is wanted: many lie in walls


class Guesses:
    """Draws poses from which the last sightings would be as they were.

    Args:
        bearing_std, range_std: added in squares to what detections say of themselves [rad], [share of the range].
    """

    def __init__(self, atlas: Atlas, area: Area, bearing_std: float, range_std: float) -> None:
        self._atlas, self._area = atlas, area
        self._bearing_std, self._range_std = bearing_std, range_std
        self._last: dict[str, tuple[SE2, Detection]] = {}

    def see(self, odometry: SE2, detections: Sequence[Detection]) -> None:
        """Keeps the last sighting of each landmark, with the odometry's pose at that time."""
        for detection in detections:
            if detection.landmark in self._atlas:
                self._last[detection.landmark] = odometry, detection

    def draw(self, count: int, odometry: SE2, detections: Sequence[Detection], rng: np.random.Generator) -> Array:
        """Poses (count, 3) of now, when the odometry says `odometry`: half from pairs of landmarks, the rest from single ones."""
        known = [d for d in detections if d.landmark in self._atlas]
        if not known:
            return self.anywhere(count, rng)
        poses = self._from_pairs(count - count // 2, odometry, known, rng)
        poses = np.concatenate([poses, self._from_circles(count - len(poses), known, rng)])
        return np.concatenate([poses, self.anywhere(count - len(poses), rng)])

    def by_ranges(self, count: int, detections: Sequence[Detection], rng: np.random.Generator) -> Array:
        """Poses (count, 3) where the circles around two landmarks meet, with any heading: all that ranges alone say."""
        known = [d for d in detections if d.landmark in self._atlas]
        found = [np.empty((0, 3))]
        for k, one in enumerate(known):
            for other in known[k + 1 :]:
                found.append(self._crossings(count, one, other, rng))
        poses = np.concatenate(found)
        poses = poses[rng.permutation(len(poses))[:count]]
        return np.concatenate([poses, self.anywhere(count - len(poses), rng)])

    def _crossings(self, count: int, one: Detection, other: Detection, rng: np.random.Generator) -> Array:
        places = [
            self._atlas.places(d.landmark)[rng.integers(len(self._atlas.places(d.landmark)), size=count)] for d in (one, other)
        ]
        apart = places[1] - places[0]
        distance = np.maximum(np.linalg.norm(apart, axis=1), 1e-9)
        (_, near), (_, far) = self._noisy(one, count, rng), self._noisy(other, count, rng)
        along = (distance**2 + near**2 - far**2) / (2.0 * distance)
        square = near**2 - along**2
        aside = rng.choice((-1.0, 1.0), count) * np.sqrt(np.maximum(square, 0.0))
        ahead = apart / distance[:, None]
        points = places[0] + along[:, None] * ahead + aside[:, None] * np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        meet = (square >= 0.0) & self._area.holds(points)
        return np.concatenate([points, rng.uniform(-math.pi, math.pi, (count, 1))], axis=1)[meet]

    def anywhere(self, count: int, rng: np.random.Generator) -> Array:
        """Poses spread evenly over the area, (count, 3)."""
        return np.concatenate([self._area.sample(count, rng), rng.uniform(-math.pi, math.pi, (count, 1))], axis=1)

    def _noisy(self, detection: Detection, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Bearings and ranges (count,) as they may really be."""
        bearing_std = math.hypot(math.sqrt(detection.covariance[0, 0]), self._bearing_std)
        range_std = math.hypot(math.sqrt(detection.covariance[1, 1]), self._range_std * detection.range)
        bearings = detection.bearing + bearing_std * rng.standard_normal(count)
        off = range_std * rng.standard_normal(count)
        off[off > 0.0] *= detection.short_tail  # the landmark is farther than the reading says
        return bearings, np.maximum(1e-3, detection.range + off)

    def _from_circles(self, count: int, known: Sequence[Detection], rng: np.random.Generator) -> Array:
        tries = _TRIES * -(-count // len(known))
        found = []
        for detection in known:
            places = self._atlas.places(detection.landmark)
            marks = places[rng.integers(len(places), size=tries)]
            bearings, ranges = self._noisy(detection, tries, rng)
            toward = rng.uniform(-math.pi, math.pi, tries)  # direction from the robot to the landmark
            points = marks - ranges[:, None] * np.stack([np.cos(toward), np.sin(toward)], axis=1)
            found.append(np.concatenate([points, (toward - bearings)[:, None]], axis=1)[self._area.holds(points)])
        poses = np.concatenate(found)
        return poses[rng.permutation(len(poses))[:count]]

    def _from_pairs(self, count: int, odometry: SE2, known: Sequence[Detection], rng: np.random.Generator) -> Array:
        """None (0, 3) where no two landmarks are as far apart as they were seen."""
        found = []
        for detection in known:
            for name, (pose, other) in self._last.items():
                if name != detection.landmark and abs(detection.time - other.time) <= _MEMORY:
                    found.append(self._from_pair(count, detection, odometry.inverse() @ pose, other, rng))
        poses = np.concatenate([np.empty((0, 3)), *found])
        return poses[rng.permutation(len(poses))[:count]]

    def _from_pair(self, count: int, one: Detection, now_from_then: SE2, other: Detection, rng: np.random.Generator) -> Array:
        places = [
            self._atlas.places(d.landmark)[rng.integers(len(self._atlas.places(d.landmark)), size=count)] for d in (one, other)
        ]
        spots = []
        for detection, frame in ((one, SE2()), (other, now_from_then)):
            bearings, ranges = self._noisy(detection, count, rng)
            spots.append(frame.transform(ranges[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)))
        apart, seen = places[1] - places[0], spots[1] - spots[0]
        distance = np.linalg.norm(apart, axis=1)
        range_stds = (max(math.sqrt(d.covariance[1, 1]) * d.short_tail, self._range_std * d.range) for d in (one, other))
        slack = 3.0 * math.hypot(*range_stds) + 0.05
        fits = (np.abs(np.linalg.norm(seen, axis=1) - distance) < slack) & (distance > 1e-6)
        theta = np.arctan2(apart[:, 1], apart[:, 0]) - np.arctan2(seen[:, 1], seen[:, 0])
        c, s = np.cos(theta), np.sin(theta)
        points = places[0] - np.stack([c * spots[0][:, 0] - s * spots[0][:, 1], s * spots[0][:, 0] + c * spots[0][:, 1]], axis=1)
        fits &= self._area.holds(points)
        return np.concatenate([points, theta[:, None]], axis=1)[fits]
