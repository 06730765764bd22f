"""The wheel encoders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robocar.core import Reading, WheelAngles
from robocar.sim.sensors.base_pose import BasePose


@dataclass(frozen=True, slots=True)
class EncoderParameters:
    """Pulse counters: read at every control tick where `period` is 0."""

    period: float = 0.0
    delay: float = 0.0


class Encoders:
    """Angles of the left and the right wheel in whole pulses [rad].

    Args:
        counts: pulses since the start, left and right, as the firmware counts them.
        pulse: angle of one pulse [rad].
    """

    def __init__(self, counts: Callable[[], tuple[int, int]], pulse: float) -> None:
        self._counts, self._pulse = counts, pulse

    def read(self, time: float, _: BasePose) -> Reading[WheelAngles]:
        left, right = self._counts()
        return Reading(time, WheelAngles(left * self._pulse, right * self._pulse))
