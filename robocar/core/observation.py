"""What the robot senses: one `Observation` per control tick, holding only what is new, every reading with its own time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from robocar.core.geometry import SE2, Array, Twist, frozen_array

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Reading(Generic[T]):
    """A value and when it was measured [s]."""

    time: float
    value: T


@dataclass(frozen=True, slots=True)
class WheelAngles:
    """Angles turned since the start by the left and the right encoder wheel [rad], in whole pulses."""

    left: float
    right: float


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Ranges along beams of one sensor: a laser, or a sonar with a single wide beam.

    Args:
        time: when it was measured [s].
        ranges: (n,) [m]; inf: nothing heard within range (no surface, or an echo lost at grazing incidence: the robot cannot tell
            them apart); nan: reading dropped.
        bearings: directions of the beams in the sensor's frame, (n,) [rad].
        max_range: largest range it can report [m].
        beam_width: full opening angle of a beam, 0 for a laser [rad].
        robot_from_sensor: where it is mounted.
        name: the sensor's name, e.g. `front_left`.
    """

    time: float
    ranges: Array
    bearings: Array
    max_range: float
    beam_width: float = 0.0
    robot_from_sensor: SE2 = SE2()
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "ranges", frozen_array(self.ranges))
        object.__setattr__(self, "bearings", frozen_array(self.bearings))
        if self.ranges.shape != self.bearings.shape or self.ranges.ndim != 1:
            raise ValueError(f"{self.ranges.shape} ranges for {self.bearings.shape} bearings")
        if not self.max_range > 0:
            raise ValueError(f"max_range must be positive, not {self.max_range}")


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """A picture, (height, width, 3) uint8 RGB, with its pinhole intrinsics (3, 3) [px] and robot_from_camera (4, 4).

    The camera's frame is OpenCV's: x right, y down, z ahead. A camera that is not on the robot (the top camera) has
    world_from_camera in `robot_from_camera`'s place.
    """

    time: float
    pixels: NDArray[np.uint8]
    intrinsics: Array
    robot_from_camera: Array


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """A landmark seen at `bearing` [rad] and `range` [m] in the robot's frame, covariance (2, 2) of (bearing, range)."""

    time: float
    landmark: str
    bearing: float
    range: float
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What is new this tick; what is not, is None or empty.

    Odometry comes as wheel angles (the car), as a twist (MRCLAM) or as a pose (CARMEN).

    Args:
        time: of the tick [s].
        wheel_angles: of the encoders.
        twist: measured or commanded velocity.
        odom_pose: world_from_robot up to drift.
        sonars: one single-beam scan per sonar that has fired.
        lidar: a laser scan.
        psd: range of the infrared distance sensor ahead [m].
        compass: heading in the map frame [rad].
        acceleration: along the robot's x and y (2,) [m/s^2].
        bumper: whether the bumper is pressed.
        image: from the car's camera; top_image: from the camera above the field.
        landmarks: detections from logs and ideal sensors; from images the estimator makes them itself.
        serial: lines that the firmware answered.
    """

    time: float
    wheel_angles: Reading[WheelAngles] | None = None
    twist: Reading[Twist] | None = None
    odom_pose: Reading[SE2] | None = None
    sonars: tuple[Scan, ...] = ()
    lidar: Scan | None = None
    psd: Reading[float] | None = None
    compass: Reading[float] | None = None
    acceleration: Reading[Array] | None = None
    bumper: Reading[bool] | None = None
    image: Image | None = None
    top_image: Image | None = None
    landmarks: tuple[Detection, ...] = ()
    serial: tuple[str, ...] = ()

    @property
    def scans(self) -> tuple[Scan, ...]:
        """All range readings of this tick, laser first."""
        return ((self.lidar,) if self.lidar is not None else ()) + self.sonars
