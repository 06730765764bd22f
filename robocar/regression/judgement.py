"""Which direction of a metric is the better one, and what change of it is none yet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Better = Literal["lower", "higher", "neither"]


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A change of a metric counts when it is larger than both margins.

    Args:
        better: which direction is an improvement; `neither`: the metric is listed and never judged.
        absolute: in the metric's unit; relative: to the size of the baseline's value.
    """

    better: Better
    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        if self.better not in ("lower", "higher", "neither"):
            raise ValueError(f"better must be 'lower', 'higher' or 'neither', not {self.better!r}")
        for name in ("absolute", "relative"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be a finite number from 0 on, not {value!r}")

    def margin(self, base: float) -> float:
        """How far a value may be from `base`, in the metric's unit."""
        return max(self.absolute, self.relative * abs(base))

    def worsening(self, change: float) -> float:
        """The change, positive where it is one for the worse; 0 where nobody can say."""
        return {"lower": change, "higher": -change, "neither": 0.0}[self.better]


_SHARE = Tolerance("higher", absolute=0.02)
_ERROR = Tolerance("lower", absolute=0.005, relative=0.10)
_ANGLE = Tolerance("lower", absolute=0.01, relative=0.10)
_NOT_JUDGED = Tolerance("neither")
_SCORES = {"accuracy": _SHARE, "precision": _SHARE, "recall": _SHARE, "f1": _SHARE, "iou": _SHARE}
_SCORES |= {"unknown": Tolerance("lower", absolute=0.02)}

TOLERANCES: Mapping[str, Tolerance] = {
    "duration": Tolerance("lower", absolute=0.5, relative=0.05),
    "path_length": Tolerance("lower", absolute=0.02, relative=0.03),
    "shortest_path_length": _NOT_JUDGED,  # of the world, not of the robot
    "spl": _SHARE,
    "min_clearance": Tolerance("higher", absolute=0.01),
    "mean_clearance": Tolerance("higher", absolute=0.02, relative=0.10),
    "contacts": Tolerance("lower"),
    "contacts_standing": _NOT_JUDGED,  # somebody ran into the car
    "replans": _NOT_JUDGED,  # more of them may be caution or confusion
    "plan_time_mean": _NOT_JUDGED,  # wall clock: a busy machine is no regression
    "plan_time_max": _NOT_JUDGED,
    "wall_time": _NOT_JUDGED,
    "real_time_factor": _NOT_JUDGED,
    "position_rmse": _ERROR,
    "heading_rmse": _ANGLE,
    "final_position_error": Tolerance("lower", absolute=0.02, relative=0.10),
    "odometry_position_rmse": _NOT_JUDGED,  # of the car and its way, not of the estimator
    "angle_over_length": Tolerance("lower", absolute=0.05, relative=0.10),
    "jerk_rms": Tolerance("lower", relative=0.10),
    "localization/convergence_time": Tolerance("lower", absolute=0.5, relative=0.10),
    "localization/recovery_time": Tolerance("lower", absolute=0.5, relative=0.10),
    "localization/position_rmse": _ERROR,
    "localization/heading_rmse": _ANGLE,
    "localization/nees": _NOT_JUDGED,  # too large and too small are both bad
    **{f"map/{part}{name}": tolerance for part in ("", "around_", "reachable_") for name, tolerance in _SCORES.items()},
    "map/path_blocked": Tolerance("lower"),
    "map/explored": Tolerance("higher", absolute=0.01),
    "map/known_area": _NOT_JUDGED,
}
"""The defaults. A metric that is not in here is listed and not judged, unless the suite says how."""

WALL_CLOCK = frozenset({"plan_time_mean", "plan_time_max", "wall_time", "real_time_factor"})
"""Metrics that the machine's load changes: equal runs need not have them equal."""


def tolerances(changes: Mapping[str, Mapping[str, object]] | None = None) -> dict[str, Tolerance]:
    """The defaults with the given fields changed, `{"duration": {"relative": 0.1}}`.

    Raises:
        ValueError: a field that no tolerance has, or a bad value.
    """
    table = dict(TOLERANCES)
    for metric, fields in (changes or {}).items():
        old = table.get(metric, _NOT_JUDGED)
        known = {"better": old.better, "absolute": old.absolute, "relative": old.relative}
        unknown = sorted(set(fields) - set(known))
        if unknown:
            raise ValueError(f"tolerance of {metric}: unknown field {unknown[0]!r}; it has better, absolute, relative")
        table[metric] = Tolerance(**{**known, **fields})  # type: ignore[arg-type]
    return table
