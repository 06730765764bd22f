"""What one scan says about the cells around the robot, read with caution and with hope (Trihatmo, Fig. 1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import SE2, Array, GridMap, Robot, Scan, ScenarioError

BINS = 720
"""Directions in the map frame that a panorama is kept in, half a degree each."""

_BIN = math.tau / BINS
_BRIDGED = math.radians(3.0)  # a gap between two beams up to this wide (a lost one in a dense laser) is no hole in the view
_STRAIGHT = math.cos(math.radians(15.0))  # two hits are one wall if the next one goes on in about the same direction
_GAP = math.radians(50.0)  # between two sonars of a ring: it counts as seen by both
_SILENT = 2.0  # 1 / cos(60 degrees): a wall at distance d sends no echo to a cone that meets it farther away than this times d
_BEHIND = 0.4  # [cells] behind what a noisy beam met lies the cell that it belongs to, where a wall's face is a border of cells
_STANDING = 0.05  # [m] scans from places this close together make one panorama


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """The two models of a scan on the same cells (Fig. 1c and 1d).

    Args:
        grid: the place of the cells, aligned with the map.
        free: seen and found empty, (rows, cols); all else counts as occupied for the safe direction (pessimistic).
        occupied: where a surface was seen, (rows, cols); all else counts as free for the shortest direction (optimistic).
        x, y: the robot in grid coordinates [cells].
    """

    grid: GridMap
    free: NDArray[np.bool_]
    occupied: NDArray[np.bool_]
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class Sector:
    """The part of the surroundings that the sensor looks at: `width` around straight ahead [rad], up to `reach` [m]."""

    width: float
    reach: float

    @property
    def whole(self) -> bool:
        return self.width >= math.tau - 1e-6


def sector_of(robot: Robot, view_angle: float, max_range: float) -> Sector:
    """The sector that the robot's laser covers, or its sonars where it has none, within the limits given [rad, m].

    Raises:
        ScenarioError: the robot carries neither.
    """
    if robot.lidar is not None:
        sensor, bearings = robot.lidar, robot.lidar.bearings + robot.lidar.robot_from_sensor.theta
        edges = float(bearings.min()), float(bearings.max())
        gap = (edges[1] - edges[0]) / max(len(bearings) - 1, 1)
        width = 2.0 * min(-edges[0], edges[1])
        if edges[1] - edges[0] + 1.5 * gap >= math.tau:
            width = math.tau
        return Sector(min(view_angle, max(width, gap)), min(max_range, sensor.max_range))
    if not robot.sonars:
        raise ScenarioError("safe-direction looks where it goes: it needs robot.lidar (hokuyo, scan360) or robot.sonars")
    headings = sorted(sonar.robot_from_sensor.theta for sonar in robot.sonars)
    beam = robot.sonars[0].beam_width
    around = np.diff([*headings, headings[0] + math.tau])
    width = math.tau if around.max() <= _GAP else beam + 2.0 * min(abs(headings[0]), abs(headings[-1]))
    return Sector(min(view_angle, width), min(max_range, min(sonar.max_range for sonar in robot.sonars)))


class DirectionPanorama:
    """What is seen from where the robot stands: for each direction in the map frame a distance from its centre.

    Only the last scan counts, as in the paper, and its predecessors from the same place: while the robot turns on the spot, its
    sector sweeps round, and what it has just turned away from is not forgotten until it drives on. Newer beams replace older
    ones.
    """

    def __init__(self, sector: Sector, resolution: float, join: float) -> None:
        """`join` [m]: hits of neighbouring beams that are no farther apart are one surface."""
        self.sector, self.resolution, self._join = sector, resolution, join
        self.forget()

    def forget(self) -> None:
        self.ranges = np.full(BINS, math.nan)  # [m], nan: not seen
        self.hit = np.zeros(BINS, dtype=np.bool_)  # a surface is there; else it is free up to the range
        self.surface = np.full(BINS, -1, dtype=np.int64)  # which one: neighbours with the same number are one wall
        self._stood: SE2 | None = None

    def look(self, pose: SE2, laser: Scan | None, sonars: tuple[Scan, ...]) -> bool:
        """Takes in a scan from `pose` (world_from_robot); returns whether a single beam of it tells anything."""
        if self._stood is None or self._stood.distance_to(pose) > _STANDING:
            self.forget()
            self._stood = pose
        if laser is not None:
            points, hits = self._endpoints(laser)
            pairs = _BRIDGED
        else:
            points, hits = _echoes(sonars, self.sector)
            pairs = _GAP
        seen = np.isfinite(points[:, 0])
        if not seen.any():
            return False
        points, hits = points[seen], hits[seen]
        # Surfaces of an earlier scan of the panorama have other numbers.
        first = int(self.surface.max()) + 1
        _fill(
            self.ranges, self.hit, self.surface, points, hits, pose.theta, pairs, self._join, laser is not None,
            self.sector.whole, first,
        )  # fmt: skip
        return True

    def _endpoints(self, scan: Scan) -> tuple[Array, NDArray[np.bool_]]:
        """Ends of the beams in the robot's frame, (n, 2), nan for lost ones; whether there is a surface."""
        sensor, reach = scan.robot_from_sensor, self.sector.reach
        bearings = scan.bearings + sensor.theta
        ranges = np.array(scan.ranges)
        inside = np.abs(np.remainder(bearings + math.pi, math.tau) - math.pi) <= 0.5 * self.sector.width + 1e-9
        ranges[~inside | ~(ranges >= 0.0)] = math.nan
        hits = ranges <= reach
        ends = np.minimum(ranges, reach)
        points = np.stack([sensor.x + ends * np.cos(bearings), sensor.y + ends * np.sin(bearings)], axis=1)
        return points, hits


def _echoes(sonars: tuple[Scan, ...], sector: Sector) -> tuple[Array, NDArray[np.bool_]]:
    """The edges and the middle of each sonar's cone at the range heard, (3 n, 2) in the robot's frame, sorted by heading.

    Silence may be an echo that was lost at grazing incidence, so it counts as free only up to where a wall whose foot the other
    sonars hear could be (`_SILENT`).
    """
    heard = [float(r) for scan in sonars for r in scan.ranges if math.isfinite(r)]
    trusted = min([sector.reach, *(_SILENT * r for r in heard)])
    points, hits = [], []
    for scan in sorted(sonars, key=lambda scan: scan.robot_from_sensor.theta):
        mount, reading = scan.robot_from_sensor, float(scan.ranges[0])
        if abs(mount.theta) > 0.5 * sector.width + 1e-9:
            continue
        echo = 0.0 <= reading <= sector.reach
        end = max(reading, 0.0) if echo else (math.nan if math.isnan(reading) else trusted)
        for share in (-0.5, 0.0, 0.5):
            heading = share * scan.beam_width
            points.append(mount.apply(end * math.cos(heading), end * math.sin(heading)) if end == end else (math.nan, math.nan))
            hits.append(echo)
    return np.array(points).reshape(-1, 2), np.array(hits, dtype=np.bool_)


@njit(cache=True)
def _fill(
    ranges: NDArray, hit: NDArray, surface: NDArray, points: NDArray, hits: NDArray, heading: float, bridged: float, join: float,
    thin: bool, around: bool, number: int,
) -> None:  # fmt: skip
    """Enters the ends of beams, sorted by bearing, into the directions between them.

    Between two beams that hit one surface lies that surface, else what the nearer beam in angle says. One surface it is if the
    hits are close, or, where the beams are `thin`, if a third one lies on the line through them: along a wall seen at grazing
    incidence neighbouring hits are far apart.
    """
    n = len(points)
    for j in range(n if around else n - 1):
        k = (j + 1) % n
        ax, ay, bx, by = points[j, 0], points[j, 1], points[k, 0], points[k, 1]
        ra, rb = math.hypot(ax, ay), math.hypot(bx, by)
        a = math.atan2(ay, ax)
        width = math.atan2(by, bx) - a
        width -= math.tau * math.floor(width / math.tau)
        first = math.ceil((heading + a) / _BIN)
        count = math.floor((heading + a + width) / _BIN) - first + 1
        if width > bridged:  # a gap; or the second lies before the first, seen from the robot's centre
            number += 1
            continue
        one = False
        if hits[j] and hits[k]:
            dx, dy = bx - ax, by - ay
            apart = math.hypot(dx, dy)
            one = apart <= join
            for i, m in ((j - 1, j), (k, (k + 1) % n)):
                if hits[i] and hits[m] and not one and thin:
                    ex, ey = points[m, 0] - points[i, 0], points[m, 1] - points[i, 1]
                    before = math.hypot(ex, ey)
                    one = dx * ex + dy * ey >= _STRAIGHT * apart * before and 0.0 < apart <= 2.0 * before
        for b in range(count):
            place = (first + b) % BINS
            share = ((first + b) * _BIN - heading - a) / max(width, 1e-9)
            if one:
                ranges[place], hit[place], surface[place] = (1.0 - share) * ra + share * rb, True, number
            elif share <= 0.5:
                ranges[place], hit[place], surface[place] = ra, hits[j], number
            else:
                ranges[place], hit[place], surface[place] = rb, hits[k], number + 1
        if not one:
            number += 1


@njit(cache=True)
def mark(
    ranges: NDArray, hit: NDArray, surface: NDArray, x: float, y: float, scale: float, body: float, join: float, free: NDArray,
    occupied: NDArray,
) -> None:  # fmt: skip
    """Draws a panorama on cells: rays up to the ranges are free, surfaces occupied; so is the robot's own place free.

    Args:
        x, y: the robot [cells]; scale: cells per metre; body: radius of its place [cells].
        free, occupied: (rows, cols), written to where something is seen; occupied cells are not free.
    """
    rows, cols = free.shape
    for i in range(max(0, int(y - body)), min(rows, int(y + body) + 1)):
        for j in range(max(0, int(x - body)), min(cols, int(x + body) + 1)):
            if (i + 0.5 - y) ** 2 + (j + 0.5 - x) ** 2 <= body * body:
                free[i, j] = True
    for b in range(BINS):
        if not ranges[b] >= 0.0:
            continue
        end = ranges[b] * scale
        c, s = math.cos(b * _BIN), math.sin(b * _BIN)
        # Near the robot the rays lie denser than the cells: there every second, fourth ... will do, as far as they reach.
        start = 0.0 if b % 8 == 0 else (10.0 if b % 4 == 0 else (20.0 if b % 2 == 0 else 40.0))
        for beside in (b - b % 8, (b - b % 8 + 8) % BINS):
            start = min(start, ranges[beside] * scale - 1.0 if ranges[beside] >= 0.0 else 0.0)
        start = max(start, 0.0)
        last = end - 0.5 if hit[b] else end
        for k in range(int((last - start) / 0.7) + 1 if last >= start else 0):
            row, col = int(y + (start + 0.7 * k) * s), int(x + (start + 0.7 * k) * c)
            if 0 <= row < rows and 0 <= col < cols:
                free[row, col] = True
    for b in range(BINS):
        if not (hit[b] and ranges[b] >= 0.0):
            continue
        behind = ranges[b] * scale + _BEHIND
        px, py = x + behind * math.cos(b * _BIN), y + behind * math.sin(b * _BIN)
        n, other = 0, (b + 1) % BINS
        qx, qy = px, py
        if hit[other] and ranges[other] >= 0.0:
            behind = ranges[other] * scale + _BEHIND
            qx, qy = x + behind * math.cos(other * _BIN), y + behind * math.sin(other * _BIN)
            apart = math.hypot(qx - px, qy - py)
            if surface[b] == surface[other] or apart <= join:
                n = min(int(2.0 * apart) + 1, 4 * (rows + cols))
        for k in range(n + 1):
            share = k / (n + 1)
            row, col = math.floor(py + share * (qy - py)), math.floor(px + share * (qx - px))
            if 0 <= row < rows and 0 <= col < cols:
                occupied[row, col] = True
                free[row, col] = False


def window(pose: SE2, reach: float, resolution: float) -> GridMap:
    """An empty grid around the robot that holds all that is nearer than `reach` [m], on the cells of a lattice that does not
    move, aligned with the map, with an outermost ring of cells that no reading gets to."""
    half = math.ceil(reach / resolution) + 2
    row, col = math.floor(pose.y / resolution), math.floor(pose.x / resolution)
    origin = SE2((col - half) * resolution, (row - half) * resolution)
    side = 2 * half + 1
    return GridMap(np.broadcast_to(np.uint8(0), (side, side)), resolution, origin)


def offset(inner: GridMap, outer: GridMap) -> tuple[int, int]:
    """Where cell (0, 0) of one grid lies on another of the same lattice, (row, col)."""
    r = outer.resolution
    return round((inner.origin.y - outer.origin.y) / r), round((inner.origin.x - outer.origin.x) / r)


def leading_edges(before: Readings, now: Readings) -> NDArray[np.int64]:
    """Cells (n, 2) of `now` as (row, col) with a surface where `before` had seen nothing but free floor, beside it too:
    something has moved there. Both are on the same lattice.

    Beside what was not seen then may have stood what is seen now: a wall beyond the sensor's reach, say, along which the car
    drives, and whose face is read a cell too near.
    """
    cells = np.argwhere(now.occupied)
    then = cells + offset(now.grid, before.grid)
    rows, cols = before.grid.shape
    inside = np.all((then >= 0) & (then < (rows, cols)), axis=1)
    cells, then = cells[inside], then[inside]
    empty = cv2.erode(before.free.view(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
    return cells[empty[then[:, 0], then[:, 1]]]
