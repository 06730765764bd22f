"""Maps judged against the world that they show: at the end of a run, and while it goes on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robocar.core import (
    FREE,
    OCCUPIED,
    SE2,
    UNKNOWN,
    Belief,
    Command,
    Mapper,
    Observation,
    OccupancyGrid,
    ParameterError,
    Robot,
    Scalar,
)
from robocar.core.truth import GroundTruth
from robocar.estimation.mapping.no_mapper import NoMapper
from robocar.metrics.map import Eye, enclosed, on_common_cells, score, summarize_map, visible_cells
from robocar.metrics.run import Metric
from robocar.recording import Recorder
from robocar.scenario.scene import Scene

INTERVAL = 1.0
"""Between two looks at the growing map [s]."""


def explores(navigator: object, mapper: Mapper) -> bool:
    """Whether a navigator draws a map instead of going to the scenario's goal: it says so by an attribute `explores`.

    Raises:
        ParameterError: it does, and nothing draws a map.
    """
    asked = bool(getattr(navigator, "explores", False))
    if asked and isinstance(mapper, NoMapper):
        raise ParameterError("a navigator that explores needs a map: --mapper laser or --mapper sonar")
    return asked


def map_metrics(mapper: Mapper, scene: Scene, robot: Robot, poses: ArrayLike, explored: bool) -> dict[str, Metric]:
    """`map/*` of a run with a mapper, see `summarize_map`; nothing without one or before its first reading.

    Args:
        poses: true ones, (n, 3) x, y [m], theta [rad].
    """
    drawn = mapper.grid()
    if drawn is None:
        return {}
    values = summarize_map(drawn, _truth(scene), poses, robot.footprint.inscribed_radius, Eye.of(robot), explored)
    return {name: Metric(value=value, unit=unit) for name, (value, unit) in values.items()}


def decided(grid: OccupancyGrid) -> OccupancyGrid:
    """The map as map_server files show it best: free, occupied or unknown, no shades between."""
    data = np.where(grid.occupied, OCCUPIED, np.where(grid.free, FREE, UNKNOWN)).astype(np.int8)
    return OccupancyGrid(data, grid.resolution, grid.origin)


def _truth(scene: Scene) -> OccupancyGrid:
    return enclosed(scene.true_grid, scene.scenario.border == "wall")


class MapWatch:
    """A recorder that adds to what another one sees: how good the map is so far, once a second, as `signals/map/*`.

    Judged over all that came into the robot's view until then.
    """

    def __init__(self, recorder: Recorder, scene: Scene, robot: Robot) -> None:
        self._recorder, self._truth, self._eye = recorder, _truth(scene), Eye.of(robot)
        self._seen = np.zeros(self._truth.shape, dtype=bool)
        self._poses: list[SE2] = []
        self._next = -math.inf

    def log(
        self,
        observation: Observation,
        belief: Belief,
        mapper: Mapper,
        command: Command,
        truth: GroundTruth | None,
        *,
        odometry: SE2 | None = None,
        planning_time: float | None = None,
    ) -> None:
        """See `Recorder.log`."""
        if truth is not None:
            self._poses.append(truth.pose)
            if observation.time >= self._next and (drawn := mapper.grid()) is not None:
                self._next = observation.time + INTERVAL
                command = replace(command, trace={**command.trace, **self._judge(drawn)})
        self._recorder.log(observation, belief, mapper, command, truth, odometry=odometry, planning_time=planning_time)

    def close(self, result: Mapping[str, Any] | None = None) -> None:
        """See `Recorder.close`."""
        self._recorder.close(result)

    def _judge(self, drawn: OccupancyGrid) -> dict[str, Scalar]:
        poses = np.array([pose.as_array() for pose in self._poses])
        self._poses = []
        self._seen |= visible_cells(self._truth, poses, self._eye.reach, self._eye.opening)
        seen = OccupancyGrid(self._seen.astype(np.int8), self._truth.resolution, self._truth.origin)
        maps, scope = on_common_cells(drawn, self._truth), on_common_cells(drawn, seen)
        if maps is None or scope is None:
            return {}
        found = score(*maps, scope[1].data > 0)
        values = {"map/f1": found.f1, "map/accuracy": found.accuracy, "map/unknown": found.unknown}
        return {name: Scalar(value, "1") for name, value in values.items() if value is not None}
