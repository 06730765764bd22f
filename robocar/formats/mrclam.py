"""UTIAS multi-robot cooperative localization and mapping data sets (Leung, Halpern, Barfoot and Liu, IJRR 30(8), 2011).

A folder holds `Barcodes.dat`, `Landmark_Groundtruth.dat` and, for each robot k, `Robotk_Odometry.dat`, `Robotk_Measurement.dat`
and `Robotk_Groundtruth.dat`: numbers in columns, lines with `#` are comments. Odometry is *commanded* speeds, each held until
the next line. A measurement names a barcode; subjects 1 to 5 are robots, which move, from 6 on landmarks.
"""

from __future__ import annotations

import bisect
import math
import os
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

import numpy as np

from robocar.core import SE2, Detection, Landmark, LogFormatError, Observation, Reading, Twist
from robocar.core.geometry import wrap_angle
from robocar.core.text import shown
from robocar.formats.files import MAX_COORDINATE, MAX_TIME, finite, text_lines
from robocar.formats.log import Log
from robocar.formats.tum import Trajectory
from robocar.reading import PathLike, read_text

Row: TypeAlias = tuple[float, ...]

BEARING_STD = 0.05
"""What a bearing is off by [rad]: the middle of what the data sets' robots show, 0.011 to 0.096 rad. The files do not say it."""
RANGE_STD, RANGE_STD_SHARE = 0.02, 0.03
"""Standard deviation of a range: `RANGE_STD` [m] and this share of it. Against ground truth, robot 1 of data set 7 is off by
0.06 m at 1 to 2 m, and its kin by 0.23 m at 6 to 8 m."""
SHORT_TAIL = 2.0
"""See `robocar.core.Detection`: robot 1's ranges that are too short are off by 6.2 % (RMS), those that are too long by 2.4 %."""
CORRELATION_TIME = 3.0
"""For how long errors of one landmark stay alike [s]: after it, those of robot 1's bearings are half as correlated."""

_ROBOTS = 5  # subjects 1 to 5
_RADIUS = 0.05  # [m] of the tubes that carry the barcodes
_COLUMNS = {
    "Barcodes.dat": ("subject", "barcode"),
    "Landmark_Groundtruth.dat": ("subject", "x", "y", "x std", "y std"),
    "Odometry.dat": ("time", "v", "omega"),
    "Measurement.dat": ("time", "barcode", "range", "bearing"),
    "Groundtruth.dat": ("time", "x", "y", "orientation"),
}


def is_mrclam(folder: PathLike) -> bool:
    """Whether a folder is such a data set."""
    return os.path.isfile(Path(folder) / "Barcodes.dat")


def load_mrclam(folder: PathLike, robot: int | None = None) -> Log:
    """Read what one robot has logged.

    A landmark that is seen again within `CORRELATION_TIME` is seen with mostly the same error: the variances grow so that all of
    its sightings in that time say as much as one.

    Measurements of other robots, of unknown barcodes, without a positive range and before the first line of odometry are left out
    and counted in `Log.skipped`; of several lines of odometry with one time the last counts. The start is the ground truth at
    the first line of odometry; without ground truth (its file is missing) there is no start.

    Args:
        folder: of the data set.
        robot: its number; by default the only or the first that the folder has.

    Raises:
        LogFormatError: the folder has no such robot (the message lists those that it has), a file is missing or empty, a line
            has the wrong number of fields, a number is not finite, times fall, a subject or a barcode comes twice; the message
            names file and line.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise LogFormatError(f"{folder}: no such folder; an MRCLAM data set is a folder with Barcodes.dat")
    present = robots(folder)
    if robot is None:
        robot = present[0]
    elif robot not in present:
        raise LogFormatError(f"{folder}: there is no robot {robot}; its robots are {', '.join(map(str, present))}")
    subjects = _subjects(folder / "Barcodes.dat")
    landmarks = _landmarks(folder / "Landmark_Groundtruth.dat")
    odometry = _timed(folder / f"Robot{robot}_Odometry.dat", "Odometry.dat")
    measurements = _timed(folder / f"Robot{robot}_Measurement.dat", "Measurement.dat")
    truth_file = folder / f"Robot{robot}_Groundtruth.dat"
    truth = _trajectory(_timed(truth_file, "Groundtruth.dat")) if truth_file.exists() else None

    skipped: Counter[str] = Counter()
    speeds: dict[float, Reading[Twist]] = {}
    for time, v, omega in odometry:
        skipped["lines of odometry whose time comes again"] += time in speeds
        speeds[time] = Reading(time, Twist(v, omega))
    begin = odometry[0][0]
    seen: dict[float, list[Detection]] = {}
    last: dict[int, float] = {}
    for time, barcode, distance, bearing in measurements:
        subject = subjects.get(int(barcode))
        problem = _unusable(subject, barcode, distance, landmarks)
        if time < begin:
            problem = "measurements before the first line of odometry"
        if problem:
            skipped[problem] += 1
            continue
        assert subject is not None
        repeats = max(1.0, CORRELATION_TIME / max(time - last.get(subject, -math.inf), 1e-3))
        last[subject] = time
        covariance = repeats * np.diag([BEARING_STD**2, (RANGE_STD + RANGE_STD_SHARE * distance) ** 2])
        detection = Detection(time, str(subject), wrap_angle(bearing), distance, covariance, SHORT_TAIL)
        seen.setdefault(time, []).append(detection)
    observations = tuple(
        Observation(time, twist=speeds.get(time), landmarks=tuple(seen.get(time, ()))) for time in sorted({*speeds, *seen})
    )
    return Log(
        folder,
        "mrclam",
        observations,
        tuple(landmarks.values()),
        truth,
        _pose_at(truth, begin) if truth is not None else None,
        tuple(f"{count} {what}" for what, count in skipped.items() if count),
    )


def _unusable(subject: int | None, barcode: float, distance: float, landmarks: dict[int, Landmark]) -> str:
    """Why a measurement cannot be used, or nothing."""
    if subject is None:
        return f"measurements of the unknown barcode {barcode:g}"
    if subject <= _ROBOTS:
        return f"measurements of robot {subject}, which moves"
    if subject not in landmarks:
        return f"measurements of landmark {subject}, whose position is not known"
    return "" if distance > 0 else "measurements without a positive range"


def robots(folder: Path) -> list[int]:
    """Numbers of the robots that a data set's folder has odometry of.

    Raises:
        LogFormatError: of none.
    """
    numbers = sorted(
        int(name)
        for file in folder.glob("Robot*_Odometry.dat")
        if (name := file.name[len("Robot") : -len("_Odometry.dat")]).isdigit()
    )
    if not numbers:
        raise LogFormatError(f"{folder}: there is no Robot<number>_Odometry.dat")
    return numbers


def _rows(path: Path, kind: str) -> list[tuple[int, Row]]:
    """Line numbers and numbers of a file."""
    columns = _COLUMNS[kind]
    rows = []
    for number, line in enumerate(text_lines(read_text(path, LogFormatError)), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) != len(columns):
            raise LogFormatError(f"{path}, line {number}: {len(words)} fields, not the {len(columns)} of {', '.join(columns)}")
        values = []
        for name, word in zip(columns, words, strict=True):
            most = MAX_TIME if name == "time" else MAX_COORDINATE
            value = finite(f"{path}, line {number}", name, word, LogFormatError, most)
            if name in ("subject", "barcode") and value != int(value):
                raise LogFormatError(f"{path}, line {number}: {name} must be a whole number, not {shown(word)}")
            values.append(value)
        rows.append((number, tuple(values)))
    return rows


def _timed(path: Path, kind: str) -> list[Row]:
    """Rows in the order of their times."""
    rows = _rows(path, kind)
    for (_, before), (number, row) in pairwise(rows):
        if row[0] < before[0]:
            raise LogFormatError(f"{path}, line {number}: time {row[0]!r} is earlier than the line before, {before[0]!r}")
    if not rows and kind != "Measurement.dat":
        raise LogFormatError(f"{path}: no line of {', '.join(_COLUMNS[kind])}")
    return [row for _, row in rows]


def _subjects(path: Path) -> dict[int, int]:
    """Subject of each barcode."""
    subjects: dict[int, int] = {}
    for number, (subject, barcode) in _rows(path, "Barcodes.dat"):
        if int(barcode) in subjects:
            raise LogFormatError(f"{path}, line {number}: barcode {barcode:g} stands there for the second time")
        subjects[int(barcode)] = int(subject)
    return subjects


def _landmarks(path: Path) -> dict[int, Landmark]:
    landmarks: dict[int, Landmark] = {}
    for number, (subject, x, y, _, _) in _rows(path, "Landmark_Groundtruth.dat"):
        if int(subject) in landmarks:
            raise LogFormatError(f"{path}, line {number}: landmark {subject:g} stands there for the second time")
        landmarks[int(subject)] = Landmark(str(int(subject)), "", np.array([x, y, 0.0]), _RADIUS)
    return landmarks


def _trajectory(rows: list[Row]) -> Trajectory:
    table = np.array(rows)
    return Trajectory(table[:, 0], np.column_stack([table[:, 1:3], [wrap_angle(theta) for theta in table[:, 3]]]))


def _pose_at(truth: Trajectory, time: float) -> SE2:
    """The pose at a time; before the first and after the last, theirs. Between two, on the straight line."""
    k = bisect.bisect_right(truth.times, time)
    if k == 0 or k == len(truth.times):
        return SE2(*(float(value) for value in truth.poses[min(k, len(truth.times) - 1)]))
    (t0, t1), (a, b) = truth.times[k - 1 : k + 1], truth.poses[k - 1 : k + 1]
    share = float((time - t0) / (t1 - t0))
    x, y = (float(value) for value in a[:2] + share * (b[:2] - a[:2]))
    return SE2(x, y, float(a[2]) + share * wrap_angle(float(b[2] - a[2])))
