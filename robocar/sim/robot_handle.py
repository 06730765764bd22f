"""A robot in a world: senses, takes commands, knows nothing of the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from robocar.core import SE2, Array, Command, Done, Drive, GiveUp, Hold, Observation, Robot, ScenarioError, Serial, Twist
from robocar.core.command import is_finite
from robocar.sim.drive_train import DriveTrain
from robocar.sim.firmware import Firmware, FirmwareParameters
from robocar.sim.fit_out import FitOut
from robocar.sim.physics import PhysicsParameters
from robocar.sim.robot_file import PanSection
from robocar.sim.robot_model import RobotModel
from robocar.sim.sensors.base_pose import BasePose, base_pose, planar
from robocar.sim.sensors.channel import Channel
from robocar.sim.sensors.sensor import Fitting
from robocar.sim.sensors.types import Overrides

_CONTACT_CHECK_DISTANCE = 0.05  # [m] nothing nearer at a tick's start: no contact is possible before the next one


@dataclass(frozen=True, slots=True)
class RobotSetup:
    """What is put into a world.

    Args:
        start: world_from_robot.
        name: unique in its world; the robot's names in the model begin with it.
        model: a name in `models/robots`, the path of a folder, or the loaded model.
        fit_out: what it carries.
        sensors: parameters of its sensors by type, which override those of `robot.yaml`.
        firmware: constants of its firmware.
    """

    start: SE2
    name: str = "robocar"
    model: str | Path | RobotModel = "robocar"
    fit_out: FitOut = FitOut()
    sensors: Overrides = field(default_factory=dict)
    firmware: FirmwareParameters = FirmwareParameters()

    @property
    def robot_model(self) -> RobotModel:
        """The model, loaded.

        Raises:
            ScenarioError: there is none of this name.
        """
        return self.model if isinstance(self.model, RobotModel) else RobotModel.load(self.model)


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What a robot's parts are given of the world that it is in.

    Args:
        model: of the world.
        data: of the world.
        streams: random generators by name.
        clearance: from a polygon (n, 2) in the world to whatever is not this robot [m].
        met_by_rays: geom groups that the robot's rays meet, (6,).
        shown: geom groups that its cameras show, (6,).
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    streams: Callable[[str], np.random.Generator]
    clearance: Callable[[Array], float]
    met_by_rays: NDArray[np.uint8]
    shown: NDArray[np.uint8]


class RobotHandle:
    """One robot of a `World`. A control tick is `sense()`, a decision, `act(command)`; then the world makes its step.

    Args:
        setup: what was put into the world.
        world: what it is given of it.
        physics: how much it may differ from other robots of its model.
    """

    def __init__(self, setup: RobotSetup, world: Surroundings, physics: PhysicsParameters) -> None:
        robot_model, prefix = setup.robot_model, f"{setup.name}/"
        self.name, self._setup, self._world = setup.name, setup, world
        self.robot: Robot = robot_model.describe(setup.fit_out, setup.sensors)
        model, data = world.model, world.data
        self._data = data
        # Views of the state: each look-up of an attribute of `data` costs as much as the number behind it.
        self._qpos, self._qvel, self._ctrl = data.qpos, data.qvel, data.ctrl
        base = model.joint(prefix + robot_model.base)
        self._base_qpos, self._base_qvel = int(base.qposadr[0]), int(base.dofadr[0])
        self._hull = model.geom(prefix + robot_model.hull).id
        self._pan: PanSection | None = robot_model.pan if setup.fit_out.camera else None
        self._pan_actuator = model.actuator(prefix + self._pan.actuator).id if self._pan is not None else -1
        self._sweeps = setup.fit_out.camera_pan == "sweep"
        self._drive = DriveTrain(model, data, prefix, robot_model.drive)
        self._drive.draw_tolerances(physics, world.streams("car/tolerances"))
        self.firmware = Firmware(
            self.robot.limits,
            self.robot.calibration,
            self.robot.pulses_per_turn,
            self._drive.volts_per_speed,
            robot_model.drive.motor.supply,
            setup.fit_out.compass,
            setup.firmware,
        )
        self._command: Command = Hold()
        self.voltages = (0.0, 0.0)
        """At the motors, left and right [V]."""
        self.contact = False
        """Whether its hull has touched anything during the last step."""
        self.may_touch = self.looks_around = False
        """Whether, during the step that has begun, it may touch anything, and turns its camera by itself."""
        self._cleared, self._room = -1.0, 0.0
        self._posed, self._pose = -1.0, base_pose(self._base())
        self._planar = planar(self._pose)
        self._closing = ExitStack()
        self._channels: dict[str, Channel] = {}
        feeds = {"compass": self.firmware.compass, "bumper": self.firmware.bumper}
        self._fed = [(sensor, feeds[name]) for name, sensor in robot_model.firmware_inputs.items()]

    # -- what drives it ------------------------------------------------------------------------------------------------

    def sense(self) -> Observation:
        """What is new at this tick; asked once a tick, as what was handed out is no longer new."""
        time = self._data.time
        self.base_pose()
        readings = {name: new for name, channel in self._channels.items() if (new := channel.poll(time)) is not None}
        for sensor, feed in self._fed:
            if sensor in readings:
                feed(readings[sensor].value)
        return Observation(time, readings, serial=self.firmware.answers())

    def act(self, command: Command) -> None:
        """Keeps the command until the world makes its next step; nothing sees it before, not even `busy`.

        Without a command a step is a `Hold`.

        Raises:
            TypeError: it is no command.
            ValueError: it holds a number that is not finite.
        """
        if not (
            (isinstance(command, Drive) and isinstance(command.twist, Twist))
            or isinstance(command, Hold | Done | GiveUp)
            or (isinstance(command, Serial) and isinstance(command.line, str))
        ):
            raise TypeError(f"robot {self.name}: expected a Drive, Serial, Hold, Done or GiveUp, not {command!r}")
        if not is_finite(command):
            raise ValueError(f"robot {self.name}: expected finite numbers, not {command!r}")
        self._command = command

    @property
    def busy(self) -> bool:
        """Whether the firmware executes a serial command."""
        return self.firmware.busy

    def kidnap(self, pose: SE2) -> None:
        """Put the robot somewhere else, at rest, between two ticks."""
        start = self._base_qpos
        self._qpos[start : start + 2] = pose.x, pose.y
        self._qpos[start + 3 : start + 7] = math.cos(pose.theta / 2), 0.0, 0.0, math.sin(pose.theta / 2)
        self._qvel[self._base_qvel : self._base_qvel + 6] = 0.0
        self._drive.stop_wheels()
        self._cleared = self._posed = -1.0
        mujoco.mj_forward(self._world.model, self._data)

    # -- the truth about it, for the world and for metrics ---------------------------------------------------------------

    def clearance(self) -> float:
        """Distance from the footprint to the nearest obstacle, mover or other robot [m].

        0 where nobody has said how to measure it.
        """
        if self._cleared != self._data.time:  # asked for by the truth and by the next step
            self._cleared = self._data.time
            self._room = self._world.clearance(self.robot.footprint.at(self.pose()))
        return self._room

    def pose(self) -> SE2:
        """world_from_robot, the truth, computed once."""
        self.base_pose()
        return self._planar

    def twist(self) -> Twist:
        """In its own frame, the truth."""
        theta, qvel, first = self.pose().theta, self._qvel.item, self._base_qvel
        return Twist(math.cos(theta) * qvel(first) + math.sin(theta) * qvel(first + 1), qvel(first + 5))

    def base_pose(self) -> BasePose:
        """world_from_base of this instant, computed once."""
        if self._posed != self._data.time:
            self._posed, self._pose = self._data.time, base_pose(self._base())
            self._planar = planar(self._pose)
        return self._pose

    def _base(self) -> Array:
        return self._qpos[self._base_qpos : self._base_qpos + 7]

    # -- what the world calls ----------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Time starts: the robot has sunk into its tyres."""
        setup, world = self._setup, self._world
        self._drive.zero()
        self._posed = -1.0
        for sensor in setup.robot_model.sensors(setup.fit_out, setup.sensors):
            fitting = Fitting(
                mount=sensor.mount,
                model=world.model,
                data=world.data,
                prefix=f"{self.name}/",
                rng=world.streams(f"sensor/{sensor.mount.name}"),
                met_by_rays=world.met_by_rays,
                shown=world.shown,
                base_pose=self.base_pose,
                counts=self._drive.counts,
                pulse=self._drive.pulse,
                at_close=self._closing,
            )
            try:
                read = sensor.kind.reader(fitting, sensor.parameters)
            except KeyError as error:  # MuJoCo's message lists the names that there are
                raise ScenarioError(f"robot {self.name}: sensor {sensor.mount.name!r}: {error.args[0]}") from error
            self._channels[sensor.mount.name] = Channel(sensor.parameters.period, sensor.parameters.delay, read)

    def obey(self, others_move: bool) -> None:
        """Hands the latched command to the firmware, at a step's start."""
        command = self._command
        if isinstance(command, Drive):
            self.firmware.drive(command.twist)
        elif isinstance(command, Serial):
            self.firmware.receive(command.line)
        elif not isinstance(command, Hold):  # done or given up: stand still
            self.firmware.drive(Twist())
        if command.pan is not None and self._pan is not None:
            self._ctrl[self._pan_actuator] = command.pan
        self.contact = False
        self.may_touch = others_move or self.clearance() < _CONTACT_CHECK_DISTANCE
        self.looks_around = self._sweeps and self._pan is not None and command.pan is None

    def drive(self) -> None:
        """One period of the firmware: encoder counts in, voltages out."""
        self.voltages = self._drive.drive(self.firmware.step(*self._drive.counts()))

    def turn_camera(self) -> None:
        """From side to side, as time goes."""
        if self._pan is not None:
            self._ctrl[self._pan_actuator] = _sweep(self._data.time, self._pan)

    def feel(self) -> None:
        """Whether it touches anything now."""
        if not self.contact:
            count = self._data.ncon
            self.contact = count > 0 and bool(np.any(self._data.contact.geom[:count] == self._hull))

    def rest(self) -> None:
        """The step is over, and the command with it."""
        self._command = Hold()

    def close(self) -> None:
        """Gives back the offscreen buffers, and the sensors: they hold the robot that holds them, and its memory with it."""
        self._closing.close()
        self._channels.clear()


def _sweep(time: float, pan: PanSection) -> float:
    """Pan angle of a camera that looks from side to side at constant speed, from the middle to the left first [rad]."""
    phase = (time * pan.sweep_rate / pan.sweep_angle + 1.0) % 4.0
    return pan.sweep_angle * (phase - 1.0 if phase < 2.0 else 3.0 - phase)
