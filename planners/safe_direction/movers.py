"""What moves around a robot that navigates by safe directions: seen, kept away from, and dodged.

The paper scans again and again, so that what moves is seen where it is; how fast the robot may be, and what it does where
something comes at it, it leaves open.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import SE2, Costmap, Observation, Robot, Twist
from robocar.core.compiling import warm_up
from robocar.planners.geometry.outlines import CostmapView, Outlines
from robocar.planners.safe_direction.view import Readings, leading_edges
from robocar.planners.tracking.moving_obstacles import NONE, MovingObstacles

_MOMENT = 0.6  # [s] between two scans that are compared to see what moves
_KEEP_OFF, _LOOK_AHEAD = 0.10, 1.0  # [m, s] the car does not get so near to what moves sooner than this
_CREEP = 0.05  # [m/s] it goes no slower than this, lest it never arrives
_HORIZON = 3.0  # [s] over which a twist is tried against what moves
_TICK = 0.1  # [s] between two looks of a trial
_NOT_YET = 0.2  # [s] how near something is before, no twist can change
_TOUCHING = 0.02  # [m] an arc that is free no farther is none
_CHANGE = 0.03  # [m] of gap that it takes to go at another speed, than is wanted and than before
_SPEEDS, _TURNS = (0.0, 0.5, 1.0, -1.0), (0.0, 0.4, -0.4, 0.8, -0.8)  # twists tried, as shares of the limits


class Movers:
    """Sees what moves by comparing scans, slows down for it, and gets out of its way.

    Args:
        obstacle_speed: how fast what cannot be followed may come [m/s].
        padding: kept free beside the robot [m].
        reaction: time until a new scan is acted on [s].
    """

    def __init__(self, robot: Robot, obstacle_speed: float, padding: float, reaction: float) -> None:
        self._robot, self._speed, self._padding, self._reaction = robot, obstacle_speed, padding, reaction
        self._followed = MovingObstacles(robot)
        self._outlines = Outlines(robot.footprint, 0.0)
        _warm_up()
        self._discs = NONE
        self._dodge: Twist | None = None
        self._recent: deque[tuple[float, Readings]] = deque()
        self.edges = np.empty((0, 2))
        """Leading edges of what moves, (n, 2) [m]."""
        self.coming = math.inf
        """From the car's circumscribed circle to the nearest leading edge ahead [m]."""

    def update(self, pose: SE2, seen: Readings, observation: Observation) -> None:
        """Takes in a scan.

        A leading edge is a surface where the cell was seen empty a moment ago, off all that stood there then. What recedes has
        its leading edge on its far side, out of sight.
        """
        self._followed.update(pose, observation)
        nothing = self._outlines.views(None, pose)[0]  # its cells are metres of the map
        self._discs = self._followed.discs(nothing, None, observation.time)
        time = observation.time
        self._recent.append((time, seen))
        while time - self._recent[0][0] > _MOMENT + 1e-6:
            self._recent.popleft()
        then, before = self._recent[0]
        self.edges, self.coming = np.empty((0, 2)), math.inf
        if time - then < 0.6 * _MOMENT:
            return
        moved = leading_edges(before, seen)
        self.edges = seen.grid.world_from_cell(moved)
        dx, dy = moved[:, 1] + 0.5 - seen.x, moved[:, 0] + 0.5 - seen.y
        ahead = math.cos(pose.theta) * dx + math.sin(pose.theta) * dy > 0.0
        if ahead.any():
            nearest = float(np.hypot(dx, dy)[ahead].min()) * seen.grid.resolution
            self.coming = nearest - self._robot.footprint.circumscribed_radius

    def swept(self, seen: Readings) -> Readings:
        """The readings with what leading edges may reach within `_LOOK_AHEAD` taken for occupied."""
        if len(self.edges) == 0:
            return seen
        r = seen.grid.resolution
        spots = np.zeros(seen.grid.shape, dtype=np.uint8)
        spots[tuple(seen.grid.cell_from_world(self.edges).T)] = 1
        reach = round(self._speed * _LOOK_AHEAD / r)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        swept = cv2.dilate(spots, disc) > 0
        body = round(self._robot.footprint.circumscribed_radius / r) + 1
        row, col = int(seen.y), int(seen.x)
        swept[row - body : row + body + 1, col - body : col + body + 1] = False
        return replace(seen, free=seen.free & ~swept, occupied=seen.occupied | swept)

    def slowed(self, wanted: Twist, seen: Readings, pose: SE2) -> Twist:
        """The same arc, slow enough for what may come the other way, and for what comes."""
        v, omega = wanted.v, wanted.omega
        slow = min(
            self._share_of_speed(seen, pose, v),
            max(self.coming - _KEEP_OFF, _CREEP) / max(abs(v) * _LOOK_AHEAD, 1e-9),
            self._robot.limits.max_vel_theta / max(abs(omega), 1e-9),
            1.0,
        )
        return Twist(slow * v, slow * omega)

    def _share_of_speed(self, seen: Readings, pose: SE2, v: float) -> float:
        """By what share to slow down so that the car stands before what comes towards it at `obstacle_speed` is there.

        With free way d ahead: v t + v^2 / 2a + w (t + v / a) <= d, for the reaction time t of two scans.
        """
        if v <= 0.0:
            return 1.0
        a, t, w = self._robot.limits.acc_lim_x, 2.0 * self._reaction, self._speed
        b = t + w / a
        root = b * b - 2.0 * (w * t - self._free_ahead(seen, pose)) / a
        allowed = a * (math.sqrt(root) - b) if root > b * b else 0.0
        return min(1.0, max(allowed, _CREEP) / v)

    def _free_ahead(self, seen: Readings, pose: SE2) -> float:
        """From the car's front to the nearest surface in the strip that it drives into, a little wider than itself [m]."""
        rows, cols = np.nonzero(seen.occupied)
        if len(rows) == 0:
            return math.inf
        r = seen.grid.resolution
        dx, dy = (cols + 0.5 - seen.x) * r, (rows + 0.5 - seen.y) * r
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        ahead, aside = c * dx + s * dy, np.abs(c * dy - s * dx)
        front = float(self._robot.footprint.vertices[:, 0].max())
        half = float(np.abs(self._robot.footprint.vertices[:, 1]).max()) + self._padding + 0.5 * r
        inside = (aside <= half) & (ahead > 0.0)
        return float(ahead[inside].min()) - front - 0.5 * r if inside.any() else math.inf

    def dodged(self, wanted: Twist, slowed: Twist, costmap: Costmap, pose: SE2) -> Twist | None:
        """Another twist, where what moves would come too near within `_HORIZON` if the car went on as it is to; None if not.

        A car that turns round on the spot, or creeps, in the way of something is run into. So of the slowed twist, the unslowed
        one, standing still, and arcs forward and back, as far as surfaces leave them free, that one is taken which keeps what
        moves off, with some liking for what is wanted, and for what was done before: who changes his mind gets nowhere.
        """
        if self._gap(slowed, pose, math.inf) >= 0.0:
            self._dodge = None
            return None
        view = self._outlines.views(costmap, pose)[-1]
        before = self._dodge or wanted
        best, most = Twist(), -math.inf
        for twist in (slowed, wanted, *self._candidates()):
            free = self._free(view, twist)
            if abs(twist.v) > 1e-6 and free <= _TOUCHING:
                continue
            value = min(self._gap(twist, pose, free), 0.0) - _CHANGE * (self._off(twist, wanted) + self._off(twist, before))
            if value > most:
                best, most = twist, value
        self._dodge = best
        return best

    def _off(self, a: Twist, b: Twist) -> float:
        """How far two twists differ, 1 at the full speed or twice the fastest turn."""
        limits = self._robot.limits
        return math.hypot((a.v - b.v) / limits.max_vel_x, 0.5 * (a.omega - b.omega) / limits.max_vel_theta)

    def _candidates(self) -> list[Twist]:
        limits = self._robot.limits
        return [
            Twist(share * (limits.max_vel_x if share > 0.0 else -limits.min_vel_x), turn * limits.max_vel_theta)
            for share in _SPEEDS
            for turn in (_TURNS if share else (0.0,))
        ]

    def _gap(self, twist: Twist, pose: SE2, free: float) -> float:
        """How much more than it must the car keeps off what moves, if it drives `free` at most [m]; inf if nothing moves."""
        return float(_least_gap(self._discs, pose.x, pose.y, pose.theta, twist.v, twist.omega, free))

    def _free(self, view: CostmapView, twist: Twist) -> float:
        """How far surfaces leave an arc free, less the way to brake [m]; 0 for a turn that they do not."""
        if abs(twist.v) < 1e-6:
            return 0.0
        braking = twist.v**2 / (2.0 * self._robot.limits.acc_lim_x) + abs(twist.v) * self._reaction
        length = abs(twist.v) * _HORIZON + braking
        return max(0.0, view.free_arc(twist.omega / twist.v, math.copysign(length, twist.v))[0] - braking)


@njit(cache=True)
def _least_gap(discs: NDArray, x: float, y: float, theta: float, v: float, omega: float, free: float) -> float:
    """Least distance from discs (n, 5) of x, y, their velocity and the room that each needs [m, m/s], less that room.

    They go on as they do; the robot has a constant twist, and stands after `free` [m].
    """
    gap = math.inf
    steps = round(_HORIZON / _TICK)
    for k in range(steps + 1):
        time = k * _TICK
        if time < _NOT_YET:
            continue
        driven = time if abs(v) * time <= free else free / abs(v)
        turn = omega * driven
        chord = v * driven * (math.sin(0.5 * turn) / (0.5 * turn) if abs(turn) > 1e-9 else 1.0)
        px, py = x + chord * math.cos(theta + 0.5 * turn), y + chord * math.sin(theta + 0.5 * turn)
        for i in range(len(discs)):
            dx, dy = discs[i, 0] + time * discs[i, 2] - px, discs[i, 1] + time * discs[i, 3] - py
            gap = min(gap, math.hypot(dx, dy) - discs[i, 4])
    return gap


@warm_up
def _warm_up() -> None:
    _least_gap(NONE, 0.0, 0.0, 0.0, 0.1, 0.1, 1.0)
