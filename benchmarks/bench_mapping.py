"""The mapper's costs: a laser scan on a large map, a sonar reading, a snapshot, bytes per cell; PythonRobotics' for comparison.

Minima over repetitions, as other work on the machine only adds to them. PythonRobotics' `lidar_to_grid_map` is no package that
can be installed and its code is not to be copied, so a stand-in written from its description is measured on its own data
(`references/lidar01.csv`, 154 beams, 2 cm cells, one scan on an empty map): a Bresenham line of free cells for each beam, and
four occupied cells around its end.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from robocar.core import SE2, Array, Belief, Observation, OccupancyGrid, Scan
from robocar.core.rays import cast_rays
from robocar.estimation.mapping.mapping import MappingParameters, OccupancyMapper
from robocar.formats.lidar_csv import load_lidar_csv

BEAMS, OPENING, REACH = 570, math.radians(205.0), 5.6


def best(work: Callable[[], object], repeats: int) -> float:
    """Shortest time of one call [s]."""
    shortest = math.inf
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        shortest = min(shortest, time.perf_counter() - started)
    return shortest


def python_grid(angles: Array, ranges: Array, resolution: float) -> Array:
    """A map of one scan, as PythonRobotics' example draws it: 0.5 unknown, 0 along each beam, 1 around its end."""
    ends = np.stack([np.cos(angles), np.sin(angles)], axis=1) * ranges[:, None]
    low, high = ends.min(axis=0) - 1.0, ends.max(axis=0) + 1.0
    cols, rows = (round(n) for n in (high - low) / resolution)
    grid = np.full((cols, rows), 0.5)
    centre = tuple(round(v) for v in -low / resolution)
    for x, y in ends:
        i, j = round((x - low[0]) / resolution), round((y - low[1]) / resolution)
        for a, b in _bresenham(centre, (i, j)):
            grid[a, b] = 0.0
        grid[i, j] = grid[i + 1, j] = grid[i, j + 1] = grid[i + 1, j + 1] = 1.0
    return grid


def _bresenham(start: tuple[int, int], end: tuple[int, int]) -> list[tuple[int, int]]:
    """Cells of a line (Bresenham 1965)."""
    (x, y), (x1, y1) = start, end
    dx, dy = abs(x1 - x), -abs(y1 - y)
    sx, sy = (1 if x < x1 else -1), (1 if y < y1 else -1)
    error, cells = dx + dy, []
    while True:
        cells.append((x, y))
        if (x, y) == (x1, y1):
            return cells
        twice = 2 * error
        if twice >= dy:
            error += dy
            x += sx
        if twice <= dx:
            error += dx
            y += sy


def large_map() -> tuple[OccupancyMapper, OccupancyGrid]:
    """A mapper whose map has 1000 x 1000 cells and more, and its world: rooms of 4 m with doors of 1 m."""
    data = np.zeros((1000, 1000), dtype=np.int8)
    data[::80, :] = data[:, ::80] = 100
    for k in range(30, 1000, 80):
        data[k : k + 20, ::80] = data[::80, k : k + 20] = 0
    mapper = OccupancyMapper(True, True)
    for x, y in ((6.0, 6.0), (44.0, 44.0)):  # scans from two corners stretch the map over the whole world
        scan = Scan(0.0, np.full(4, 5.9), np.array([0.0, 0.5, 1.0, 1.5]) * math.pi, 6.0)
        mapper.update(Belief(SE2(x, y)), Observation(0.0, lidar=scan))
    return mapper, OccupancyGrid(data, 0.05)


def main(repeats: int = 300) -> None:
    """Prints the table."""
    mapper, world = large_map()
    pose = SE2(26.0, 26.0, 0.3)
    bearings = OPENING * (np.arange(BEAMS) / (BEAMS - 1) - 0.5)
    ranges = cast_rays(world, world.occupied, pose.position, bearings + pose.theta, REACH)
    laser = Observation(0.0, lidar=Scan(0.0, ranges, bearings, REACH))
    mapper.update(Belief(pose), laser)
    grid = mapper.grid()
    assert grid is not None
    print(f"map of {grid.shape[1]} x {grid.shape[0]} cells, {mapper.nbytes / grid.data.size:.0f} bytes a cell")
    sonar = Observation(0.0, sonars=(Scan(0.0, np.array([2.0]), np.zeros(1), 5.0, math.radians(15.0)),))
    laser_time = best(lambda: mapper.update(Belief(pose), laser), repeats)
    sonar_time = best(lambda: mapper.update(Belief(pose), sonar), repeats)
    print(f"laser scan, {BEAMS} beams, 5.6 m: {1e3 * laser_time:7.3f} ms (target 1 ms)")
    print(f"sonar reading, 2 m:             {1e3 * sonar_time:7.3f} ms (target 0.1 ms)")

    def look() -> None:
        mapper.update(Belief(pose), laser)
        mapper.grid()

    print(f"laser scan and a snapshot:      {1e3 * best(look, max(10, repeats // 10)):7.3f} ms")

    data = Path(os.environ.get("ROBOCAR_DATA") or Path(__file__).resolve().parents[1].parent / "shared" / "data")
    file = data / "references" / "lidar01.csv"
    if not file.is_file():
        print(f"no {file.name}: set ROBOCAR_DATA for the comparison with PythonRobotics")
        return
    (observation,) = load_lidar_csv(file).observations
    assert observation.lidar is not None
    scan = observation.lidar

    def ours() -> None:
        fine = OccupancyMapper(True, False, parameters=MappingParameters(resolution=0.02))
        fine.update(Belief(SE2()), observation)
        fine.grid()

    mine = best(ours, repeats)
    theirs = best(lambda: python_grid(scan.bearings, scan.ranges, 0.02), max(5, repeats // 30))
    print(f"lidar01.csv, empty map to picture: {1e3 * mine:.3f} ms")
    print(f"cell by cell in Python:            {1e3 * theirs:.3f} ms, {theirs / mine:.0f} times as long")


if __name__ == "__main__":
    main()
