"""Laser scanners."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from robocar.core import RangeSensor, Scan
from robocar.sim.sensors.base_pose import BasePose
from robocar.sim.sensors.rays import RayFan


@dataclass(frozen=True, slots=True)
class LidarParameters:
    """A laser scanner; `dropout` is the share of beams that are lost (nan)."""

    period: float = 0.1
    delay: float = 0.0
    min_range: float = 0.06
    range_std: float = 0.01
    dropout: float = 0.001


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
