"""What a car with sonars knows of obstacles: a prior map and the echoes since, on a fine grid.

The echo of a 15 degree cone does not say where on its arc the surface is. Each reading therefore marks the middle of its arc
and takes back what lies nearer: neighbouring readings that look past a wrong mark clear it, and what stays explains all of them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from robocar.core import LETHAL, SE2, Array, Costmap, OccupancyGrid, Scan
from robocar.core.compiling import warm_up
from robocar.planners.geometry.surfaces import REACH, surfaces

FINE = 0.025  # [m] resolution of the grid on which echoes are gathered
_HIT, _MOST, _LEAST = 2, 6, -6  # evidence from which on a fine cell counts as an obstacle, and its bounds
_PRIOR = 100  # evidence of what the prior map shows: never taken back
_EXPLAINED = -_PRIOR  # beside it: echoes from here are the prior's, never marked


@njit(cache=True)
def _mark_cone(
    evidence: NDArray[np.int8],
    col: float,
    row: float,
    heading: float,
    reading: float,
    half_angle: float,
    free_reach: float,
    tolerance: float,
) -> None:
    """One echo on the fine grid; all lengths in fine cells, angles in the grid's frame.

    Cells in the middle of the arc gain evidence, nearer ones lose more. The echo came from somewhere on the arc; what was
    marked wrongly
    is taken back by the readings next to it, which look past it: together they leave the surface that explains all of
    them (a morphological closing of the ranges by the cone).
    """
    rows, cols = evidence.shape
    reach = reading + tolerance if reading <= free_reach else free_reach
    ux, uy = math.cos(heading), math.sin(heading)
    cos_edge, cos_middle = math.cos(half_angle), math.cos(0.6 * half_angle)
    # The cone's bounding box: its apex, the ends of its edges, and the circle's extremes where the cone holds them.
    low_col, high_col, low_row, high_row = col, col, row, row
    for angle in (heading - half_angle, heading, heading + half_angle):
        x, y = col + reach * math.cos(angle) / cos_edge, row + reach * math.sin(angle) / cos_edge
        low_col, high_col = min(low_col, x), max(high_col, x)
        low_row, high_row = min(low_row, y), max(high_row, y)
    for i in range(max(0, int(low_row)), min(rows, int(high_row) + 1)):
        for j in range(max(0, int(low_col)), min(cols, int(high_col) + 1)):
            if abs(evidence[i, j]) == _PRIOR:  # decided by the prior, one way or the other
                continue
            dx, dy = j + 0.5 - col, i + 0.5 - row
            distance = math.hypot(dx, dy)
            along = dx * ux + dy * uy
            if distance > reach or along < cos_edge * distance:
                continue
            if distance < reading - 0.5:
                evidence[i, j] = max(_LEAST, evidence[i, j] - 3)
            elif along >= cos_middle * distance:
                evidence[i, j] = min(_MOST, evidence[i, j] + 2)


@njit(cache=True)
def _disc_blocked(evidence: NDArray[np.int8], col: float, row: float, radius: float) -> bool:
    """Whether an obstacle reaches into the disc on which the car turns; in fine cells."""
    rows, cols = evidence.shape
    for i in range(max(0, int(row - radius) - 1), min(rows, int(row + radius) + 2)):
        for j in range(max(0, int(col - radius) - 1), min(cols, int(col + radius) + 2)):
            if evidence[i, j] < _HIT:
                continue
            # The point of the fine cell that is nearest to the centre.
            dx = max(abs(j + 0.5 - col) - 0.5, 0.0)
            dy = max(abs(i + 0.5 - row) - 0.5, 0.0)
            if dx * dx + dy * dy < radius * radius:
                return True
    return False


@njit(cache=True)
def _way_blocked(
    evidence: NDArray[np.int8], col0: float, row0: float, col1: float, row1: float, half_width: float, front: float
) -> bool:
    """Whether an obstacle lies where the car drives straight from one point to another, `front` ahead of it included."""
    rows, cols = evidence.shape
    length = math.hypot(col1 - col0, row1 - row0)
    if length < 1e-9:
        return False
    ux, uy = (col1 - col0) / length, (row1 - row0) / length
    reach = half_width + front + 1
    for i in range(int(min(row0, row1) - reach) - 1, int(max(row0, row1) + reach) + 2):
        for j in range(int(min(col0, col1) - reach) - 1, int(max(col0, col1) + reach) + 2):
            if not (0 <= i < rows and 0 <= j < cols) or evidence[i, j] < _HIT:
                continue
            dx, dy = j + 0.5 - col0, i + 0.5 - row0
            along, across = dx * ux + dy * uy, abs(dy * ux - dx * uy)
            if -0.5 <= along <= length + front + 0.5 and across < half_width + 0.5:
                return True
    return False


class ObstacleMemory:
    """What the car knows of obstacles: the prior map, and echoes since, on a fine grid that grows as needed."""

    def __init__(
        self,
        world_from_lattice: SE2,
        extent: tuple[float, float],
        prior: OccupancyGrid | None,
        tolerance: float,
        allow_unknown: bool = True,
    ) -> None:
        """`extent` is the size along the lattice's axes [m]; a prior has the lattice's frame and extent; `tolerance` and
        `allow_unknown` see `robocar.planners.search.dynamic_a_star_parameters`."""
        self.resolution = FINE
        if prior is not None:
            split = max(1, math.ceil(prior.resolution / FINE - 1e-9))
            self.resolution = prior.resolution / split
            solid = prior.occupied if allow_unknown else prior.occupied | prior.unknown
            known = solid.repeat(split, axis=0).repeat(split, axis=1)
            outside = np.pad(known, 1, constant_values=True)
            room = np.asarray(distance_transform_edt(~outside)) * self.resolution
            self._evidence = np.where(outside, _PRIOR, np.where(room <= tolerance, _EXPLAINED, 0)).astype(np.int8)
            world_from_lattice @= SE2(-self.resolution, -self.resolution)
        else:
            rows, cols = (max(1, math.ceil(side / FINE)) for side in reversed(extent))
            self._evidence = np.zeros((rows, cols), dtype=np.int8)
        self._origin = world_from_lattice
        self._bounded = prior is not None
        _warm_up()

    def _grid_point(self, point: Array | tuple[float, float]) -> tuple[float, float]:
        """(column, row) of a world point."""
        x, y = self._origin.inverse_apply(float(point[0]), float(point[1]))
        return x / self.resolution, y / self.resolution

    def _grow(self, point: Array, reach: float) -> None:
        """Makes room for `reach` [m] around a world point; without a prior the world has no known end."""
        col, row = self._grid_point(point)
        need = math.ceil(reach / self.resolution)
        rows, cols = self._evidence.shape
        low, left = max(0, need - math.floor(row)), max(0, need - math.floor(col))
        high, right = max(0, math.ceil(row) + need - rows), max(0, math.ceil(col) + need - cols)
        if self._bounded or max(low, left, high, right) == 0:
            return
        low, left, high, right = (k + 40 if k else 0 for k in (low, left, high, right))
        self._evidence = np.pad(self._evidence, ((low, high), (left, right)))
        self._origin = self._origin @ SE2(-left * self.resolution, -low * self.resolution, 0.0)

    def mark(self, world_from_robot: SE2, scan: Scan, hit_range: float, free_range: float) -> None:
        """Takes in the echoes of a sonar or the beams of a laser; what was not heard says nothing (it may have been lost)."""
        sensor = world_from_robot @ scan.robot_from_sensor
        self._grow(sensor.position, hit_range)
        col, row = self._grid_point(sensor.position)
        half = max(0.5 * scan.beam_width, 0.5 * self.resolution / hit_range)
        heading = sensor.theta - self._origin.theta
        scale = 1.0 / self.resolution
        for reading, bearing in zip(scan.ranges, scan.bearings, strict=True):
            if math.isfinite(reading) and reading <= max(hit_range, 2 * free_range):
                seen = reading if reading <= hit_range else 1e6  # too far to mark, yet free before it
                _mark_cone(self._evidence, col, row, heading + bearing, seen * scale, half, free_range * scale, 0.02 * scale)

    def show(self, seen: OccupancyGrid) -> None:
        """Takes in a map that shows every obstacle as it is now: it replaces all echoes; the prior stays."""
        rows, cols = self._evidence.shape
        col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
        points = self._origin.transform(np.stack([col.ravel(), row.ravel()], axis=1) * self.resolution)
        cells = seen.cell_from_world(points)
        inside = seen.contains(cells)
        occupied = np.zeros(len(points), dtype=bool)
        occupied[inside] = seen.occupied[cells[inside, 0], cells[inside, 1]]
        fresh = np.where(occupied.reshape(rows, cols), _MOST, 0)
        self._evidence = np.where(np.abs(self._evidence) == _PRIOR, self._evidence, fresh).astype(np.int8)

    def disc_blocked(self, centre: tuple[float, float], radius: float) -> bool:
        """See `_disc_blocked`; in metres."""
        col, row = self._grid_point(centre)
        return bool(_disc_blocked(self._evidence, col, row, radius / self.resolution))

    def way_blocked(self, start: Array, end: Array, half_width: float, front: float) -> bool:
        """See `_way_blocked`; lengths in metres."""
        scale = 1.0 / self.resolution
        return bool(
            _way_blocked(self._evidence, *self._grid_point(start), *self._grid_point(end), half_width * scale, front * scale)
        )

    def surfaces(self, pose: SE2) -> Array:
        """See `robocar.planners.geometry.surfaces.surfaces`."""
        costs = np.where(self._evidence >= _HIT, np.uint8(LETHAL), np.uint8(0))
        return surfaces(Costmap(costs, self.resolution, self._origin, walled=self._bounded), pose, REACH)

    def forget(self) -> None:
        """Drops every echo, keeps the prior."""
        self._evidence[np.abs(self._evidence) != _PRIOR] = 0

    def echoes(self) -> Array:
        """Centres (n, 2) [m] of the fine cells that echoes mark as obstacles."""
        rows, cols = np.nonzero((self._evidence >= _HIT) & (self._evidence < _PRIOR))
        return self._origin.transform(np.stack([cols + 0.5, rows + 0.5], axis=1) * self.resolution)


@warm_up
def _warm_up() -> None:
    scratch = np.zeros((4, 4), dtype=np.int8)
    _mark_cone(scratch, 1.0, 1.0, 0.0, 2.0, 0.1, 1.0, 0.5)
    _disc_blocked(scratch, 1.0, 1.0, 1.0)
    _way_blocked(scratch, 1.0, 1.0, 2.0, 2.0, 1.0, 1.0)
