"""The accelerometer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from robocar.core import Array, Reading
from robocar.sim.sensors.sensor import Fitting, SensorType


@dataclass(frozen=True, slots=True)
class AccelerometerParameters:
    """Two axes; noise in m/s^2."""

    period: float = 0.05
    delay: float = 0.0
    std: float = 0.05


def reader(fitting: Fitting, parameters: AccelerometerParameters) -> Callable[[float], Reading[Array]]:
    """Acceleration forward and to the left [m/s^2]."""
    measured, std, rng = fitting.sensor_data(), parameters.std, fitting.rng
    return lambda time: Reading(time, measured[:2] + std * rng.standard_normal(2))


SENSOR = SensorType(AccelerometerParameters, reader, element=mujoco.mjtSensor.mjSENS_ACCELEROMETER)
