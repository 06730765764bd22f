"""What a recorded log from outside holds, whatever its format: the sensor data as observations, and what is known beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from robocar.core import SE2, Landmark, Observation
from robocar.formats.tum import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A log, ready for replay.

    Args:
        path: where it was read from; kind: `mrclam`, `carmen`, `lidar_csv`, `run` (our own recordings).
        observations: in the order of their times.
        landmarks: known positions of landmarks by name.
        truth: ground truth, for metrics and pictures only, or None.
        start: the pose that an estimator is told it starts from, or None.
        skipped: lines that could not be used, with the reason: shown to the user.
        notes: what was repaired or guessed: shown to the user.
    """

    path: Path
    kind: str
    observations: tuple[Observation, ...]
    landmarks: tuple[Landmark, ...] = ()
    truth: Trajectory | None = None
    start: SE2 | None = None
    skipped: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
