"""What all bugs share: their view of the world, how they turn and drive, and how they follow a boundary.

Motion is that of Das, Dutta and Debnath 2020 (assumption A3): turn on the spot, then drive straight, each at constant speed. The
comparison of the bugs is then about their decisions only. A physical car adds a guard: it never drives or turns into what the
last scan shows, and where it stands too close to something to turn, it backs out first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
from numba import njit

from planners.navigator import Reactive
from planners.open_points import OpenPoint, Panorama, Surround, VirtualCircle, find_open_points
from robocar.core import (
    SE2,
    STOP,
    Array,
    Belief,
    Command,
    Context,
    Costmap,
    Drive,
    GiveUp,
    Goal,
    Observation,
    Path,
    Robot,
    Scalar,
    Text,
    Twist,
    wrap_angle,
)
from robocar.core.trace import Drawable

ARRIVED = 0.03  # [m] at a sub-goal
HIT = 0.12  # [m] a way that is free no farther has hit an obstacle; from ...
LEAVE = 0.25  # [m] on it may be left again
LOOP = 0.15  # [m] this near to where it began, a boundary has been followed all round, after ...
LOOP_LENGTH = 0.8  # [m]
STOPPING_SHARE = 0.5  # of the goal's tolerance: the belief may be off
NEW_HEADING = math.radians(10.0)  # a straight motion that differs by more is another iteration
_SQUEEZE = 0.98  # what lies inside a disc already counts as touching it, and no more
_TURN_FROM = math.radians(25.0)  # a larger error of the heading is turned away on the spot, down to ...
_TURN_TO = math.radians(2.0)
_STEER = 2.0  # [1/s] smaller ones are steered away while driving
_GUARD = 0.015  # [m] around the outline, kept while moving
_TURN_ROOM = 0.005  # [m] around the outline, kept while turning
_STIRRED = 0.02  # [m]
_BACKING = "too close to turn: backing out"
_REACTION = 0.15  # [s] from a scan to the brakes


@dataclass(frozen=True, slots=True)
class Parameters:
    """One set for all bugs; names are Nav2's where it has them.

    Args:
        safety_constant: added to the half of the largest diagonal to give the virtual circle's radius r [m].
        range_jump: delta d, the jump of the range that makes an open point [m].
        range_std: of the sensor's noise [m].
        gap_tolerance: a gap is wide enough from 2 r times one plus this on.
        desired_linear_vel: towards points [m/s]; boundary_vel: along boundaries [m/s].
        rotate_to_heading_angular_vel: [rad/s].
        looks: scans, taken standing, that a decision is made from.
        detection_distance: gaps of 2 r have to be seen from this far; it decides how many beams are needed [m].
    """

    safety_constant: float = 0.03
    range_jump: float = 0.2
    range_std: float = 0.01
    gap_tolerance: float = 0.05
    desired_linear_vel: float = 0.4
    boundary_vel: float = 0.2
    rotate_to_heading_angular_vel: float = 1.2
    looks: int = 3
    detection_distance: float = 0.75

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            zero_is_fine = name in ("range_std", "gap_tolerance")
            if not (math.isfinite(value) and (value > 0 or (zero_is_fine and value == 0))):
                raise ValueError(f"{name} must be positive, not {value}")


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a bug knows when it decides.

    Args:
        time: [s]; pose: of the robot; centre: of its virtual circle, (2,) [m].
        panorama: the last scan; hits: its surface points, (m, 2) [m]; fresh: whether it is new.
        goal: where to go.
        blocked: whether the guard has stopped the last motion.
    """

    time: float
    pose: SE2
    centre: Array
    panorama: Panorama
    hits: Array
    fresh: bool
    goal: Goal
    blocked: bool
    circle: VirtualCircle
    parameters: Parameters

    @property
    def goal_distance(self) -> float:
        """d_min [m]."""
        return math.dist(self.centre, self.goal.position)

    @property
    def goal_heading(self) -> float:
        """[rad]"""
        return self.heading_to(self.goal.position)

    @property
    def passing_radius(self) -> float:
        """Half the safety constant is left for noise, so that a wall at the virtual circle's edge does not block it [m]."""
        return self.circle.body + 0.5 * self.parameters.safety_constant

    def heading_to(self, point: Array) -> float:
        """[rad]"""
        return math.atan2(point[1] - self.centre[1], point[0] - self.centre[0])

    def free_way(self, heading: float, length: float, radius: float | None = None) -> float:
        """How far the circle (or a disc of `radius`) can go before it meets a surface, at most `length` [m]."""
        x, y = self.centre
        return free_way(self.hits, x, y, heading, self.passing_radius if radius is None else radius, length)

    def goal_in_sight(self) -> bool:
        """Whether nothing that is seen stands in the straight way to where the goal counts as reached."""
        return self.goal_is_open(math.inf)

    def goal_is_open(self, length: float) -> bool:
        """Whether the next `length` of the straight way to the goal is free [m]."""
        enough = min(length, self.goal_distance - 0.8 * self.goal.xy_goal_tolerance)
        return enough <= 0.0 or self.free_way(self.goal_heading, enough) >= enough

    def reachable(self, point: Array) -> bool:
        """Whether the outline can drive straight to `point` (2,) and turn there."""
        length = math.dist(self.centre, point)
        room = np.min(np.hypot(self.hits[:, 0] - point[0], self.hits[:, 1] - point[1]), initial=math.inf)
        return room >= self.circle.body and self.free_way(self.heading_to(point), length, self.circle.driving) >= length

    def open_points(self) -> list[OpenPoint]:
        """The sure ones of the last scan."""
        found = find_open_points(self.panorama, self.parameters.range_jump, self.parameters.range_std)
        return [point for point in found if point.sure]


@dataclass(frozen=True, slots=True, eq=False)
class To:
    """Turn, then drive straight until the virtual circle's centre is at `point` (2,) [m]."""

    point: Array


@dataclass(frozen=True, slots=True)
class Along:
    """Turn to `heading` [rad], then drive straight at `speed` [m/s]; decided anew at every scan."""

    heading: float
    speed: float


@dataclass(frozen=True, slots=True)
class Stand:
    """Stand still and look."""


Move: TypeAlias = To | Along | Stand | GiveUp


class Strategy(Protocol):
    """What makes one bug different from another."""

    def reset(self) -> None: ...

    def step(self, view: View) -> Move:
        """The next motion; asked at every scan, while one is under way too."""
        ...

    def trace(self, view: View) -> dict[str, Drawable]:
        """What it wants to be seen now."""
        ...


@njit(cache=True)
def free_way(points: Array, x: float, y: float, heading: float, radius: float, length: float) -> float:
    """How far a disc at (x, y) can move along `heading` [rad] before it touches one of the points (n, 2), at most `length` [m].

    A point inside the disc blocks the directions towards it only.
    """
    c, s = math.cos(heading), math.sin(heading)
    free = length
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        along, lateral = c * dx + s * dy, c * dy - s * dx
        if 0.0 < along < free + radius and abs(lateral) < radius:
            r2 = min(radius * radius, _SQUEEZE * _SQUEEZE * (dx * dx + dy * dy))
            if r2 > lateral * lateral:
                free = min(free, max(0.0, along - math.sqrt(r2 - lateral * lateral)))
    return free


@njit(cache=True)
def narrow_gap(points: Array, x: float, y: float, heading: float, length: float, width: float, passed: float) -> float:
    """How far along a straight way it first passes between two points less than `width` [m] apart; inf where it never does.

    SAFE_POINT (section 2.3) asks for the distance of facing open points. Here all pairs of surface points, one on either side of
    the way, are asked, since of an obliquely seen door the two open points lie farther apart than its jambs. A gap nearer than
    `passed` [m] is one that the robot is in already; beyond the end of the way, it still is one.
    """
    c, s = math.cos(heading), math.sin(heading)
    near = np.empty((len(points), 2))
    count = 0
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        along, lateral = c * dx + s * dy, c * dy - s * dx
        if -width < along < length + passed + width and abs(lateral) < width:
            near[count, 0], near[count, 1] = along, lateral
            count += 1
    first = math.inf
    for i in range(count):
        a, left = near[i]
        if left <= 0.0:
            continue
        for k in range(count):
            b, right = near[k]
            if right > 0.0 or (a - b) ** 2 + (left - right) ** 2 >= width * width:
                continue
            crossing = (b * left - a * right) / (left - right)
            if passed < crossing <= length + passed and crossing < first:
                first = crossing
    return first


@njit(cache=True)
def first_free(
    points: Array, x: float, y: float, start: float, side: int, span: float, radius: float, length: float, step: float
) -> float:
    """The first heading from `start` on, turning by `side`, in which the disc can move `length`; nan where none
    in `span` [rad] is."""
    for k in range(int(span / step) + 1):
        heading = start + side * k * step
        if free_way(points, x, y, heading, radius, length) >= length:
            return heading
    return math.nan


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

    def __init__(self, robot: Robot, parameters: Parameters) -> None:
        vertices = robot.footprint.vertices
        self._front, self._rear = float(vertices[:, 0].max()), float(-vertices[:, 0].min())
        self._half = float(np.abs(vertices[:, 1]).max())
        self._limits, self._parameters = robot.limits, parameters
        self.forget()

    def forget(self) -> None:
        """A new episode."""
        self._turning = False
        self._last, self._time = Twist(), -math.inf
        self.blocked = self.backing = False
        self._way_out = 0.0  # 1 ahead, -1 back, while it gets out of where it cannot turn

    def stand(self, time: float) -> Twist:
        """Brakes, and stands."""
        return self._done(Twist(), time)

    def drive(self, pose: SE2, hits: Array, heading: float, left: float, speed: float, time: float) -> Twist:
        """Towards `heading` [rad], slowing down to stop after `left` [m]."""
        local = _robot_frame(hits, pose.x, pose.y, pose.theta)
        error = wrap_angle(heading - pose.theta)
        self._turning = abs(error) > (_TURN_TO if self._turning else _TURN_FROM)
        if self._turning or self.backing:
            return self._turn(local, error, time)
        lim, dt = self._limits, self._dt(time)
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

    def cramped(self, pose: SE2, hits: Array) -> bool:
        """Whether the robot has no room to turn, but may gain some by driving straight."""
        local = _robot_frame(hits, pose.x, pose.y, pose.theta)
        return self._room(local) < self._turning_room and self._back_out(local) != Twist()

    def back_out(self, pose: SE2, hits: Array, time: float) -> Twist:
        """Straight, to where there is room to turn."""
        return self._done(self._back_out(_robot_frame(hits, pose.x, pose.y, pose.theta)), time)

    @property
    def _turning_room(self) -> float:
        return math.hypot(max(self._front, self._rear), self._half) + 2.0 * _TURN_ROOM

    def _room(self, local: Array) -> float:
        return float(np.min(np.hypot(local[:, 0], local[:, 1]), initial=math.inf))

    @property
    def _fastest(self) -> float:
        return min(self._parameters.rotate_to_heading_angular_vel, self._limits.max_vel_theta)

    def _turn(self, local: Array, error: float, time: float) -> Twist:
        """Turns if there is room, else backs out to where there is."""
        box = self._front + _TURN_ROOM, self._rear + _TURN_ROOM, self._half + _TURN_ROOM
        stretch = math.copysign(min(abs(error), 0.6), error)
        if self.backing:
            self.backing = self._room(local) < self._turning_room
        if not self.backing and not _turn(local, *box, stretch):
            other = math.copysign(min(math.tau - abs(error), 0.6), -error)
            if abs(error) > 2.0 and _turn(local, *box, other):
                return self._done(Twist(0.0, math.copysign(0.5 * self._fastest, other)), time)
            self.backing = True
        if self.backing:
            return self._done(self._back_out(local), time)
        self.blocked, self._way_out = False, 0.0
        rate = min(self._fastest, math.sqrt(self._limits.acc_lim_theta * abs(error)), abs(error) / self._dt(time))
        return self._done(Twist(0.0, math.copysign(rate, error)), time)

    def _back_out(self, local: Array) -> Twist:
        """Straight, the way that gains room: away from the nearest surface if that way is free, else the other, and on that way until it ends."""
        gap, half, speed = 0.01, self._half + 0.002, min(0.08, -self._limits.min_vel_x)
        if not len(local):
            return Twist()
        if self._way_out == 0.0:
            nearest = local[np.argmin(np.hypot(local[:, 0], local[:, 1]))]
            self._way_out = -1.0 if nearest[0] > 0.0 else 1.0
        for sign in (self._way_out, -self._way_out):
            if _straight(local, self._front, self._rear, half, sign) > gap and (sign > 0 or speed > 0):
                self.blocked, self._way_out = False, sign  # until it is closed
                return Twist(sign * (speed if speed > 0 else 0.08), 0.0)
        self.backing, self.blocked = False, True
        return Twist()

    def _dt(self, time: float) -> float:
        return min(max(time - self._time, 0.01), 0.2)

    def _done(self, twist: Twist, time: float) -> Twist:
        dt, lim = self._dt(time), self._limits
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

    def move(self, view: View) -> Move:
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


def nearer_side(view: View) -> int:
    """On which hand an obstacle ahead will be when it is followed by turning the least: +1 left, -1 right."""
    x, y = view.centre
    turns = []
    for side in (1, -1):
        heading = first_free(
            view.hits, x, y, view.goal_heading, -side, math.pi, view.passing_radius, HIT + 0.05, math.radians(3.0)
        )
        turns.append(abs(heading - view.goal_heading) if not math.isnan(heading) else math.inf)
    return 1 if turns[0] <= turns[1] else -1


class Bug:
    """A bug as a local planner: what it sees, what its strategy decides, and the motion that carries it out.

    Args:
        robot: needs a laser or sonars all round, see `Surround`.
        strategy: decides.

    Raises:
        ParameterError: the robot does not look all round closely enough.
    """

    def __init__(self, robot: Robot, strategy: Strategy, parameters: Parameters | None = None) -> None:
        self.parameters = p = parameters or Parameters()
        self.circle = VirtualCircle.of(robot.footprint, p.safety_constant)
        self.strategy = strategy
        self._motion = Motion(robot, p)
        self._surround = Surround(robot, 2.0 * math.atan(self.circle.radius / p.detection_distance))
        self._forget()
        _warm_up(self._motion)
        self._motion.forget()

    def reset(self, rng: np.random.Generator) -> None:
        """A new episode; there is no chance in it."""
        self._surround.forget()
        self._motion.forget()
        self.strategy.reset()
        self._forget()

    def _forget(self) -> None:
        self.iterations = self.turns = 0
        self._panorama: Panorama | None = None
        self._hits = np.empty((0, 2))
        self._counted: Array | float | None = None
        self._note = ""
        self._cramped = True  # until it has been seen that it can turn where it starts

    def command(
        self, belief: Belief, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal
    ) -> Command:
        """The twist until the next scan; path and costmap are not needed."""
        pose = belief.pose
        panorama = self._surround.panorama(observation, pose)
        if panorama is not None and panorama.lost:
            self._panorama = None
            self._motion.stand(observation.time)
            return replace(STOP, trace=self._said("no beam has come back: standing"))
        if panorama is not None:
            self._panorama, self._hits = panorama, panorama.hits()
        if self._panorama is None:
            self._motion.stand(observation.time)
            return STOP
        centre = self.circle.centre(pose)
        if math.dist(centre, goal.position) <= STOPPING_SHARE * goal.xy_goal_tolerance:
            return Drive(self._align(pose, goal, observation.time))
        view = View(
            observation.time,
            pose,
            centre,
            self._panorama,
            self._hits,
            panorama is not None,
            goal,
            self._motion.blocked,
            self.circle,
            self.parameters,
        )
        if self._cramped and view.fresh:
            self._cramped = self._motion.cramped(pose, self._hits)
        if self._cramped:
            return Drive(self._motion.back_out(pose, self._hits, observation.time), trace=self._said(_BACKING))
        move = self.strategy.step(view)
        trace = self._count(move) | (self.strategy.trace(view) if view.fresh else {})
        if isinstance(move, GiveUp):
            return replace(move, trace=trace | dict(move.trace))
        twist = self._twist(move, view)
        trace |= self._said(_BACKING if self._motion.backing else "")
        return Drive(twist, trace=trace)

    def _twist(self, move: To | Along | Stand, view: View) -> Twist:
        motion, time = self._motion, view.time
        if isinstance(move, Stand):
            return motion.stand(time)
        if isinstance(move, Along):
            return motion.drive(view.pose, self._hits, move.heading, math.inf, move.speed, time)
        axle = self.circle.axle(move.point, view.heading_to(move.point))
        left = math.dist(view.pose.position, axle)
        heading = math.atan2(axle[1] - view.pose.y, axle[0] - view.pose.x)
        return motion.drive(view.pose, self._hits, heading, left, self.parameters.desired_linear_vel, time)

    def _align(self, pose: SE2, goal: Goal, time: float) -> Twist:
        """At the goal: stand, or turn to its heading."""
        turn = 0.0 if goal.heading is None else wrap_angle(goal.heading - pose.theta)
        if abs(turn) <= STOPPING_SHARE * goal.yaw_goal_tolerance:
            return self._motion.stand(time)
        return self._motion.turn(pose, self._hits, pose.theta + turn, time)

    def _count(self, move: Move) -> dict[str, Drawable]:
        """An iteration is a new straight motion: to another point, or along a heading more than 10 degrees away."""
        counted = self._counted
        if isinstance(move, To):
            new = not (isinstance(counted, np.ndarray) and np.array_equal(counted, move.point))
            self._counted = move.point
        elif isinstance(move, Along):
            new = not isinstance(counted, float) or abs(wrap_angle(counted - move.heading)) > NEW_HEADING
            self._counted = move.heading if new else counted
        else:
            return {}
        self.iterations += new
        # `replans` is the name under which the metrics count decisions.
        return {"replans": Scalar(self.iterations)} if new else {}

    def _said(self, note: str) -> dict[str, Drawable]:
        """A line of the log, once."""
        new, self._note = note and note != self._note, note
        return {"bug": Text(note, "WARN")} if new else {}


def _warm_up(motion: Motion) -> None:
    """Compiled here, not in the control loop."""
    points = np.array([[0.5, 0.1], [0.5, -0.1], [0.1, 0.3]])
    free_way(points, 0.0, 0.0, 0.0, 0.1, 1.0)
    narrow_gap(points, 0.0, 0.0, 0.0, 1.0, 0.3, 0.1)
    first_free(points, 0.0, 0.0, 0.0, 1, 1.0, 0.1, 0.1, 0.1)
    for heading in (0.0, 2.0):
        motion.drive(SE2(), points, heading, 1.0, 0.1, 0.0)
    panorama = Panorama(0.0, np.zeros(2), np.linspace(0.0, 6.0, 60), np.linspace(1.0, 6.0, 60), 6.0, 0.1)
    find_open_points(panorama, 0.2, 0.01)


def build_bug(context: Context, strategy: Strategy) -> Reactive:
    """The navigator: the bug with this strategy for the context's robot, with its parameters."""
    return Reactive(Bug(context.robot, strategy, context.parameters_of(Parameters)))
