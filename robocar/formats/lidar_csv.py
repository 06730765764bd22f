"""A single laser scan as a table: `angle [rad], range [m]` a line, as PythonRobotics keeps its `lidar01.csv`."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from robocar.core import SE2, LogFormatError, Observation, Reading, Scan, wrap_angles
from robocar.formats.log import Log
from robocar.reading import PathLike, read_text


def load_lidar_csv(path: PathLike) -> Log:
    """Read one scan, taken at the origin.

    inf is a beam without return, nan a lost one. The scanner's range is not in the file: it is taken for that of its farthest
    return.

    Raises:
        LogFormatError: the file cannot be read, or no line of it is a beam. Single lines that make no sense are left out and
            listed in `Log.skipped` with their numbers.
    """
    path = Path(path)
    beams: list[tuple[float, float]] = []
    skipped: list[str] = []
    for number, line in enumerate(read_text(path, LogFormatError).splitlines(), start=1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            angle, reading = (float(word) for word in words)
        except ValueError:
            skipped.append(f"line {number}: expected an angle and a range, not {line[:60]!r}")
            continue
        if not math.isfinite(angle) or reading < 0.0:
            skipped.append(f"line {number}: expected a finite angle and a range from 0 on, not {line[:60]!r}")
            continue
        beams.append((angle, reading))
    if not beams:
        first = f"; {skipped[0]}" if skipped else ""
        raise LogFormatError(f"{path}: no line holds an angle [rad] and a range [m]{first}")
    bearings, ranges = np.array(beams).T
    farthest = np.max(ranges[np.isfinite(ranges)], initial=0.0)
    scan = Scan(0.0, ranges, wrap_angles(bearings), float(farthest) or 1.0)
    return Log(
        path, "lidar_csv", (Observation(0.0, odom_pose=Reading(0.0, SE2()), lidar=scan),), start=SE2(), skipped=tuple(skipped)
    )
