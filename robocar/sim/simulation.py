"""The physics run: a world with the car in it, that senses, acts and knows the truth."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import mujoco
import numpy as np

from robocar.core import (
    SE2,
    Array,
    Command,
    Drive,
    Hold,
    Observation,
    Robot,
    ScenarioError,
    Serial,
    Twist,
)
from robocar.core.randomness import stream
from robocar.core.truth import GroundTruth
from robocar.sim import car
from robocar.sim.firmware import Firmware, FirmwareParameters
from robocar.sim.sensors.accelerometer import Accelerometer
from robocar.sim.sensors.base_pose import BasePose, base_pose, planar
from robocar.sim.sensors.bumper import Bumper
from robocar.sim.sensors.camera import OffscreenCamera
from robocar.sim.sensors.channel import Channel
from robocar.sim.sensors.compass import Compass
from robocar.sim.sensors.encoder import Encoders
from robocar.sim.sensors.lidar import Lidar
from robocar.sim.sensors.parameters import SensorParameters
from robocar.sim.sensors.psd import Psd
from robocar.sim.sensors.sonar import Sonar

World: TypeAlias = mujoco.MjSpec
_WHEELS = ("front_left", "rear_left", "front_right", "rear_right")
_SWEEP_ANGLE, _SWEEP_RATE = 1.3, 1.2  # [rad] to either side, [rad/s]
_CONTACT_CHECK_DISTANCE = 0.05  # [m] nothing nearer at a tick's start: no contact is possible before the next one
_DOUBT = 0.10  # [m] by which a costmap of usual cells and inflation may see an obstacle nearer than it is


@dataclass(frozen=True, slots=True)
class PhysicsParameters:
    """Time steps and how much one car differs from the next.

    Args:
        timestep: of the physics [s]; control_period: between two commands [s], an integer multiple of the firmware's period.
        friction_std, wheel_radius_std: each run draws its own car: spread of the tyres' friction and of the radius of
            each wheel, relative to the nominal values.
    """

    timestep: float = 0.005
    control_period: float = 0.05
    friction_std: float = 0.05
    wheel_radius_std: float = 0.001


class Simulation:
    """A car in a world. One control tick is `sense()`, a decision, `act(command)`."""

    def __init__(
        self,
        world: World,
        *,
        start: SE2,
        seed: int,
        fit_out: car.FitOut | None = None,
        sensors: SensorParameters | None = None,
        physics: PhysicsParameters | None = None,
        firmware: FirmwareParameters | None = None,
        clearance: Callable[[Array], float] | None = None,
        movers: Sequence[Any] = (),
    ) -> None:
        """
        Args:
            world: without the car; it is changed: the car is attached to it.
            start: world_from_robot.
            seed: of all noise and of this car's tolerances.
            clearance: distance [m] from a polygon (n, 2) in the world to the nearest static obstacle (for ground truth).
            movers: moving obstacles of the world, see `robocar.sim.movers`.
        """
        fit_out = fit_out or car.FitOut()
        sensors = sensors or SensorParameters()
        physics = physics or PhysicsParameters()
        firmware = firmware or FirmwareParameters()
        self._seed = seed
        self.control_period = physics.control_period
        self._firmware_steps = _multiple(physics.control_period, firmware.period, "control_period", "the firmware's period")
        self._physics_steps = _multiple(firmware.period, physics.timestep, "the firmware's period", "timestep")

        _set_options(world, physics.timestep)
        frame = world.worldbody.add_frame(pos=[start.x, start.y, 0.0], quat=_quaternion(start.theta))
        world.attach(car.car_spec(fit_out), prefix=car.PREFIX, frame=frame)
        self.model = world.compile()
        self.data = mujoco.MjData(self.model)
        # Views of the state: each look-up of an attribute of `data` costs as much as the number behind it.
        self._qpos, self._qvel, self._ctrl = self.data.qpos, self.data.qvel, self.data.ctrl
        self._draw_tolerances(physics)
        self.robot: Robot = car.describe(fit_out, sensors, self.model)

        base = self.model.joint(car.PREFIX + "base")
        self._base_qpos, self._base_qvel = int(base.qposadr[0]), int(base.dofadr[0])
        wheels = [self.model.joint(f"{car.PREFIX}{name}_wheel") for name in _WHEELS]
        self._wheel_dofs = [int(w.dofadr[0]) for w in wheels]
        self._encoder_qpos = int(wheels[1].qposadr[0]), int(wheels[3].qposadr[0])
        self._encoder_zero = self._encoder_angles()
        motor = self.model.actuator(f"{car.PREFIX}front_left_motor")
        self._volts_per_speed, self._ohms = _motor_constants(self.model, motor.id)
        self._motors = [self.model.actuator(f"{car.PREFIX}{name}_motor").id for name in _WHEELS]
        self._pan = self.model.actuator(car.PREFIX + "pan").id if fit_out.camera else None
        self._sweeps = fit_out.camera_pan == "sweep"
        self._hull = self.model.geom(car.PREFIX + "hull").id
        self._warnings = self.data.warning.number  # a view: looking names up is slow
        self._clearance = clearance
        self._movers = tuple(movers)

        self.firmware = Firmware(
            self.robot.limits,
            self.robot.calibration,
            self.robot.pulses_per_turn,
            self._volts_per_speed,
            car.SUPPLY,
            fit_out.compass,
            firmware,
        )
        self._pulse = math.tau / self.robot.pulses_per_turn
        self._voltages = (0.0, 0.0)
        self._contact = False
        self._cleared, self._room = -1.0, 0.0
        self._hash = hashlib.sha256()
        mujoco.mj_forward(self.model, self.data)
        self._settle()
        self._posed, self._pose = -1.0, base_pose(self._base())
        self._cameras: list[OffscreenCamera] = []
        self._build_sensors(fit_out, sensors)

    # -- the three verbs of the loop ---------------------------------------------------------------------------------

    def sense(self) -> Observation:
        """What is new at this tick."""
        time = self.data.time
        self._look()
        new: dict[str, Any] = {name: channel.poll(time) for name, channel in self._single.items()}
        compass = new.get("compass")
        if compass is not None:
            self.firmware.compass(compass.value)
        bumper = new["bumper"]
        if bumper is not None:
            self.firmware.bumper(bumper.value)
        sonars = tuple(scan for channel in self._sonars if (scan := channel.poll(time)) is not None)
        return Observation(time, sonars=sonars, serial=self.firmware.answers(), **new)

    def act(self, command: Command) -> None:
        """Hand the command to the firmware and let the world go on for one control period."""
        if isinstance(command, Drive):
            self.firmware.drive(command.twist)
        elif isinstance(command, Serial):
            self.firmware.receive(command.line)
        elif not isinstance(command, Hold):  # done or given up: stand still
            self.firmware.drive(Twist())
        if command.pan is not None and self._pan is not None:
            self.data.ctrl[self._pan] = command.pan
        self._contact = False
        near = bool(self._movers) or self.clearance() < _CONTACT_CHECK_DISTANCE
        for _ in range(self._firmware_steps):
            self._voltages = self._limit_currents(self.firmware.step(*self._counts()))
            self._apply(self._voltages)
            for mover in self._movers:
                mover.drive(self.data)
            if self._sweeps and self._pan is not None and command.pan is None:
                self.data.ctrl[self._pan] = _sweep(self.data.time)
            mujoco.mj_step(self.model, self.data, self._physics_steps)
            if near and not self._contact:
                self._contact = self._touching()
        self._update_hash()

    def ground_truth(self) -> GroundTruth:
        """What only metrics and pictures may know."""
        pose = planar(self._look())
        v_world = self.data.qvel[self._base_qvel : self._base_qvel + 2]
        forward = math.cos(pose.theta) * v_world[0] + math.sin(pose.theta) * v_world[1]
        return GroundTruth(
            time=self.data.time,
            pose=pose,
            twist=Twist(float(forward), float(self.data.qvel[self._base_qvel + 5])),
            clearance=self.clearance(),
            movers={mover.name: mover.pose(self.data) for mover in self._movers},
            voltages=self._voltages,
            contact=self._contact,
            mover_velocities={mover.name: mover.velocity(self.data) for mover in self._movers},
        )

    # -- what experiments and scenarios ask for ----------------------------------------------------------------------

    @property
    def time(self) -> float:
        """[s]"""
        return self.data.time

    @property
    def hash(self) -> str:
        """sha256 over (time, qpos, qvel, ctrl) of all control ticks so far."""
        return self._hash.hexdigest()

    @property
    def busy(self) -> bool:
        """Whether the firmware executes a serial command."""
        return self.firmware.busy

    def diverged(self) -> str | None:
        """Why the physics can no longer be believed, or None."""
        if not math.isfinite(self._qpos.sum()):
            return "the state is not finite"
        if self._warnings.any():
            return f"MuJoCo warns: {', '.join(mujoco.mjtWarning(i).name for i in self._warnings.nonzero()[0])}"
        return None

    def clearance(self) -> float:
        """Distance from the footprint to the nearest obstacle or mover [m]; 0 where nobody said how to measure it."""
        if self._cleared != self.data.time:  # asked for by the truth and by the next step
            self._cleared = self.data.time
            corners = self.robot.footprint.at(planar(self._look()))
            self._room = self._clearance(corners) if self._clearance is not None else 0.0
            for mover in self._movers:
                self._room = min(self._room, mover.distance(self.data, corners))
        return self._room

    def mover_at(self, point: Array) -> str | None:
        """Name of a mover that is so near to a point (2,) [m] that a car could not be sure to have room there."""
        room = self.robot.footprint.circumscribed_radius + _DOUBT
        return next((m.name for m in self._movers if m.distance(self.data, np.reshape(point, (1, 2))) < room), None)

    def kidnap(self, pose: SE2) -> None:
        """Put the car somewhere else, at rest, between two ticks."""
        start = self._base_qpos
        self.data.qpos[start : start + 2] = pose.x, pose.y
        self.data.qpos[start + 3 : start + 7] = _quaternion(pose.theta)
        self.data.qvel[self._base_qvel : self._base_qvel + 6] = 0.0
        self.data.qvel[self._wheel_dofs] = 0.0
        self._cleared = self._posed = -1.0
        mujoco.mj_forward(self.model, self.data)

    def close(self) -> None:
        """Give back the offscreen buffers."""
        for camera in self._cameras:
            camera.close()
        self._cameras.clear()

    def _look(self) -> BasePose:
        """The car's pose of this instant, computed once."""
        if self._posed != self.data.time:
            self._posed, self._pose = self.data.time, base_pose(self._base())
        return self._pose

    # -- parts ---------------------------------------------------------------------------------------------------------

    def _base(self) -> Array:
        return self._qpos[self._base_qpos : self._base_qpos + 7]

    def _encoder_angles(self) -> tuple[float, float]:
        left, right = self._encoder_qpos
        return float(self._qpos[left]), float(self._qpos[right])

    def _counts(self) -> tuple[int, int]:
        """Whole pulses since the start."""
        left, right = self._encoder_angles()
        return (
            math.floor((left - self._encoder_zero[0]) / self._pulse),
            math.floor((right - self._encoder_zero[1]) / self._pulse),
        )

    def _limit_currents(self, voltages: tuple[float, float]) -> tuple[float, float]:
        """L298P: the current of a channel, twice (V - back-EMF) / R, stays within its limit."""
        front_left, rear_left, front_right, rear_right = (float(self._qvel[dof]) for dof in self._wheel_dofs)
        left, right = voltages
        return self._limit(left, 0.5 * (front_left + rear_left)), self._limit(right, 0.5 * (front_right + rear_right))

    def _limit(self, voltage: float, speed: float) -> float:
        """The voltage [V] nearest to the asked one that the channel can give at this wheel speed [rad/s]."""
        emf = self._volts_per_speed * speed
        headroom = 0.5 * car.CHANNEL_CURRENT * self._ohms
        return min(max(voltage, emf - headroom, -car.SUPPLY), emf + headroom, car.SUPPLY)

    def _apply(self, voltages: tuple[float, float]) -> None:
        """Both motors of a side hang on one channel."""
        front_left, rear_left, front_right, rear_right = self._motors
        ctrl = self._ctrl
        ctrl[front_left] = ctrl[rear_left] = voltages[0]
        ctrl[front_right] = ctrl[rear_right] = voltages[1]

    def _touching(self) -> bool:
        """Whether the hull touches anything."""
        count = self.data.ncon
        return count > 0 and bool(np.any(self.data.contact.geom[:count] == self._hull))

    def _settle(self) -> None:
        """Let the car sink into its tyres before time starts."""
        for _ in range(round(0.5 / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
        self.data.time = 0.0
        self.data.qvel[:] = 0.0
        self._encoder_zero = self._encoder_angles()

    def _draw_tolerances(self, physics: PhysicsParameters) -> None:
        rng = stream(self._seed, "car/tolerances")
        friction = 1.0 + physics.friction_std * float(np.clip(rng.standard_normal(), -2.5, 2.5))
        for name in _WHEELS:
            geom = self.model.geom(f"{car.PREFIX}{name}_wheel")
            geom.friction[0] *= friction
            scale = 1.0 + physics.wheel_radius_std * float(np.clip(rng.standard_normal(), -2.5, 2.5))
            geom.size[[0, 2]] *= scale

    def _build_sensors(self, fit_out: car.FitOut, sensors: SensorParameters) -> None:
        model, data = self.model, self.data

        def rng(name: str) -> np.random.Generator:
            return stream(self._seed, f"sensor/{name}")

        def height(site: str) -> float:
            return float(model.site(car.PREFIX + site).pos[2])

        def channel(parameters: Any, read: Callable[[float, BasePose], Any]) -> Channel[Any]:
            return Channel(parameters.period, parameters.delay, lambda time: read(time, self._pose))

        self._sonars = []
        for sensor in self.robot.sonars:
            sonar = Sonar(model, data, sensor, height(f"sonar_{sensor.name}"), sensors.sonar, rng(f"sonar/{sensor.name}"))
            self._sonars.append(channel(sensors.sonar, sonar.read))
        psd = Psd(model, data, model.site(car.PREFIX + "psd").pos.copy(), sensors.psd, rng("psd"))
        accelerometer = Accelerometer(data.sensor(car.PREFIX + "accelerometer").data, sensors.accelerometer, rng("accelerometer"))
        bumper = Bumper(data.sensor(car.PREFIX + "bumper").data, sensors.bumper)
        self._single: dict[str, Channel[Any]] = {
            "wheel_angles": channel(sensors.encoder, Encoders(self._counts, self._pulse).read),
            "psd": channel(sensors.psd, psd.read),
            "acceleration": channel(sensors.accelerometer, accelerometer.read),
            "bumper": channel(sensors.bumper, bumper.read),
        }
        if self.robot.lidar is not None:
            lidar = Lidar(model, data, self.robot.lidar, height("lidar"), sensors.lidar, rng("lidar"))
            self._single["lidar"] = channel(sensors.lidar, lidar.read)
        if fit_out.compass:
            self._single["compass"] = channel(sensors.compass, Compass(sensors.compass, rng("compass")).read)
        if fit_out.camera:
            camera = OffscreenCamera(model, data, car.PREFIX + "camera", sensors.camera.width, sensors.camera.height)
            self._cameras.append(camera)
            self._single["image"] = channel(sensors.camera, lambda time, pose: camera.read(time, pose.position, pose.rotation))
        if fit_out.top_camera:
            top = OffscreenCamera(model, data, "top", sensors.top_camera.width, sensors.top_camera.height)
            self._cameras.append(top)
            self._single["top_image"] = channel(sensors.top_camera, lambda time, _: top.read(time, None, None))

    def _update_hash(self) -> None:
        self._hash.update(np.float64(self.data.time).tobytes())
        for values in (self._qpos, self._qvel, self._ctrl):
            self._hash.update(values.tobytes())


def _set_options(world: mujoco.MjSpec, timestep: float) -> None:
    """Solver settings that the car's tyres were modelled with (models/robots/robocar/README.md)."""
    world.option.timestep = timestep
    world.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    world.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # Softer across the contact than into it: tyres creep under load instead of sticking and slipping in turns.
    world.option.impratio = 0.1


def _sweep(time: float) -> float:
    """Pan angle of a camera that looks from side to side at constant speed, from the middle to the left first [rad]."""
    phase = (time * _SWEEP_RATE / _SWEEP_ANGLE + 1.0) % 4.0
    return _SWEEP_ANGLE * (phase - 1.0 if phase < 2.0 else 3.0 - phase)


def _motor_constants(model: mujoco.MjModel, actuator: int) -> tuple[float, float]:
    """Back-EMF of the wheel [V s/rad] and winding resistance [Ohm]: the compiled `dcmotor` keeps (R, K) in its gain."""
    ohms, constant = (float(value) for value in model.actuator_gainprm[actuator, :2])
    return constant * float(model.actuator_gear[actuator, 0]), ohms


def _quaternion(theta: float) -> list[float]:
    return [math.cos(theta / 2), 0.0, 0.0, math.sin(theta / 2)]


def _multiple(whole: float, part: float, whole_name: str, part_name: str) -> int:
    count = round(whole / part) if part > 0 else 0
    if count < 1 or abs(count * part - whole) > 1e-9:
        raise ScenarioError(f"{whole_name} ({whole} s) must be an integer multiple of {part_name} ({part} s)")
    return count
