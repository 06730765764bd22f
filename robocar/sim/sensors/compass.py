"""The compass."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from robocar.core import Reading, wrap_angle
from robocar.sim.sensors.sensor import Fitting, SensorType


@dataclass(frozen=True, slots=True)
class CompassParameters:
    """Noise and resolution in degrees."""

    period: float = 0.05
    delay: float = 0.0
    std: float = 0.4
    resolution: float = 0.1


def reader(fitting: Fitting, parameters: CompassParameters) -> Callable[[float], Reading[float]]:
    """Heading in the map frame."""
    std, step = math.radians(parameters.std), math.radians(parameters.resolution)

    def read(time: float) -> Reading[float]:
        heading = fitting.base_pose().heading + std * fitting.rng.standard_normal()
        if step > 0:
            heading = step * round(heading / step)
        return Reading(time, wrap_angle(heading))

    return read


SENSOR = SensorType(CompassParameters, reader, firmware_input="compass")
