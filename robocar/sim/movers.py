"""Moving obstacles: boxes and cylinders that follow waypoints, push, and are pushed.

A mover is a body on two slides and a spring-loaded hinge, driven by velocity actuators of limited force. A mocap body would not
do: it has infinite mass, passes through walls and cannot be stopped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np

from robocar.core import SE2, Array, ScenarioError, frozen_array
from robocar.core.distance import polygon_distance

RESPONSE = 0.05  # [s] time constant of the speed control: quick against anything that the car could react to
HINGE_FREQUENCY = 2.0 * math.pi  # [rad/s] a mover that was turned by a push turns back within about a second


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A moving obstacle.

    Args:
        name: unique among the movers.
        shape: "box" with `size` = (length, width, height) or "cylinder" with `size` = (radius, height) [m].
        start: world_from_mover at time 0; the heading stays.
        waypoints: visited in turn, again and again, (n, 2) [m]; none: it stands, but can be pushed.
        speed: [m/s].
        mass: [kg].
        max_force: with which it drives or brakes [N].
    """

    name: str
    shape: Literal["box", "cylinder"]
    size: tuple[float, ...]
    start: SE2
    waypoints: Array = field(default_factory=lambda: np.empty((0, 2)))
    speed: float = 0.2
    mass: float = 5.0
    max_force: float = 20.0

    def __post_init__(self) -> None:
        numbers = {"box": 3, "cylinder": 2}.get(self.shape)
        if numbers is None:
            raise ScenarioError(f"mover {self.name!r}: shape {self.shape!r} is neither box nor cylinder")
        if len(self.size) != numbers or not all(math.isfinite(s) and s > 0 for s in self.size):
            raise ScenarioError(f"mover {self.name!r}: a {self.shape} needs {numbers} positive sizes [m], not {self.size}")
        waypoints = frozen_array(self.waypoints)
        if waypoints.ndim != 2 or waypoints.shape[1] != 2 or not np.all(np.isfinite(waypoints)):
            raise ScenarioError(f"mover {self.name!r}: waypoints must be finite points [x, y], not {self.waypoints}")
        object.__setattr__(self, "waypoints", waypoints)
        if not (math.isfinite(self.speed) and self.speed >= 0):
            raise ScenarioError(f"mover {self.name!r}: speed {self.speed} m/s must not be negative")
        for quantity in ("mass", "max_force"):
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

    def outline(self, pose: SE2) -> Array:
        """Corners in the world, counter-clockwise, (4, 2); of a cylinder the centre, (1, 2) [m]."""
        if self.shape == "cylinder":
            return pose.position[None]
        x, y = self.size[0] / 2, self.size[1] / 2
        return pose.transform([[x, y], [-x, y], [-x, -y], [x, -y]])


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
    body.add_joint(
        name=f"mover/{mover.name}/turn",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        stiffness=[inertia * HINGE_FREQUENCY**2, 0, 0],
        damping=[2 * inertia * HINGE_FREQUENCY, 0, 0],
    )
    if mover.shape == "box":
        shape, size = mujoco.mjtGeom.mjGEOM_BOX, [s / 2 for s in mover.size]
    else:
        shape, size = mujoco.mjtGeom.mjGEOM_CYLINDER, [mover.radius, mover.height / 2, 0]
    body.add_geom(name=f"mover/{mover.name}", type=shape, size=size, mass=mover.mass, quat=_quaternion(mover.start.theta), **geom)


class MovingObstacle:
    """Drives one mover of a compiled world along its waypoints."""

    def __init__(self, mover: Mover) -> None:
        self.mover = mover
        self.name = mover.name
        self._data: mujoco.MjData | None = None

    def drive(self, data: mujoco.MjData) -> None:
        """Sets the speed towards the next waypoint, for as long as until the next call."""
        self._bind(data)
        velocity = np.zeros(2)
        if len(self.mover.waypoints):
            ahead = self._ahead()
            distance = math.hypot(*ahead)
            # The speed follows with a lag of RESPONSE, so turning this far ahead passes closest to the corner.
            if distance <= max(self.mover.speed * RESPONSE, 1e-3) and len(self.mover.waypoints) > 1:
                self._next = (self._next + 1) % len(self.mover.waypoints)
                ahead = self._ahead()
                distance = math.hypot(*ahead)
            if distance > 0:
                # Far off at full speed; a single waypoint is approached gently.
                velocity = ahead * min(self.mover.speed / distance, 1.0 / (4 * RESPONSE))
        self._drive_x[0], self._drive_y[0] = velocity

    def pose(self, data: mujoco.MjData) -> SE2:
        """world_from_mover."""
        self._bind(data)
        start = self.mover.start
        return SE2(start.x + float(self._x[0]), start.y + float(self._y[0]), start.theta + float(self._turn[0]))

    def distance(self, data: mujoco.MjData, corners: Array) -> float:
        """From the mover to a convex polygon (n, 2) in the world, counter-clockwise [m]; 0 where they touch or overlap."""
        return max(polygon_distance(corners, self.mover.outline(self.pose(data))) - self.mover.radius, 0.0)

    def _ahead(self) -> Array:
        """From the mover to its next waypoint, (2,) [m]."""
        x, y = self.mover.waypoints[self._next]
        return np.array([x - self.mover.start.x - self._x[0], y - self.mover.start.y - self._y[0]])

    def _bind(self, data: mujoco.MjData) -> None:
        """Looks its numbers up in `data` once: views, as names are slow. A new `data` is a new run."""
        if data is self._data:
            return
        self._data = data
        name = f"mover/{self.name}"
        self._x, self._y, self._turn = (data.joint(f"{name}/{joint}").qpos for joint in ("x", "y", "turn"))
        self._drive_x, self._drive_y = (data.actuator(f"{name}/{axis}").ctrl for axis in ("x", "y"))
        self._next = 0


def _quaternion(theta: float) -> list[float]:
    return [math.cos(theta / 2), 0.0, 0.0, math.sin(theta / 2)]
