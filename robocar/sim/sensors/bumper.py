"""The bumper."""

from __future__ import annotations

from dataclasses import dataclass

from robocar.core import Array, Reading
from robocar.sim.sensors.base_pose import BasePose


@dataclass(frozen=True, slots=True)
class BumperParameters:
    """Pressed from this force on [N]."""

    period: float = 0.05
    delay: float = 0.0
    threshold: float = 0.5


class Bumper:
    """Whether it is pressed; `sensor` is MuJoCo's view of the touch sensor's number."""

    def __init__(self, sensor: Array, parameters: BumperParameters) -> None:
        self._sensor, self._threshold = sensor, parameters.threshold

    def read(self, time: float, _: BasePose) -> Reading[bool]:
        return Reading(time, bool(self._sensor[0] > self._threshold))
