"""Inverse sensor models: what one range reading says about the cells of a log-odds grid.

Moravec and Elfes, High Resolution Maps from Wide Angle Sonar (1985); Thrun, Burgard and Fox, Probabilistic Robotics (2005),
section 9.2: l(cell) += log p / (1 - p) with p the probability of occupancy given this reading alone; a cell that no reading has
touched has exactly l = 0.

All lengths are in cells and all angles in the grid's frame. A reading changes each cell at most once, however many beams pass it:
beams of one scan are no independent looks at the same cell. `stamp` (rows, cols) uint8 holds `mark` where that has happened.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core.rays import advance_to, start_ray

NEVER_SEEN = np.float32(0.0)
_NUDGE = np.float32(1e-6)  # what a sum that comes to exactly 0 becomes: it has been seen
_SURFACE = 0.5  # [cells] behind the echo: the cell of the obstacle, not the one before it, whichever way the noise goes


class LaserModel(NamedTuple):
    """What a beam says.

    Args:
        max_range: of the laser [cells].
        hit_range: up to which its ends are marked [cells].
        silent_range: up to which a beam without return is free [cells].
        hit: change of the log-odds where a beam ends, > 0.
        miss: change of the log-odds of what it passed, < 0.
    """

    max_range: float
    hit_range: float
    silent_range: float
    hit: float
    miss: float


class SonarModel(NamedTuple):
    """What a reading says.

    Args:
        half_width: of the cone [rad].
        hit_range: up to which echoes are marked [cells].
        free_range: up to which the cone is cleared [cells].
        hit: log-odds that the arc's cells share.
        miss: change of the log-odds of a cell on the axis at the sensor, with an echo.
        silent_miss: the same without one.
        solid: log-odds above which a cell is known to be occupied.
    """

    half_width: float
    hit_range: float
    free_range: float
    hit: float
    miss: float
    silent_miss: float
    solid: float


@njit(cache=True)
def _add(log_odds: NDArray, row: int, col: int, change: float, low: float, high: float) -> None:
    value = np.float32(min(max(log_odds[row, col] + change, low), high))
    log_odds[row, col] = value if value != NEVER_SEEN else _NUDGE


@njit(cache=True)
def update_laser(
    log_odds: NDArray, stamp: NDArray, mark: int, x: float, y: float, theta: float, ranges: NDArray, bearings: NDArray,
    model: LaserModel, low: float, high: float,
) -> None:  # fmt: skip
    """One scan: ends of beams are occupied, what they passed is free; a cell that is both is occupied.

    A beam without return (inf) is free up to `silent_range`, one that ends beyond `hit_range` up to there; beams that are lost
    (nan), negative, or beyond `max_range` say nothing.

    Args:
        x, y, theta: the sensor's pose.
        ranges: (n,), bearings: in the sensor's frame, (n,) [rad].
        low, high: bounds of the log-odds.
    """
    rows, cols = log_odds.shape
    max_range, hit_range, silent_range, hit, miss = model
    for i in range(len(ranges)):
        reading = ranges[i]
        if not (0.0 <= reading <= min(hit_range, max_range)):
            continue
        angle = theta + bearings[i]
        if not math.isfinite(angle):
            continue
        row = math.floor(y + (reading + _SURFACE) * math.sin(angle))
        col = math.floor(x + (reading + _SURFACE) * math.cos(angle))
        if 0 <= row < rows and 0 <= col < cols and stamp[row, col] != mark:
            stamp[row, col] = mark
            _add(log_odds, row, col, hit, low, high)
    for i in range(len(ranges)):
        reading = ranges[i]
        angle = theta + bearings[i]
        if not (math.isfinite(angle) and (0.0 <= reading <= max_range or reading == math.inf)):
            continue
        reach = min(silent_range, max_range) if reading == math.inf else min(reading, hit_range)
        dx, dy = math.cos(angle), math.sin(angle)
        last_col, last_row = math.floor(x + reach * dx), math.floor(y + reach * dy)
        ray = start_ray(x, y, dx, dy)
        # The end's own cell is left alone: the echo came from its far border or from the next cell.
        for _ in range(abs(last_col - ray.col) + abs(last_row - ray.row)):
            row, col = ray.row, ray.col
            if 0 <= row < rows and 0 <= col < cols and stamp[row, col] != mark:
                stamp[row, col] = mark
                _add(log_odds, row, col, miss, low, high)
            ray = advance_to(ray, last_row, last_col)


@njit(cache=True)
def _fan(k: int, rays: int, half_width: float) -> float:
    """Angle of the k-th of an odd number of rays: from the axis outwards, so that a cell counts as what it is nearest to it."""
    side = 1.0 if k % 2 == 0 else -1.0
    return side * half_width * ((k + 1) // 2) / (rays // 2)


@njit(cache=True)
def update_sonar(
    log_odds: NDArray, stamp: NDArray, mark: int, x: float, y: float, axis: float, reading: float, model: SonarModel,
    low: float, high: float,
) -> None:  # fmt: skip
    """One reading: somewhere on the arc at its range stands something, and inside the cone before it nothing does.

    The echo's evidence is shared among the cells of the arc by how likely each of them sent it: a bell over the angle (Moravec
    and Elfes) times the odds that the map gives the cell so far (Thrun, Learning Occupancy Grid Maps with Forward Sensor
    Models, 2003: the expected responsibilities of his E-step). So an arc that crosses free space and a known wall makes the
    wall surer, and nothing else.

    Free space is believed less towards the rim and towards its end (Moravec and Elfes, E_a and E_r). A surface at grazing
    incidence sends no echo back: a farther one may answer, or none. So the cone ends, ray by ray, at cells that the map knows
    to be occupied (log-odds above `solid`); it is cleared no farther than `free_range`, since the farther it reaches the more
    of it lies behind a wall along which the sonar looks; and silence (inf) is weak evidence.

    Args:
        x, y: the sensor's place; axis: of the cone; reading: range of the echo, inf for none.
        low, high: bounds of the log-odds.
    """
    rows, cols = log_odds.shape
    half_width, hit_range, free_range, hit, miss, silent_miss, solid = model
    echo = reading <= hit_range
    change = silent_miss if reading == math.inf else miss
    reach = min(reading, free_range)
    rays = 3 + 2 * int(2.0 * half_width * (reading if echo else reach))  # half a cell apart at their ends
    if echo:
        cells = np.empty((rays, 2), dtype=np.int64)
        shares = np.empty(rays)
        n, total = 0, 0.0
        for k in range(rays):
            offset = _fan(k, rays, half_width)
            row = math.floor(y + (reading + _SURFACE) * math.sin(axis + offset))
            col = math.floor(x + (reading + _SURFACE) * math.cos(axis + offset))
            if not (0 <= row < rows and 0 <= col < cols) or stamp[row, col] == mark:
                continue
            stamp[row, col] = mark
            cells[n, 0], cells[n, 1] = row, col
            bell = max(1.0 - (offset / half_width) ** 2, 0.05) if half_width > 0.0 else 1.0
            shares[n] = bell * math.exp(log_odds[row, col])
            total += shares[n]
            n += 1
        for k in range(n):
            _add(log_odds, cells[k, 0], cells[k, 1], hit * shares[k] / total, low, high)
    for k in range(rays):
        offset = _fan(k, rays, half_width)
        angular = 1.0 - (offset / half_width) ** 2 if half_width > 0.0 else 1.0
        dx, dy = math.cos(axis + offset), math.sin(axis + offset)
        steps = int(2.0 * reach)
        for i in range(steps):
            distance = 0.5 * (i + 0.5)
            row, col = math.floor(y + distance * dy), math.floor(x + distance * dx)
            if not (0 <= row < rows and 0 <= col < cols):
                break
            known = log_odds[row, col] > solid
            if stamp[row, col] != mark:
                stamp[row, col] = mark
                radial = 1.0 - (distance / reach) ** 2
                _add(log_odds, row, col, change * angular * radial, low, high)
            if known:
                break


@njit(cache=True)
def update_disc(log_odds: NDArray, x: float, y: float, radius: float, miss: float, low: float, high: float) -> None:
    """Where the robot stands, nothing else does: the cells whose centres lie within `radius` are free."""
    rows, cols = log_odds.shape
    for row in range(max(0, math.floor(y - radius)), min(rows, math.floor(y + radius) + 1)):
        for col in range(max(0, math.floor(x - radius)), min(cols, math.floor(x + radius) + 1)):
            if math.hypot(col + 0.5 - x, row + 0.5 - y) <= radius:
                _add(log_odds, row, col, miss, low, high)


@njit(cache=True)
def write_percent(
    log_odds: NDArray, percent: NDArray, undecided_low: float, undecided_high: float, r0: int, r1: int, c0: int, c1: int
) -> None:
    """Occupancy in percent of rows r0 to r1 and columns c0 to c1 (excluded); -1 where never seen or between the two bounds."""
    for row in range(r0, r1):
        for col in range(c0, c1):
            value = log_odds[row, col]
            if value == NEVER_SEEN or undecided_low < value < undecided_high:
                percent[row, col] = -1
            else:
                percent[row, col] = round(100.0 / (1.0 + math.exp(-value)))
