"""Grids drawn as text: `#` wall, `.` or blank free, `?` unknown, `S` start, `G` goal; the last line is the lowest row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robocar.core import FREE, OCCUPIED, SE2, UNKNOWN, Array, MapFormatError, OccupancyGrid
from robocar.formats.files import check_cells, check_resolution, text_lines
from robocar.reading import PathLike, read_text

_WORLD = SE2()
_VALUE_OF = {"#": OCCUPIED, ".": FREE, " ": FREE, "?": UNKNOWN, "S": FREE, "G": FREE}


@dataclass(frozen=True, slots=True, eq=False)
class TextGrid:
    """A drawn grid with the centres of its start and goal cells in the world, (2,) [m], or None where it has none."""

    grid: OccupancyGrid
    start: Array | None = None
    goal: Array | None = None


def load_text_grid(path: PathLike, resolution: float = 1.0, origin: SE2 = _WORLD) -> TextGrid:
    """Load a text grid from a file, LF or CRLF; see `parse_text_grid`."""
    return parse_text_grid(read_text(path), resolution, origin, name=str(path))


def parse_text_grid(text: str, resolution: float = 1.0, origin: SE2 = _WORLD, name: str = "text grid") -> TextGrid:
    """Read a drawn grid.

    Args:
        resolution: side of a cell [m].
        origin: world_from_grid, the pose of the lower left corner.
        name: of the source, for messages.

    Raises:
        MapFormatError: no rows, ragged rows, unknown characters, or more than one `S` or `G`; the message names line and column.
        ParameterError: `resolution` is not a positive number.
    """
    resolution = check_resolution(resolution)
    lines = text_lines(text)
    if not lines or not lines[0]:
        raise MapFormatError(f"{name}, line 1: a grid must begin with a row of {_known()}, not with an empty line")
    rows, cols = len(lines), len(lines[0])
    check_cells(name, rows, cols)
    marks: dict[str, tuple[int, int]] = {}
    for number, line in enumerate(lines, start=1):
        if len(line) != cols:
            raise MapFormatError(f"{name}, line {number}: {len(line)} characters, line 1 has {cols}")
        for character in set(line) - _VALUE_OF.keys():
            where = f"{name}, line {number}, column {line.index(character) + 1}"
            raise MapFormatError(f"{where}: unknown character {character!r}, known are {_known()}")
        for mark in "SG":
            if line.count(mark) + (mark in marks) > 1:
                raise MapFormatError(
                    f"{name}, line {number}, column {line.rindex(mark) + 1}: a second {mark}, only one is allowed"
                )
            if mark in line:
                marks[mark] = (rows - number, line.index(mark))
    table = np.zeros(128, np.int8)
    for character, value in _VALUE_OF.items():
        table[ord(character)] = value
    data = table[np.frombuffer("".join(lines).encode("ascii"), np.uint8)].reshape(rows, cols)[::-1]
    grid = OccupancyGrid(data, resolution, origin)
    start, goal = (grid.world_from_cell(marks[mark]) if mark in marks else None for mark in "SG")
    return TextGrid(grid, start, goal)


def _known() -> str:
    return " ".join(repr(character) for character in _VALUE_OF)
