"""The wheel encoders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robocar.core import Reading, WheelAngles
from robocar.sim.sensors.sensor import Fitting, SensorType


@dataclass(frozen=True, slots=True)
class EncoderParameters:
    """Pulse counters: read at every control tick where `period` is 0."""

    period: float = 0.0
    delay: float = 0.0


def reader(fitting: Fitting, _: EncoderParameters) -> Callable[[float], Reading[WheelAngles]]:
    """Angles of the left and the right wheel in whole pulses [rad], as the firmware counts them."""

    def read(time: float) -> Reading[WheelAngles]:
        left, right = fitting.counts()
        return Reading(time, WheelAngles(left * fitting.pulse, right * fitting.pulse))

    return read


SENSOR = SensorType(EncoderParameters, reader)
