"""A single laser scan as a table: `angle [rad], range [m]` a line, as PythonRobotics keeps its `lidar01.csv`."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from robocar.core import SE2, LogFormatError, Observation, Reading, Scan, wrap_angles
from robocar.core.text import shown
from robocar.formats.files import MAX_COORDINATE
from robocar.formats.log import Log
from robocar.reading import PathLike, read_text


def load_lidar_csv(path: PathLike) -> Log:
    """Read one scan, taken at the origin.

    A head line, where there is one, must name an angle and a range: `time, gyro_z` is another table. inf is a beam without
    return, nan a lost one. The scanner's range is not in the file: it is taken for that of its farthest return.

    Raises:
        LogFormatError: the file cannot be read, or no line of it is a beam. Single lines that make no sense are left out and
            listed in `Log.skipped` with their numbers.
    """
    path = Path(path)
    beams: list[tuple[float, float]] = []
    skipped: list[str] = []
    lines = read_text(path, LogFormatError).splitlines()
    _refuse_another_table(path, lines)
    for number, line in enumerate(lines, start=1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            angle, reading = (float(word) for word in words)
        except ValueError:
            skipped.append(f"line {number}: expected an angle and a range, not {shown(line[:60])}")
            continue
        if not abs(angle) <= _MAX_ANGLE or reading < 0.0 or (math.isfinite(reading) and reading > MAX_COORDINATE):
            skipped.append(f"line {number}: expected a finite angle [rad] and a range [m] from 0 on, not {shown(line[:60])}")
            continue
        beams.append((angle, reading))
    if not any(math.isfinite(reading) or reading > 0 for _, reading in beams):
        first = f"; {skipped[0]}" if skipped else ""
        raise LogFormatError(f"{path}: no line holds an angle [rad] and a range [m]{first or '; all are nan' * bool(beams)}")
    bearings, ranges = np.array(beams).T
    farthest = np.max(ranges[np.isfinite(ranges)], initial=0.0)
    scan = Scan(0.0, ranges, wrap_angles(bearings), float(farthest) or 1.0)
    return Log(
        path, "lidar_csv", (Observation(0.0, odom_pose=Reading(0.0, SE2()), lidar=scan),), start=SE2(), skipped=tuple(skipped)
    )


_MAX_ANGLE = 4 * math.pi  # [rad]: two turns
_ANGLES = ("angle", "bearing", "theta", "phi", "azimuth", "rad", "deg")
_RANGES = ("range", "dist", "depth", "r", "ray", "m")


def _refuse_another_table(path: Path, lines: list[str]) -> None:
    """A head line that names other things than an angle and a range.

    Raises:
        LogFormatError: what is named, and what would be valid.
    """
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    names = [name.strip().strip('"').lower() for name in re.split(r"[,;\t]", first)]
    if not names[0] or not any(c.isalpha() for name in names for c in name) or _is_number(names[0]):
        return
    good = len(names) == 2 and names[0].startswith(_ANGLES) and names[1].startswith(_RANGES)
    if not good:
        raise LogFormatError(f"{path}: a table of {shown(first[:60])}, not of laser beams: expected the columns angle, range")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
