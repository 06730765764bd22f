"""Costmaps for a robot with dimension: the prior map, what the range sensors see, and the inflation of both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core import LETHAL, NO_INFORMATION, SE2, Costmap, Footprint, GridMap, Observation, OccupancyGrid, Robot, Scan
from robocar.core.compiling import trial_robot, warm_up
from robocar.core.way import length_over
from robocar.planners.costmap.inflation_layer import inflate_window, inflation_kernel
from robocar.planners.costmap.obstacle_layer import HIT, commit, forget_disc, mark_laser, mark_sonar


@dataclass(frozen=True, slots=True)
class CostmapParameters:
    """Names are Nav2's where it has them.

    Args:
        inflation_radius: from obstacles to where they cost nothing [m].
        cost_scaling_factor: how fast costs fall with the distance [1/m].
        margin: beyond the inscribed radius, the width on which costs are highest without being blocked [m].
        allow_unknown: whether unknown cells of the prior map count as free; else as obstacles.
        walled: whether the prior map is taken to have walls around its edges, as the world has them.
        obstacle_max_range: laser hits farther away are not marked [m].
        sonar_obstacle_max_range: the same for sonars, whose echoes say less the farther they come from [m].
        sonar_shadow: how deep what answers a sonar is taken to be, until an echo comes from beyond: its sides, met at grazing
            incidence, do not answer (Utomo 2015: cells of 0.3 m) [m].
        raytrace_max_range: beams clear up to here [m].
        prior_tolerance: hits this near to an obstacle of the prior map are its own, seen with errors of range and pose [m].
        resolution: cells are at most this large; coarser prior maps are split, up to `max_cells` cells [m].
        free_space: around start, goal and all that can be seen from the robot, the width of the map that grows where there is no
            prior, at least half of it: a way round everything seen so far [m].
    """

    inflation_radius: float = 0.35
    cost_scaling_factor: float = 10.0
    margin: float = 0.02
    allow_unknown: bool = True
    walled: bool = True
    obstacle_max_range: float = 2.5
    sonar_obstacle_max_range: float = 1.0
    sonar_shadow: float = 0.3
    raytrace_max_range: float = 3.0
    prior_tolerance: float = 0.1
    resolution: float = 0.05
    max_cells: int = 1_000_000
    free_space: float = 2.0

    def __post_init__(self) -> None:
        for name in ("inflation_radius", "cost_scaling_factor", "margin", "prior_tolerance", "sonar_shadow"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must not be negative, not {getattr(self, name)}")
        for name in (
            "obstacle_max_range",
            "sonar_obstacle_max_range",
            "raytrace_max_range",
            "resolution",
            "free_space",
            "max_cells",
        ):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")


def inflate(occupancy: OccupancyGrid, inscribed_radius: float, parameters: CostmapParameters | None = None) -> Costmap:
    """Costmap of a map for a robot of this inscribed radius [m]; see `inflation.inflation_kernel` for the costs.

    Occupied cells are lethal; unknown cells are free, or 255 and inflated like obstacles (`CostmapParameters.allow_unknown`).
    """
    parameters = parameters or CostmapParameters()
    solid = _solid(occupancy, parameters)
    costs = np.empty_like(solid)
    kernel = _kernel(occupancy.resolution, inscribed_radius, parameters)
    inflate_window(solid, kernel, costs, parameters.walled, 0, solid.shape[0], 0, solid.shape[1])
    return Costmap(costs, occupancy.resolution, occupancy.origin, walled=parameters.walled)


def _solid(occupancy: OccupancyGrid, parameters: CostmapParameters) -> NDArray[np.uint8]:
    solid = np.where(occupancy.occupied, LETHAL, 0).astype(np.uint8)
    if not parameters.allow_unknown:
        solid[occupancy.unknown] = NO_INFORMATION
    return solid


def split_prior(prior: OccupancyGrid, p: CostmapParameters) -> tuple[NDArray[np.uint8], float]:
    """Obstacles of a prior map (254, unknown ones 255) on cells of at most `CostmapParameters.resolution`, and their side [m]."""
    split = math.ceil(prior.resolution / p.resolution - 1e-9)
    split = max(1, min(split | 1 if split > 1 else 1, math.isqrt(p.max_cells // prior.data.size)))
    return _solid(prior, p).repeat(split, axis=0).repeat(split, axis=1), prior.resolution / split


def _kernel(resolution: float, inscribed_radius: float, p: CostmapParameters) -> NDArray[np.uint8]:
    return inflation_kernel(resolution, inscribed_radius, p.margin, p.inflation_radius, p.cost_scaling_factor)


def safe_cost(p: CostmapParameters, footprint: Footprint, resolution: float) -> float:
    """A robot in a cell that costs less touches nothing, wherever in the cell it is and however it is turned.

    0 where the inflation does not reach that far: then no cost says so.
    """
    distance = footprint.circumscribed_radius + math.sqrt(0.5) * resolution
    if distance > p.inflation_radius:
        return 0.0
    decay = math.exp(-p.cost_scaling_factor * max(distance - footprint.inscribed_radius - p.margin, 0.0))
    return float(math.floor(252.0 * decay))


class LayeredCostmap:
    """Prior map and obstacle layer, inflated.

    Hits mark cells and looks through them clear them again; the prior map's own obstacles stay. A laser clears along its beams. A
    sonar marks the inner part of its arc at the range heard and a little behind it, unless something known lies on the arc that
    explains the echo. An echo clears only the inner part of the cone well short of its range and silence clears nothing, since
    echoes get lost at grazing incidence.

    Without a prior map everything is free until seen otherwise, on a grid that covers the points given and grows with the way.

    Args:
        prior: the map that the robot is given, or None.
        robot: for its inscribed radius.
    """

    frame: ClassVar[Literal["map", "odom"]] = "map"

    def __init__(self, prior: OccupancyGrid | None, robot: Robot, parameters: CostmapParameters | None = None) -> None:
        self.parameters = parameters or CostmapParameters()
        self.prior = prior
        self.inscribed_radius = robot.footprint.inscribed_radius
        p = self.parameters
        self._mark_reach = p.obstacle_max_range if robot.lidar is not None else p.sonar_obstacle_max_range
        self.version = 0
        self._place: GridMap | None = None
        _warm_up()
        self.clear()

    def clear(self) -> None:
        """Forgets everything that was seen."""
        if self.prior is not None:
            self._set_ground(*split_prior(self.prior, self.parameters), self.prior.origin)
        elif self._place is not None:
            self._set_ground(np.zeros_like(self._solid), self._place.resolution, self._place.origin)

    def cover(self, points: ArrayLike) -> None:
        """Without a prior map: grows the grid so that world points (n, 2) [m] have free space around them."""
        if self.prior is not None:
            return
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        resolution, room = self.parameters.resolution, self.parameters.free_space
        if self._place is None:
            low, high = points.min(axis=0) - room, points.max(axis=0) + room
            cols, rows = np.ceil((high - low) / resolution).astype(int)
            self._set_ground(np.zeros((rows, cols), dtype=np.uint8), resolution, SE2(low[0], low[1]))
            return
        at = self._place.grid_from_world(points)
        rows, cols = self._place.shape
        # Grown by twice the room once half of it is used up, so that it happens seldom.
        room /= resolution
        low, high = at.min(axis=0) - room / 2, at.max(axis=0) + room / 2
        left, bottom = (math.ceil(room - v) if v < 0 else 0 for v in low)
        right = math.ceil(high[0] - cols + room) if high[0] > cols else 0
        top = math.ceil(high[1] - rows + room) if high[1] > rows else 0
        if left or bottom or right or top:
            evidence = np.pad(self._evidence, ((bottom, top), (left, right)))
            origin = self._place.origin @ SE2(-left * resolution, -bottom * resolution)
            self._set_ground(np.zeros(evidence.shape, dtype=np.uint8), resolution, origin, evidence)

    def update(self, pose: SE2, observation: Observation) -> bool:
        """Takes in what is seen from `pose`, the robot's in the map frame; returns whether costs have changed."""
        before = self.version
        # Walls that ran to the edge of the map would close a room that is open beyond it.
        reach = self._mark_reach
        self.cover([(pose.x - reach, pose.y - reach), (pose.x + reach, pose.y + reach)])
        for scan in observation.scans:
            self._integrate(pose, scan)
        return self.version != before

    def unknown_length(self, points: ArrayLike) -> float:
        """How much of a polyline (n, 2) [m] leads over cells that the prior map does not know [m]."""
        return 0.0 if self.prior is None else length_over(self.prior, self.prior.unknown, points)

    def costmap(self) -> Costmap:
        """The costs as they are now; the same object until they change.

        Raises:
            ValueError: there is no prior map, and neither `cover` nor `update` was called.
        """
        if self._place is None:
            raise ValueError("without a prior map the costmap needs `cover` or `update` first, to know its place")
        if self._costmap is None:
            costs = self._costs.copy()
            costs.flags.writeable = False
            self._costmap = Costmap(costs, self._place.resolution, self._place.origin, self.frame, self._walled)
        return self._costmap

    def _set_ground(
        self, ground: NDArray[np.uint8], resolution: float, origin: SE2, evidence: NDArray[np.int8] | None = None
    ) -> None:
        """Starts on the prior's obstacles, `ground` is 0, 254 or 255, (rows, cols), and on what has been seen there."""
        rows, cols = ground.shape
        self._place = GridMap(np.broadcast_to(np.uint8(0), (rows, cols)), resolution, origin)
        self._grid_from_world = origin.inverse()
        self._ground, self._solid = ground, ground.copy()
        self._evidence = np.zeros((rows, cols), dtype=np.int8) if evidence is None else evidence
        np.maximum(self._solid, LETHAL, out=self._solid, where=self._evidence >= HIT)
        self._near_hit = np.zeros((rows, cols), dtype=np.bool_)
        self._costs = np.empty((rows, cols), dtype=np.uint8)
        self._kernel = _kernel(resolution, self.inscribed_radius, self.parameters)
        # Cells whose hits the prior map explains; the tolerance is drawn around its obstacles like an inflation.
        near = inflation_kernel(resolution, self.parameters.prior_tolerance, 0.0, 0.0, 0.0)
        self._explained = np.empty((rows, cols), dtype=np.uint8)
        self._walled = self.parameters.walled and self.prior is not None
        obstacles = np.where(ground == LETHAL, ground, 0).astype(np.uint8)
        inflate_window(obstacles, near, self._explained, self._walled, 0, rows, 0, cols)
        self._touched = np.empty(1024, dtype=np.int64)
        self._inflate(0, rows, 0, cols)

    def _inflate(self, r0: int, r1: int, c0: int, c1: int) -> None:
        """Recomputes the costs that obstacles in rows r0 to r1 and columns c0 to c1 (excluded) reach."""
        k = self._kernel.shape[0] // 2
        rows, cols = self._solid.shape
        box = max(0, r0 - k), min(rows, r1 + k), max(0, c0 - k), min(cols, c1 + k)
        inflate_window(self._solid, self._kernel, self._costs, self._walled, *box)
        self._costmap: Costmap | None = None
        self.version += 1

    def _integrate(self, pose: SE2, scan: Scan) -> None:
        assert self._place is not None
        p, resolution = self.parameters, self._place.resolution
        grid_from_sensor = self._grid_from_world @ pose @ scan.robot_from_sensor
        grid_from_robot = self._grid_from_world @ pose
        x, y, theta = grid_from_sensor.x / resolution, grid_from_sensor.y / resolution, grid_from_sensor.theta
        ranges, bearings = np.array(scan.ranges), np.array(scan.bearings)  # contiguous and writable: one compiled version for all
        evidence, reach = self._evidence, p.raytrace_max_range / resolution
        if scan.beam_width > 0.0:
            n, self._touched = mark_sonar(
                evidence, self._explained, self._touched, x, y, theta, ranges, bearings, scan.beam_width / 2,
                p.sonar_obstacle_max_range / resolution, reach, p.sonar_shadow / resolution, resolution,
            )  # fmt: skip
        else:
            n, self._touched = mark_laser(
                evidence, self._explained, self._near_hit, self._touched, x, y, theta, ranges, bearings,
                p.obstacle_max_range / resolution, min(reach, scan.max_range / resolution), resolution,
            )  # fmt: skip
        n, self._touched = forget_disc(
            evidence, self._touched, n, grid_from_robot.x / resolution, grid_from_robot.y / resolution,
            self.inscribed_radius / resolution,
        )  # fmt: skip
        r0, r1, c0, c1 = commit(evidence, self._ground, self._solid, self._touched, n)
        if r1 > r0:
            self._inflate(r0, r1, c0, c1)


@warm_up
def _warm_up() -> None:
    layer = LayeredCostmap(None, trial_robot())
    for beam_width in (0.0, 0.3):
        scan = Scan(0.0, np.array([1.0]), np.array([0.0]), 5.0, beam_width)
        layer.update(SE2(), Observation(0.0, lidar=scan))
