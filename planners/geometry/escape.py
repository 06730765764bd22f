"""The way out of a tight place: a short manoeuvre to where the robot has room to turn.

A robot beside a wall can neither turn on the spot nor follow a path that leads away: its corners would swing into the wall. What
helps is a search over what it can do (Pivtoraiko, Knepper and Kelly, Differentially Constrained Mobile Robot Motion Planning in
State Lattices, Journal of Field Robotics 26(3), 2009): short arcs ahead and back, and small turns. Every navigator gets out of
tight places in this way, and in no other:

* the whole sweep of the outline keeps `MARGIN` off all surfaces that are known, or, where the robot stands nearer to one than
  that, comes no nearer; what seems to reach into the robot reaches no deeper;
* the manoeuvre ends with room to turn, or, where none is in reach, with more room than before.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import SE2, Array, Drive, Lines, Robot, Text, Twist
from robocar.core.compiling import warm_up
from robocar.core.trace import PLAN_COLOR, Drawable
from robocar.planners.geometry.surfaces import FAR, floors, keeps, room

MARGIN = 0.003
"""[m] What a robot that drives slowly strays from an arc, and a little more."""
CELLS = 0.002
"""[m] How much deeper a cell that seems to reach into the robot may come: its surface lies somewhere in it, farther away."""

_GAIN = 0.01  # [m] less room than this more is not worth a manoeuvre
_STEP, _TURN = 0.06, 0.15  # [m, rad] length of an arc, angle of a turn
_CURVATURES = (0.0, 0.25, -0.25, 1.0, -1.0, 4.0, -4.0)  # [1/m]
_ARCS = np.array([(sign * _STEP, k * sign * _STEP) for sign in (1.0, -1.0) for k in _CURVATURES] + [(0, _TURN), (0, -_TURN)])
"""Length and change of heading of what is tried from each pose, (n, 2) [m, rad]."""
_SWEEP = 0.01  # [m] a corner moves at most so far between two checks
_REVERSE = 1.5  # times as costly as ahead: few sensors look there
_TURNING = 0.15  # [m/rad] what a turn costs
_CUSP = 0.1  # [m] what a change of direction costs
_GREED = 3.0  # weight of the room that is still missing
_EXPANSIONS = 3000  # at most
_CELL, _ANGLE = 0.015, 0.06  # [m, rad] poses nearer than this are one
_SLACK = 1e-4  # [m] less is no motion towards a surface
_SPEED, _RATE = 0.1, 0.6  # [m/s, rad/s]
_ARRIVED = 0.02  # [rad]
_STIFFNESS, _DAMPING = 60.0, 15.0  # [1/m^2, 1/m] of the feedback to the arc, in distance driven
_MORE = 0.05  # [m] of room, for a robot that has room to turn and still cannot go on
_SAME = 1e-3  # [m, rad] poses that differ by less are one to a search that failed
_WHY = "no room to turn: driving to where there is"
_TRIES = 4  # searches for one manoeuvre, where it is held up


@njit(cache=True)
def _moved(x: float, y: float, theta: float, length: float, turn: float) -> tuple[float, float, float]:
    """The pose after an arc [m, rad]."""
    chord = length if abs(turn) < 1e-9 else length * math.sin(0.5 * turn) / (0.5 * turn)
    return x + chord * math.cos(theta + 0.5 * turn), y + chord * math.sin(theta + 0.5 * turn), theta + turn


@njit(cache=True)
def _free(segments: Array, least: Array, pose: Array, length: float, turn: float, outline: Array) -> bool:
    """Whether the outline keeps off all segments, as far as `least` (n,) [m] says, along an arc."""
    radius = 0.0
    for i in range(len(outline)):
        radius = max(radius, math.hypot(outline[i, 0], outline[i, 1]))
    n = max(1, math.ceil((abs(length) + radius * abs(turn)) / _SWEEP))
    for i in range(1, n + 1):
        x, y, theta = _moved(pose[0], pose[1], pose[2], length * i / n, turn * i / n)
        if not keeps(segments, least, x, y, theta, outline):
            return False
    return True


@njit(cache=True)
def _search(
    segments: Array, least: Array, start: Array, outline: Array, wanted: float, arcs: Array
) -> tuple[NDArray, Array, int]:
    """The arcs (indices into `arcs`) to where there is `wanted` room around the robot's origin [m], or as much as can be had, and
    the poses at their ends, (n,) and (n, 3), and what was expanded; none where there is nothing to gain.

    Weighted A*: the room that is missing is a lower bound of the way to where it is.
    """
    poses, parents, by = np.empty((_EXPANSIONS * 16 + 1, 3)), [-1], [-1]
    poses[0] = start
    costs = [0.0]
    closed = {(0, 0, 0)}
    closed.clear()
    first = room(segments, start[0], start[1])
    best, best_room = 0, first
    heap = [(0.0, 0)]
    expansions = 0
    while len(heap) > 0 and expansions < _EXPANSIONS:
        _, node = heapq.heappop(heap)
        x, y, theta = poses[node]
        key = (
            math.floor((x - start[0]) / _CELL + 0.5),
            math.floor((y - start[1]) / _CELL + 0.5),
            math.floor((theta - start[2]) / _ANGLE + 0.5),
        )
        if key in closed:
            continue
        closed.add(key)
        expansions += 1
        here = room(segments, x, y)
        if here > best_room:
            best, best_room = node, here
        if here >= wanted:
            break
        for k in range(len(arcs)):
            length, turn = arcs[k]
            if not _free(segments, least, poses[node], length, turn, outline):
                continue
            cost = costs[node] + max(length, -_REVERSE * length) + (_TURNING * abs(turn) if length == 0.0 else 0.0)
            before = by[node]
            if before >= 0 and (arcs[before, 0] * length < 0.0 or (arcs[before, 0] == 0.0) != (length == 0.0)):
                cost += _CUSP
            child = len(parents)
            px, py, heading = _moved(x, y, theta, length, turn)
            poses[child, 0], poses[child, 1], poses[child, 2] = px, py, heading
            parents.append(node)
            by.append(k)
            costs.append(cost)
            heapq.heappush(heap, (cost + _GREED * max(0.0, wanted - room(segments, px, py)), child))
    if best_room < min(wanted, first + _GAIN):
        best = 0
    count, node = 0, best
    while node > 0:
        count, node = count + 1, parents[node]
    chosen, ends = np.empty(count, dtype=np.int64), np.empty((count, 3))
    node = best
    for i in range(count - 1, -1, -1):
        chosen[i], ends[i], node = by[node], poses[node], parents[node]
    return chosen, ends, expansions


class Escape:
    """Finds a manoeuvre and carries it out.

    Args:
        wanted: free around the robot's circumscribed circle where the manoeuvre ends [m].
        doubt: how much deeper what seems to reach into the robot may come, being misplaced [m].
    """

    def __init__(self, robot: Robot, wanted: float, doubt: float = 0.0) -> None:
        self._outline = np.array(robot.footprint.vertices)  # (n, 2) [m]
        self._limits, self._doubt, self._dt = robot.limits, doubt, 0.1
        self._wanted = min(robot.footprint.circumscribed_radius + wanted, 0.9 * FAR)
        self._arcs = _ARCS if robot.limits.min_vel_x < 0.0 else _ARCS[_ARCS[:, 0] >= 0.0]
        self._chosen, self._ends = np.empty(0, dtype=np.int64), np.empty((0, 3))
        self._tries, self._last = 0, Twist()
        self._in_vain: tuple[Array, Array] | None = None  # where and among what there was no manoeuvre
        self._news: dict[str, Drawable] = {}
        self._expansions = 0
        _warm_up()

    @property
    def running(self) -> bool:
        """Whether a manoeuvre is under way."""
        return len(self._chosen) > 0

    def roomy(self, pose: SE2, segments: Array) -> bool:
        """Whether there is room to turn already."""
        return room(segments, pose.x, pose.y) >= self._wanted

    def turns(self, pose: SE2, segments: Array, angle: float) -> bool:
        """Whether a turn on the spot by `angle` [rad] keeps `MARGIN`, or comes no nearer."""
        return _free(segments, self._least(pose, segments), _array(pose), 0.0, angle, self._outline)

    def begin(self, pose: SE2, segments: Array) -> bool:
        """Looks for a manoeuvre among the surfaces (n, 4) [m], for a robot that stands. Returns whether there is one."""
        tried = self._in_vain
        if tried and np.abs(_array(pose) - tried[0]).max() < _SAME and np.array_equal(tried[1], segments):
            return False  # nothing has changed
        self._tries, self._last = _TRIES, Twist()
        found = self._plan(pose, segments)
        self._in_vain = None if found else (_array(pose), segments)
        return found

    def stop(self) -> None:
        """Gives it up."""
        self._chosen = self._chosen[:0]

    def command(self, pose: SE2, segments: Array, period: float) -> Drive | None:
        """The next command of the manoeuvre, for `period` [s]; None where it is over: the robot all but stands then."""
        self._dt = period
        twist = self._twist(pose, segments)
        if twist is None:
            return None
        work = {"expansions": self._expansions} if self._expansions else {}
        news, self._news, self._expansions = self._news, {}, 0
        return Drive(twist, trace=news, work=work)

    def _twist(self, pose: SE2, segments: Array) -> Twist | None:
        while self.running and self._passed(pose):
            self._chosen, self._ends = self._chosen[1:], self._ends[1:]
        if not self.running:
            return None
        twist = self._limited(self._towards(pose))
        braking = self._dt + abs(twist.v) / (2.0 * self._limits.acc_lim_x)  # [s]
        least = self._least(pose, segments)
        if not _free(segments, least, _array(pose), twist.v * braking, twist.omega * braking, self._outline):
            twist = Twist()
            if self._last == Twist():
                self._tries -= 1
                if self._tries <= 0 or not self._plan(pose, segments):
                    self.stop()
                    return None
        self._last = twist
        return twist

    def _least(self, pose: SE2, segments: Array) -> Array:
        """The clearance to keep from each segment: `MARGIN`, or what there is, (n,) [m]."""
        return floors(segments, pose.x, pose.y, pose.theta, self._outline, MARGIN, self._doubt) - _SLACK

    def _plan(self, pose: SE2, segments: Array) -> bool:
        here = room(segments, pose.x, pose.y)
        wanted = self._wanted if here < self._wanted else here + _MORE
        least = self._least(pose, segments)
        self._chosen, self._ends, spent = _search(segments, least, _array(pose), self._outline, wanted, self._arcs)
        self._expansions += spent
        if self.running:
            way = np.concatenate([_array(pose)[None], self._ends])[:, :2]
            self._news = {"escape": Lines((way,), color=PLAN_COLOR, radius=0.012), "escape/why": Text(_WHY, "WARN")}
        return self.running

    def _passed(self, pose: SE2) -> bool:
        """Whether the end of the arc is reached."""
        length, turn = self._arcs[self._chosen[0]]
        end = SE2(*self._ends[0])
        if length == 0.0:
            return math.remainder(end.theta - pose.theta, math.tau) * math.copysign(1.0, turn) <= _ARRIVED
        left = -(end.inverse() @ pose).x * math.copysign(1.0, length)
        return left <= max(0.5 * _SPEED * self._dt, 0.002)

    def _towards(self, pose: SE2) -> Twist:
        """The arc, and back to it where the robot has strayed."""
        length, turn = self._arcs[self._chosen[0]]
        end = SE2(*self._ends[0])
        if length == 0.0:
            left = math.remainder(end.theta - pose.theta, math.tau)
            return Twist(0.0, math.copysign(min(_RATE, math.sqrt(self._limits.acc_lim_theta * abs(left))), left))
        sign, curvature = math.copysign(1.0, length), turn / length
        left = max(-(end.inverse() @ pose).x * sign, 0.0)
        x, y, theta = _moved(end.x, end.y, end.theta, -sign * left, -sign * left * curvature)
        strayed = SE2(x, y, theta).inverse() @ pose
        ahead = left + sum(abs(self._arcs[k, 0]) for k in self._run())
        speed = min(_SPEED, self._limits.max_vel_x if sign > 0.0 else -self._limits.min_vel_x)
        speed = min(speed, 0.02 + math.sqrt(self._limits.acc_lim_x * ahead))
        back = _DAMPING * math.remainder(strayed.theta, math.tau) + sign * _STIFFNESS * strayed.y
        return Twist(sign * speed, speed * (sign * curvature - back))

    def _run(self) -> list[int]:
        """The arcs after this one up to the next change of direction."""
        sign, run = self._arcs[self._chosen[0], 0], []
        for k in self._chosen[1:]:
            if self._arcs[k, 0] * sign <= 0.0:
                break
            run.append(int(k))
        return run

    def _limited(self, twist: Twist) -> Twist:
        """Within the accelerations and the rates of the robot."""
        limits, last, dt = self._limits, self._last, self._dt
        v = min(max(twist.v, last.v - limits.acc_lim_x * dt), last.v + limits.acc_lim_x * dt)
        omega = twist.omega if twist.v == 0.0 else twist.omega * v / twist.v  # the curvature is kept
        omega = min(max(omega, last.omega - limits.acc_lim_theta * dt), last.omega + limits.acc_lim_theta * dt)
        return Twist(v, min(max(omega, -limits.max_vel_theta), limits.max_vel_theta))


def _array(pose: SE2) -> Array:
    return np.array([pose.x, pose.y, pose.theta])


@warm_up
def _warm_up() -> None:
    outline, walls = np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]), np.array([[-1.0, -0.11, 1.0, -0.11]])
    start = np.zeros(3)
    least = floors(walls, 0.0, 0.0, 0.0, outline, 0.001, 0.0)
    _search(walls, least, start, outline, 0.15, _ARCS)
    _free(walls, least, start, 0.1, 0.0, outline)
    room(walls, 0.0, 0.0)
