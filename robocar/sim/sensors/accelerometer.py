"""The accelerometer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robocar.core import Array, Reading
from robocar.sim.sensors.base_pose import BasePose


@dataclass(frozen=True, slots=True)
class AccelerometerParameters:
    """Two axes; noise in m/s^2."""

    period: float = 0.05
    delay: float = 0.0
    std: float = 0.05


class Accelerometer:
    """Acceleration forward and to the left [m/s^2]; `sensor` is MuJoCo's view of the sensor's three numbers."""

    def __init__(self, sensor: Array, parameters: AccelerometerParameters, rng: np.random.Generator) -> None:
        self._sensor, self._std, self._rng = sensor, parameters.std, rng

    def read(self, time: float, _: BasePose) -> Reading[Array]:
        return Reading(time, self._sensor[:2] + self._std * self._rng.standard_normal(2))
