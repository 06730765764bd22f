"""Trajectories in the TUM format: lines `time x y z qx qy qz qw`, as evo and the TUM RGB-D benchmark read them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from robocar.core import Array, LogFormatError, frozen_array
from robocar.formats.files import MAX_COORDINATE, MAX_TIME, finite, text_lines, write_atomically
from robocar.reading import PathLike, read_text

_FIELDS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses on the plane over time.

    Args:
        times: never falling, (n,) [s].
        poses: x, y [m], theta [rad] in (-pi, pi], (n, 3).
    """

    times: Array
    poses: Array

    def __post_init__(self) -> None:
        times, poses = frozen_array(self.times), frozen_array(self.poses)
        if times.ndim != 1 or poses.shape != (times.size, 3):
            raise ValueError(f"a trajectory needs times (n,) and poses (n, 3), not {times.shape} and {poses.shape}")
        if not (np.all(np.isfinite(times)) and np.all(np.isfinite(poses))):
            raise ValueError("a trajectory needs finite numbers")
        if np.any(np.diff(times) < 0):
            raise ValueError("the times of a trajectory must not fall")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "poses", poses)


def read_tum(path: PathLike) -> Trajectory:
    """Read a trajectory; lines that begin with `#` and empty lines are skipped.

    Height, roll and pitch are dropped: theta is the yaw of the quaternion, which need not be of unit length.

    Raises:
        LogFormatError: wrong number of fields, no finite number, a zero quaternion, falling times; the message names the line.
    """
    times: list[float] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in enumerate(text_lines(read_text(path, LogFormatError)), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where = f"{path}, line {number}"
        words = line.split()
        if len(words) != len(_FIELDS):
            raise LogFormatError(f"{where}: {len(words)} fields, not the 8 of {' '.join(_FIELDS)}")
        time, x, y, _, qx, qy, qz, qw = (
            finite(where, name, word, LogFormatError, MAX_TIME if name == "time" else MAX_COORDINATE)
            for name, word in zip(_FIELDS, words, strict=True)
        )
        if math.hypot(qx, qy, qz, qw) < 1e-6:
            raise LogFormatError(f"{where}: the quaternion qx qy qz qw is zero, it must have unit length")
        if times and time < times[-1]:
            raise LogFormatError(f"{where}: time {words[0]} is earlier than the line before, {times[-1]}")
        times.append(time)
        poses.append((x, y, math.atan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)))
    return Trajectory(np.array(times), np.array(poses, dtype=float).reshape(-1, 3))


def write_tum(path: PathLike, times: ArrayLike, poses: ArrayLike) -> Path:
    """Write poses (n, 3) as x, y [m], theta [rad] at times (n,) [s]; the numbers are written in full.

    Raises:
        ValueError: wrong shapes, numbers that are not finite, falling times.
        OutputError: the file cannot be written.
    """
    trajectory = Trajectory(np.asarray(times, dtype=float), np.asarray(poses, dtype=float))
    lines = [
        f"{time!r} {x!r} {y!r} 0 0 0 {math.sin(theta / 2)!r} {math.cos(theta / 2)!r}\n"
        for time, (x, y, theta) in zip(trajectory.times.tolist(), trajectory.poses.tolist(), strict=True)
    ]
    write_atomically(path, "".join(["# time x y z qx qy qz qw\n", *lines]).encode())
    return Path(path)
