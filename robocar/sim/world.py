"""The physics run: a world with robots in it, its truth and its hash."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations
from types import MappingProxyType
from weakref import proxy

import mujoco
import numpy as np
from numpy.typing import NDArray

from robocar.core import Array, ScenarioError
from robocar.core.distance import polygon_distance
from robocar.core.randomness import stream
from robocar.core.truth import GroundTruth
from robocar.sim.movers import MovingObstacle
from robocar.sim.physics import PhysicsParameters, set_physics
from robocar.sim.robot_handle import RobotHandle, RobotSetup, Surroundings
from robocar.sim.world_spec import SEEN_GROUP, SENSED_GROUP

ROBOT_GROUPS = (1, 3, 4, 5)
"""Geom groups of the robots of a world, in their order: MuJoCo has six, and rays and cameras use two of them for the rest."""
_DOUBT = 0.10  # [m] by which a costmap of usual cells and inflation may see an obstacle nearer than it is
_SETTLING = 0.5  # [s] that robots are given to sink into their tyres


class World:
    """Robots in a world. A control tick: every robot senses and is told what to do (`act` only latches), then `step`.

    Args:
        spec: the world without robots; it is changed: they are attached to it.
        robots: what is put into it, one or several.
        seed: of all noise and of the robots' tolerances.
        physics: time steps and tolerances.
        clearance: distance [m] from a polygon (n, 2) in the world to the nearest static obstacle (for ground truth).
        movers: moving obstacles of the world.

    Raises:
        ScenarioError: robots that do not fit together, or time steps that do not.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        robots: Sequence[RobotSetup],
        *,
        seed: int,
        physics: PhysicsParameters | None = None,
        clearance: Callable[[Array], float] | None = None,
        movers: Sequence[MovingObstacle] = (),
    ) -> None:
        physics = physics or PhysicsParameters()
        _check(robots)
        self.control_period = physics.control_period
        period = robots[0].firmware.period
        self._firmware_steps = _multiple(physics.control_period, period, "control_period", "the firmware's period")
        self._physics_steps = _multiple(period, physics.timestep, "the firmware's period", "timestep")
        set_physics(spec, physics.timestep)
        for setup, group in zip(robots, ROBOT_GROUPS, strict=False):
            start = setup.start
            frame = spec.worldbody.add_frame(
                pos=[start.x, start.y, 0.0], quat=[math.cos(start.theta / 2), 0.0, 0.0, math.sin(start.theta / 2)]
            )
            spec.attach(setup.robot_model.spec(setup.fit_out, group), prefix=f"{setup.name}/", frame=frame)
            spec.option.impratio = setup.robot_model.impratio
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        # Views of the state: each look-up of an attribute of `data` costs as much as the number behind it.
        self._qpos, self._qvel, self._ctrl = self.data.qpos, self.data.qvel, self.data.ctrl
        self._warnings = self.data.warning.number
        self._clearance, self._movers = clearance, tuple(movers)
        self._hash = hashlib.sha256()
        handles: dict[str, RobotHandle] = {}
        for k, setup in enumerate(robots):
            whose = f"{setup.name}/" if len(robots) > 1 else ""
            surroundings = Surroundings(
                model=self.model,
                data=self.data,
                streams=partial(_stream_of, seed, whose),
                clearance=partial(World._room, proxy(self), setup.name),  # no circle: a world goes with its last reference
                met_by_rays=_groups(SENSED_GROUP, *(g for i, g in enumerate(ROBOT_GROUPS[: len(robots)]) if i != k)),
                shown=_groups(SENSED_GROUP, SEEN_GROUP, *ROBOT_GROUPS[: len(robots)]),
            )
            handles[setup.name] = RobotHandle(setup, surroundings, physics)
        self.robots: Mapping[str, RobotHandle] = MappingProxyType(handles)
        """By name, in the order in which they were given."""
        self._settle()
        for robot in handles.values():
            robot.begin()

    @property
    def robot(self) -> RobotHandle:
        """The only robot.

        Raises:
            ScenarioError: there are several.
        """
        if len(self.robots) > 1:
            raise ScenarioError(f"this world has several robots; say which: {', '.join(self.robots)}")
        return next(iter(self.robots.values()))

    def step(self) -> None:
        """Every robot starts what it was told, and the world goes on for one control period."""
        robots, movers = self.robots.values(), self._movers
        others_move = bool(movers) or len(robots) > 1
        for robot in robots:
            robot.obey(others_move)
        looking = [robot for robot in robots if robot.looks_around]
        feeling = [robot for robot in robots if robot.may_touch]
        for _ in range(self._firmware_steps):
            for robot in robots:
                robot.drive()
            for mover in movers:
                mover.drive(self.data)
            for robot in looking:
                robot.turn_camera()
            mujoco.mj_step(self.model, self.data, self._physics_steps)
            for robot in feeling:
                robot.feel()
        for robot in robots:
            robot.rest()
        self._update_hash()

    def ground_truth(self, robot: RobotHandle | None = None) -> GroundTruth:
        """What only metrics and pictures may know, about one robot; by default about the only one."""
        robot = robot or self.robot
        return GroundTruth(
            time=self.data.time,
            pose=robot.pose(),
            twist=robot.twist(),
            clearance=robot.clearance(),
            movers={mover.name: mover.pose(self.data) for mover in self._movers},
            voltages=robot.voltages,
            contact=robot.contact,
            mover_velocities={mover.name: mover.velocity(self.data) for mover in self._movers},
        )

    @property
    def time(self) -> float:
        """[s]"""
        return self.data.time

    @property
    def hash(self) -> str:
        """sha256 over (time, qpos, qvel, ctrl) of all control ticks so far."""
        return self._hash.hexdigest()

    def diverged(self) -> str | None:
        """Why the physics can no longer be believed, or None."""
        if not math.isfinite(self._qpos.sum()):
            return "the state is not finite"
        if self._warnings.any():
            return f"MuJoCo warns: {', '.join(mujoco.mjtWarning(i).name for i in self._warnings.nonzero()[0])}"
        return None

    def mover_at(self, point: Array, robot: RobotHandle | None = None) -> str | None:
        """Name of a mover so near to a point (2,) [m] that a robot, by default the only one, could not be sure of room there."""
        room = (robot or self.robot).robot.footprint.circumscribed_radius + _DOUBT
        return next((m.name for m in self._movers if m.distance(self.data, np.reshape(point, (1, 2))) < room), None)

    def close(self) -> None:
        """Gives back what the robots' sensors hold."""
        for robot in self.robots.values():
            robot.close()

    # -- parts ---------------------------------------------------------------------------------------------------------

    def _room(self, name: str, corners: Array) -> float:
        """From a polygon (n, 2), the footprint of robot `name`, to the nearest thing that is not this robot [m]."""
        room = self._clearance(corners) if self._clearance is not None else 0.0
        for mover in self._movers:
            room = min(room, mover.distance(self.data, corners))
        for other in self.robots.values():
            if other.name != name:
                room = min(room, polygon_distance(corners, other.robot.footprint.at(other.pose())))
        return room

    def _settle(self) -> None:
        """Let the robots sink into their tyres before time starts."""
        mujoco.mj_forward(self.model, self.data)
        for _ in range(round(_SETTLING / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
        self.data.time = 0.0
        self.data.qvel[:] = 0.0

    def _update_hash(self) -> None:
        self._hash.update(np.float64(self.data.time).tobytes())
        for values in (self._qpos, self._qvel, self._ctrl):
            self._hash.update(values.tobytes())


def _check(robots: Sequence[RobotSetup]) -> None:
    names = [setup.name for setup in robots]
    if not robots:
        raise ScenarioError("a world needs a robot")
    if len(robots) > len(ROBOT_GROUPS):
        raise ScenarioError(f"a world holds at most {len(ROBOT_GROUPS)} robots, not {len(robots)}")
    if len(set(names)) < len(names) or not all(name and "/" not in name for name in names):
        raise ScenarioError(f"robots need different names without a slash, not {names}")
    for what, values in (
        ("impratio", {setup.robot_model.impratio for setup in robots}),
        ("firmware's period", {setup.firmware.period for setup in robots}),
    ):
        if len(values) > 1:
            raise ScenarioError(f"robots of one world must agree on the {what}, not {sorted(values)}")
    outlines = [setup.robot_model.footprint.at(setup.start) for setup in robots]
    for (a, first), (b, second) in combinations(zip(robots, outlines, strict=True), 2):
        if polygon_distance(first, second) == 0.0:
            raise ScenarioError(
                f"robots need room of their own at the start, not {a.name!r} at {a.start} and {b.name!r} at {b.start}"
            )


def _stream_of(seed: int, whose: str, name: str) -> np.random.Generator:
    return stream(seed, whose + name)


def _groups(*numbers: int) -> NDArray[np.uint8]:
    """(6,) of 0 and 1, as MuJoCo takes them."""
    chosen = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
    chosen[list(numbers)] = 1
    return chosen


def _multiple(whole: float, part: float, whole_name: str, part_name: str) -> int:
    count = round(whole / part) if part > 0 else 0
    if count < 1 or abs(count * part - whole) > 1e-9:
        raise ScenarioError(f"{whole_name} ({whole} s) must be an integer multiple of {part_name} ({part} s)")
    return count
