"""What an algorithm may know about the machine that it drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from robocar.core.errors import ParameterError
from robocar.core.footprint import Footprint
from robocar.core.geometry import SE2, Array, frozen_array
from robocar.core.grid import OccupancyGrid
from robocar.core.truth import GroundTruth

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

    def __post_init__(self) -> None:
        object.__setattr__(self, "curvature", frozen_array(self.curvature))
        object.__setattr__(self, "track", frozen_array(self.track))

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
    """Everything that planners and estimators are told about the car; `sensors` names all that are fitted."""

    footprint: Footprint
    limits: Limits
    calibration: Calibration
    pulses_per_turn: int
    sonars: tuple[RangeSensor, ...] = ()
    lidar: RangeSensor | None = None
    compass: bool = False
    camera: bool = False
    top_camera: bool = False
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Landmark:
    """A coloured ball at `position` (3,) [m]."""

    name: str
    color: str
    position: Array
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", frozen_array(self.position))


def _no_oracle() -> GroundTruth:
    raise RuntimeError("the simulator's truth is given to an estimator whose factory declares it: @declares(oracle=True)")


@dataclass(frozen=True, slots=True)
class Context:
    """What every factory `build(context)` gets.

    Args:
        robot: the machine.
        prior: the map that the robot is given, or None.
        start: the pose that the robot is told it starts from, or None (global localization).
        landmarks: the balls that it is told of.
        parameters: overrides by name, nested by part: `{"speed": 0.3, "controller": {"sim_time": 3.0}}` (`parameters_of`,
            `part`).
        rng: the component's own random stream.
        control_period: time between two commands [s].
        oracle: the simulator's truth, only for factories that declare that they want it (`robocar.core.capabilities`).
        whole: of a part's context, the parameters that `part` took it from.
        path: of these parameters among the settings, `navigator.controller`, for messages.
    """

    robot: Robot
    prior: OccupancyGrid | None
    start: SE2 | None
    landmarks: tuple[Landmark, ...]
    parameters: Mapping[str, Any]
    rng: np.random.Generator
    control_period: float
    oracle: Callable[[], GroundTruth] = _no_oracle
    whole: Mapping[str, Any] | None = None
    path: str = ""

    def part(self, name: str) -> Context:
        """The same context with the parameters of one part, e.g. of the `controller`; a part has the parts of the whole."""
        whole, path = (self.parameters, self.path) if self.whole is None else (self.whole, self.path.rpartition(".")[0])
        return replace(self, parameters=whole.get(name, {}), whole=whole, path=f"{path}.{name}")

    def parameters_of(self, cls: type[P]) -> P:
        """The dataclass of parameters `cls` with the overrides of this part that carry its fields' names.

        Raises:
            ParameterError: a value has the wrong type, or the dataclass refuses it.
        """
        chosen = {}
        for f in fields(cls):  # type: ignore[arg-type]
            if f.name in self.parameters:
                chosen[f.name] = _as_type_of(f.default, self.parameters[f.name], f"{self.path}.{f.name}".lstrip("."))
        try:
            return cls(**chosen)
        except ValueError as error:
            raise ParameterError(f"{self.path or cls.__module__}: {error}") from error


def _as_type_of(default: Any, value: Any, name: str) -> Any:
    """`value` as the type of a parameter's default: 1 is a fine float, "fast" is not."""
    if isinstance(default, bool):
        good = isinstance(value, bool)
    elif isinstance(default, float):
        good = isinstance(value, float) or (isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**1000)
        value = float(value) if good else value
    elif isinstance(default, int):
        good = isinstance(value, int) and not isinstance(value, bool)
    elif isinstance(default, str):
        good = isinstance(value, str)
    else:
        good = True
    if not good:
        raise ParameterError(f"parameter {name} takes a {type(default).__name__} (default {default!r}), not {value!r:.80}")
    return value
