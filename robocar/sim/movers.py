"""Moving obstacles: boxes and cylinders that go to and fro, push, and are pushed.

A mover is a body on two slides and a hinge, driven by actuators of limited force. A mocap body would not do: it has infinite
mass, passes through walls and cannot be stopped.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from robocar.core import SE2, Array, ScenarioError, frozen_array, wrap_angle
from robocar.core.distance import polygon_distance

Motion = Literal["constant", "stop-turn-go", "random-walk"]
MOTIONS: tuple[Motion, ...] = ("constant", "stop-turn-go", "random-walk")

RESPONSE = 0.05  # [s] time constant of the speed control: quick against anything that the car could react to
HINGE_FREQUENCY = 2.0 * math.pi  # [rad/s] a mover that was turned by a push turns back within about a second
TURNING_FREQUENCY = 20.0  # [rad/s] of the heading control of one that turns by itself
ARRIVED = 0.01  # [m] from where a mover stops
FACING = 0.02  # [rad] from the way it is to go
PATIENCE = 3.0  # times the time that a leg of a random walk takes, and one second, before it goes elsewhere
TRIES = 30  # points that are drawn for a leg of a random walk, until the way to one is free
TURN_STEP = math.radians(6)  # between the outlines whose hull covers a turn


class Sweep(NamedTuple):
    """What a mover covers on its way from `a` to `b`: a convex polygon (n, 2) grown by `radius` [m]."""

    a: SE2
    b: SE2
    polygon: Array
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A moving obstacle.

    Args:
        name: unique among the movers.
        shape: "box" with `size` = (length, width, height) or "cylinder" with `size` = (radius, height) [m].
        start: world_from_mover at time 0.
        waypoints: visited in turn, again and again, (n, 2) [m]; none: it stands, but can be pushed.
        speed: [m/s].
        mass: [kg].
        max_force: with which it drives or brakes [N].
        motion: "constant": at constant speed round the way points, without turning; "stop-turn-go": stands at each of them for
            `pause`, turns towards the next one, goes; "random-walk": the same to points that are drawn from the disc of radius
            `roam` around its start, each with a free straight way to it (random waypoint model: Johnson and Maltz, Dynamic
            Source Routing in Ad Hoc Wireless Networks, 1996).
        pause: [s].
        turn_speed: [rad/s].
        roam: [m].
    """

    name: str
    shape: Literal["box", "cylinder"]
    size: tuple[float, ...]
    start: SE2
    waypoints: Array = field(default_factory=lambda: np.empty((0, 2)))
    speed: float = 0.2
    mass: float = 5.0
    max_force: float = 20.0
    motion: Motion = "constant"
    pause: float = 1.0
    turn_speed: float = 1.0
    roam: float = 2.0

    def __post_init__(self) -> None:
        numbers = {"box": 3, "cylinder": 2}.get(self.shape)
        if numbers is None:
            raise ScenarioError(f"mover {self.name!r}: shape {self.shape!r} is neither box nor cylinder")
        if self.motion not in MOTIONS:
            raise ScenarioError(f"mover {self.name!r}: motion {self.motion!r} is none of {', '.join(MOTIONS)}")
        if len(self.size) != numbers or not all(math.isfinite(s) and s > 0 for s in self.size):
            raise ScenarioError(f"mover {self.name!r}: a {self.shape} needs {numbers} positive sizes [m], not {self.size}")
        waypoints = frozen_array(self.waypoints)
        if waypoints.ndim != 2 or waypoints.shape[1] != 2 or not np.all(np.isfinite(waypoints)):
            raise ScenarioError(f"mover {self.name!r}: waypoints must be finite points [x, y], not {self.waypoints}")
        if self.motion == "random-walk" and len(waypoints):
            raise ScenarioError(f"mover {self.name!r}: a random walk takes no way point but its start")
        object.__setattr__(self, "waypoints", waypoints)
        for quantity in ("speed", "pause"):
            value = getattr(self, quantity)
            if not (math.isfinite(value) and value >= 0):
                raise ScenarioError(f"mover {self.name!r}: {quantity} {value} must not be negative")
        if self.speed == 0 and self.motion != "constant":
            raise ScenarioError(f"mover {self.name!r}: speed 0 leads nowhere; {self.motion} needs a positive one")
        for quantity in ("mass", "max_force", "turn_speed", "roam"):
            value = getattr(self, quantity)
            if not (math.isfinite(value) and value > 0):
                raise ScenarioError(f"mover {self.name!r}: {quantity} {value} must be positive")

    @property
    def height(self) -> float:
        """[m]"""
        return self.size[-1]

    @property
    def radius(self) -> float:
        """By which `outline` has to grow to be the mover's shadow on the floor [m]: a cylinder's radius, 0 for a box."""
        return self.size[0] if self.shape == "cylinder" else 0.0

    @property
    def reach(self) -> float:
        """Radius of the circle around it [m]."""
        return self.radius or 0.5 * math.hypot(self.size[0], self.size[1])

    @property
    def turns(self) -> bool:
        """Whether it turns by itself."""
        return self.motion != "constant"

    def outline(self, pose: SE2) -> Array:
        """Corners in the world, counter-clockwise, (4, 2); of a cylinder the centre, (1, 2) [m]."""
        if self.shape == "cylinder":
            return pose.position[None]
        x, y = self.size[0] / 2, self.size[1] / 2
        return pose.transform([[x, y], [-x, y], [-x, -y], [x, -y]])

    def sweep(self, a: SE2, b: SE2) -> Sweep:
        """What it covers on the straight way from `a`, with the heading of `b`; at one place, what it covers as it turns."""
        if a.distance_to(b) > 0.0:
            poses = [SE2(a.x, a.y, b.theta), b]
        else:
            turn = wrap_angle(b.theta - a.theta)
            count = 1 + math.ceil(abs(turn) / TURN_STEP)
            poses = [SE2(a.x, a.y, a.theta + turn * share) for share in np.linspace(0.0, 1.0, count)]
        points = np.unique(np.concatenate([self.outline(pose) for pose in poses]), axis=0)
        return Sweep(a, b, points if len(points) < 3 else points[ConvexHull(points).vertices], self.radius)

    def sweeps(self) -> Iterator[Sweep]:
        """What it covers until it goes round for the second time; of a random walk what it covers as it turns at its start."""
        here = self.start
        if self.motion == "random-walk":
            yield Sweep(here, here, here.position[None], self.reach)
            return
        rounds = self.waypoints if len(self.waypoints) < 2 else np.concatenate([self.waypoints, self.waypoints[:2]])
        if not len(rounds):
            yield self.sweep(here, here)
        for x, y in rounds:
            there = SE2(float(x), float(y), self.heading(here, float(x), float(y)))
            if there.theta != here.theta or there.distance_to(here) == 0.0:
                yield self.sweep(here, SE2(here.x, here.y, there.theta))
            if there.distance_to(here) > 0.0:
                yield self.sweep(here, there)
            here = there

    def heading(self, here: SE2, x: float, y: float) -> float:
        """With which it goes from `here` to a point [rad]."""
        if not self.turns or (x, y) == (here.x, here.y):
            return here.theta
        return math.atan2(y - here.y, x - here.x)


def add_mover(spec: mujoco.MjSpec, mover: Mover, **geom: object) -> None:
    """Adds the mover's body, joints and actuators; `geom` sets further attributes of its geom (bits, material, group)."""
    body = spec.worldbody.add_body(name=f"mover/{mover.name}", pos=[mover.start.x, mover.start.y, mover.height / 2])
    inertia = mover.mass * (0.5 * mover.radius**2 if mover.radius else (mover.size[0] ** 2 + mover.size[1] ** 2) / 12)
    for axis, direction in (("x", [1, 0, 0]), ("y", [0, 1, 0])):
        joint = body.add_joint(name=f"mover/{mover.name}/{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction)
        actuator = spec.add_actuator(
            name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT, forcerange=[-mover.max_force, mover.max_force]
        )
        actuator.forcelimited = True
        actuator.set_to_velocity(kv=mover.mass / RESPONSE)
    hinge = body.add_joint(name=f"mover/{mover.name}/turn", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    if mover.turns:
        torque = mover.max_force * mover.reach
        actuator = spec.add_actuator(
            name=hinge.name, target=hinge.name, trntype=mujoco.mjtTrn.mjTRN_JOINT, forcerange=[-torque, torque]
        )
        actuator.forcelimited = True
        actuator.set_to_position(kp=inertia * TURNING_FREQUENCY**2, kv=2 * inertia * TURNING_FREQUENCY)
    else:
        hinge.stiffness = [inertia * HINGE_FREQUENCY**2, 0, 0]
        hinge.damping = [2 * inertia * HINGE_FREQUENCY, 0, 0]
    if mover.shape == "box":
        shape, size = mujoco.mjtGeom.mjGEOM_BOX, [s / 2 for s in mover.size]
    else:
        shape, size = mujoco.mjtGeom.mjGEOM_CYLINDER, [mover.radius, mover.height / 2, 0]
    body.add_geom(name=f"mover/{mover.name}", type=shape, size=size, mass=mover.mass, quat=_quaternion(mover.start.theta), **geom)


class MovingObstacle:
    """Drives one mover of a compiled world.

    Args:
        mover: part of the world.
        rng: of a random walk, which draws from a copy: each new `MjData` is the same run again.
        room: distance from a convex polygon (n, 2) in the world to the nearest wall or standing obstacle [m], for a random walk.

    Raises:
        ScenarioError: a random walk without `rng` or `room`.
    """

    def __init__(
        self, mover: Mover, rng: np.random.Generator | None = None, room: Callable[[Array], float] | None = None
    ) -> None:
        if mover.motion == "random-walk" and (rng is None or room is None):
            raise ScenarioError(f"mover {mover.name!r}: a random walk needs a random generator and the room to walls")
        self.mover = mover
        self.name = mover.name
        self._seed_rng = rng if mover.motion == "random-walk" else None
        self._room = room
        self._data: mujoco.MjData | None = None

    def drive(self, data: mujoco.MjData) -> None:
        """Sets the speed for as long as until the next call."""
        self._bind(data)
        if self.mover.turns:
            velocity = self._stop_turn_go(data.time)
            self._drive_turn[0] = self._heading - self.mover.start.theta
        else:
            velocity = self._glide()
        self._drive_x[0], self._drive_y[0] = velocity

    def pose(self, data: mujoco.MjData) -> SE2:
        """world_from_mover."""
        self._bind(data)
        return SE2(*self._place(), self.mover.start.theta + float(self._turn[0]))

    def velocity(self, data: mujoco.MjData) -> tuple[float, float, float]:
        """Of its centre in the world, x and y [m/s], and its turning rate [rad/s]."""
        self._bind(data)
        return float(self._vx[0]), float(self._vy[0]), float(self._omega[0])

    def distance(self, data: mujoco.MjData, corners: Array) -> float:
        """From the mover to a convex polygon (n, 2) in the world, counter-clockwise [m]; 0 where they touch or overlap."""
        return max(polygon_distance(corners, self.mover.outline(self.pose(data))) - self.mover.radius, 0.0)

    def _glide(self) -> tuple[float, float]:
        """Velocity of constant motion (2,) [m/s]."""
        waypoints, speed = self.mover.waypoints, self.mover.speed
        if not len(waypoints):
            return 0.0, 0.0
        x, y = self._ahead(waypoints[self._next])
        # The speed follows with a lag of RESPONSE, so turning this far ahead passes closest to the corner.
        if math.hypot(x, y) <= max(speed * RESPONSE, 1e-3) and len(waypoints) > 1:
            self._next = (self._next + 1) % len(waypoints)
            x, y = self._ahead(waypoints[self._next])
        return self._towards(x, y)

    def _stop_turn_go(self, time: float) -> tuple[float, float]:
        """Velocity (2,) [m/s]; turns the heading towards the next stop meanwhile."""
        passed, self._time = time - self._time, time
        if self._target is None and time >= self._rest_until and (target := self._next_stop()) is not None:
            way = self._stop.distance_to(target) / self.mover.speed + math.pi / self.mover.turn_speed
            self._target, self._patience, self._facing = target, time + PATIENCE * way + 1.0, False
        if self._target is None:
            return 0.0, 0.0
        turn = wrap_angle(self._target.theta - self._heading)
        most = self.mover.turn_speed * passed
        self._heading += min(max(turn, -most), most)
        away = self._target.theta - self.mover.start.theta - float(self._turn[0])
        self._facing = self._facing or abs(wrap_angle(away)) < FACING
        if not self._facing:
            return 0.0, 0.0
        x, y = self._ahead((self._target.x, self._target.y))
        if math.hypot(x, y) <= ARRIVED:
            self._stop, self._target, self._rest_until = self._target, None, time + self.mover.pause
            return 0.0, 0.0
        if self._rng is not None and time > self._patience:  # something is in its way: elsewhere there may be none
            self._stop, self._target, self._rest_until = SE2(*self._place(), self._heading), None, time + self.mover.pause
            return 0.0, 0.0
        return self._towards(x, y)

    def _next_stop(self) -> SE2 | None:
        """Where to go next and with which heading; None if there is nowhere to go."""
        mover, here = self.mover, self._stop
        if self._rng is None:
            if not len(mover.waypoints):
                return None
            x, y = (float(v) for v in mover.waypoints[self._next])
            self._next = (self._next + 1) % len(mover.waypoints)
            return SE2(x, y, mover.heading(here, x, y))
        assert self._room is not None
        for _ in range(TRIES):
            distance, angle = mover.roam * math.sqrt(self._rng.random()), self._rng.uniform(-math.pi, math.pi)
            x, y = mover.start.apply(distance * math.cos(angle), distance * math.sin(angle))
            there = SE2(x, y, mover.heading(here, x, y))
            swept = mover.sweep(here, there)
            if self._room(there.position[None]) > mover.reach and self._room(swept.polygon) > swept.radius:
                return there
        return None

    def _towards(self, x: float, y: float) -> tuple[float, float]:
        """Velocity to a point that lies (x, y) ahead [m]: far off at full speed; the last bit is approached gently."""
        distance = math.hypot(x, y)
        share = min(self.mover.speed / distance, 1.0 / (4 * RESPONSE)) if distance > 0 else 0.0
        return share * x, share * y

    def _place(self) -> tuple[float, float]:
        return self.mover.start.x + float(self._x[0]), self.mover.start.y + float(self._y[0])

    def _ahead(self, point: Array | tuple[float, float]) -> tuple[float, float]:
        """From the mover to a point, x and y [m]."""
        x, y = self._place()
        return float(point[0]) - x, float(point[1]) - y

    def _bind(self, data: mujoco.MjData) -> None:
        """Looks its numbers up in `data` once: views, as names are slow. A new `data` is a new run."""
        if data is self._data:
            return
        self._data = data
        joints = [data.joint(f"mover/{self.name}/{joint}") for joint in ("x", "y", "turn")]
        self._x, self._y, self._turn = (joint.qpos for joint in joints)
        self._vx, self._vy, self._omega = (joint.qvel for joint in joints)
        axes = ("x", "y", "turn") if self.mover.turns else ("x", "y")
        self._drive_x, self._drive_y, *turn = (data.actuator(f"mover/{self.name}/{axis}").ctrl for axis in axes)
        self._drive_turn = turn[0] if turn else np.zeros(1)
        self._rng = copy.deepcopy(self._seed_rng)
        self._next = 0
        self._stop: SE2 = self.mover.start
        self._target: SE2 | None = None
        self._facing = False
        self._heading = self.mover.start.theta
        self._time, self._rest_until, self._patience = data.time, -math.inf, math.inf


def _quaternion(theta: float) -> list[float]:
    return [math.cos(theta / 2), 0.0, 0.0, math.sin(theta / 2)]
