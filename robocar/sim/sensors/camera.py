"""The camera on a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robocar.core import Image
from robocar.sim.sensors.offscreen import OffscreenCamera
from robocar.sim.sensors.sensor import Fitting, SensorType


@dataclass(frozen=True, slots=True)
class CameraParameters:
    """The camera on the pan/tilt head; its size in pixels."""

    period: float = 0.1
    delay: float = 0.0
    width: int = 160
    height: int = 120


def reader(fitting: Fitting, parameters: CameraParameters) -> Callable[[float], Image]:
    """Pictures; their pose relative to the robot's base."""
    name = fitting.prefix + fitting.mount.element
    camera = OffscreenCamera(fitting.model, fitting.data, name, (parameters.width, parameters.height), fitting.shown)
    fitting.at_close.callback(camera.close)

    def read(time: float) -> Image:
        base = fitting.base_pose()
        return camera.read(time, base.position, base.rotation)

    return read


SENSOR = SensorType(CameraParameters, reader)
