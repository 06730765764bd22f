"""Any log from outside by one call."""

from __future__ import annotations

import os
from pathlib import Path

from robocar.core import LogFormatError
from robocar.formats.carmen import load_carmen
from robocar.formats.lidar_csv import load_lidar_csv
from robocar.formats.log import Log
from robocar.formats.mrclam import is_mrclam, load_mrclam
from robocar.reading import PathLike

LOG_KINDS = "an MRCLAM folder, a CARMEN .log, .clf or .gfs, packed (.gz) or not, or a .csv of laser scans"
_CARMEN_ENDINGS = (".log", ".clf", ".gfs", ".log.gz", ".clf.gz", ".gfs.gz")


def is_log(path: PathLike) -> bool:
    """Whether this is named as a log is, or is an MRCLAM folder."""
    path = Path(path)
    return is_mrclam(path) if os.path.isdir(path) else path.name.lower().endswith((".csv", *_CARMEN_ENDINGS))


def load_log(path: PathLike, subject: int | None = None) -> Log:
    """The log at a path, whatever its format.

    Args:
        subject: number of the robot, for an MRCLAM folder; by default the first.

    Raises:
        LogFormatError: nothing is there, or nothing that is known; the folder has no such robot, or the log is of one robot only.
    """
    path = Path(path)
    if not os.path.exists(path):
        raise LogFormatError(f"{path}: no such file or folder")
    if os.path.isdir(path) and is_mrclam(path):
        return load_mrclam(path, subject)
    refuse_subject(path, subject)
    if os.path.isfile(path) and path.name.lower().endswith(".csv"):
        return load_lidar_csv(path)
    if os.path.isfile(path) and path.name.lower().endswith(_CARMEN_ENDINGS):
        return load_carmen(path)
    raise LogFormatError(f"{path}: not a log that is known; a log is a run directory, {LOG_KINDS}")


def refuse_subject(path: Path, subject: int | None) -> None:
    """Only an MRCLAM folder holds several robots.

    Raises:
        LogFormatError: a subject is given.
    """
    if subject is not None:
        raise LogFormatError(f"{path}: subject {subject} goes with an MRCLAM folder, which holds logs of several robots")
