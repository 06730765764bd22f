"""Obstacles that move, as discs with velocities, for controllers that look a few seconds ahead.

Around each disc some room is kept free. A trajectory that enters it costs more than any that does not, and the more, the deeper
and the longer; so where all do, that one is chosen which gives way best, or stands. To come closer to it than now costs a little,
so that the car dodges early instead of late.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import SE2, Array, Costmap, Observation, Robot, frozen_array
from robocar.core.compiling import warm_up
from robocar.planners.geometry.outlines import CostmapView
from robocar.planners.tracking.kernel import line
from robocar.planners.tracking.panorama import ScanPanorama
from robocar.planners.tracking.tracker import Kind, ObstacleTracker, Tracked

_MAX_WIDTH, _MAX_DISTANCE = 0.8, 4.0  # [m] of what is followed: walls do not move
_LEAST_WIDTH, _LEAST_RANGE = 0.2, 1.5  # [m] what is so wide must be followed from so far
_ROOM = 0.1  # [m] kept free around them
_FASTEST = 0.6  # [m/s] what seems to move faster is taken to move so fast: places are rough
STAY = 2.0
"""For so long a trajectory must not be met after its end, where the robot stands [s]: it may not end in the way of a mover."""

NONE = np.empty((0, 5))
_MEETING, _DEPTH = 10.0, 50.0  # costs of entering their room, far above all others
_CLOSE = 1.0  # cost of coming up to it from afar
_CHANGED = 0.12  # [m/s] of difference are another velocity: it turns or stops
_THREAT = 3.0  # [s] that it may stand
_SLOW = 0.08  # [m/s] of what has moved before: is no motion
_WINDOW, _RECENT = 1.05, 0.35  # [s]
_IMPRINT = 2.0  # [cells] around a disc, where the costmap may still hold its surface


def unseen(robot: Robot) -> str:
    """Why this robot does not show what moves to `MovingObstacles` and `ObstacleTracker`; '' where it does.

    They follow the ends of what stands free. A sonar's cone does not show where an obstacle ends; of a laser's beams two must end
    on it. What is no faster than the car meets it from the half ahead only.
    """
    lidar = robot.lidar
    if lidar is None:
        return "it sees with a laser what moves, and the robot has none: fit robot.lidar: scan360 or hokuyo"
    bearings = np.sort(lidar.bearings + lidar.robot_from_sensor.theta)
    spacing = float(np.max(np.diff(bearings), initial=0.0))
    if bearings[0] > -0.5 * math.pi or bearings[-1] < 0.5 * math.pi - spacing:
        left, right = (math.degrees(edge) for edge in (bearings[-1], -bearings[0]))
        return f"its laser must look 90 degrees to either side, not {left:.0f} to the left and {right:.0f} to the right"
    if spacing > (widest := 0.5 * _LEAST_WIDTH / _LEAST_RANGE):
        found, needed = math.degrees(spacing), math.degrees(widest)
        return f"its laser's beams must be at most {needed:.1f} degrees apart, not {found:.1f}"
    if lidar.max_range < _LEAST_RANGE:
        return f"its laser must reach {_LEAST_RANGE:g} m, not {lidar.max_range:g} m"
    return ""


class MovingObstacles:
    """What the laser sees moving; nothing without a laser.

    `robocar.planners.tracking.tracker` says which obstacles move. Its positions lie between the ends in sight, which shift as a
    box shows another side; here each is taken for a disc that touches the nearest point seen, and its velocity comes from those.
    """

    def __init__(self, robot: Robot) -> None:
        self._radius = robot.footprint.circumscribed_radius
        self._tracker = ObstacleTracker(_MAX_WIDTH, _MAX_DISTANCE) if robot.lidar is not None else None
        self._centres: dict[int, deque[tuple[float, float, float]]] = {}
        self._tracked: list[Tracked] = []
        self._moved: set[int] = set()  # what has been seen to move is watched more closely: it may go on, or has just turned
        _warm_up()

    def update(self, pose: SE2, observation: Observation) -> None:
        """Takes in a laser scan, if there is one."""
        scan = observation.lidar
        if self._tracker is None or scan is None or len(scan.bearings) < 3:
            return
        at = pose @ scan.robot_from_sensor
        spacing = float(np.median(np.diff(scan.bearings)))
        ranges = np.where(scan.ranges < 0.0, np.nan, scan.ranges)
        panorama = ScanPanorama(
            scan.time, at.position, frozen_array(at.theta + scan.bearings), frozen_array(ranges), scan.max_range, spacing
        )
        self._tracker.update(panorama)
        self._tracked = list(self._tracker.tracked)
        moved = {o.number for o in self._tracked if o.kind is Kind.DYNAMIC}
        self._moved = moved | self._moved.intersection(o.number for o in self._tracked)
        centres = self._centres
        self._centres = {o.number: centres.get(o.number, deque(maxlen=32)) for o in self._tracked}
        for obstacle in self._tracked:
            if obstacle.time == panorama.time:
                places = self._centres[obstacle.number]
                places.append((panorama.time, *_centre(panorama, obstacle)))
                while panorama.time - places[0][0] > _WINDOW:
                    places.popleft()

    def discs(self, view: CostmapView, costmap: Costmap | None, time: float) -> Array:
        """Those that move, in the grid coordinates of the view: x, y, their velocity, and how near the robot's centre may come to
        theirs, (n, 5) [cells, cells / s]. One that lately went otherwise than before is there twice: it may do either."""
        if self._tracker is None:
            return NONE
        rows = []
        for obstacle in self._tracked:
            places = self._centres[obstacle.number]
            if obstacle.number in self._moved and places:
                room = obstacle.radius + self._radius + _ROOM
                found = courses(np.array(places), time)
                if obstacle.kind is Kind.DYNAMIC or max(math.hypot(*course[2:]) for course in found) > _SLOW:
                    rows += [(*course, room) for course in found]
        if not rows:
            return NONE
        discs = np.array(rows)
        origin = SE2() if costmap is None else costmap.origin
        turned = SE2(theta=origin.theta).inverse()
        discs[:, :2] = origin.inverse().transform(discs[:, :2])
        discs[:, 2:4] = turned.transform(discs[:, 2:4])
        return discs / view.resolution

    def coming(self, pose: SE2, observation: Observation, view: CostmapView, costmap: Costmap | None) -> Array | None:
        """The `discs` after this scan, where one of them comes into its room while the robot stands; else None."""
        self.update(pose, observation)
        discs = self.discs(view, costmap, observation.time)
        return discs if depth_later(discs, 0.0, _THREAT, 0.2, view.x, view.y) > 0.0 else None


def _centre(panorama: ScanPanorama, obstacle: Tracked) -> tuple[float, float]:
    """Of the disc of the obstacle's radius that touches the nearest point seen of it [m]."""
    (ax, ay), (bx, by) = (obstacle.ends - panorama.origin).tolist()
    start = math.atan2(ay, ax)
    span = (math.atan2(by, bx) - start) % math.tau
    its = (panorama.bearings - start + 1e-6) % math.tau <= span + 2e-6
    away = math.hypot(ax + bx, ay + by)
    nearest = float(np.nanmin(panorama.ranges[its], initial=0.5 * away))
    share = (nearest + obstacle.radius) / away if away > 0.0 else 0.0
    return float(panorama.origin[0]) + share * (ax + bx), float(panorama.origin[1]) + share * (ay + by)


def courses(centres: Array, time: float) -> list[tuple[float, float, float, float]]:
    """Where something is expected and its velocity, by the straight lines through its places (t, x, y), (n, 3) [s, m], of the
    last second and, where it differs, of the last `_RECENT`.

    The velocity of a whole second lags where something turns back; that of a moment is rough.
    """
    found: list[tuple[float, float, float, float]] = []
    last = float(centres[-1, 0])
    for since in (_WINDOW, _RECENT):
        x, y, vx, vy = line(centres[last - centres[:, 0] <= since + 1e-6])
        speed = math.hypot(vx, vy)
        if speed > _FASTEST:
            vx, vy = vx * _FASTEST / speed, vy * _FASTEST / speed
        if not found or math.hypot(vx - found[0][2], vy - found[0][3]) > _CHANGED:
            found.append((x + (time - last) * vx, y + (time - last) * vy, vx, vy))
    return found


def near(discs: Array, view: CostmapView) -> bool:
    """Whether the robot is in the room of one of the discs, or within half of it."""
    return len(discs) > 0 and encounter(discs, 0.0, view.x, view.y)[1] > 0.5


def without(discs: Array, view: CostmapView, radius: float) -> NDArray[np.uint8]:
    """The costs of the view where those that move do not stand in it: what is left is what stands.

    Args:
        radius: of the robot, which the discs' room holds [m].
    """
    costs = view.costs.copy()
    for x, y, _, _, room in discs:
        body = room - (radius + _ROOM) / view.resolution + _IMPRINT
        first_row, first_col = max(0, math.floor(y - body)), max(0, math.floor(x - body))
        there = costs[first_row : max(0, math.ceil(y + body)), first_col : max(0, math.ceil(x + body))]
        rows, cols = np.ogrid[first_row : first_row + there.shape[0], first_col : first_col + there.shape[1]]
        there[np.hypot(cols + 0.5 - x, rows + 0.5 - y) < body] = 0
    costs.flags.writeable = False
    return costs


@njit(cache=True)
def met(depth, close):
    """Cost of an encounter with movers, of numbers or arrays: mean depth, and how much closer than now (`rollouts`)."""
    return _MEETING * (depth > 0.0) + _DEPTH * depth + _CLOSE * close


@njit(cache=True)
def encounter(discs: Array, time: float, x: float, y: float) -> tuple[float, float]:
    """How deep a robot at (x, y) is in the room of the discs after `time`, each going on as it does now, and how close to it.

    Returns:
        Depths, of each disc 1 at its centre and 0 from where its room ends, summed up; closeness, of the nearest disc 1 where its
        room ends and 0 from twice as far.
    """
    depth, nearest = 0.0, 2.0
    for i in range(len(discs)):
        dx, dy = discs[i, 0] + time * discs[i, 2] - x, discs[i, 1] + time * discs[i, 3] - y
        if dx * dx + dy * dy < 4.0 * discs[i, 4] * discs[i, 4]:
            share = math.hypot(dx, dy) / discs[i, 4]
            depth += max(0.0, 1.0 - share)
            nearest = min(nearest, share)
    return depth, min(1.0, 2.0 - nearest)


@njit(cache=True)
def depth_later(discs: Array, time: float, stay: float, dt: float, x: float, y: float) -> float:
    """The depths of `encounter`, summed up in steps of `dt`, of a robot that stands at (x, y) from `time` for `stay`."""
    total = 0.0
    if len(discs) > 0:
        for i in range(1, min(1000, int(stay / dt)) + 1):
            total += encounter(discs, time + i * dt, x, y)[0]
    return total


@warm_up
def _warm_up() -> None:
    encounter(np.array([[1.0, 0.0, 0.0, 0.0, 0.1]]), 0.0, 0.0, 0.0)
    depth_later(np.array([[1.0, 0.0, 0.0, 0.0, 0.1]]), 0.0, 0.0, 0.2, 0.0, 0.0)
    met(0.0, 0.0)
    courses(np.zeros((2, 3)), 0.0)
