"""What `robocar.planners.costmap.obstacle_layer` computes, in plain Python: cell by cell, without boxes and without state."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robocar.core import Array

HIT, MOST = 2, 4  # what a hit adds, which makes an obstacle; the cap
CLEARED, CORE = 0.7, 0.6  # of a sonar's range and of its opening angle

Cell = tuple[int, int]
Pose = tuple[float, float, float]


def inside(grid: NDArray, cell: Cell) -> bool:
    return 0 <= cell[0] < grid.shape[0] and 0 <= cell[1] < grid.shape[1]


def end_of(x: float, y: float, angle: float, length: float) -> Cell:
    return math.floor(y + length * math.sin(angle)), math.floor(x + length * math.cos(angle))


def passed(x: float, y: float, angle: float, length: float) -> list[Cell]:
    """All cells of a beam but its last one: all borders between first and last cell, in the order in which they are crossed."""
    (row, col), (last_row, last_col) = (math.floor(y), math.floor(x)), end_of(x, y, angle, length)
    dx, dy = math.cos(angle), math.sin(angle)
    along_x, along_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    crossings = [((col + along_x * k + (dx > 0) - x) / dx, 0, along_x) for k in range(abs(last_col - col))]
    crossings += [((row + along_y * k + (dy > 0) - y) / dy, along_y, 0) for k in range(abs(last_row - row))]
    cells = [(row, col)]
    for _, down, across in sorted(crossings, key=lambda crossing: crossing[0]):
        cells.append((cells[-1][0] + down, cells[-1][1] + across))
    return cells[:-1]


def look_through(evidence: NDArray, cell: Cell, changed: list[Cell]) -> None:
    """A look through a cell takes one hit's half back."""
    if evidence[cell] > 0:
        evidence[cell] -= 1
        if evidence[cell] == HIT - 1:
            changed.append(cell)


def laser(
    evidence: NDArray, explained: NDArray, pose: Pose, ranges: Array, bearings: Array, mark_reach: float, clear_reach: float
) -> list[Cell]:
    """A scan with ranges in cells; returns the cells whose state may have changed, in order."""
    x, y, theta = pose
    changed: list[Cell] = []
    beams = [(theta + b, r) for r, b in zip(ranges.tolist(), bearings.tolist(), strict=True) if r >= 0.0]  # neither nan nor below
    ends = [end_of(x, y, angle, reading) for angle, reading in beams if reading < math.inf]
    beside = {(row + i, col + j) for row, col in ends for i in (-1, 0, 1) for j in (-1, 0, 1)}
    for angle, reading in beams:
        for cell in passed(x, y, angle, min(reading, clear_reach)):
            if inside(evidence, cell) and cell not in beside:
                look_through(evidence, cell, changed)
    for angle, reading in beams:
        cell = end_of(x, y, angle, reading) if reading <= mark_reach else (-1, -1)
        if inside(evidence, cell) and not explained[cell]:
            evidence[cell] = min(evidence[cell] + HIT, MOST)
            changed.append(cell)
    return changed


def sonar(
    evidence: NDArray, explained: NDArray, pose: Pose, ranges: Array, bearings: Array, half_width: float,
    reaches: tuple[float, float], shadow: float,
) -> list[Cell]:  # fmt: skip
    """Echoes with ranges in cells; `reaches` of marking and clearing; returns as `laser`."""
    x, y, theta = pose
    mark_reach, clear_reach = reaches
    changed: list[Cell] = []
    for reading, bearing in zip(ranges.tolist(), bearings.tolist(), strict=True):
        if not 0.0 <= reading < math.inf:
            continue
        axis, depth, core = theta + bearing, min(CLEARED * reading, clear_reach), CORE * half_width
        for cell in np.ndindex(evidence.shape):
            dx, dy = cell[1] + 0.5 - x, cell[0] + 0.5 - y
            distance = math.hypot(dx, dy)
            if distance <= depth and dx * math.cos(axis) + dy * math.sin(axis) >= math.cos(core) * distance:
                look_through(evidence, (cell[0], cell[1]), changed)
        if reading > mark_reach:
            continue
        samples = 2 + int(4.0 * reading * half_width)
        offsets = [half_width * (2.0 * k / (samples - 1) - 1.0) for k in range(samples)]
        if _explains(evidence, explained, [(o, end_of(x, y, axis + o, reading)) for o in offsets], core):
            continue
        # Only from arcs that lie on the grid: what is behind one that does not is not looked for.
        for offset in (o for o in offsets if abs(o) <= core and inside(evidence, end_of(x, y, axis + o, reading))):
            for step in range(int(2.0 * shadow) + 1):
                cell = end_of(x, y, axis + offset, reading + 0.5 * step)
                if inside(evidence, cell) and not explained[cell] and evidence[cell] < HIT:
                    evidence[cell] = HIT
                    changed.append(cell)
    return changed


def _explains(evidence: NDArray, explained: NDArray, arc: list[tuple[float, Cell]], core: float) -> bool:
    """Whether something known stands on the arc; obstacles that the echo confirms get the most evidence."""
    known = False
    for offset, cell in arc:
        if not inside(evidence, cell):
            continue
        if explained[cell]:
            known = True
        elif evidence[cell] >= HIT:
            evidence[cell] = MOST
            known = known or abs(offset) <= core
    return known
