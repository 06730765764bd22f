"""Reading files with errors of one clear line, and writing them so that no half-written file is ever seen."""

from __future__ import annotations

import gzip
import io
import math
import os
import zlib
from pathlib import Path
from typing import TypeAlias

from robocar.core import MapFormatError, OutputError, ParameterError, RobocarError

PathLike: TypeAlias = str | os.PathLike[str]

MAX_CELLS = 1 << 26
"""Larger maps are refused before anything is allocated: 8192 x 8192 cells, 410 m x 410 m at 5 cm."""

MAX_BYTES = 1 << 30
"""Larger files are refused before they are read."""


def read_bytes(path: PathLike, error: type[RobocarError] = MapFormatError) -> bytes:
    """The content of a file; raises `error` where it is missing, no regular file, or too large."""
    path = Path(path)
    try:
        if not path.exists():
            raise error(f"{path}: no such file")
        if not path.is_file():
            raise error(f"{path}: not a file (a directory or a device)")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise error(f"{path}: {size} bytes, at most {MAX_BYTES} are read")
        return path.read_bytes()
    except (OSError, ValueError) as failure:  # ValueError: a null byte in the path
        raise error(f"{path}: cannot be read ({failure})") from failure


def read_text(path: PathLike, error: type[RobocarError] = MapFormatError) -> str:
    """The content of a UTF-8 text file, with or without a byte-order mark; line ends are left as they are."""
    data = read_bytes(path, error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        line = data.count(b"\n", 0, failure.start) + 1
        raise error(f"{path}, line {line}: byte 0x{data[failure.start]:02x} is not UTF-8 text") from failure


def text_lines(text: str) -> list[str]:
    """Lines without their ends (LF or CRLF) and without empty lines at the end of the text."""
    lines = [line.removesuffix("\r") for line in text.split("\n")]
    while lines and not lines[-1]:
        lines.pop()
    return lines


def gunzip(data: bytes, path: PathLike) -> bytes:
    """Unpacked bytes; never more than `MAX_BYTES`, however well they were packed."""
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            unpacked = stream.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as failure:
        raise MapFormatError(f"{path}: damaged or truncated gzip file ({failure})") from failure
    if len(unpacked) > MAX_BYTES:
        raise MapFormatError(f"{path}: unpacks to more than {MAX_BYTES} bytes")
    return unpacked


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
        raise ParameterError(f"resolution must be a positive number of metres per cell, not {resolution!r}")
    return float(resolution)
