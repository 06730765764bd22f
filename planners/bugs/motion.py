"""How all bugs move: turning on the spot, driving straight, and along boundaries.

Motion is that of Das, Dutta and Debnath 2020 (assumption A3): turn on the spot, then drive straight, each at constant speed. The
comparison of the bugs is then about their decisions only. A physical car adds a guard: it never drives or turns into what the
last scan shows, and where it stands too close to something to turn, it says so (`cramped`) and stands: `Bug` gets it out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from robocar.core import SE2, Array, Robot, Twist, wrap_angle
from robocar.planners.bugs.view import HIT, Along, BugParameters, BugView, Move, Stand, first_free

_TURN_FROM = math.radians(25.0)  # a larger error of the heading is turned away on the spot, down to ...
_TURN_TO = math.radians(2.0)
_STEER = 2.0  # [1/s] smaller ones are steered away while driving
_GUARD = 0.015  # [m] around the outline, kept while moving
_TURN_ROOM = 0.005  # [m] around the outline, kept while turning
_STIRRED = 0.02  # [m] less is no motion
_REACTION = 0.15  # [s] from a scan to the brakes


@njit(cache=True)
def _straight(points: Array, front: float, rear: float, half: float, sign: float) -> float:
    """How far the outline (in its own frame: `front`, `rear`, `half` width, all positive) can go straight, ahead for sign 1 and
    back for -1, before it meets one of the points (n, 2) [m]."""
    free = math.inf
    end = front if sign > 0 else rear
    for i in range(len(points)):
        ahead = sign * points[i, 0]
        if abs(points[i, 1]) < half and ahead > end - 0.02:  # what is beside it is not in its way
            free = min(free, ahead - end)
    return max(0.0, free)


@njit(cache=True)
def _turn(points: Array, front: float, rear: float, half: float, angle: float) -> bool:
    """Whether the outline can turn on the spot by `angle` [rad] without meeting one of the points, but for those that it
    covers already."""
    for i in range(len(points)):
        x, y = points[i]
        if x * x + y * y > (max(front, rear) + half) ** 2 or (-rear < x < front and abs(y) < half):
            continue
        for k in range(1, 9):
            t = -angle * k / 8.0
            px, py = math.cos(t) * x - math.sin(t) * y, math.sin(t) * x + math.cos(t) * y
            if -rear < px < front and abs(py) < half:
                return False
    return True


class Motion:
    """Turns on the spot, then drives straight, guarded by the last scan."""

    def __init__(self, robot: Robot, parameters: BugParameters) -> None:
        vertices = robot.footprint.vertices
        self._front, self._rear = float(vertices[:, 0].max()), float(-vertices[:, 0].min())
        self._half = float(np.abs(vertices[:, 1]).max())
        self._limits, self._parameters = robot.limits, parameters
        self._turning = False
        self._last, self._time = Twist(), -math.inf
        self.blocked = self.cramped = False

    def stand(self, time: float) -> Twist:
        """Brakes, and stands."""
        return self._done(Twist(), time)

    def drive(self, pose: SE2, hits: Array, heading: float, left: float, speed: float, time: float) -> Twist:
        """Towards `heading` [rad], slowing down to stop after `left` [m]."""
        local = _robot_frame(hits, pose.x, pose.y, pose.theta)
        error = wrap_angle(heading - pose.theta)
        self._turning = abs(error) > (_TURN_TO if self._turning else _TURN_FROM)
        if self._turning:
            return self._turn(local, error, time)
        lim, dt = self._limits, self.period(time)
        v = min(speed, lim.max_vel_x, math.sqrt(2.0 * 0.5 * lim.acc_lim_x * max(left, 0.0)) + 0.01, left / dt + 0.01)
        v = max(0.0, min(v, max(self._last.v, 0.0) + lim.acc_lim_x * dt))
        v *= max(0.2, math.cos(error)) if abs(error) < math.pi / 2 else 0.2
        omega = min(max(_STEER * error, -self._fastest), self._fastest)
        free = _straight(local, self._front, self._rear, self._half + _GUARD, 1.0) - _GUARD
        if free < v * v / (2.0 * lim.acc_lim_x) + v * _REACTION:
            slow = min(v, math.sqrt(2.0 * lim.acc_lim_x * max(free - 0.02, 0.0)) * 0.5)
            self.blocked = slow < 0.02
            return self._done(Twist(0.0 if self.blocked else slow, 0.0 if self.blocked else omega), time)
        self.blocked = False
        return self._done(Twist(v, omega), time)

    def turn(self, pose: SE2, hits: Array, heading: float, time: float) -> Twist:
        """On the spot, to `heading` [rad]."""
        return self._turn(_robot_frame(hits, pose.x, pose.y, pose.theta), wrap_angle(heading - pose.theta), time)

    def can_turn(self, pose: SE2, hits: Array) -> bool:
        """Whether there is room to turn as far as it likes."""
        local = _robot_frame(hits, pose.x, pose.y, pose.theta)
        return float(np.min(np.hypot(local[:, 0], local[:, 1]), initial=math.inf)) >= self._turning_room

    def taken_over(self, twist: Twist, time: float) -> None:
        """Somebody else has driven: the accelerations go on from there."""
        self._last, self._time = twist, time
        self.cramped = self._turning = False

    def opposed(self, pose: SE2, hits: Array, v: float) -> bool:
        """Whether the last scan shows something in the straight way, where the car is going at `v` [m/s]; what is beside it is
        not in its way."""
        local = _robot_frame(hits, pose.x, pose.y, pose.theta)
        return (
            v != 0.0 and _straight(local, self._front, self._rear, 0.7 * self._half, math.copysign(1.0, v)) < abs(v) * _REACTION
        )

    @property
    def _turning_room(self) -> float:
        return math.hypot(max(self._front, self._rear), self._half) + 2.0 * _TURN_ROOM

    @property
    def _fastest(self) -> float:
        return min(self._parameters.rotate_to_heading_angular_vel, self._limits.max_vel_theta)

    def _turn(self, local: Array, error: float, time: float) -> Twist:
        """Turns if there is room, else stands."""
        box = self._front + _TURN_ROOM, self._rear + _TURN_ROOM, self._half + _TURN_ROOM
        stretch = math.copysign(min(abs(error), 0.6), error)
        self.cramped = False
        if not _turn(local, *box, stretch):
            other = math.copysign(math.tau - abs(error), -error)
            # All of the other way round, or it would turn to and fro where there is no room, and touch something at last.
            if abs(error) > 2.0 and all(_turn(local, *box, share * other) for share in (0.15, 0.3, 0.5, 0.7, 0.85, 1.0)):
                return self._done(Twist(0.0, math.copysign(0.5 * self._fastest, other)), time)
            self.cramped = True
            return self._done(Twist(), time)
        self.blocked = False
        rate = min(self._fastest, math.sqrt(self._limits.acc_lim_theta * abs(error)), abs(error) / self.period(time))
        return self._done(Twist(0.0, math.copysign(rate, error)), time)

    def period(self, time: float) -> float:
        """Since the last command [s]."""
        return min(max(time - self._time, 0.01), 0.2)

    def _done(self, twist: Twist, time: float) -> Twist:
        dt, lim = self.period(time), self._limits
        omega = min(max(twist.omega, self._last.omega - lim.acc_lim_theta * dt), self._last.omega + lim.acc_lim_theta * dt)
        self._last, self._time = Twist(twist.v, omega if twist.omega != 0.0 else 0.0), time
        return self._last


@njit(cache=True)
def _robot_frame(hits: Array, x: float, y: float, theta: float) -> Array:
    """Points near the robot in its own frame, (k, 2) [m]."""
    out = np.empty_like(hits)
    c, s = math.cos(theta), math.sin(theta)
    count = 0
    for i in range(len(hits)):
        dx, dy = hits[i, 0] - x, hits[i, 1] - y
        if dx * dx + dy * dy < 1.0:
            out[count, 0], out[count, 1] = c * dx + s * dy, c * dy - s * dx
            count += 1
    return out[:count]


class Boundary:
    """Follows the boundary of an obstacle, grown by the virtual circle, keeping it on one hand.

    At every scan the headings are tried from the obstacle's side away from it, and the first in which the circle can move a step
    is driven.

    Args:
        side: +1 keeps the obstacle on the left, -1 on the right.
        step: [m].
    """

    _SPAN, _BACK, _STEP = math.radians(330.0), math.radians(110.0), math.radians(3.0)

    def __init__(self, side: int, heading: float, step: float = 0.12) -> None:
        self.side, self.heading, self.step = side, heading, step
        self.travelled = 0.0
        self._last: Array | None = None
        self._reference, self._moved = heading, 0.0

    def move(self, view: BugView) -> Move:
        """The next straight motion; stands where the circle cannot move at all."""
        if self._last is not None:
            way = math.dist(self._last, view.centre)
            self.travelled, self._moved = self.travelled + way, self._moved + way
            if self._moved > _STIRRED:  # while it only turns, the sides stay where they are
                self._reference, self._moved = self.heading, 0.0
        self._last = view.centre
        x, y = view.centre
        start = self._reference + self.side * self._BACK
        for radius in (view.circle.radius, view.passing_radius, view.circle.body):
            heading = first_free(view.hits, x, y, start, -self.side, self._SPAN, radius, self.step, self._STEP)
            if not math.isnan(heading):
                self.heading = wrap_angle(heading)
                return Along(self.heading, view.parameters.boundary_vel)
        return Stand()


def nearer_side(view: BugView) -> int:
    """On which hand an obstacle ahead will be when it is followed by turning the least: +1 left, -1 right."""
    x, y = view.centre
    turns = []
    for side in (1, -1):
        heading = first_free(
            view.hits, x, y, view.goal_heading, -side, math.pi, view.passing_radius, HIT + 0.05, math.radians(3.0)
        )
        turns.append(abs(heading - view.goal_heading) if not math.isnan(heading) else math.inf)
    return 1 if turns[0] <= turns[1] else -1
