"""Whether the robot will meet an obstacle that moves, where and when, and the virtual obstacle there.

Das, Dutta and Debnath, Operative Critical Point Bug, IJEECS 18(3), 2020, eq. 8-10 and section 3.1.

Eq. 9 and 10 are for points. With bodies that have dimensions the robot's virtual circle and the obstacle's circle meet if they
overlap at any time while the robot turns, drives and stands at the end of its way. For paths that cross this is |RTC - OTC|
within the time that both need to clear the collision point; it holds for parallel paths too, which have no such point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array, frozen_array
from robocar.core.compiling import warm_up
from robocar.planners.tracking.panorama import ScanPanorama
from robocar.planners.tracking.tracker import Tracked


@dataclass(frozen=True, slots=True, eq=False)
class Collision:
    """The robot and an obstacle will meet.

    Args:
        obstacle: which one.
        point: P_C, where the robot's circle will be when they touch first, (2,) [m].
        robot_time, obstacle_time: RTC and OTC, until each is there (eq. 9, 10) [s].
        first, last: from when to when they overlap [s], from now on.
        start, end: where the obstacle is at these times, (2,) [m]: between them it is the virtual obstacle.
    """

    obstacle: Tracked
    point: Array
    robot_time: float
    obstacle_time: float
    first: float
    last: float
    start: Array
    end: Array


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """Obstacles that move.

    Args:
        obstacles: as they are followed.
        rows: x, y, vx, vy, radius and time of each, (n, 6) [m, m/s, s].
    """

    obstacles: list[Tracked]
    rows: Array

    @classmethod
    def of(cls, obstacles: list[Tracked]) -> Moving:
        rows = [(*o.position.tolist(), *o.velocity.tolist(), o.radius, o.time) for o in obstacles]
        return cls(obstacles, np.array(rows).reshape(-1, 6))

    def __len__(self) -> int:
        return len(self.obstacles)


class StraightDrive(NamedTuple):
    """What the robot means to do: stand and turn, drive straight, stand there.

    Args:
        x, y: centre of its circle where it begins [m].
        heading: of its way [rad].
        length: of its way [m].
        speed: [m/s].
        delay: until it drives [s].
        stay: that it stands at the end [s].
        radius: of its circle, with what is to be kept free around it [m].
    """

    x: float
    y: float
    heading: float
    length: float
    speed: float
    delay: float
    stay: float
    radius: float


def predict(moving: Moving, now: float, drive: StraightDrive, horizon: float) -> Collision | None:
    """The first collision with one of the obstacles, if the robot's circle drives straight (eq. 7-10); None if there is none.

    Args:
        horizon: how far ahead it looks [s].
    """
    k, begin, end = _first(moving.rows, now, drive, horizon)
    if k < 0:
        return None
    obstacle = moving.obstacles[k]
    (x, y), (vx, vy), v = obstacle.at(now).tolist(), obstacle.velocity.tolist(), obstacle.speed
    gone = min(max(begin - drive.delay, 0.0) * drive.speed, drive.length)
    px, py = drive.x + gone * math.cos(drive.heading), drive.y + gone * math.sin(drive.heading)
    return Collision(
        obstacle,
        frozen_array([px, py]),
        gone / drive.speed,
        math.hypot(x - px, y - py) / v if v > 0 else 0.0,
        begin,
        end,
        frozen_array([x + begin * vx, y + begin * vy]),
        frozen_array([x + end * vx, y + end * vy]),
    )


def crossing(start: Array, heading: float, obstacle: Array, velocity: Array) -> Array | None:
    """P_C of the paper: where the lines of robot and obstacle cross, ahead of both, (2,) [m]; None where they do not."""
    c, s = math.cos(heading), math.sin(heading)
    det = c * velocity[1] - s * velocity[0]
    if abs(det) < 1e-9:
        return None
    dx, dy = obstacle[0] - start[0], obstacle[1] - start[1]
    gone = (dx * velocity[1] - dy * velocity[0]) / det
    other = (dx * s - dy * c) / det
    return np.array([start[0] + gone * c, start[1] + gone * s]) if gone >= 0.0 and other >= 0.0 else None


def standing_world(panorama: ScanPanorama, moving: Moving, margin: float) -> ScanPanorama:
    """The panorama without the obstacles that move: beams that end within `margin` [m] of one are lost ones."""
    if not len(moving):
        return panorama
    ranges = np.array(panorama.ranges)
    _blank(ranges, panorama.bearings, panorama.origin, moving.rows, panorama.time, margin)
    ranges.flags.writeable = False
    return replace(panorama, ranges=ranges)


def with_virtual(panorama: ScanPanorama, collisions: list[Collision], margin: float = 0.0) -> ScanPanorama:
    """The panorama with a virtual obstacle at each collision point: what the obstacle, grown by `margin` [m], sweeps while the
    two would overlap."""
    ranges = np.array(panorama.ranges)
    for c in collisions:
        _cast_capsule(ranges, panorama.origin, panorama.bearings, c.start, c.end, c.obstacle.radius + margin)
    return replace(panorama, ranges=frozen_array(ranges))


def near_virtual(points: Array, collisions: list[Collision], margin: float) -> NDArray[np.bool_]:
    """Which of the points (n, 2 or more columns: x, y) lie within `margin` [m] of a virtual obstacle, (n,)."""
    near = np.zeros(len(points), dtype=np.bool_)
    for c in collisions:
        _mark_near(near, points, c.start, c.end, c.obstacle.radius + margin)
    return near


@warm_up
def prepare() -> None:
    """Compiles what the control loop needs."""
    bearings = frozen_array(np.linspace(-math.pi, math.pi, 36, endpoint=False))
    panorama = ScanPanorama(0.0, frozen_array(np.zeros(2)), bearings, frozen_array(np.full(36, 4.0)), 6.0, math.tau / 36)
    ahead = Moving.of([Tracked(0, 0.0, np.array([2.0, 0.0]), 0.2, np.zeros((2, 2)), velocity=np.array([-0.1, 0.0]))])
    collision = predict(ahead, 0.0, StraightDrive(0.0, 0.0, 0.0, 2.0, 0.3, 0.5, 1.0, 0.3), 9.0)
    assert collision is not None
    with_virtual(standing_world(panorama, ahead, 0.1), [collision])
    near_virtual(np.zeros((1, 10)), [collision], 0.1)


@njit(cache=True)
def _blank(ranges: Array, bearings: Array, origin: Array, rows: Array, time: float, margin: float) -> None:
    """Loses the beams that end within `margin` of one of the obstacles (see `Moving`)."""
    for i in range(len(ranges)):
        if not ranges[i] < math.inf:
            continue
        x, y = origin[0] + ranges[i] * math.cos(bearings[i]), origin[1] + ranges[i] * math.sin(bearings[i])
        for k in range(len(rows)):
            age, reach = time - rows[k, 5], rows[k, 4] + margin
            dx, dy = rows[k, 0] + age * rows[k, 2] - x, rows[k, 1] + age * rows[k, 3] - y
            if dx * dx + dy * dy < reach * reach:
                ranges[i] = math.nan
                break


@njit(cache=True)
def _first(rows: Array, now: float, drive: StraightDrive, horizon: float) -> tuple[int, float, float]:
    """Which of the obstacles (see `Moving`) is met first, from when to when; -1 if none is."""
    first, begin, end = -1, math.inf, math.inf
    for k in range(len(rows)):
        age, vx, vy = now - rows[k, 5], rows[k, 2], rows[k, 3]
        dx, dy = rows[k, 0] + age * vx - drive.x, rows[k, 1] + age * vy - drive.y
        b, e = _overlap(dx, dy, vx, vy, rows[k, 4], drive, horizon)
        if b < begin:
            first, begin, end = k, b, e
    return first, begin, end


@njit(cache=True)
def _overlap(
    x: float, y: float, vx: float, vy: float, radius: float, drive: StraightDrive, horizon: float
) -> tuple[float, float]:
    """From when to when an obstacle at (x, y) relative to the robot overlaps with its circle while it drives; inf where it never
    does.

    Approaching counts only: an overlap that is there now and opens is none.
    """
    first, last = math.inf, -math.inf
    c, s = math.cos(drive.heading), math.sin(drive.heading)
    length, v, reach = drive.length, drive.speed, drive.radius + radius
    there = drive.delay + length / v
    times = (0.0, drive.delay, there, there + drive.stay)
    for phase in range(3):
        t0, t1 = times[phase], min(times[phase + 1], horizon)
        if t1 <= t0:
            continue
        speed = v if phase == 1 else 0.0
        gone = length if phase == 2 else 0.0
        px, py = x + vx * t0 - gone * c, y + vy * t0 - gone * s
        wx, wy = vx - speed * c, vy - speed * s
        a, b, d = wx * wx + wy * wy, px * wx + py * wy, px * px + py * py - reach * reach
        if a < 1e-12:
            if d < 0.0 and phase != 0:
                first, last = min(first, t0), max(last, t1)
            continue
        root = b * b - a * d
        if root <= 0.0:
            continue
        root = math.sqrt(root)
        enter, leave = t0 + (-b - root) / a, t0 + (-b + root) / a
        if leave <= t0 or enter >= t1 or (d < 0.0 and b >= 0.0 and first == math.inf):
            continue
        first, last = min(first, max(enter, t0)), max(last, min(leave, t1))
    return first, last


@njit(cache=True)
def _cast_capsule(ranges: Array, origin: Array, bearings: Array, a: Array, b: Array, radius: float) -> None:
    """Shortens the ranges to where the beams meet what a circle sweeps from a to b; from inside it, none."""
    steps = max(1, math.ceil(math.hypot(b[0] - a[0], b[1] - a[1]) / (0.3 * max(radius, 0.02))))
    steps = min(steps, 200)
    for k in range(steps + 1):
        dx = a[0] + (b[0] - a[0]) * k / steps - origin[0]
        dy = a[1] + (b[1] - a[1]) * k / steps - origin[1]
        if dx * dx + dy * dy <= radius * radius:
            continue
        for i in range(len(ranges)):
            c, s = math.cos(bearings[i]), math.sin(bearings[i])
            along, across = c * dx + s * dy, c * dy - s * dx
            if along > 0.0 and abs(across) < radius:
                hit = along - math.sqrt(radius * radius - across * across)
                if not ranges[i] <= hit:  # nan too
                    ranges[i] = hit


@njit(cache=True)
def _mark_near(near: NDArray[np.bool_], points: Array, a: Array, b: Array, reach: float) -> None:
    """Marks the points within `reach` of the segment from a to b."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = max(dx * dx + dy * dy, 1e-12)
    for k in range(len(points)):
        px, py = points[k, 0] - a[0], points[k, 1] - a[1]
        share = min(max((px * dx + py * dy) / length, 0.0), 1.0)
        near[k] |= math.hypot(px - share * dx, py - share * dy) < reach
