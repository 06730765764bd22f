"""The local costmap: a window that rolls along with the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core import LETHAL, SE2, GridMap, Observation, OccupancyGrid, Robot
from robocar.core.grid import cutout
from robocar.planners.costmap import layered as layered
from robocar.planners.costmap.layered import LayeredCostmap, split_prior

_HERE = SE2()
_SLACK = 1 / 8  # of the window's width, how far the robot goes from its middle before it moves


@dataclass(frozen=True, slots=True)
class RollingCostmapParameters:
    """
    Args:
        local_width: of the square window, `width` and `height` of Nav2's local costmap [m].
    """

    local_width: float = 6.0

    def __post_init__(self) -> None:
        if not 0.5 <= self.local_width <= 100.0:
            raise ValueError(f"local_width must be from 0.5 to 100 m, not {self.local_width}")


class RollingCostmap(LayeredCostmap):
    """The layers of `LayeredCostmap` in a square window around the robot, in the `odom` frame.

    The window moves by whole cells, so that what was seen keeps its cell; what leaves the window is forgotten, and what enters it
    is the prior map's, or free where there is none. Where the pose jumps, because an estimator corrects itself, what was seen
    stays where it is around the robot, and only the prior map is laid under it anew.

    Args:
        prior: the map that the robot is given, or None; the window's cells are as large as its cells, split alike.
        robot: for its inscribed radius.
    """

    frame = "odom"

    def __init__(
        self,
        prior: OccupancyGrid | None,
        robot: Robot,
        layers: layered.CostmapParameters | None = None,
        parameters: RollingCostmapParameters | None = None,
    ) -> None:
        layers = layers or layered.CostmapParameters()
        if prior is None:
            self._static = GridMap(np.zeros((1, 1), dtype=np.uint8), layers.resolution)
        else:
            obstacles, resolution = split_prior(prior, layers)
            edge = resolution if layers.walled else 0.0
            if layers.walled:
                obstacles = np.pad(obstacles, 1, constant_values=LETHAL)
            self._static = GridMap(obstacles, resolution, prior.origin @ SE2(-edge, -edge))
        self._cells = max(8, round((parameters or RollingCostmapParameters()).local_width / self._static.resolution))
        self._corner = (0, 0)  # of the window, (row, col) of the lattice: the static map's, its origin taken for a pose in `odom`
        self._map_from_odom = SE2()  # by which the prior map lies under the window
        super().__init__(None, robot, layers)

    def clear(self) -> None:
        """Forgets everything that was seen."""
        if self._place is not None:
            self._set_ground(self._ground, self._place.resolution, self._place.origin)

    def cover(self, points: ArrayLike) -> None:
        """Does nothing: the window is where the robot is."""

    def update(self, pose: SE2, observation: Observation, map_from_odom: SE2 = _HERE) -> bool:
        """Takes in what is seen from `pose`, the robot's in the `odom` frame; returns whether costs have changed.

        The prior map is laid under the window anew whenever `map_from_odom` is another one.
        """
        before = self.version
        row, col = (int(i) for i in self._static.cell_from_world(pose.position))
        half = self._cells // 2
        middle = self._corner[0] + half, self._corner[1] + half
        far = max(abs(row - middle[0]), abs(col - middle[1])) > _SLACK * self._cells
        if map_from_odom != self._map_from_odom:
            self._map_from_odom = map_from_odom
            self._move((row - half, col - half) if self._place is None or far else self._corner)
        elif self._place is None or far:
            self._move((row - half, col - half))
        for scan in observation.scans:
            self._integrate(pose, scan)
        return self.version != before

    def _move(self, corner: tuple[int, int]) -> None:
        shape, resolution = (self._cells, self._cells), self._static.resolution
        (row, col), (row_before, col_before) = corner, self._corner
        seen = None if self._place is None else cutout(self._evidence, row - row_before, col - col_before, shape)
        ground = cutout(self._static.data, row, col, shape) if self._map_from_odom == _HERE else self._prior_at(corner)
        self._corner = corner
        origin = self._static.origin @ SE2(corner[1] * resolution, corner[0] * resolution)
        self._set_ground(ground, resolution, origin, seen)

    def _prior_at(self, corner: tuple[int, int]) -> NDArray[np.uint8]:
        """What the prior map holds at the centres of the window's cells, (n, n); nothing beyond it."""
        n, static = self._cells, self._static
        rows, cols = np.mgrid[corner[0] : corner[0] + n, corner[1] : corner[1] + n]
        cells = static.cell_from_world(self._map_from_odom.transform(static.world_from_cell(np.stack([rows, cols], axis=-1))))
        inside = static.contains(cells)
        ground = np.zeros((n, n), dtype=np.uint8)
        ground[inside] = static.data[cells[inside, 0], cells[inside, 1]]
        return ground
