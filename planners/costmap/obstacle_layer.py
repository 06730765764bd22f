"""What range sensors mark and clear on the cells around the robot; lengths in cells (`GridMap.grid_from_world`)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import LETHAL
from robocar.core.rays import advance_to, start_ray
from robocar.planners.search.grid_search import doubled

HIT, MOST = 2, 4
"""Evidence that one hit adds, which makes an obstacle, and its cap: it takes three looks through to be forgotten."""

_CLEAR_DEPTH = 0.7  # of a sonar's range, what its echo clears
_CORE = 0.6  # of a sonar's opening angle, what its echo clears and marks: the rim sees walls beside the way


@njit(cache=True)
def _note(touched: NDArray, n: int, cell: int) -> tuple[int, NDArray]:
    if n == len(touched):
        touched = doubled(touched)
    touched[n] = cell
    return n + 1, touched


@njit(cache=True)
def _set_around_hits(
    mask: NDArray, value: bool, x: float, y: float, theta: float, ranges: NDArray, bearings: NDArray, resolution: float
) -> None:
    """Sets the mask in the cells that a scan hit and in their neighbours; lengths in cells but `ranges` [m]."""
    rows, cols = mask.shape
    for i in range(len(ranges)):
        if 0.0 <= ranges[i] < math.inf:
            reading, angle = ranges[i] / resolution, theta + bearings[i]
            row, col = math.floor(y + reading * math.sin(angle)), math.floor(x + reading * math.cos(angle))
            mask[max(0, row - 1) : max(0, min(rows, row + 2)), max(0, col - 1) : max(0, min(cols, col + 2))] = value


@njit(cache=True)
def mark_laser(
    evidence: NDArray, explained: NDArray, near_hit: NDArray, touched: NDArray, x: float, y: float, theta: float, ranges: NDArray,
    bearings: NDArray, mark_reach: float, clear_reach: float, resolution: float,
) -> tuple[int, NDArray]:  # fmt: skip
    """Clears along the beams, then marks their ends; lengths in cells but `ranges` [m]. Returns cells that may have changed.

    A beam along a wall runs through cells of the wall beside the one that it hits, since ranges are noisy and cells are coarse.
    So cells beside any hit of this scan are not cleared: else the walls of corridors would crumble, thin ones to holes.
    """
    rows, cols = evidence.shape
    n = 0
    _set_around_hits(near_hit, True, x, y, theta, ranges, bearings, resolution)
    for i in range(len(ranges)):
        if not ranges[i] >= 0.0:  # dropped, or below zero by its noise
            continue
        angle = theta + bearings[i]
        dx, dy = math.cos(angle), math.sin(angle)
        # Without a return everything up to the sensor's reach is free.
        end = min(ranges[i] / resolution, clear_reach)
        last_col, last_row = math.floor(x + end * dx), math.floor(y + end * dy)
        ray = start_ray(x, y, dx, dy)
        for _ in range(abs(last_col - ray.col) + abs(last_row - ray.row)):  # all but the last cell
            row, col = ray.row, ray.col
            if 0 <= row < rows and 0 <= col < cols and evidence[row, col] > 0 and not near_hit[row, col]:
                evidence[row, col] -= 1
                if evidence[row, col] == HIT - 1:
                    n, touched = _note(touched, n, row * cols + col)
            ray = advance_to(ray, last_row, last_col)
    for i in range(len(ranges)):
        reading = ranges[i] / resolution
        if not 0.0 <= reading <= mark_reach:  # not a number, infinite, below zero or too far
            continue
        angle = theta + bearings[i]
        row, col = math.floor(y + reading * math.sin(angle)), math.floor(x + reading * math.cos(angle))
        if 0 <= row < rows and 0 <= col < cols and explained[row, col] == 0:
            evidence[row, col] = min(evidence[row, col] + HIT, MOST)
            n, touched = _note(touched, n, row * cols + col)
    _set_around_hits(near_hit, False, x, y, theta, ranges, bearings, resolution)
    return n, touched


@njit(cache=True)
def mark_sonar(
    evidence: NDArray, explained: NDArray, touched: NDArray, x: float, y: float, theta: float, ranges: NDArray, bearings: NDArray,
    half_width: float, mark_reach: float, clear_reach: float, shadow: float, resolution: float,
) -> tuple[int, NDArray]:  # fmt: skip
    """Clears the inner part of the cones, then marks their arcs and `shadow` behind them; lengths in cells but `ranges` [m]."""
    rows, cols = evidence.shape
    n = 0
    for i in range(len(ranges)):
        if not 0.0 <= ranges[i] < math.inf:
            continue
        reading = ranges[i] / resolution
        axis = theta + bearings[i]
        depth = min(_CLEAR_DEPTH * reading, clear_reach)
        cos_axis, sin_axis, cos_width = math.cos(axis), math.sin(axis), math.cos(_CORE * half_width)
        reach_x, reach_y = depth * cos_axis, depth * sin_axis
        side = depth * math.sin(_CORE * half_width) + 1.0
        for row in range(max(0, int(min(y, y + reach_y) - side)), min(rows, int(max(y, y + reach_y) + side) + 1)):
            for col in range(max(0, int(min(x, x + reach_x) - side)), min(cols, int(max(x, x + reach_x) + side) + 1)):
                if evidence[row, col] == 0:
                    continue
                dx, dy = col + 0.5 - x, row + 0.5 - y
                distance = math.hypot(dx, dy)
                if distance <= depth and dx * cos_axis + dy * sin_axis >= cos_width * distance:
                    evidence[row, col] -= 1
                    if evidence[row, col] == HIT - 1:
                        n, touched = _note(touched, n, row * cols + col)
        if reading > mark_reach:
            continue
        samples = 2 + int(4.0 * reading * half_width)  # at most half a cell apart
        known = False
        for pass_ in range(2):  # is the echo explained? if not, what does it mark?
            for k in range(samples):
                offset = half_width * (2.0 * k / (samples - 1) - 1.0)
                row = math.floor(y + reading * math.sin(axis + offset))
                col = math.floor(x + reading * math.cos(axis + offset))
                if not (0 <= row < rows and 0 <= col < cols):
                    continue
                if pass_ == 0:
                    if explained[row, col] != 0:
                        known = True
                    elif evidence[row, col] >= HIT:
                        evidence[row, col] = MOST
                        # On the rim another surface may have answered.
                        known = known or abs(offset) <= _CORE * half_width
                elif abs(offset) <= _CORE * half_width:
                    for step in range(int(2.0 * shadow) + 1):
                        behind = reading + 0.5 * step
                        row = math.floor(y + behind * math.sin(axis + offset))
                        col = math.floor(x + behind * math.cos(axis + offset))
                        if 0 <= row < rows and 0 <= col < cols and explained[row, col] == 0 and evidence[row, col] < HIT:
                            evidence[row, col] = HIT
                            n, touched = _note(touched, n, row * cols + col)
            if known:
                break
    return n, touched


@njit(cache=True)
def forget_disc(evidence: NDArray, touched: NDArray, n: int, x: float, y: float, radius: float) -> tuple[int, NDArray]:
    """Where the robot is, nothing else is."""
    rows, cols = evidence.shape
    for row in range(max(0, int(y - radius)), min(rows, int(y + radius) + 1)):
        for col in range(max(0, int(x - radius)), min(cols, int(x + radius) + 1)):
            if evidence[row, col] > 0 and math.hypot(col + 0.5 - x, row + 0.5 - y) <= radius:
                evidence[row, col] = 0
                n, touched = _note(touched, n, row * cols + col)
    return n, touched


@njit(cache=True)
def commit(evidence: NDArray, ground: NDArray, solid: NDArray, touched: NDArray, n: int) -> tuple[int, int, int, int]:
    """Brings `solid` up to date at the touched cells; returns the box (r0, r1, c0, c1) of what has changed."""
    rows, cols = evidence.shape
    r0, r1, c0, c1 = rows, 0, cols, 0
    for i in range(n):
        row, col = touched[i] // cols, touched[i] % cols
        new = ground[row, col]
        if evidence[row, col] >= HIT:
            new = max(new, np.uint8(LETHAL))
        if solid[row, col] != new:
            solid[row, col] = new
            r0, r1, c0, c1 = min(r0, row), max(r1, row + 1), min(c0, col), max(c1, col + 1)
    return r0, r1, c0, c1
