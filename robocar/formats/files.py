"""Maps no larger than memory holds, and files written so that no half-written one is ever seen. `robocar.reading` reads them."""

from __future__ import annotations

import math
import os
from pathlib import Path

from robocar.core import MapFormatError, OutputError, ParameterError, RobocarError
from robocar.core.text import shown
from robocar.reading import PathLike

MAX_CELLS = 1 << 25
"""Larger maps are refused before anything is allocated: 5792 x 5792 cells, 290 m x 290 m at 5 cm."""

MAX_COORDINATE = 1e7
"""Where things may lie and how far they may be apart [m]: the coordinates of national grids fit in."""

MAX_TIME = 1e10
"""Of stamps [s]: those since 1970 fit in."""

RESOLUTIONS = (1e-6, 1e6)
"""Sides of cells that are believed [m]."""


def finite(where: str, field: str, word: object, error: type[RobocarError], most: float = MAX_COORDINATE) -> float:
    """A number of a file, at most `most` large; raises `error` for what is none. YAML leaves some, such as 1e-05, as text."""
    try:
        number = float(word) if isinstance(word, int | float | str) and not isinstance(word, bool) else math.nan
    except (ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise error(f"{where}: {field} must be a finite number, not {shown(word)}")
    if abs(number) > most:
        raise error(f"{where}: {field} must be within {most:g} of zero, not {shown(word)}")
    return number


def text_lines(text: str) -> list[str]:
    """Lines without their ends (LF or CRLF) and without empty lines at the end of the text."""
    lines = [line.removesuffix("\r") for line in text.split("\n")]
    while lines and not lines[-1]:
        lines.pop()
    return lines


def write_atomically(path: PathLike, data: bytes) -> None:
    """Write beside `path` and rename: readers see the old file or the new one, never a part.

    Raises:
        OutputError: the directory is missing or not writable, or the disk is full.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(data)
        os.replace(part, path)
    except OSError as failure:
        part.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written ({failure.strerror or failure})") from failure


def check_cells(path: PathLike, rows: float, cols: float) -> None:
    """Refuse maps that nobody means, before their cells are allocated."""
    if rows * cols > MAX_CELLS:
        raise MapFormatError(f"{path}: {cols:.0f} x {rows:.0f} cells, at most {MAX_CELLS} are allowed")


def check_resolution(resolution: float) -> float:
    """A resolution given by the caller [m]; raises `ParameterError` unless it is a positive number."""
    good = isinstance(resolution, int | float) and not isinstance(resolution, bool)
    if not (good and math.isfinite(resolution) and resolution > 0):
        raise ParameterError(f"resolution must be a positive number of metres per cell, not {shown(resolution)}")
    low, high = RESOLUTIONS
    if not low <= resolution <= high:
        raise ParameterError(f"resolution must be from {low:g} to {high:g} metres per cell, not {shown(resolution)}")
    return float(resolution)
