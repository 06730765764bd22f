"""The infrared distance sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robocar.core import Reading
from robocar.sim.sensors.rays import RayFan
from robocar.sim.sensors.sensor import Fitting, SensorType


@dataclass(frozen=True, slots=True)
class PsdParameters:
    """The infrared distance sensor: 10 to 80 cm (thesis, Table 1.1)."""

    period: float = 0.05
    delay: float = 0.0
    min_range: float = 0.10
    max_range: float = 0.80
    relative_std: float = 0.02


def reader(fitting: Fitting, parameters: PsdParameters) -> Callable[[float], Reading[float]]:
    """Nearest surface on one ray ahead; nan outside 10 to 80 cm."""
    p, rng = parameters, fitting.rng
    fan = RayFan(fitting, np.array([[1.0, 0.0, 0.0]]), p.max_range)

    def read(time: float) -> Reading[float]:
        noisy = fan.first_echo(0.0) * (1.0 + p.relative_std * rng.standard_normal())
        return Reading(time, noisy if p.min_range <= noisy <= p.max_range else math.nan)

    return read


SENSOR = SensorType(PsdParameters, reader)
