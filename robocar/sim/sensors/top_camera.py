"""The camera above the field, which the world holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robocar.core import Image
from robocar.sim.sensors.offscreen import OffscreenCamera
from robocar.sim.sensors.sensor import Fitting, SensorType


@dataclass(frozen=True, slots=True)
class TopCameraParameters:
    """The camera above the field; its size in pixels."""

    period: float = 0.2
    delay: float = 0.0
    width: int = 640
    height: int = 480


def reader(fitting: Fitting, parameters: TopCameraParameters) -> Callable[[float], Image]:
    """Pictures; their pose in the world."""
    name = fitting.mount.element
    camera = OffscreenCamera(fitting.model, fitting.data, name, (parameters.width, parameters.height), fitting.shown)
    fitting.at_close.callback(camera.close)
    return lambda time: camera.read(time, None, None)


SENSOR = SensorType(TopCameraParameters, reader)
