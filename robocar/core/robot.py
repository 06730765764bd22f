"""What an algorithm may know about the machine that it drives."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np

from robocar.core.errors import ParameterError
from robocar.core.footprint import Footprint
from robocar.core.geometry import SE2, Array, frozen_array
from robocar.core.grid import OccupancyGrid

P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class Limits:
    """Speeds [m/s, rad/s] and accelerations [m/s^2, rad/s^2] that the car keeps, with Nav2's names."""

    min_vel_x: float
    max_vel_x: float
    max_vel_theta: float
    acc_lim_x: float
    acc_lim_theta: float


@dataclass(frozen=True, slots=True)
class RangeSensor:
    """Geometry of a fitted sonar or laser.

    Args:
        bearings: of the beams in the sensor's frame, (n,) [rad].
        beam_width: full opening angle, 0 for a laser [rad].
        min_range, max_range: [m].
        period: between readings [s].
    """

    name: str
    robot_from_sensor: SE2
    bearings: Array
    beam_width: float
    min_range: float
    max_range: float
    period: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "bearings", frozen_array(self.bearings))


@dataclass(frozen=True, slots=True)
class Calibration:
    """What the experiment `odometry_calibration` identifies.

    The wheels of a skid-steered car slip sideways: its effective track is wider than its geometric one and depends on how
    tightly it turns, so it is a function of the curvature omega / v. Positions in between are interpolated, those beyond are
    held.

    Args:
        wheel_radius: effective rolling radius [m].
        curvature: |omega| / v with v > 0, ascending, (n,) [1/m]; the last entry stands for turning on the spot.
        track: effective track at these curvatures, (n,) [m].
    """

    wheel_radius: float
    curvature: Array
    track: Array

    def effective_track(self, v: float, omega: float) -> float:
        """Effective track for this twist [m]; on the spot and at rest that of turning on the spot."""
        curvature, track = self.curvature, self.track
        if omega == 0.0 or abs(omega) >= curvature[-1] * abs(v):
            return float(track[-1])
        tightness = abs(omega / v)
        if tightness <= curvature[0]:
            return float(track[0])
        i = int(curvature.searchsorted(tightness))
        share = (tightness - curvature[i - 1]) / (curvature[i] - curvature[i - 1])
        return float(track[i - 1] + share * (track[i] - track[i - 1]))


@dataclass(frozen=True, slots=True)
class Robot:
    """Everything that planners and estimators are told about the car."""

    footprint: Footprint
    limits: Limits
    calibration: Calibration
    pulses_per_turn: int
    sonars: tuple[RangeSensor, ...] = ()
    lidar: RangeSensor | None = None
    compass: bool = False
    camera: bool = False
    top_camera: bool = False


@dataclass(frozen=True, slots=True)
class Landmark:
    """A coloured ball at `position` (3,) [m]."""

    name: str
    color: str
    position: Array
    radius: float


@dataclass(frozen=True, slots=True)
class Context:
    """What every factory `build(context)` gets.

    Args:
        robot: the machine.
        prior: the map that the robot is given, or None.
        start: the pose that the robot is told it starts from, or None (global localization).
        landmarks: the balls that it is told of.
        parameters: flat overrides by name; each component picks its own (`parameters_of`).
        rng: the component's own random stream.
        control_period: time between two commands [s].
    """

    robot: Robot
    prior: OccupancyGrid | None
    start: SE2 | None
    landmarks: tuple[Landmark, ...]
    parameters: dict[str, Any]
    rng: np.random.Generator
    control_period: float

    def parameters_of(self, cls: type[P]) -> P:
        """The dataclass of parameters `cls` with the overrides that carry its fields' names.

        Raises:
            ParameterError: a value has the wrong type, or the dataclass refuses it.
        """
        chosen = {}
        for f in fields(cls):  # type: ignore[arg-type]
            if f.name in self.parameters:
                chosen[f.name] = _as_type_of(f.default, self.parameters[f.name], f.name)
        try:
            return cls(**chosen)
        except ValueError as error:
            raise ParameterError(f"{cls.__module__}: {error}") from error


def _as_type_of(default: Any, value: Any, name: str) -> Any:
    """`value` as the type of a parameter's default: 1 is a fine float, "fast" is not."""
    if isinstance(default, bool):
        good = isinstance(value, bool)
    elif isinstance(default, float):
        good = isinstance(value, int | float) and not isinstance(value, bool)
        value = float(value) if good else value
    elif isinstance(default, int):
        good = isinstance(value, int) and not isinstance(value, bool)
    elif isinstance(default, str):
        good = isinstance(value, str)
    else:
        good = True
    if not good:
        raise ParameterError(f"parameter {name} takes a {type(default).__name__} (default {default!r}), not {value!r}")
    return value
