"""Grids on the floor: the one place that converts between cells and metres.

Row 0 has the lowest y, column 0 the lowest x of the grid's own frame; the frame's origin is the outer corner of cell (0, 0), and
may be shifted and rotated against the world (map_server's `origin`). Image files store rows from the top: the one flip is in
`robocar.formats`, and its mirror in `robocar.recording`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core.errors import OutsideMap
from robocar.core.geometry import SE2, Array, frozen_array

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of an occupancy grid; between free and occupied lies the probability in percent."""

INSCRIBED, LETHAL, NO_INFORMATION = 253, 254, 255
"""Nav2's costs of a costmap: 0 free ... 252, inscribed (the robot's centre must not be there), lethal, unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """Numbers on square cells.

    Args:
        data: (rows, cols), any number type; kept read-only.
        resolution: side of a cell [m].
        origin: world_from_grid, the pose of the outer corner of cell (0, 0).
    """

    data: NDArray
    resolution: float
    origin: SE2 = SE2()

    def __post_init__(self) -> None:
        data = self.data if isinstance(self.data, np.ndarray) else np.asarray(self.data)
        if data.ndim != 2 or data.size == 0:
            raise ValueError(f"a grid needs rows and columns, not shape {data.shape}")
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise ValueError(f"the resolution must be a positive number of metres, not {self.resolution}")
        object.__setattr__(self, "data", frozen_array(data, data.dtype))

    def with_data(self, data: NDArray) -> GridMap:
        """A plain grid of the same place with other numbers, (rows, cols)."""
        if data.shape != self.data.shape:
            raise ValueError(f"data of shape {data.shape} on a grid of shape {self.data.shape}")
        return GridMap(data, self.resolution, self.origin)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)"""
        return self.data.shape  # type: ignore[return-value]

    @property
    def size(self) -> tuple[float, float]:
        """Extent along the grid's x and y [m]."""
        rows, cols = self.shape
        return cols * self.resolution, rows * self.resolution

    def grid_from_world(self, points: ArrayLike) -> Array:
        """World points (..., 2) [m] in continuous grid coordinates: column, row in cells, (..., 2)."""
        return self.origin.inverse().transform(points) / self.resolution

    def cell_from_world(self, points: ArrayLike) -> NDArray[np.intp]:
        """Cells (..., 2) as (row, col) that hold the points (..., 2) [m]; cells outside the grid are not an error."""
        grid = np.floor(self.grid_from_world(points)).astype(np.intp)
        return grid[..., ::-1]

    def world_from_cell(self, cells: ArrayLike) -> Array:
        """Centres (..., 2) [m] of the cells (..., 2) given as (row, col)."""
        cells = np.asarray(cells)
        return self.origin.transform((cells[..., ::-1] + 0.5) * self.resolution)

    def contains(self, cells: ArrayLike) -> NDArray[np.bool_]:
        """Whether the cells (..., 2) lie on the grid, (...)."""
        cells = np.asarray(cells)
        rows, cols = self.shape
        return (cells[..., 0] >= 0) & (cells[..., 0] < rows) & (cells[..., 1] >= 0) & (cells[..., 1] < cols)

    def cell_inside(self, point: ArrayLike, what: str = "point") -> tuple[int, int]:
        """The cell that holds one point (2,) [m].

        Raises:
            OutsideMap: the point is not on the grid; `what` names it in the message.
        """
        row, col = (int(i) for i in self.cell_from_world(point))
        rows, cols = self.shape
        if not (0 <= row < rows and 0 <= col < cols):
            x, y = np.asarray(point, dtype=float)
            corners = self.corners()
            raise OutsideMap(
                f"{what} ({x:.3f}, {y:.3f}) lies outside the map, which spans "
                f"x {corners[:, 0].min():.3f} to {corners[:, 0].max():.3f}, "
                f"y {corners[:, 1].min():.3f} to {corners[:, 1].max():.3f} m"
            )
        return row, col

    def corners(self) -> Array:
        """The four outer corners in the world, counter-clockwise from cell (0, 0), (4, 2) [m]."""
        width, height = self.size
        return self.origin.transform([[0, 0], [width, 0], [width, height], [0, height]])

    def same_place(self, other: GridMap) -> bool:
        """Whether the cells of both grids coincide."""
        return self.shape == other.shape and self.resolution == other.resolution and self.origin == other.origin


class OccupancyGrid(GridMap):
    """Occupancy in percent: -1 unknown, 0 free ... 100 occupied, (rows, cols) int8."""

    __slots__ = ()

    def __post_init__(self) -> None:
        data = np.asarray(self.data)
        if not np.all((data >= UNKNOWN) & (data <= OCCUPIED)):  # false for nan too
            raise ValueError("occupancy goes from -1 (unknown) over 0 (free) to 100 (occupied)")
        if data.dtype != np.int8:
            object.__setattr__(self, "data", data.astype(np.int8))
        super().__post_init__()

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Cells that count as obstacles: at least 65 % (Nav2's default `occupied_thresh`), (rows, cols)."""
        return self.data >= 65

    @property
    def free(self) -> NDArray[np.bool_]:
        """Cells that are known and no obstacle, (rows, cols)."""
        return (self.data >= 0) & (self.data < 65)

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """(rows, cols)"""
        return self.data < 0

    def around(self, point: ArrayLike, reach: float) -> OccupancyGrid:
        """The cells within `reach` [m] of that of a point (2,) [m], in rows and columns; of a point outside those at the edge."""
        row, col = (int(i) for i in self.cell_from_world(point))
        rows, cols = self.shape
        cells = math.ceil(reach / self.resolution)
        r0, c0 = min(max(0, row - cells), rows - 1), min(max(0, col - cells), cols - 1)
        r1, c1 = max(r0 + 1, min(rows, row + cells + 1)), max(c0 + 1, min(cols, col + cells + 1))
        origin = self.origin @ SE2(c0 * self.resolution, r0 * self.resolution)
        return OccupancyGrid(self.data[r0:r1, c0:c1], self.resolution, origin)


@dataclass(frozen=True, slots=True, eq=False)
class Costmap(GridMap):
    """Traversal costs: 0 free ... 252, 253 inscribed, 254 lethal, 255 unknown, (rows, cols) uint8.

    A cell at 253 or above must not hold the robot's centre. What unknown cells mean is decided where the costmap is made
    (`robocar.planners.costmap.layered`): a planner sees 255 as blocked, so a map that may be crossed unseen holds a low cost
    there.

    Args:
        frame: of `origin`, REP-105: `map`, or `odom`, which corrections of the pose do not move.
        walled: whether what lies beyond the edge is lethal, as it is around a map that the robot is given; else it is not known,
            as around a window that rolls along with the robot.
    """

    frame: Literal["map", "odom"] = "map"
    walled: bool = False

    def __post_init__(self) -> None:
        data = np.asarray(self.data)
        if self.frame not in ("map", "odom"):
            raise ValueError(f"a costmap's frame is 'map' or 'odom', not {self.frame!r}")
        if data.dtype != np.uint8:
            if not np.all((data >= 0) & (data <= NO_INFORMATION)):
                raise ValueError("costs go from 0 to 255")
            object.__setattr__(self, "data", data.astype(np.uint8))
        GridMap.__post_init__(self)

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """Cells where the robot's centre must not be, (rows, cols)."""
        return self.data >= INSCRIBED


def cutout(data: NDArray, row: int, col: int, shape: tuple[int, int]) -> NDArray:
    """A copy of the cells of `data` from (row, col) on, with this shape; zero where `data` has none."""
    cells = np.zeros(shape, dtype=data.dtype)
    (rows, cols), (height, width) = data.shape, shape
    r0, r1, c0, c1 = max(0, row), min(rows, row + height), max(0, col), min(cols, col + width)
    if r1 > r0 and c1 > c0:
        cells[r0 - row : r1 - row, c0 - col : c1 - col] = data[r0:r1, c0:c1]
    return cells
