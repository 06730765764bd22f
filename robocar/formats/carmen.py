"""Laser logs of the Carnegie Mellon Robot Navigation Toolkit (CARMEN), the format of most public 2D laser data sets.

One message a line, `FLASER n r1 ... rn x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp`: n ranges [m] from
right to left, the laser's pose (in corrected logs that of a SLAM system), and the odometry's. Other messages are left aside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from robocar.core import SE2, Array, LogFormatError, MapFormatError, Observation, Reading, Scan
from robocar.formats.log import Log
from robocar.reading import PathLike, gunzip, read_bytes

NO_RETURN = (32.767, 50.0)
"""What drivers write where nothing was seen, besides everything from `LONGEST` on [m]."""

LONGEST = 81.8
"""SICK scanners count up to 8191 centimetres, the last ones of which are error codes [m]."""

NOMINAL_PERIOD = 0.1
"""Between scans of a log whose timestamps do not ascend [s]."""

_OTHERS = {
    *("PARAM", "SYNC", "NEFF", "MARKER", "TRUEPOS", "RLASER", "ODOM", "ROBOTLASER1", "ROBOTLASER2", "RAWLASER1", "RAWLASER2"),
    *("RAWLASER3", "RAWLASER4", "LASER3", "LASER4", "REMISSIONFLASER", "REMISSIONRLASER", "SONAR", "BUMPER", "IMU", "GPS"),
    *("NMEAGGA", "NMEARMC", "WIFI", "SCANMARK", "POSITIONLASER", "PANTILT", "VECTORMOVE", "ROBOTVELOCITY", "FOLLOWTRAJECTORY"),
    *("ARM", "SONAR1", "POS", "SCRIPT", "PANTILTSTATUS", "LOCALIZE", "LEVEL", "SIMULATOR"),
}


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    ranges: Array
    laser: SE2
    odometry: SE2
    stamps: tuple[float, float]  # of the logger and of the message [s], nan where there is none


def load_carmen(path: PathLike, pose: Literal["laser", "odometry"] = "laser") -> Log:
    """Read a CARMEN log, packed by gzip or not.

    Each scan becomes one observation with the laser at the robot's origin. Ranges that stand for nothing seen become inf, zero
    and negative ones nan. Times are the logger's, else the messages', else, where neither ascends, 0.1 s apart.

    Args:
        path: the log.
        pose: which of the two poses becomes `Observation.odom_pose`: that of the laser, which a corrected log has corrected, or
            the odometry's. Where the laser's never changes, the odometry's is taken.

    Raises:
        LogFormatError: the file cannot be read, or no line of it is a scan. Single lines that make no sense are left out and
            listed in `Log.skipped` with their numbers.
    """
    path = Path(path)
    scans: list[_Scan] = []
    skipped: list[str] = []
    for number, line in enumerate(_text(path).splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            if words[0] == "FLASER":
                scans.append(_flaser(words))
            elif words[0] not in _OTHERS:
                raise ValueError(f"unknown message {words[0][:40]!r}")
        except ValueError as problem:
            skipped.append(f"line {number}: {problem}")
    if not scans:
        first = f"; {skipped[0]}" if skipped else ""
        raise LogFormatError(f"{path}: no FLASER message can be read, so this is no CARMEN laser log{first}")
    still = len({(s.laser.x, s.laser.y, s.laser.theta) for s in scans}) == 1
    poses = [s.odometry if pose == "odometry" or still else s.laser for s in scans]
    times = _times(scans)
    max_range = _max_range(np.concatenate([s.ranges for s in scans]))
    observations = tuple(
        Observation(time, odom_pose=Reading(time, at), lidar=Scan(time, _returns(s.ranges), _bearings(len(s.ranges)), max_range))
        for s, at, time in zip(scans, poses, times, strict=True)
    )
    return Log(path, "carmen", observations, start=poses[0], skipped=tuple(skipped))


def _text(path: Path) -> str:
    data = read_bytes(path, LogFormatError)
    if data.startswith(b"\x1f\x8b"):
        try:
            data = gunzip(data, path)
        except MapFormatError as failure:
            raise LogFormatError(str(failure)) from failure
    return data.decode("utf-8-sig", errors="replace")  # what is no text is no number either, and its line is named


def _flaser(words: list[str]) -> _Scan:
    if len(words) < 2:
        raise ValueError("FLASER without a number of beams")
    count = int(words[1]) if words[1].isdecimal() else 0
    if count < 1:
        raise ValueError(f"FLASER: the number of beams must be a whole number above 0, not {words[1][:40]!r}")
    if len(words) < count + 8:
        raise ValueError(f"FLASER with {count} beams needs {count + 8} words or more, not {len(words)}")
    ranges = np.array([_number(word, "a range") for word in words[2 : 2 + count]])
    x, y, theta, *odometry = (_finite(word, "a pose") for word in words[2 + count : 8 + count])
    rest = words[8 + count :]
    stamps = (_stamp(rest[2]), _stamp(rest[0])) if len(rest) >= 3 else (math.nan, math.nan)
    return _Scan(ranges, SE2(x, y, theta), SE2(*odometry), stamps)


def _number(word: str, what: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"FLASER: {what} must be a number, not {word[:40]!r}") from None


def _finite(word: str, what: str) -> float:
    value = _number(word, what)
    if not math.isfinite(value):
        raise ValueError(f"FLASER: {what} must be finite, not {word[:40]!r}")
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


def _returns(ranges: Array) -> Array:
    """Ranges with inf for nothing seen and nan for what is none."""
    nothing = (ranges >= LONGEST) | np.isin(ranges, NO_RETURN)
    return np.where(nothing, np.inf, np.where(ranges > 0.0, ranges, np.nan))


def _max_range(ranges: Array) -> float:
    """What the scanner was set to, as far as the log shows it [m]."""
    largest = np.max(ranges[np.isfinite(ranges)], initial=0.0)
    return float(largest) if largest in NO_RETURN else LONGEST


def _times(scans: list[_Scan]) -> list[float]:
    """Of the scans, strictly ascending from 0 [s]."""
    for k in (0, 1):
        stamps = np.array([s.stamps[k] for s in scans])
        if np.isfinite(stamps).all() and np.all(np.diff(stamps) > 0):
            return (stamps - stamps[0]).tolist()
    return [k * NOMINAL_PERIOD for k in range(len(scans))]
