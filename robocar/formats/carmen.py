"""Laser logs of the Carnegie Mellon Robot Navigation Toolkit (CARMEN), the format of most public 2D laser data sets.

One message a line, and three kinds of scans:

* `FLASER n r1 ... rn x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp`: n ranges [m] from right to left,
  the laser's pose (in corrected logs that of a SLAM system), and the odometry's;
* `ROBOTLASER1`, which newer loggers write beside or instead: angles and the largest range come first, see `_robotlaser`;
* `LASER_READING n r1 ... rn x y theta time`, as GMapping writes (`.gfs`): one pose, of the odometry.

A log is read by the first of these kinds that it has. Other messages are left aside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from robocar.core import SE2, Array, LogFormatError, Observation, Reading, Scan
from robocar.core.text import shown
from robocar.formats.carmen_repair import NO_RETURN, largest_range, repaired_times
from robocar.formats.files import MAX_COORDINATE
from robocar.formats.log import Log
from robocar.reading import PathLike, gunzip, is_packed, read_bytes

MAX_BEAMS = 100_000
"""Of a scan."""

_OTHERS = {
    *("PARAM", "SYNC", "NEFF", "MARKER", "TRUEPOS", "RLASER", "ODOM", "ROBOTLASER2", "RAWLASER1", "RAWLASER2"),
    *("RAWLASER3", "RAWLASER4", "LASER3", "LASER4", "REMISSIONFLASER", "REMISSIONRLASER", "SONAR", "BUMPER", "IMU", "GPS"),
    *("NMEAGGA", "NMEARMC", "WIFI", "SCANMARK", "POSITIONLASER", "PANTILT", "VECTORMOVE", "ROBOTVELOCITY", "FOLLOWTRAJECTORY"),
    *("ODO_UPDATE", "SM_UPDATE", "RESAMPLE", "ENTROPY"),  # of GMapping
    *("ARM", "SONAR1", "POS", "SCRIPT", "PANTILTSTATUS", "LOCALIZE", "LEVEL", "SIMULATOR"),
}


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    ranges: Array
    laser: SE2
    odometry: SE2
    stamps: tuple[float, float]  # of the logger and of the message [s], nan where there is none
    bearings: Array
    largest: float = math.nan  # range of the scanner, where the message says it [m]


def load_carmen(path: PathLike, pose: Literal["laser", "odometry"] = "laser") -> Log:
    """Read a CARMEN log, packed by gzip or not.

    Each scan becomes one observation with the laser at the robot's origin. Ranges that stand for nothing seen become inf, zero
    and negative ones nan: `carmen_repair.largest_range` finds the one that the scanner was set to. Times are the logger's, else
    the messages', put in order where a few of them fall, else 0.1 s apart. `Log.notes` says what was done.

    Args:
        path: the log.
        pose: which of the two poses becomes `Observation.odom_pose`: that of the laser, which a corrected log has corrected, or
            the odometry's. Where the laser's never changes, the odometry's is taken.

    Raises:
        LogFormatError: the file cannot be read, or no line of it is a scan. Single lines that make no sense are left out and
            listed in `Log.skipped` with their numbers.
    """
    path = Path(path)
    found, skipped = _messages(_text(path))
    kind = next((kind for kind in _KINDS if found[kind]), None)
    if kind is None:
        first = f"; {skipped[0]}" if skipped else ""
        raise LogFormatError(f"{path}: no {' or '.join(_KINDS)} message can be read, so this is no CARMEN laser log{first}")
    scans = found[kind]
    # FLASER does not say the scanner's range; the same scans as ROBOTLASER1 do.
    declared = [scan.largest for scan in (*scans, *found["ROBOTLASER1"])]
    max_range, about_range = largest_range(np.concatenate([s.ranges for s in scans]), declared)
    times, order, about_times = repaired_times([scan.stamps for scan in scans])
    scans = [scans[k] for k in order]
    still = len({(s.laser.x, s.laser.y, s.laser.theta) for s in scans}) == 1
    poses = [s.odometry if pose == "odometry" or still else s.laser for s in scans]
    observations = tuple(
        Observation(time, odom_pose=Reading(time, at), lidar=Scan(time, _returns(s.ranges, max_range), s.bearings, max_range))
        for s, at, time in zip(scans, poses, times, strict=True)
    )
    notes = tuple(note for note in (about_range, about_times) if note)
    return Log(path, "carmen", observations, start=poses[0], skipped=tuple(skipped), notes=notes)


def _messages(text: str) -> tuple[dict[str, list[_Scan]], list[str]]:
    """Scans by kind of message, and the lines that make no sense."""
    found: dict[str, list[_Scan]] = {kind: [] for kind in _KINDS}
    skipped: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        kind = words[0]
        try:
            if kind in _KINDS:
                found[kind].append(_KINDS[kind](line.split()))
            elif kind not in _OTHERS:
                raise ValueError(f"unknown message {shown(kind[:40])}")
        except ValueError as problem:
            skipped.append(f"line {number}: {problem}")
    return found, skipped


def _text(path: Path) -> str:
    data = read_bytes(path, LogFormatError)
    if is_packed(data):
        data = gunzip(data, path, LogFormatError)
    return data.decode("utf-8-sig", errors="replace")  # what is no text is no number either, and its line is named


def _count(words: list[str], at: int, more: int) -> int:
    """The number of beams, which stands at a place and is followed by as many ranges and `more` words at least."""
    kind = words[0]
    if len(words) <= at:
        raise ValueError(f"{kind} without a number of beams")
    word = words[at]
    count = int(word) if word.isdecimal() and len(word) < 40 else 0
    if count < 1:
        raise ValueError(f"{kind}: the number of beams must be a whole number above 0, not {shown(word[:40])}")
    needed = at + 1 + count + more
    if len(words) < needed or count > MAX_BEAMS:
        raise ValueError(f"{kind} with {count} beams needs {needed} words or more (at most {MAX_BEAMS} beams), not {len(words)}")
    return count


def _ranges(words: list[str], at: int, count: int) -> Array:
    return np.array([_number(words[0], word, "a range") for word in words[at + 1 : at + 1 + count]])


def _pose(words: list[str], at: int) -> SE2:
    return SE2(*(_finite(words[0], word, "a pose") for word in words[at : at + 3]))


def _flaser(words: list[str]) -> _Scan:
    count = _count(words, 1, 6)
    rest = words[8 + count :]
    stamps = (_stamp(rest[2]), _stamp(rest[0])) if len(rest) >= 3 else (math.nan, math.nan)
    return _Scan(_ranges(words, 1, count), _pose(words, 2 + count), _pose(words, 5 + count), stamps, _bearings(count))


def _laser_reading(words: list[str]) -> _Scan:
    count = _count(words, 1, 3)
    pose = _pose(words, 2 + count)
    stamp = _stamp(words[5 + count]) if len(words) > 5 + count else math.nan
    return _Scan(_ranges(words, 1, count), pose, pose, (stamp, math.nan), _bearings(count))


def _robotlaser(words: list[str]) -> _Scan:
    """`ROBOTLASER1 type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode n r1 ... rn m e1 ...
    em laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward_safety side_safety turn_axis ipc_timestamp host
    logger_timestamp`: with m remission values, angles in radians."""
    count = _count(words, 8, 7)
    start, _, step, largest = (_finite(words[0], word, "an angle or the maximum range") for word in words[2:6])
    remissions = words[9 + count]
    if not (remissions.isdecimal() and len(remissions) < 7):
        raise ValueError(f"ROBOTLASER1: the number of remission values must be a whole number, not {shown(remissions[:40])}")
    at = 10 + count + int(remissions)
    if len(words) < at + 6:
        raise ValueError(f"ROBOTLASER1 with {count} beams and {remissions} remission values needs {at + 6} words or more")
    rest = words[at + 11 :]
    stamps = (_stamp(rest[2]), _stamp(rest[0])) if len(rest) >= 3 else (math.nan, math.nan)
    bearings = start + step * np.arange(count, dtype=float)
    return _Scan(_ranges(words, 8, count), _pose(words, at), _pose(words, at + 3), stamps, bearings, largest)


_KINDS = {"FLASER": _flaser, "ROBOTLASER1": _robotlaser, "LASER_READING": _laser_reading}
"""Kinds of scans, the best first."""


def _number(kind: str, word: str, what: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"{kind}: {what} must be a number, not {shown(word[:40])}") from None


def _finite(kind: str, word: str, what: str) -> float:
    value = _number(kind, word, what)
    if not math.isfinite(value):
        raise ValueError(f"{kind}: {what} must be finite, not {shown(word[:40])}")
    if abs(value) > MAX_COORDINATE:
        raise ValueError(f"{kind}: {what} must be within {MAX_COORDINATE:g} of zero, not {shown(word[:40])}")
    return value


def _stamp(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _bearings(beams: int) -> Array:
    """From -90 degrees on: 180 or 181 beams are a degree apart, 360 or 361 half a degree, others fill the half circle [rad]."""
    step = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}.get(beams, 180.0 / max(beams - 1, 1))
    return np.radians(-90.0 + step * np.arange(beams)) if beams > 1 else np.zeros(1)


def _returns(ranges: Array, max_range: float) -> Array:
    """Ranges with inf for nothing seen and nan for what is none."""
    nothing = (ranges >= max_range) | np.isin(ranges, NO_RETURN)
    return np.where(nothing, np.inf, np.where(ranges > 0.0, ranges, np.nan))
