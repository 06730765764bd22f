"""The bumper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from robocar.core import Reading
from robocar.sim.sensors.sensor import Fitting, SensorType


@dataclass(frozen=True, slots=True)
class BumperParameters:
    """Pressed from this force on [N]."""

    period: float = 0.05
    delay: float = 0.0
    threshold: float = 0.5


def reader(fitting: Fitting, parameters: BumperParameters) -> Callable[[float], Reading[bool]]:
    """Whether it is pressed."""
    force, threshold = fitting.sensor_data(), parameters.threshold
    return lambda time: Reading(time, bool(force[0] > threshold))


SENSOR = SensorType(BumperParameters, reader, element=mujoco.mjtSensor.mjSENS_TOUCH, firmware_input="bumper")
