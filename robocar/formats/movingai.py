"""Maps and scenarios of the MovingAI benchmarks.

Source: Sturtevant, "Benchmarks for Grid-Based Pathfinding" (2012); files have (0, 0) at the top left, x is the column, y the row.
Passable are `.`, `G` and swamp `S`: the benchmark lets agents of the ground step into swamp, but not into water `W`. For a car
that never starts in water, `W` blocks like `@`, `O` and `T`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import FREE, OCCUPIED, MapFormatError, OccupancyGrid
from robocar.core.text import shown
from robocar.formats.files import check_cells, check_resolution, text_lines
from robocar.reading import PathLike, read_text

PASSABLE = ".GS"
BLOCKED = "@OTW"


@dataclass(frozen=True, slots=True)
class ScenarioLine:
    """One query of a `.scen` file, as it stands there.

    Args:
        bucket: group of about equal lengths; no check value.
        map_name: as the file says, often with folders of its author's.
        width, height: of the map in cells.
        start, goal: (x, y) in cells, y from the top.
        optimal_length: in cells; steps cost 1 and sqrt(2), no corner is cut.
    """

    bucket: int
    map_name: str
    width: int
    height: int
    start: tuple[int, int]
    goal: tuple[int, int]
    optimal_length: float

    def cell(self, point: tuple[int, int]) -> tuple[int, int]:
        """(row, col) on the loaded grid of the file's (x, y)."""
        x, y = point
        return self.height - 1 - y, x

    @property
    def start_cell(self) -> tuple[int, int]:
        """(row, col)"""
        return self.cell(self.start)

    @property
    def goal_cell(self) -> tuple[int, int]:
        """(row, col)"""
        return self.cell(self.goal)


def load_movingai_map(path: PathLike, resolution: float = 1.0) -> OccupancyGrid:
    """Load a `.map` file, LF or CRLF; the file's last row becomes row 0.

    Args:
        resolution: side of a cell [m].

    Raises:
        MapFormatError: wrong header, ragged or missing rows, unknown characters; the message names the line.
        ParameterError: `resolution` is not a positive number.
    """
    resolution = check_resolution(resolution)
    lines = text_lines(read_text(path))
    rows, cols = _header(path, lines)
    check_cells(path, rows, cols)
    body = lines[4:]
    if len(body) < rows:
        raise MapFormatError(f"{path}: truncated, the header announces height {rows}, the file has {len(body)} rows")
    if len(body) > rows:
        raise MapFormatError(f"{path}, line {5 + rows}: the header announces height {rows}, the file has {len(body)} rows")
    for number, line in enumerate(body, start=5):
        if len(line) != cols:
            raise MapFormatError(f"{path}, line {number}: {len(line)} characters, the header announces width {cols}")
        strange = line.strip(PASSABLE + BLOCKED)
        if strange:
            where = f"{path}, line {number}, column {line.index(strange[0]) + 1}"
            raise MapFormatError(f"{where}: unknown terrain {strange[0]!r}, known are {' '.join(PASSABLE + BLOCKED)}")
    terrain = np.frombuffer("".join(body).encode("ascii"), np.uint8).reshape(rows, cols)
    passable = np.isin(terrain, np.frombuffer(PASSABLE.encode(), np.uint8))
    return OccupancyGrid(np.where(passable, FREE, OCCUPIED).astype(np.int8)[::-1], resolution)


def _header(path: PathLike, lines: list[str]) -> tuple[int, int]:
    """(rows, cols) of the four header lines; `height` and `width` may come in either order."""
    words = [line.split() for line in lines[:4]]
    if not words or words[0] != ["type", "octile"]:
        raise MapFormatError(f"{path}, line 1: must be 'type octile', not {(lines or [''])[0][:40]!r}")
    sizes: dict[str, int] = {}
    for number in (2, 3):
        line = words[number - 1] if number <= len(words) else []
        if len(line) != 2 or line[0] not in ("height", "width") or line[0] in sizes or not _is_count(line[1]):
            missing = " or ".join(f"'{name} N'" for name in ("height", "width") if name not in sizes)
            found = lines[number - 1][:40] if number <= len(lines) else "the end of the file"
            raise MapFormatError(f"{path}, line {number}: must be {missing} with N a positive integer, not {found!r}")
        sizes[line[0]] = int(line[1])
    if len(words) < 4 or words[3] != ["map"]:
        found = lines[3][:40] if len(lines) > 3 else "the end of the file"
        raise MapFormatError(f"{path}, line 4: must be 'map', not {found!r}")
    return sizes["height"], sizes["width"]


def _is_count(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) <= 9 and int(word) > 0


def load_scenarios(path: PathLike) -> list[ScenarioLine]:
    """Load a `.scen` file of version 1, tab or space separated, LF or CRLF.

    Raises:
        MapFormatError: wrong version, wrong number of fields, no numbers, points outside the map; the message names the line.
    """
    lines = text_lines(read_text(path))
    first = lines[0].split() if lines else []
    if first not in (["version", "1"], ["version", "1.0"]):
        raise MapFormatError(f"{path}, line 1: must be 'version 1', not {(lines or [''])[0][:40]!r}")
    return [_scenario(f"{path}, line {number}", line) for number, line in enumerate(lines[1:], start=2) if line.strip()]


def _scenario(where: str, line: str) -> ScenarioLine:
    # Names of maps may hold blanks where the fields are separated by tabs.
    words = line.strip().split("\t") if line.count("\t") == 8 else line.split()
    if len(words) != 9:
        raise MapFormatError(
            f"{where}: {len(words)} fields, not 9: bucket, map, width, height, start x, start y, goal x, goal y, optimal length"
        )
    names = ("bucket", "width", "height", "start x", "start y", "goal x", "goal y")
    numbers = []
    for name, word in zip(names, [words[0], *words[2:8]], strict=True):
        word = word.strip()
        if not (word.isascii() and word.isdigit() and len(word) <= 9):
            raise MapFormatError(f"{where}: {name} must be an integer from 0, not {shown(word)}")
        numbers.append(int(word))
    bucket, width, height, *points = numbers
    for name, value, size in zip(names[3:], points, (width, height, width, height), strict=True):
        if value >= size:
            raise MapFormatError(f"{where}: {name} {value} lies outside the map of {width} x {height} cells")
    try:
        length = float(words[8])
    except ValueError:
        length = math.nan
    if not (math.isfinite(length) and length >= 0):
        raise MapFormatError(f"{where}: optimal length must be a number from 0, not {shown(words[8])}")
    start_x, start_y, goal_x, goal_y = points
    return ScenarioLine(bucket, words[1].strip(), width, height, (start_x, start_y), (goal_x, goal_y), length)
