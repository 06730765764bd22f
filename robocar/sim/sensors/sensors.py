"""The car's sensors: each with its own rate, delay, noise and random stream.

A sensor takes a reading when it is due and hands it out after its delay, so an observation may hold readings older than its own
time. Readings are due at multiples of the sensor's period and taken at the first control tick from then on.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import mujoco
import numpy as np
from numba import njit

from robocar.core import SE2, Array, RangeSensor, Reading, Scan, wrap_angle

T = TypeVar("T")

SEEN_BY_RAYS = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
"""Geom groups that range sensors see: the world (0), not the car (1) nor what is only to be looked at (2)."""


@dataclass(frozen=True, slots=True)
class SonarParameters:
    """A 40 kHz ultrasonic ranger.

    Args:
        period, delay: [s]; beam_width: full cone angle [deg]; min_range, max_range: [m].
        range_std: noise [m]; relative_std: noise as a share of the range.
        max_incidence: surfaces seen at a larger angle from their normal send no echo back [deg].
        dropout: share of readings that are lost (nan).
    """

    period: float = 0.05
    delay: float = 0.0
    beam_width: float = 15.0
    min_range: float = 0.02
    max_range: float = 5.0
    range_std: float = 0.004
    relative_std: float = 0.003
    max_incidence: float = 60.0
    dropout: float = 0.005


@dataclass(frozen=True, slots=True)
class LidarParameters:
    """A laser scanner; `dropout` is the share of beams that are lost (nan)."""

    period: float = 0.1
    delay: float = 0.0
    min_range: float = 0.06
    range_std: float = 0.01
    dropout: float = 0.001


@dataclass(frozen=True, slots=True)
class PsdParameters:
    """The infrared distance sensor: 10 to 80 cm (thesis, Table 1.1)."""

    period: float = 0.05
    delay: float = 0.0
    min_range: float = 0.10
    max_range: float = 0.80
    relative_std: float = 0.02


@dataclass(frozen=True, slots=True)
class CompassParameters:
    """Noise and resolution in degrees."""

    period: float = 0.05
    delay: float = 0.0
    std: float = 0.4
    resolution: float = 0.1


@dataclass(frozen=True, slots=True)
class AccelerometerParameters:
    """Two axes; noise in m/s^2."""

    period: float = 0.05
    delay: float = 0.0
    std: float = 0.05


@dataclass(frozen=True, slots=True)
class BumperParameters:
    """Pressed from this force on [N]."""

    period: float = 0.05
    delay: float = 0.0
    threshold: float = 0.5


@dataclass(frozen=True, slots=True)
class CameraParameters:
    """The camera on the pan/tilt head; its size in pixels."""

    period: float = 0.1
    delay: float = 0.0
    width: int = 160
    height: int = 120


@dataclass(frozen=True, slots=True)
class TopCameraParameters:
    """The camera above the field; its size in pixels."""

    period: float = 0.2
    delay: float = 0.0
    width: int = 640
    height: int = 480


@dataclass(frozen=True, slots=True)
class EncoderParameters:
    """Pulse counters: read at every control tick where `period` is 0."""

    period: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True, slots=True)
class SensorParameters:
    """One entry per kind of sensor, as in a scenario's `robot.sensors`."""

    encoder: EncoderParameters = field(default_factory=EncoderParameters)
    sonar: SonarParameters = field(default_factory=SonarParameters)
    lidar: LidarParameters = field(default_factory=LidarParameters)
    psd: PsdParameters = field(default_factory=PsdParameters)
    compass: CompassParameters = field(default_factory=CompassParameters)
    accelerometer: AccelerometerParameters = field(default_factory=AccelerometerParameters)
    bumper: BumperParameters = field(default_factory=BumperParameters)
    camera: CameraParameters = field(default_factory=CameraParameters)
    top_camera: TopCameraParameters = field(default_factory=TopCameraParameters)


class Channel(Generic[T]):
    """Takes readings when they are due and hands each out once, after its delay."""

    def __init__(self, period: float, delay: float, read: Callable[[float], T]) -> None:
        self._period = period
        self._delay = delay
        self._read = read
        self._taken = 0
        self._under_way: deque[tuple[float, T]] = deque()

    def poll(self, time: float) -> T | None:
        """The newest reading that has arrived by `time` [s] and was not handed out yet."""
        # A millionth of the step absorbs the rounding of sums of time steps.
        if time + 1e-9 >= self._taken * self._period:
            self._taken = math.floor((time + 1e-9) / self._period) + 1 if self._period > 0 else self._taken + 1
            self._under_way.append((time + self._delay, self._read(time)))
        newest = None
        while self._under_way and self._under_way[0][0] <= time + 1e-9:
            newest = self._under_way.popleft()[1]
        return newest


@njit(cache=True)
def _first_echo(distances: Array, directions: Array, normals: Array, reach: float, min_cosine: float) -> float:
    """Smallest distance in reach among the rays whose angle of incidence has at least this cosine; inf if there is none."""
    first = math.inf
    for i in range(len(distances)):
        distance = distances[i]
        if 0.0 <= distance <= reach and distance < first:
            cosine = abs(directions[i, 0] * normals[i, 0] + directions[i, 1] * normals[i, 1] + directions[i, 2] * normals[i, 2])
            if cosine >= min_cosine:
                first = distance
    return first


class RayFan:
    """Rays from a point fixed to the car, cast into the world's surfaces."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, origin: Array, directions: Array, reach: float) -> None:
        """`origin` (3,) and unit `directions` (n, 3) in the frame of the car's base."""
        self._model, self._data = model, data
        self._origin = np.asarray(origin, dtype=float)
        self._directions = np.ascontiguousarray(directions, dtype=float)
        self._reach = reach
        count = len(directions)
        self._turned = np.empty((count, 3))
        self._distances = np.empty(count)
        self._geoms = np.empty(count, dtype=np.int32)
        self._normals = np.empty((count, 3))
        self._flat = self._turned.ravel(), self._normals.ravel()  # views
        _first_echo(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), 1.0, 0.0)  # compiled here, not in the control loop

    def _cast(self, position: Array, rotation: Array) -> None:
        np.dot(self._directions, rotation.T, out=self._turned)
        directions, normals = self._flat
        mujoco.mj_multiRay(
            self._model,
            self._data,
            position + rotation @ self._origin,
            directions,
            SEEN_BY_RAYS,
            True,
            -1,
            self._geoms,
            self._distances,
            normals,
            len(self._distances),
            self._reach,
        )

    def cast(self, position: Array, rotation: Array) -> Array:
        """Distances (n,) [m], inf where nothing is in reach.

        Args:
            position, rotation: world_from_base, (3,) [m] and (3, 3).
        """
        self._cast(position, rotation)
        return np.where((self._distances < 0) | (self._distances > self._reach), np.inf, self._distances)

    def first_echo(self, position: Array, rotation: Array, min_cosine: float) -> float:
        """The nearest surface that is not seen at too grazing an angle [m], inf if there is none.

        Args:
            min_cosine: of the angle of incidence, measured from the surface's normal.
        """
        self._cast(position, rotation)
        return float(_first_echo(self._distances, self._turned, self._normals, self._reach, min_cosine))


def cone_rays(beam_width: float) -> Array:
    """Unit vectors (n, 3) that fill a cone around x, about 2 degrees apart sideways and 4 up and down.

    Walls stand upright, so what a cone hears first is a matter of its width; a few rays above and below see low boxes.
    """
    half = beam_width / 2
    rays = []
    for elevation in np.linspace(-half, half, 5)[1:-1]:
        reach = math.sqrt(half**2 - elevation**2)
        for azimuth in np.linspace(-reach, reach, 2 * math.ceil(math.degrees(reach) / 1.9) + 1):
            rays.append(
                (
                    math.cos(elevation) * math.cos(azimuth),
                    math.cos(elevation) * math.sin(azimuth),
                    math.sin(elevation),
                )
            )
    return np.array(rays)


@dataclass(frozen=True, slots=True)
class BasePose:
    """world_from_base of this instant: position (3,), rotation (3, 3)."""

    position: Array
    rotation: Array

    @property
    def heading(self) -> float:
        """[rad]"""
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])


class Sonar:
    """Hears the first echo within its cone; echoes from surfaces at grazing incidence are lost."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        sensor: RangeSensor,
        height: float,
        parameters: SonarParameters,
        rng: np.random.Generator,
    ) -> None:
        self._sensor, self._parameters, self._rng = sensor, parameters, rng
        mount = sensor.robot_from_sensor
        c, s = math.cos(mount.theta), math.sin(mount.theta)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        directions = cone_rays(sensor.beam_width) @ turn.T
        self._fan = RayFan(model, data, np.array([mount.x, mount.y, height]), directions, parameters.max_range)
        self._min_cosine = math.cos(math.radians(parameters.max_incidence))

    def read(self, time: float, pose: BasePose) -> Scan:
        p = self._parameters
        first = self._fan.first_echo(pose.position, pose.rotation, self._min_cosine)
        # The same draws whatever was heard, so that one echo more does not change the noise of all later ones.
        noise, lost = self._rng.standard_normal(), self._rng.random()
        if math.isfinite(first):
            first = first + noise * math.hypot(p.range_std, p.relative_std * first)
            first = max(first, p.min_range) if first <= p.max_range else math.inf
        if lost < p.dropout:
            first = math.nan
        return Scan(
            time,
            np.array([first]),
            self._sensor.bearings,
            p.max_range,
            self._sensor.beam_width,
            self._sensor.robot_from_sensor,
            self._sensor.name,
        )


class Lidar:
    """A laser scanner: thin beams in one plane."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        sensor: RangeSensor,
        height: float,
        parameters: LidarParameters,
        rng: np.random.Generator,
    ) -> None:
        self._sensor, self._parameters, self._rng = sensor, parameters, rng
        mount = sensor.robot_from_sensor
        angles = sensor.bearings + mount.theta
        directions = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
        self._fan = RayFan(model, data, np.array([mount.x, mount.y, height]), directions, sensor.max_range)

    def read(self, time: float, pose: BasePose) -> Scan:
        p, sensor = self._parameters, self._sensor
        ranges = self._fan.cast(pose.position, pose.rotation)
        ranges = ranges + self._rng.normal(0.0, p.range_std, len(ranges))
        ranges = np.where(ranges > sensor.max_range, np.inf, np.maximum(ranges, sensor.min_range))
        ranges[self._rng.random(len(ranges)) < p.dropout] = np.nan
        return Scan(time, ranges, sensor.bearings, sensor.max_range, 0.0, sensor.robot_from_sensor, sensor.name)


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


def base_pose(qpos: Array) -> BasePose:
    """world_from_base from the seven numbers of a free joint."""
    w, x, y, z = qpos[3:7]
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return BasePose(qpos[:3].copy(), rotation)


def planar(pose: BasePose) -> SE2:
    """The pose's shadow on the floor."""
    return SE2(float(pose.position[0]), float(pose.position[1]), pose.heading)
