"""Worlds drawn after the figures of the safe-direction paper, and how runs in them are judged."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robocar.core import OCCUPIED, SE2, Array, Footprint, OccupancyGrid
from robocar.core.distance import ClearanceField
from robocar.formats import save_ros_map

RESOLUTION = 0.05  # [m]
Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 [m]."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A world of axis-parallel boxes with a wall of one cell around it.

    Args:
        size: width and height [m]; boxes: obstacles; start: x, y, heading; goal: x, y.
        lidar: the fit-out; movers: as in a scenario file.
    """

    size: tuple[float, float]
    boxes: Sequence[Box]
    start: tuple[float, float, float]
    goal: tuple[float, float]
    lidar: str = "hokuyo"
    time_limit: float = 180.0
    movers: Sequence[Mapping[str, Any]] = field(default_factory=tuple)

    def grid(self) -> OccupancyGrid:
        """The world as a map."""
        cols, rows = (round(side / RESOLUTION) for side in self.size)
        data = np.zeros((rows, cols), dtype=np.int8)
        data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
        for x0, y0, x1, y1 in self.boxes:
            data[round(y0 / RESOLUTION) : round(y1 / RESOLUTION), round(x0 / RESOLUTION) : round(x1 / RESOLUTION)] = OCCUPIED
        return OccupancyGrid(data, RESOLUTION)

    def scenario(self, name: str, folder: Path) -> dict[str, Any]:
        """The scenario; its map is written to `folder`. The car is told nothing of it."""
        folder.mkdir(parents=True, exist_ok=True)
        save_ros_map(self.grid(), folder / name)
        return {
            "name": name,
            "map": str((folder / f"{name}.yaml").resolve()),
            "prior": "none",
            "start": list(self.start),
            "goal": list(self.goal),
            "robot": {"lidar": self.lidar, "sonars": "none"},
            "movers": [dict(mover) for mover in self.movers],
            "time_limit": self.time_limit,
            "defaults": {"navigator": "safe-direction", "estimator": "truth", "mapper": "none"},
        }


FIGURES: dict[str, Drawn] = {
    # An obstacle near the goal stands behind another one and is not seen from the start.
    "figure-8": Drawn(
        (6.0, 5.0),
        [(1.6, 1.8, 2.6, 2.8), (3.9, 2.4, 4.4, 3.2), (2.8, 4.0, 3.4, 5.0)],
        (0.6, 0.8, 0.6),
        (5.2, 4.0),
    ),
    # Obstacles on both sides of a way that is wide enough to choose how near to pass.
    "figure-9": Drawn(
        (7.0, 4.0),
        [(1.5, 0.0, 2.0, 1.9), (3.2, 2.0, 3.7, 4.0), (4.9, 0.0, 5.4, 1.9)],
        (0.6, 0.7, 0.5),
        (6.3, 0.8),
    ),
    # A culdesac between start and goal.
    "figure-10": Drawn(
        (6.5, 6.0),
        [(2.0, 1.8, 4.4, 1.95), (2.0, 4.05, 4.4, 4.2), (4.25, 1.8, 4.4, 4.2)],
        (2.6, 3.0, 0.0),
        (5.7, 3.0),
    ),
    # The nearer way round is closed by a wall that begins out of range.
    "figure-11": Drawn(
        (8.0, 6.0),
        [(2.0, 2.2, 6.0, 3.4), (5.85, 3.4, 6.0, 6.0)],
        (1.0, 3.2, 0.0),
        (7.2, 3.4),
    ),
    # Many obstacles of different size.
    "figure-12": Drawn(
        (9.0, 7.0),
        [(1.4, 0.0, 1.8, 2.2), (1.2, 3.4, 2.6, 4.2), (3.0, 1.2, 4.2, 2.0), (3.4, 4.8, 3.8, 7.0), (4.6, 3.0, 5.4, 3.9),
         (5.6, 0.0, 6.0, 1.6), (5.4, 5.2, 6.8, 5.7), (6.8, 2.2, 7.3, 4.0), (0.0, 5.4, 1.4, 5.8)],
        (0.6, 0.7, 1.2),
        (8.3, 6.2),
        time_limit=240.0,
    ),
    # A corridor of 1 m with two bends, for the distance to its middle line.
    "corridor": Drawn((9.0, 5.0), [(0.0, 0.0, 9.0, 1.0), (0.0, 2.0, 4.0, 5.0), (5.0, 0.0, 9.0, 3.0), (0.0, 4.0, 9.0, 5.0)],
                      (0.7, 1.5, 0.0), (8.2, 3.5)),
}  # fmt: skip

MIDDLE = (((1.5, 1.5), (3.0, 1.5)), ((6.0, 3.5), (7.6, 3.5)))
"""The corridor's straight stretches, its width off bends and the goal: ends of the middle line [m]."""


def culdesac(depth: float) -> Drawn:
    """A culdesac 2 m wide and `depth` [m] deep, the car at its mouth."""
    x1 = 2.0 + depth
    return Drawn(
        (x1 + 2.1, 5.6),
        [(2.0, 1.65, x1, 1.8), (2.0, 3.8, x1, 3.95), (x1 - 0.15, 1.65, x1, 3.95)],
        (2.0, 2.8, 0.0),
        (x1 + 1.3, 2.8),
        time_limit=300.0,
    )


def path_clearance(points: Array, grid: OccupancyGrid) -> Array:
    """Distance from points (n, 2) [m] to the nearest wall [m], (n,)."""
    return ClearanceField(grid, grid.occupied).points(np.ascontiguousarray(points))


def outline_clearance(points: Array, grid: OccupancyGrid, outline: Footprint) -> float:
    """Least distance [m] of the outline to a wall on a way over points (n, 2) [m], looking from each to the next."""
    field, least = ClearanceField(grid, grid.occupied), math.inf
    for here, there in itertools.pairwise(points):
        heading = math.atan2(there[1] - here[1], there[0] - here[0])
        least = min(least, field.footprint(outline.at(SE2(here[0], here[1], heading))))
    return least


def middle_error(points: Array) -> Array:
    """Distances [m] from the middle line of the corridor's stretches, of those points (n, 2) [m] that lie beside one."""
    found = []
    for (x0, y0), (x1, y1) in MIDDLE:
        along = np.array([x1 - x0, y1 - y0])
        length = float(np.hypot(*along))
        away = points - (x0, y0)
        share = away @ along / length**2
        across = (away[:, 0] * along[1] - away[:, 1] * along[0]) / length
        found.append(across[(share >= 0.0) & (share <= 1.0) & (np.abs(across) < 0.5)])
    return np.concatenate(found)
