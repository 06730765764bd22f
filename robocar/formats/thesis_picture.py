"""Maps as the thesis shows them (Utomo 2015, Figs 4.14-4.17): unknown 0 (black), seen free 64 (dark), occupied 255 (white)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robocar.core import OccupancyGrid, OutputError
from robocar.formats.files import write_atomically
from robocar.reading import PathLike

UNKNOWN_GREY, FREE_GREY, OCCUPIED_GREY = 0, 64, 255


def thesis_picture(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """Grey levels of a map, (rows, cols) with the top row, that of the largest y, first."""
    levels = np.where(grid.occupied, OCCUPIED_GREY, np.where(grid.free, FREE_GREY, UNKNOWN_GREY))
    return np.ascontiguousarray(levels[::-1].astype(np.uint8))


def save_thesis_picture(grid: OccupancyGrid, path: PathLike) -> Path:
    """Write the picture as `.png` or `.pgm`, by the path's ending.

    Raises:
        OutputError: another ending, or the file cannot be written.
    """
    import cv2

    path = Path(path)
    if path.suffix not in (".png", ".pgm"):
        raise OutputError(f"{path}: a thesis picture ends with .png or .pgm")
    done, data = cv2.imencode(path.suffix, thesis_picture(grid))
    if not done:
        raise OutputError(f"{path}: the picture cannot be encoded")
    write_atomically(path, data.tobytes())
    return path
