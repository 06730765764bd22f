"""The infrared distance sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from robocar.core import Array, Reading
from robocar.sim.sensors.base_pose import BasePose
from robocar.sim.sensors.rays import RayFan


@dataclass(frozen=True, slots=True)
class PsdParameters:
    """The infrared distance sensor: 10 to 80 cm (thesis, Table 1.1)."""

    period: float = 0.05
    delay: float = 0.0
    min_range: float = 0.10
    max_range: float = 0.80
    relative_std: float = 0.02


class Psd:
    """The infrared distance sensor ahead: nearest surface on one ray; nan outside 10 to 80 cm."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, origin: Array, parameters: PsdParameters, rng: np.random.Generator
    ) -> None:
        self._fan = RayFan(model, data, origin, np.array([[1.0, 0.0, 0.0]]), parameters.max_range)
        self._parameters, self._rng = parameters, rng

    def read(self, time: float, pose: BasePose) -> Reading[float]:
        p = self._parameters
        distance = self._fan.first_echo(pose.position, pose.rotation, 0.0)
        noisy = distance * (1.0 + p.relative_std * self._rng.standard_normal())
        return Reading(time, noisy if p.min_range <= noisy <= p.max_range else math.nan)
