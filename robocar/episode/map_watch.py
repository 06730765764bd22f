"""How good the map is while it is being drawn, for the recording; and how a map is written."""

from __future__ import annotations

import math

import numpy as np

from robocar.core import FREE, OCCUPIED, SE2, UNKNOWN, MapView, OccupancyGrid, Robot
from robocar.core.truth import GroundTruth
from robocar.metrics import Eye
from robocar.metrics.map import on_common_cells, score, visible_cells

INTERVAL = 1.0
"""Between two looks at the growing map [s]."""


def decided(grid: OccupancyGrid) -> OccupancyGrid:
    """The map as map_server files show it best: free, occupied or unknown, no shades between."""
    data = np.where(grid.occupied, OCCUPIED, np.where(grid.free, FREE, UNKNOWN)).astype(np.int8)
    return OccupancyGrid(data, grid.resolution, grid.origin)


class MapWatch:
    """Judges the growing map once a second, over all that came into the robot's view until then.

    Args:
        truth: the true map with its border.
    """

    def __init__(self, truth: OccupancyGrid, robot: Robot) -> None:
        self._truth, self._eye = truth, Eye.of(robot)
        self._seen = np.zeros(truth.shape, dtype=bool)
        self._poses: list[SE2] = []
        self._next = -math.inf

    def look(self, truth: GroundTruth, view: MapView | None) -> dict[str, float]:
        """The scores by name, `map/f1` and so on; nothing where it is not time, or nothing is drawn yet."""
        self._poses.append(truth.pose)
        if view is None or truth.time < self._next or (drawn := view.grid()) is None:
            return {}
        self._next = truth.time + INTERVAL
        poses = np.array([pose.as_array() for pose in self._poses])
        self._poses = []
        self._seen |= visible_cells(self._truth, poses, self._eye.reach, self._eye.opening)
        seen = OccupancyGrid(self._seen.astype(np.int8), self._truth.resolution, self._truth.origin)
        maps, scope = on_common_cells(drawn, self._truth), on_common_cells(drawn, seen)
        if maps is None or scope is None:
            return {}
        found = score(*maps, scope[1].data > 0)
        values = {"map/f1": found.f1, "map/accuracy": found.accuracy, "map/unknown": found.unknown}
        return {name: value for name, value in values.items() if value is not None}
