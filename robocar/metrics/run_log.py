"""What a run, or the replay of a log, leaves for its judgement: one value, from which all metrics are computed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from robocar.core import SE2, Array, Footprint, Goal, OccupancyGrid, Robot, frozen_array


class Shape(NamedTuple):
    """A mover's shadow on the floor, in its own frame: a convex polygon (k, 2) [m], counter-clockwise, grown by `radius` [m]."""

    outline: Array
    radius: float = 0.0


class Track(NamedTuple):
    """Where a mover was: x, y [m] and theta [rad], (n, 3), and its velocity in the world, [m/s] and [rad/s], (n, 3)."""

    shape: Shape
    poses: ArrayLike
    velocities: ArrayLike


@dataclass(frozen=True, slots=True)
class Eye:
    """What came into view of the robot: how far it sees [m], and its field of view around its x axis [rad]."""

    reach: float
    opening: float = math.tau

    @classmethod
    def of(cls, robot: Robot) -> Eye:
        """Its laser's, or, without one, all around up to the farthest sonar's range: cones are what is to be judged."""
        if robot.lidar is not None:
            bearings = robot.lidar.bearings
            full = len(bearings) > 1 and np.ptp(bearings) * len(bearings) / (len(bearings) - 1) >= math.tau - 1e-6
            return cls(robot.lidar.max_range, math.tau if full else float(np.ptp(bearings)))
        return cls(max((sonar.max_range for sonar in robot.sonars), default=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class DrawnMap:
    """The map that a run drew, and what it is judged by.

    Args:
        grid: the map at the end.
        truth: the true map with its border, see `robocar.scenario.scene.enclosed`.
        eye: what the robot could see.
        explored: whether the task was to draw the whole map.
    """

    grid: OccupancyGrid
    truth: OccupancyGrid
    eye: Eye
    explored: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RunLog:
    """What the loop collects, one row per control tick. What a log does not have is None.

    Args:
        time: simulated, strictly ascending, (n,) [s].
        truth_poses: (n, 3) x, y [m], theta [rad] in the map frame, nan where there is none.
        estimate_poses: the estimator's, as `truth_poses`.
        odometry_poses: of dead reckoning alone, as `truth_poses`.
        status: how the run ended, `success` where the goal was reached.
        footprint: the robot's.
        truth_twists: (n, 2) v [m/s], omega [rad/s].
        clearance: footprint to the nearest wall or mover, (n,) [m]; 0 in contact, inf where there is nothing.
        contact: whether the robot touches a wall or a mover, (n,) bool.
        standing: whether the robot stands still, (n,) bool.
        plan_time: wall time of the navigator, (n,) [s]; nan where it was not asked.
        work: what was computed for all commands together, by unit, see `robocar.core.Command`.
        grid: the true map with its border.
        start: the true pose before the first tick.
        goal: None also for tasks without one.
        wall_time: of the loop, without building the world [s].
        carried: whether an event moved the robot since the tick before (`kidnap`), (n,) bool; None becomes all False.
        discs: x, y and radius of all obstacles, (k, 3) [m], where they are round and stand on an open plane.
        covariances: of the estimate, (n, 3, 3), nan at ticks without one.
        localized: whether an estimator had to find the pose, instead of the oracle.
        movers: where the moving obstacles were, by name; None in a world without any.
        drawn: the map that was drawn; None without a mapper or before its first reading.

    Raises:
        ValueError: an array of another shape, or times that do not ascend.
    """

    time: Array
    truth_poses: Array
    estimate_poses: Array
    odometry_poses: Array
    status: str
    footprint: Footprint
    truth_twists: Array | None = None
    clearance: Array | None = None
    contact: NDArray[np.bool_] | None = None
    standing: NDArray[np.bool_] | None = None
    plan_time: Array | None = None
    work: Mapping[str, int] | None = None
    grid: OccupancyGrid | None = None
    start: SE2 | None = None
    goal: Goal | None = None
    wall_time: float | None = None
    carried: NDArray[np.bool_] | None = None
    discs: Array | None = None
    covariances: Array | None = None
    localized: bool = False
    movers: Mapping[str, Track] | None = None
    drawn: DrawnMap | None = None

    @property
    def success(self) -> bool:
        """Whether the run reached its goal."""
        return self.status == "success"

    def __post_init__(self) -> None:
        n = np.size(self.time)
        if self.carried is None:
            object.__setattr__(self, "carried", np.zeros(n, dtype=bool))
        shapes = {"time": (n,), "truth_poses": (n, 3), "truth_twists": (n, 2), "estimate_poses": (n, 3), "odometry_poses": (n, 3)}
        shapes |= {"clearance": (n,), "plan_time": (n,), "covariances": (n, 3, 3)}
        flags = {"contact": (n,), "standing": (n,), "carried": (n,)}
        for name, shape in {**shapes, **flags}.items():
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, _rows(name, values, shape, bool if name in flags else float))
        for name, track in (self.movers or {}).items():
            for part in ("poses", "velocities"):
                _rows(f"{part} of mover {name!r}", getattr(track, part), (n, 3), float)
        if not np.all(np.diff(self.time) > 0):
            raise ValueError("the times of a run must ascend strictly")


def _rows(name: str, values: ArrayLike, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray:
    """Read-only and of this shape.

    Raises:
        ValueError: they are not.
    """
    array = frozen_array(values, dtype)
    if shape[0] == 0 and array.size == 0:
        array = frozen_array(array.reshape(shape), array.dtype)
    if array.shape != shape:
        raise ValueError(f"{name} of shape {array.shape} where {shape[0]} ticks need {shape}")
    return array
