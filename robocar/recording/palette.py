"""The colours of the recording: one meaning, one colour, in the map, the 3D view and the time series.

The three poses are blue, orange and green of Okabe and Ito's palette, which colour-blind readers can tell apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robocar.core import INSCRIBED, LETHAL, Costmap, GridMap, OccupancyGrid
from robocar.core.trace import PLAN_COLOR

Rgb = tuple[int, int, int]

TRUTH: Rgb = (0, 158, 115)
ODOMETRY: Rgb = (230, 159, 0)
ESTIMATE: Rgb = (0, 114, 178)
ODOMETRY_PALE: Rgb = (245, 210, 130)
ESTIMATE_PALE: Rgb = (120, 185, 225)
LEFT: Rgb = (230, 100, 90)
RIGHT: Rgb = (90, 140, 230)
COMMAND: Rgb = (204, 121, 167)
PLAN: Rgb = PLAN_COLOR
GOAL: Rgb = (220, 38, 38)
CAR_BODY: Rgb = (250, 204, 21)
WHEEL: Rgb = (38, 38, 42)
WALL: Rgb = (71, 85, 105)
SOLID: Rgb = (146, 104, 74)
MOVER: Rgb = (150, 60, 190)
BACKGROUND: Rgb = (203, 210, 219)
ECHO = (14, 165, 233, 90)
NO_ECHO = (14, 165, 233, 26)
LASER: Rgb = (220, 38, 127)
PARTICLES: Rgb = (56, 150, 220)

LANDMARKS: dict[str, Rgb] = {
    "red": (220, 38, 38),
    "green": (22, 163, 74),
    "blue": (37, 99, 235),
    "yellow": (234, 179, 8),
    "orange": (249, 115, 22),
    "magenta": (217, 70, 239),
    "purple": (126, 34, 206),
    "cyan": (6, 182, 212),
    "white": (250, 250, 250),
    "black": (20, 20, 20),
}

# Viridis at equal steps, interpolated below.
_VIRIDIS = np.array(
    [
        *([68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142]),
        *([31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37]),
    ]
)


def rgba32(color: tuple[int, ...]) -> int:
    """Colour (r, g, b) or (r, g, b, a) as Rerun's 0xRRGGBBAA."""
    red, green, blue, alpha = color if len(color) == 4 else (*color, 255)
    return (red << 24) | (green << 16) | (blue << 8) | alpha


def packed(colors: list[tuple[int, ...]]) -> NDArray[np.uint32]:
    """Several colours for Rerun, which takes a plain list of four for one colour's channels."""
    return np.array([rgba32(color) for color in colors], dtype=np.uint32)


def viridis(values: NDArray) -> NDArray[np.uint8]:
    """Colours (..., 4) RGBA of numbers (...) from the lowest to the highest; transparent where they are not finite."""
    values = np.asarray(values)
    flat = values.reshape(-1)
    parts = [flat[k : k + _PART] for k in range(0, flat.size, _PART)]  # in doubles a large grid at once takes ten times its size
    ends = [(float(known.min()), float(known.max())) for part in parts if (known := part[np.isfinite(part)]).size]
    low = min((end[0] for end in ends), default=0.0)
    span = max((end[1] for end in ends), default=0.0) - low or 1.0
    steps = np.linspace(0.0, 1.0, len(_VIRIDIS))
    colors = np.empty((flat.size, 4), dtype=np.uint8)
    for k, part in enumerate(parts):
        finite = np.isfinite(part)
        position = (np.where(finite, part, low) - low) / span
        for c in range(3):
            colors[k * _PART : k * _PART + part.size, c] = np.interp(position, steps, _VIRIDIS[:, c])
        colors[k * _PART : k * _PART + part.size, 3] = np.where(finite, 255, 0)
    return colors.reshape(*values.shape, 4)


_PART = 1 << 18  # numbers that are coloured at once


def _ramp(start: tuple[int, ...], end: tuple[int, ...], count: int) -> NDArray[np.uint8]:
    return np.linspace(start, end, count).round().astype(np.uint8)


def _world_colors() -> NDArray[np.uint8]:
    """By the occupancy's byte (-1 is 255): paper-white floor, slate walls, grey where nothing is known."""
    table = np.zeros((256, 4), dtype=np.uint8)
    table[:] = (168, 176, 187, 255)
    table[0:101] = _ramp((248, 249, 250, 255), (*WALL, 255), 101)
    return table


def _knowledge_colors(occupied: Rgb, free_alpha: int) -> NDArray[np.uint8]:
    """By the occupancy's byte, to lie over the world: what is unknown is transparent."""
    table = np.zeros((256, 4), dtype=np.uint8)
    table[0:101] = _ramp((150, 220, 255, free_alpha), (*occupied, 235), 101)
    return table


def _cost_colors() -> NDArray[np.uint8]:
    """By the cost, to lie over the world: free is transparent, then yellow to red; lethal and inscribed stand out."""
    table = np.zeros((256, 4), dtype=np.uint8)
    table[1:INSCRIBED] = _ramp((255, 214, 102, 40), (244, 132, 40, 150), INSCRIBED - 1)
    table[INSCRIBED] = (240, 110, 60, 170)
    table[LETHAL] = (200, 30, 30, 225)
    return table


WORLD = _world_colors()
PRIOR = _knowledge_colors((67, 56, 202), 0)
MAPPED = _knowledge_colors((200, 60, 20), 60)
COSTS = _cost_colors()


def grid_colors(grid: GridMap) -> NDArray[np.uint8]:
    """Colours (rows, cols, 4) RGBA of a grid that lies over the world, by what kind of grid it is."""
    if isinstance(grid, Costmap):
        return COSTS[grid.data]
    if isinstance(grid, OccupancyGrid):
        return MAPPED[grid.data.view(np.uint8)]
    return viridis(grid.data)
