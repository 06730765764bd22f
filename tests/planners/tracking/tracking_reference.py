"""The rules of `robocar.planners.tracking.tracker`, one obstacle after the other, in plain Python: an oracle for its kernel."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from robocar.core import Array
from robocar.planners.tracking.kernel import ends_of, line, seen_through
from robocar.planners.tracking.panorama import ScanPanorama
from robocar.planners.tracking.tracker import Kind, _clusters


@dataclass
class Follow:
    """An obstacle and all that is remembered of it."""

    number: int
    time: float
    position: Array
    radius: float
    ends: Array
    first_seen: float
    history: deque[tuple[float, float, float]]
    kind: Kind = Kind.PROVISIONAL
    velocity: Array = field(default_factory=lambda: np.zeros(2))
    surface: deque[tuple[float, Array]] = field(default_factory=lambda: deque(maxlen=16))
    evidence: int = 0

    @property
    def moves(self) -> bool:
        return self.kind is Kind.DYNAMIC


class Reference:
    """Follows obstacles as `Obstacles` does."""

    def __init__(self, max_width: float, max_distance: float) -> None:
        self.max_width, self.max_distance = max_width, max_distance
        self.tracked: list[Follow] = []
        self.past: deque[ScanPanorama] = deque(maxlen=16)
        self.count = 0

    def update(self, seen: ScanPanorama) -> None:
        clusters, beams = _clusters(seen.bearings, seen.ranges, seen.spacing, self.max_width, self.max_distance, *seen.origin)
        left, now = list(range(len(clusters))), seen.time
        for obstacle in self.tracked:
            x, y = obstacle.position + (now - obstacle.time) * obstacle.velocity
            apart = {k: math.hypot(clusters[k, 0] - x, clusters[k, 1] - y) for k in left}
            nearest = min(left, key=lambda k: apart[k], default=None)
            if nearest is not None and apart[nearest] < 0.35 + 0.5 * obstacle.radius:
                left.remove(nearest)
                points = ends_of(
                    seen.origin, seen.bearings, seen.ranges, beams[int(clusters[nearest, 7]) : int(clusters[nearest, 8])]
                )
                self.follow(obstacle, seen, clusters[nearest], points, apart[nearest])
        for k in left:
            self.count += 1
            x, y, radius, *ends = clusters[k, :7].tolist()
            history = deque([(now, x, y)], maxlen=32)
            self.tracked.append(Follow(self.count, now, np.array([x, y]), radius, np.reshape(ends, (2, 2)), now, history))
        self.tracked = [o for o in self.tracked if now - o.history[-1][0] < (1.5 if o.moves else 3.0)]
        self.past.append(seen)

    def follow(self, obstacle: Follow, seen: ScanPanorama, cluster: Array, points: Array, off: float) -> None:
        x, y, radius, *ends = cluster[:7].tolist()
        now, history = seen.time, obstacle.history
        if obstacle.moves and off > 0.12 + 0.5 * max(0.0, radius - obstacle.radius):
            while len(history) > 2:
                history.popleft()
        history.append((now, x, y))
        while now - history[0][0] > 1.05 and len(history) > 3:
            history.popleft()
        obstacle.radius = max(radius, 0.98 * obstacle.radius) if abs(radius - obstacle.radius) < 0.2 else radius
        obstacle.ends = np.reshape(ends, (2, 2))
        px, py, vx, vy = line(np.array(history))
        speed = math.hypot(vx, vy)
        shares = [0.0]
        for age in (0.35, 1.45):
            scan = next((p for p in reversed(self.past) if now - p.time >= age), None)
            stood = next((old for time, old in reversed(obstacle.surface) if now - time >= age), None)
            if scan is not None and len(scan.ranges) > 2:
                shares.append(seen_through(points, scan.origin, scan.bearings, scan.ranges, 0.08))
            if stood is not None:
                shares.append(seen_through(stood, seen.origin, seen.bearings, seen.ranges, 0.08))
        taken = max(shares) if now - history[0][0] >= 0.25 else 0.0
        obstacle.surface.append((now, points))
        moving = taken >= 0.3 and 0.04 < speed < 1.5
        obstacle.evidence = min(obstacle.evidence + 1, 8) if moving else max(obstacle.evidence - 1, 0)
        if obstacle.moves:
            if obstacle.evidence == 0 or speed < 0.02:
                obstacle.kind = Kind.STATIONARY
        elif obstacle.evidence >= 2:
            obstacle.kind = Kind.DYNAMIC
        elif obstacle.evidence == 1:
            obstacle.kind = Kind.PROVISIONALLY_DYNAMIC
        elif now - obstacle.first_seen >= 1.45:
            obstacle.kind = Kind.STATIONARY
        obstacle.position = np.array([px, py] if obstacle.moves else [x, y])
        obstacle.velocity = np.array([vx, vy]) if obstacle.moves else np.zeros(2)
        obstacle.time = now
