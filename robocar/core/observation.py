"""What the robot senses: one `Observation` per control tick, holding only what is new, every reading with its own time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from types import MappingProxyType
from typing import Any, Generic, TypedDict, TypeVar, Unpack

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
    """A landmark seen at `bearing` [rad] and `range` [m] in the robot's frame.

    Args:
        covariance: of (bearing, range), (2, 2); its range is that of readings that are too long.
        short_tail: standard deviation of ranges that are too short over that of ranges that are too long: the range's error
            has a split normal distribution, 1 is the normal one.
    """

    time: float
    landmark: str
    bearing: float
    range: float
    covariance: Array
    short_tail: float = 1.0

    def __post_init__(self) -> None:
        if not (isfinite(self.short_tail) and self.short_tail > 0):
            raise ValueError(f"short_tail must be a finite number above 0, not {self.short_tail}")


class UsualReadings(TypedDict, total=False):
    """Readings by the names of `Observation`'s properties; None and () are nothing new."""

    wheel_angles: Reading[WheelAngles] | None
    twist: Reading[Twist] | None
    odom_pose: Reading[SE2] | None
    sonars: tuple[Scan, ...]
    lidar: Scan | None
    psd: Reading[float] | None
    compass: Reading[float] | None
    acceleration: Reading[Array] | None
    bumper: Reading[bool] | None
    image: Image | None
    top_image: Image | None
    landmarks: tuple[Detection, ...]
    serial: tuple[str, ...]


_SENSOR_OF = {
    "wheel_angles": "encoder",
    "acceleration": "accelerometer",
    "image": "camera",
    "top_image": "top_camera",
}
USUAL_SENSORS = frozenset(_SENSOR_OF.get(name, name) for name in UsualReadings.__annotations__ if name != "sonars")
"""Names of the sensors that have a property of their own."""


class Observation:
    """What is new this tick, by the sensors' names; what is not new, is not there.

    The usual sensors also have a property each, which says None or () where there is nothing new. Odometry comes as wheel angles
    (the car), as a twist (MRCLAM) or as a pose (CARMEN). An observation does not change.

    Args:
        time: of the tick [s].
        readings: by the sensor's name: a `Reading`, a `Scan`, an `Image`, a tuple of `Detection` or a tuple of lines.
        usual: the same by the names of the properties: `Observation(0.0, lidar=scan, sonars=(left, right))`.

    Raises:
        TypeError: what is given is no reading.
        ValueError: two sonars of one name, or a time that is not finite.
    """

    __slots__ = ("_lidars", "_readings", "_sonars", "_time")

    def __init__(self, time: float, readings: Mapping[str, Any] | None = None, **usual: Unpack[UsualReadings]) -> None:
        if not isfinite(time):
            raise ValueError(f"an observation needs a finite time, not {time}")
        given = {} if readings is None else dict(readings)
        for name, reading in usual.items():
            if name == "sonars":
                given.update(_by_name(usual.get("sonars", ())))
            else:
                given[_SENSOR_OF.get(name, name)] = reading
        new: dict[str, Any] = {}
        lidars, sonars = [], []
        for name, reading in given.items():
            if reading is None or (reading.__class__ is tuple and not reading):
                continue
            new[name] = reading
            if isinstance(reading, Scan):
                (lidars if reading.beam_width == 0.0 else sonars).append(reading)
            if not (isinstance(reading, _TIMED) and isfinite(reading.time)):
                _check_others(name, reading)
        self._time = time
        self._readings = MappingProxyType(new)
        self._lidars, self._sonars = tuple(lidars), tuple(sonars)

    def __repr__(self) -> str:
        return f"Observation({self._time!r}, {dict(self._readings)!r})"

    def __reduce__(self) -> tuple[type[Observation], tuple[float, dict[str, Any]]]:
        return Observation, (self._time, dict(self._readings))

    def with_readings(self, changes: Mapping[str, Any]) -> Observation:
        """The same but for these sensors, by name; None or () takes a reading away."""
        return Observation(self._time, {**self._readings, **changes})

    @property
    def time(self) -> float:
        """Of the tick [s]."""
        return self._time

    @property
    def readings(self) -> Mapping[str, Any]:
        """All that is new, by the sensor's name; it cannot be written to."""
        return self._readings

    @property
    def wheel_angles(self) -> Reading[WheelAngles] | None:
        """Of the encoders."""
        return self._readings.get("encoder")

    @property
    def twist(self) -> Reading[Twist] | None:
        """Measured or commanded velocity."""
        return self._readings.get("twist")

    @property
    def odom_pose(self) -> Reading[SE2] | None:
        """world_from_robot up to drift."""
        return self._readings.get("odom_pose")

    @property
    def sonars(self) -> tuple[Scan, ...]:
        """One scan of a wide beam per sonar that has fired."""
        return self._sonars

    @property
    def lidars(self) -> tuple[Scan, ...]:
        """One scan per laser: those whose beams have no width."""
        return self._lidars

    @property
    def lidar(self) -> Scan | None:
        """The scan of the first laser."""
        return self._lidars[0] if self._lidars else None

    @property
    def scans(self) -> tuple[Scan, ...]:
        """All range scans of this tick, lasers first."""
        return self._lidars + self._sonars

    @property
    def psd(self) -> Reading[float] | None:
        """Range of the infrared distance sensor ahead [m]."""
        return self._readings.get("psd")

    @property
    def compass(self) -> Reading[float] | None:
        """Heading in the map frame [rad]."""
        return self._readings.get("compass")

    @property
    def acceleration(self) -> Reading[Array] | None:
        """Along the robot's x and y (2,) [m/s^2]."""
        return self._readings.get("accelerometer")

    @property
    def bumper(self) -> Reading[bool] | None:
        """Whether the bumper is pressed."""
        return self._readings.get("bumper")

    @property
    def image(self) -> Image | None:
        """From the car's camera."""
        return self._readings.get("camera")

    @property
    def top_image(self) -> Image | None:
        """From the camera above the field."""
        return self._readings.get("top_camera")

    @property
    def landmarks(self) -> tuple[Detection, ...]:
        """Detections from logs and ideal sensors; from images the estimator makes them itself."""
        return self._readings.get("landmarks", ())

    @property
    def serial(self) -> tuple[str, ...]:
        """Lines that the firmware answered."""
        return self._readings.get("serial", ())


_TIMED = (Reading, Scan, Image)


def _check_others(name: str, reading: Any) -> None:
    """It has a finite time, unless it is a tuple of such detections or of lines."""
    several = reading if isinstance(reading, tuple) else ()
    if several and all(isinstance(line, str) for line in several):
        return
    if not (isinstance(reading, _TIMED) or (several and all(isinstance(one, Detection) for one in several))):
        raise TypeError(f"{name}: expected a Reading, a Scan, an Image, a tuple of Detection or of lines, not {reading!r}")
    timed: tuple[Any, ...] = several or (reading,)
    for one in timed:
        if not isfinite(one.time):
            raise ValueError(f"{name}: a reading needs a finite time, not {one.time}")


def _by_name(sonars: tuple[Scan, ...]) -> dict[str, Scan]:
    """Sonars by the names of their sensors; those without a name by their number."""
    if not (isinstance(sonars, tuple | list) and all(isinstance(scan, Scan) for scan in sonars)):
        raise TypeError(f"sonars: expected a tuple of Scan, not {sonars!r}")
    named = {f"sonar/{scan.name or k}": scan for k, scan in enumerate(sonars)}
    if len(named) < len(sonars):
        raise ValueError(f"sonars need different names, not {[scan.name for scan in sonars]}")
    return named
