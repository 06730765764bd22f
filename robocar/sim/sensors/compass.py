"""The compass."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import Reading, wrap_angle
from robocar.sim.sensors.base_pose import BasePose


@dataclass(frozen=True, slots=True)
class CompassParameters:
    """Noise and resolution in degrees."""

    period: float = 0.05
    delay: float = 0.0
    std: float = 0.4
    resolution: float = 0.1


class Compass:
    """Heading in the map frame."""

    def __init__(self, parameters: CompassParameters, rng: np.random.Generator) -> None:
        self._std = math.radians(parameters.std)
        self._step = math.radians(parameters.resolution)
        self._rng = rng

    def read(self, time: float, pose: BasePose) -> Reading[float]:
        heading = pose.heading + self._std * self._rng.standard_normal()
        if self._step > 0:
            heading = self._step * round(heading / self._step)
        return Reading(time, wrap_angle(heading))
