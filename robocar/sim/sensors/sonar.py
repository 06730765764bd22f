"""Ultrasonic rangers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robocar.core import Array, RangeSensor, Scan
from robocar.sim.sensors.rays import RayFan
from robocar.sim.sensors.sensor import Fitting, Mount, SensorType


@dataclass(frozen=True, slots=True)
class SonarParameters:
    """A 40 kHz ultrasonic ranger.

    Args:
        period: [s].
        delay: [s].
        beam_width: full cone angle [deg].
        min_range: [m].
        max_range: [m].
        range_std: noise [m].
        relative_std: noise as a share of the range.
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


def geometry(mount: Mount, parameters: SonarParameters) -> RangeSensor:
    """Its one beam."""
    p = parameters
    return RangeSensor(
        mount.label, mount.robot_from_sensor, np.zeros(1), math.radians(p.beam_width), p.min_range, p.max_range, p.period
    )


def reader(fitting: Fitting, parameters: SonarParameters) -> Callable[[float], Scan]:
    """Hears the first echo within its cone; echoes from surfaces at grazing incidence are lost."""
    p, rng = parameters, fitting.rng
    sensor = geometry(fitting.mount, p)
    mount = sensor.robot_from_sensor
    c, s = math.cos(mount.theta), math.sin(mount.theta)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    fan = RayFan(fitting, cone_rays(sensor.beam_width) @ turn.T, p.max_range)
    min_cosine = math.cos(math.radians(p.max_incidence))

    def read(time: float) -> Scan:
        first = fan.first_echo(min_cosine)
        # The same draws whatever was heard, so that one echo more does not change the noise of all later ones.
        noise, lost = rng.standard_normal(), rng.random()
        if math.isfinite(first):
            first = first + noise * math.hypot(p.range_std, p.relative_std * first)
            first = max(first, p.min_range) if first <= p.max_range else math.inf
        if lost < p.dropout:
            first = math.nan
        return Scan(time, np.array([first]), sensor.bearings, p.max_range, sensor.beam_width, mount, sensor.name)

    return read


SENSOR = SensorType(SonarParameters, reader, geometry)
