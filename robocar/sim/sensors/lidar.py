"""Laser scanners."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robocar.core import RangeSensor, Scan
from robocar.sim.sensors.rays import RayFan
from robocar.sim.sensors.sensor import Fitting, Mount, SensorType


@dataclass(frozen=True, slots=True)
class LidarParameters:
    """A laser scanner: thin beams in one plane.

    Args:
        period: [s].
        delay: [s].
        opening: angle between its outermost beams; from 360 on they go all around [deg].
        beams: how many.
        min_range: what is nearer is seen here [m].
        max_range: [m].
        range_std: noise [m].
        dropout: share of beams that are lost (nan).
    """

    period: float = 0.1
    delay: float = 0.0
    opening: float = 360.0
    beams: int = 360
    min_range: float = 0.06
    max_range: float = 6.0
    range_std: float = 0.01
    dropout: float = 0.001


def geometry(mount: Mount, parameters: LidarParameters) -> RangeSensor:
    """Its beams from right to left, the middle one ahead."""
    opening = math.radians(parameters.opening)
    bearings = np.linspace(-opening / 2, opening / 2, parameters.beams, endpoint=parameters.opening < 360.0)
    p = parameters
    return RangeSensor(mount.label, mount.robot_from_sensor, bearings, 0.0, p.min_range, p.max_range, p.period)


def reader(fitting: Fitting, parameters: LidarParameters) -> Callable[[float], Scan]:
    """One scan; farther than `max_range` is inf."""
    p, rng, mount = parameters, fitting.rng, fitting.mount.robot_from_sensor
    bearings = geometry(fitting.mount, p).bearings
    angles = bearings + mount.theta
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    fan = RayFan(fitting, directions, p.max_range)

    def read(time: float) -> Scan:
        ranges = fan.cast()
        ranges = ranges + rng.normal(0.0, p.range_std, len(ranges))
        ranges = np.where(ranges > p.max_range, np.inf, np.maximum(ranges, p.min_range))
        ranges[rng.random(len(ranges)) < p.dropout] = np.nan
        return Scan(time, ranges, bearings, p.max_range, 0.0, mount, fitting.mount.label)

    return read


SENSOR = SensorType(LidarParameters, reader, geometry)
