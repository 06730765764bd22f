"""Seeded random maps for tests, benchmarks and experiments.

Every map has a closed border and one free component (4-connected, so that no passage is a corner only). The same generator state
gives the same map.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from robocar.core import FREE, OCCUPIED, SE2, OccupancyGrid, ParameterError

Cells = NDArray[np.bool_]


def cave(
    rows: int,
    cols: int,
    rng: np.random.Generator,
    *,
    resolution: float = 0.05,
    origin: SE2 | None = None,
    density: float = 0.45,
    rounds: int = 5,
) -> OccupancyGrid:
    """A cave by a cellular automaton: noise, then the 4-5 rule, then the largest hollow.

    Source: Johnson, Yannakakis and Togelius, "Cellular automata for real-time generation of infinite cave levels" (2010): in each
    round a cell is rock if at least five of the 3 x 3 cells around it are.

    Args:
        rows, cols: at least 8 each.
        rng: decides everything that is random.
        resolution: side of a cell [m].
        origin: world_from_grid, by default at the world's origin.
        density: share of rock in the noise, in (0, 0.6).
        rounds: of the automaton; more rounds make smoother walls.

    Raises:
        ParameterError: a size or share outside its range.
    """
    _at_least(rows, 8, "rows")
    _at_least(cols, 8, "cols")
    if not 0 < density < 0.6:
        raise ParameterError(f"density {density} leaves no cave: choose it between 0 and 0.6")
    if rounds < 0:
        raise ParameterError(f"rounds {rounds} is negative")
    rock = rng.random((rows, cols)) < density
    for _ in range(rounds):
        padded = np.pad(rock, 1, constant_values=True).astype(np.uint8)
        around = cv2.boxFilter(padded, cv2.CV_16S, (3, 3), normalize=False)[1:-1, 1:-1]
        rock = around >= 5
    _close_border(rock)
    if not np.any(~rock):  # small dense noise can die out; a cave needs a hollow
        rock[rows // 2, cols // 2] = False
    return _grid(~_largest_component(~rock), resolution, origin)


def maze(
    rows: int, cols: int, corridor: int, rng: np.random.Generator, *, resolution: float = 0.05, origin: SE2 | None = None
) -> OccupancyGrid:
    """A perfect maze (exactly one way between any two places) with walls one cell thick, by a depth-first walk.

    Where `corridor` + 1 does not divide `rows` - 1, the wall along the far border is thicker.

    Args:
        rows, cols: at least `corridor` + 2 each.
        corridor: width of the passages, in cells.
        rng, resolution, origin: as for `cave`.

    Raises:
        ParameterError: the grid does not hold one passage.
    """
    _at_least(corridor, 1, "corridor")
    _at_least(rows, corridor + 2, "rows")
    _at_least(cols, corridor + 2, "cols")
    pitch = corridor + 1
    shape = ((rows - 1) // pitch, (cols - 1) // pitch)
    free = np.zeros((rows, cols), dtype=np.bool_)
    seen = np.zeros(shape, dtype=np.bool_)
    room = (int(rng.integers(shape[0])), int(rng.integers(shape[1])))
    seen[room] = True
    _carve(free, room, room, pitch)
    trail = [room]
    while trail:
        row, col = trail[-1]
        neighbours = [
            (r, c)
            for r, c in ((row - 1, col), (row, col - 1), (row, col + 1), (row + 1, col))
            if 0 <= r < shape[0] and 0 <= c < shape[1] and not seen[r, c]
        ]
        if not neighbours:
            trail.pop()
            continue
        chosen = neighbours[int(rng.integers(len(neighbours)))]
        seen[chosen] = True
        _carve(free, (row, col), chosen, pitch)
        trail.append(chosen)
    return _grid(~free, resolution, origin)


def rooms(
    rows: int,
    cols: int,
    rng: np.random.Generator,
    *,
    resolution: float = 0.05,
    origin: SE2 | None = None,
    smallest: int = 12,
    door: int = 8,
) -> OccupancyGrid:
    """An office floor: the rectangle is split in two again and again, each wall gets a door.

    Walls are one cell thick. A wall never ends at an older door, so every door leads from room to room.

    Args:
        rows, cols: at least `smallest` + 2 each.
        smallest: least width of a room, in cells; larger than `door`.
        door: width of the doors, in cells.
        rng, resolution, origin: as for `cave`.

    Raises:
        ParameterError: a size outside its range.
    """
    _at_least(door, 1, "door")
    _at_least(smallest, door + 1, "smallest")
    _at_least(rows, smallest + 2, "rows")
    _at_least(cols, smallest + 2, "cols")
    wall = np.zeros((rows, cols), dtype=np.bool_)
    _close_border(wall)
    opening = np.zeros((rows, cols), dtype=np.bool_)
    waiting = [(1, 1, rows - 1, cols - 1)]
    while waiting:
        r0, c0, r1, c1 = waiting.pop()
        along_rows = r1 - r0 > c1 - c0  # split the longer side
        # Transposed views let one piece of code split either way.
        walls, openings = (wall, opening) if along_rows else (wall.T, opening.T)
        lo, hi, left, right = (r0, r1, c0, c1) if along_rows else (c0, c1, r0, r1)
        places = np.array(
            [p for p in range(lo + smallest, hi - smallest) if not openings[p, left - 1] and not openings[p, right]],
            dtype=np.intp,
        )
        if len(places) == 0:
            continue
        place = int(rng.choice(places))
        start = int(rng.integers(left, right - door + 1))
        walls[place, left:right] = True
        walls[place, start : start + door] = False
        openings[place, start : start + door] = True
        if along_rows:
            waiting += [(r0, c0, place, c1), (place + 1, c0, r1, c1)]
        else:
            waiting += [(r0, c0, r1, place), (r0, place + 1, r1, c1)]
    return _grid(wall, resolution, origin)


def _carve(free: Cells, a: tuple[int, int], b: tuple[int, int], pitch: int) -> None:
    """Frees two neighbouring rooms of a maze and the wall between them."""
    (r0, c0), (r1, c1) = min(a, b), max(a, b)
    free[r0 * pitch + 1 : (r1 + 1) * pitch, c0 * pitch + 1 : (c1 + 1) * pitch] = True


def _close_border(wall: Cells) -> None:
    wall[[0, -1], :] = True
    wall[:, [0, -1]] = True


def _largest_component(free: Cells) -> Cells:
    """The largest 4-connected set of free cells."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(free.astype(np.uint8), connectivity=4)
    return labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))


def _grid(occupied: Cells, resolution: float, origin: SE2 | None) -> OccupancyGrid:
    return OccupancyGrid(np.where(occupied, OCCUPIED, FREE).astype(np.int8), resolution, origin or SE2())


def _at_least(value: int, least: int, name: str) -> None:
    if value < least:
        raise ParameterError(f"{name} is {value}; a generated map needs at least {least}")
