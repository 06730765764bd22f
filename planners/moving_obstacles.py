"""Obstacles that move, as discs with velocities, for local planners that look a few seconds ahead."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.obstacle_tracking import Obstacles
from planners.open_points import Panorama
from planners.outlines import View
from robocar.core import SE2, Array, Costmap, Observation, Robot, frozen_array

_MAX_WIDTH, _MAX_DISTANCE = 0.8, 4.0  # [m] of what is followed: walls do not move
_ROOM = 0.05  # [m] kept free around them
_FASTEST = 0.6  # [m/s] what seems to move faster is noise of the tracker
STAY = 2.0
"""For so long a trajectory must not be met after its end, where the robot stands [s]: it may not end in the way of a mover."""

NONE = np.empty((0, 5))


class MovingObstacles:
    """What the laser sees moving; nothing without a laser."""

    def __init__(self, robot: Robot) -> None:
        self._radius = robot.footprint.circumscribed_radius
        self._tracker = Obstacles(_MAX_WIDTH, _MAX_DISTANCE) if robot.lidar is not None else None
        meeting(np.array([[1.0, 0.0, 0.0, 0.0, 0.1]]), np.ones(1), 0.0, 0.0, 0.0)  # compiled here, not in the control loop

    def forget(self) -> None:
        """A new episode."""
        if self._tracker is not None:
            self._tracker.forget()

    def update(self, pose: SE2, observation: Observation) -> None:
        """Takes in a laser scan, if there is one."""
        scan = observation.lidar
        if self._tracker is None or scan is None or len(scan.bearings) < 3:
            return
        at = pose @ scan.robot_from_sensor
        spacing = float(np.median(np.diff(scan.bearings)))
        ranges = np.where(scan.ranges < 0.0, np.nan, scan.ranges)
        panorama = Panorama(
            scan.time, at.position, frozen_array(at.theta + scan.bearings), frozen_array(ranges), scan.max_range, spacing
        )
        self._tracker.update(panorama)

    def discs(self, view: View, costmap: Costmap | None, time: float) -> Array:
        """Those that move, in the grid coordinates of the view: x, y, their velocity, and how near the robot's centre may come to
        theirs, (n, 5) [cells, cells / s]."""
        if self._tracker is None:
            return NONE
        rows = []
        for obstacle in self._tracker.dynamic:
            x, y = obstacle.at(time)
            vx, vy = obstacle.velocity
            if math.hypot(vx, vy) <= _FASTEST:
                rows.append((x, y, vx, vy, obstacle.radius + self._radius + _ROOM))
        if not rows:
            return NONE
        discs = np.array(rows)
        origin = SE2() if costmap is None else costmap.origin
        turned = SE2(theta=origin.theta).inverse()
        discs[:, :2] = origin.inverse().transform(discs[:, :2])
        discs[:, 2:4] = turned.transform(discs[:, 2:4])
        return discs / view.resolution


@njit(cache=True)
def rooms(discs: Array, x: float, y: float) -> Array:
    """How near each disc may come, (n,): no nearer than it is now, where it is too near already."""
    out = np.empty(len(discs))
    for i in range(len(discs)):
        out[i] = min(discs[i, 4], math.hypot(discs[i, 0] - x, discs[i, 1] - y) - 1e-3)
    return out


@njit(cache=True)
def meeting(discs: Array, room: Array, time: float, x: float, y: float) -> bool:
    """Whether a robot at (x, y) is too near to one of the discs after `time`, each going on as it does now."""
    for i in range(len(discs)):
        dx, dy = discs[i, 0] + time * discs[i, 2] - x, discs[i, 1] + time * discs[i, 3] - y
        if dx * dx + dy * dy < room[i] * room[i] and room[i] > 0.0:
            return True
    return False


@njit(cache=True)
def met_later(discs: Array, room: Array, time: float, stay: float, dt: float, x: float, y: float) -> float:
    """When one of the discs comes too near to a robot that stands at (x, y) from `time` for `stay`; inf if none does."""
    if len(discs) > 0:
        for i in range(1, min(1000, int(stay / dt)) + 1):
            if meeting(discs, room, time + i * dt, x, y):
                return time + i * dt
    return math.inf
