"""A skid-steered drive: the wheels of a side turn alike, their motors hang on one channel."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np

from robocar.sim.physics import PhysicsParameters
from robocar.sim.robot_file import DriveSection


class _Channel(NamedTuple):
    """One side: places of its wheels in `qvel`, of its motors in `ctrl`, of its encoder in `qpos`, and by how much
    the voltage may differ from the back-EMF [V]."""

    dofs: tuple[int, ...]
    motors: tuple[int, ...]
    encoder: int
    headroom: float


class DriveTrain:
    """Wheels, motors and encoders of one robot in a compiled world.

    Args:
        model: of the world.
        data: of the world.
        prefix: of the robot's names.
        drive: as in `robot.yaml`.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, prefix: str, drive: DriveSection) -> None:
        self._model, self._prefix, self._drive = model, prefix, drive
        # Views of the state: each look-up of an attribute of `data` costs as much as the number behind it.
        self._qpos, self._qvel, self._ctrl = data.qpos, data.qvel, data.ctrl
        sides = drive.left, drive.right
        motors = [[model.actuator(prefix + motor).id for motor in side.motors] for side in sides]
        # The compiled `dcmotor` keeps (R, K) in its gain: winding resistance [Ohm], and back-EMF of the rotor [V s/rad].
        ohms, constant = (float(value) for value in model.actuator_gainprm[motors[0][0], :2])
        self.volts_per_speed = constant * float(model.actuator_gear[motors[0][0], 0])
        """Back-EMF of a wheel [V s/rad]."""
        self._left, self._right = (
            _Channel(
                tuple(int(model.joint(prefix + wheel).dofadr[0]) for wheel in side.wheels),
                tuple(own),
                int(model.joint(prefix + side.encoder).qposadr[0]),
                drive.motor.channel_current / len(own) * ohms,
            )
            for side, own in zip(sides, motors, strict=True)
        )
        self._supply = drive.motor.supply
        self.pulse = math.tau / drive.pulses_per_turn
        self.zero()

    def zero(self) -> None:
        """Counts pulses from here."""
        self._start = self._qpos.item(self._left.encoder), self._qpos.item(self._right.encoder)

    def counts(self) -> tuple[int, int]:
        """Whole pulses since the start, left and right."""
        angle, start = self._qpos.item, self._start
        return (
            math.floor((angle(self._left.encoder) - start[0]) / self.pulse),
            math.floor((angle(self._right.encoder) - start[1]) / self.pulse),
        )

    def drive(self, voltages: tuple[float, float]) -> tuple[float, float]:
        """Puts voltages [V] on the left and the right channel, as far as the channels can give them, and returns these."""
        left, right = self._limited(self._left, voltages[0]), self._limited(self._right, voltages[1])
        ctrl = self._ctrl
        for motor in self._left.motors:
            ctrl[motor] = left
        for motor in self._right.motors:
            ctrl[motor] = right
        return left, right

    def stop_wheels(self) -> None:
        """They turn no more."""
        self._qvel[[*self._left.dofs, *self._right.dofs]] = 0.0

    def draw_tolerances(self, physics: PhysicsParameters, rng: np.random.Generator) -> None:
        """This robot's own tyres: their friction, and the radius of each wheel (an ellipsoid)."""
        friction = 1.0 + physics.friction_std * float(np.clip(rng.standard_normal(), -2.5, 2.5))
        for wheel in (*self._drive.left.wheels, *self._drive.right.wheels):
            geom = self._model.geom(self._prefix + wheel)
            geom.friction[0] *= friction
            geom.size[[0, 2]] *= 1.0 + physics.wheel_radius_std * float(np.clip(rng.standard_normal(), -2.5, 2.5))

    def _limited(self, channel: _Channel, voltage: float) -> float:
        """The voltage [V] nearest to the asked one that a channel can give at its wheels' speed.

        The current of a channel, n (V - back-EMF) / R for n motors, stays within its limit.
        """
        speed, qvel = 0.0, self._qvel.item
        for dof in channel.dofs:
            speed += qvel(dof)
        emf = self.volts_per_speed * (speed / len(channel.dofs))
        supply, headroom = self._supply, channel.headroom
        return min(max(voltage, emf - headroom, -supply), emf + headroom, supply)
