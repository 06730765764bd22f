"""Surfaces around the robot as line segments, and how near its outline comes to them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import LETHAL, SE2, Array, Costmap

FAR = 1.0
"""[m] Room is not told apart beyond this."""
REACH = 2.0
"""[m] How far around the robot surfaces matter to a manoeuvre."""

_STRAIGHT = 0.012  # [m] points that stray no farther from a line lie on it


@njit(cache=True)
def _edges(blocked: NDArray[np.bool_]) -> Array:
    """The sides between blocked cells and others, those in a line joined, (n, 4) [cells]; the frame of the grid has none."""
    rows, cols = blocked.shape
    found = np.empty((2 * rows * cols, 4))
    n = 0
    for row in range(1, rows):
        start = -1
        for col in range(cols + 1):
            edge = col < cols and blocked[row - 1, col] != blocked[row, col]
            if edge and start < 0:
                start = col
            elif not edge and start >= 0:
                found[n] = start, row, col, row
                n, start = n + 1, -1
    for col in range(1, cols):
        start = -1
        for row in range(rows + 1):
            edge = row < rows and blocked[row, col - 1] != blocked[row, col]
            if edge and start < 0:
                start = row
            elif not edge and start >= 0:
                found[n] = col, start, col, row
                n, start = n + 1, -1
    return found[:n].copy()


def surfaces(costmap: Costmap | None, pose: SE2, reach: float) -> Array:
    """Where lethal or unknown cells, or what lies beyond a walled map, within `reach` [m] of the robot begin, as segments
    (x0, y0, x1, y1) in the costmap's frame, (n, 4) [m]."""
    if costmap is None:
        return np.empty((0, 4))
    row, col = (int(v) for v in costmap.cell_from_world(pose.position))
    cells, (rows, cols) = math.ceil(reach / costmap.resolution), costmap.shape
    window = np.full((2 * cells + 1, 2 * cells + 1), costmap.walled)
    low, left, high, right = max(0, row - cells), max(0, col - cells), min(rows, row + cells + 1), min(cols, col + cells + 1)
    if low < high and left < right:
        part = costmap.data[low:high, left:right] >= LETHAL
        window[low - row + cells : high - row + cells, left - col + cells : right - col + cells] = part
    segments = _edges(window) + np.array([col - cells, row - cells] * 2)
    return costmap.origin.transform(segments.reshape(-1, 2) * costmap.resolution).reshape(-1, 4)


def lines(points: Array, pose: SE2, gap: float, reach: float) -> Array:
    """The surfaces within `reach` of the robot that the points (m, 2) [m] of a scan, in their order, show.

    Split and fit (Nguyen, Martinelli, Tomatis and Siegwart, A Comparison of Line Extraction Algorithms using 2D Laser
    Rangefinders, IROS 2005): points that are all near to the straight line between the first and the last of them are one
    surface, of which the line of least squares is known better than any point.

    Args:
        gap: what is narrower is closed [m].

    Returns:
        Segments (n, 4) [m]; a point alone is one of no length.
    """
    near = points[np.hypot(points[:, 0] - pose.x, points[:, 1] - pose.y) < reach]
    if len(near) == 0:
        return np.empty((0, 4))
    wide = np.hypot(*(np.roll(near, -1, axis=0) - near).T) >= gap
    near = np.roll(near, -1 - int(np.argmax(wide)), axis=0)  # begins after a gap, if there is one
    ends = np.flatnonzero(np.hypot(*np.diff(near, axis=0).T) >= gap) + 1
    found = [_fitted(group) for group in np.split(near, ends)]
    if not wide.any():
        found.append(np.concatenate([found[-1][-1, 2:], found[0][0, :2]])[None])
    return np.concatenate(found)


def _fitted(points: Array) -> Array:
    """The lines of points that hang together, and what joins them, (n, 4)."""
    pieces, waiting = [], [points]
    while waiting:
        piece = waiting.pop()
        along = piece[-1] - piece[0]
        length = float(np.hypot(*along))
        off = piece - piece[0]
        away = np.hypot(*off.T) if length == 0.0 else np.abs(off[:, 0] * along[1] - off[:, 1] * along[0]) / length
        k = int(np.argmax(away))
        if away[k] > _STRAIGHT and 0 < k < len(piece) - 1:
            waiting += [piece[k:], piece[: k + 1]]
        else:
            pieces.append(_least_squares(piece))
    fitted = np.array(pieces)
    return np.concatenate([fitted, np.concatenate([fitted[:-1, 2:], fitted[1:, :2]], axis=1)])


def _least_squares(points: Array) -> Array:
    """The piece of the line through the points that they cover, (4,)."""
    if len(points) < 3:
        return np.concatenate([points[0], points[-1]])
    middle = points.mean(axis=0)
    direction = np.linalg.svd(points - middle, full_matrices=False)[2][0]
    first, last = (middle + ((p - middle) @ direction) * direction for p in (points[0], points[-1]))
    return np.concatenate([first, last])


@njit(cache=True)
def clearance(segments: Array, x: float, y: float, theta: float, outline: Array, below: float) -> float:
    """How far the outline at a pose is from the nearest segment; below zero, how deep the deepest one reaches into it.

    Exact where it is less than `below`, else at least that. Two convex shapes are apart by the largest gap over the normals of
    their edges, unless two corners are nearest (separating axis theorem).

    Args:
        segments: (n, 4) [m]; points are segments of no length.
        outline: convex, counter-clockwise, (k, 2) in the robot's frame [m].
    """
    c, s, k = math.cos(theta), math.sin(theta), len(outline)
    reach = below
    for i in range(k):
        reach = max(reach, math.hypot(outline[i, 0], outline[i, 1]) + below)
    nearest = below
    for j in range(len(segments)):
        ax, ay, bx, by = segments[j]
        if _apart(x, y, ax, ay, bx, by) > reach:
            continue
        ax, ay, bx, by = ax - x, ay - y, bx - x, by - y
        ax, ay, bx, by = c * ax + s * ay, c * ay - s * ax, c * bx + s * by, c * by - s * bx
        nearest = min(nearest, _gap(outline, ax, ay, bx, by, nearest))
    return nearest


@njit(cache=True)
def floors(segments: Array, x: float, y: float, theta: float, outline: Array, margin: float, doubt: float) -> Array:
    """How near each segment may come to an outline that is at this pose, (n,) [m]: `margin`, or as near as the nearest is. Where
    some reach into the outline these may come `doubt` deeper, and each of the others `margin` near, or as near as it is."""
    found, nearest = np.empty(len(segments)), margin
    for j in range(len(segments)):
        found[j] = clearance(segments[j : j + 1], x, y, theta, outline, margin)
        nearest = min(nearest, found[j])
    for j in range(len(segments)):
        if nearest >= 0.0:
            found[j] = nearest
        elif found[j] < 0.0:
            found[j] -= doubt
    return found


@njit(cache=True)
def keeps(segments: Array, floors: Array, x: float, y: float, theta: float, outline: Array) -> bool:
    """Whether the outline at a pose is no nearer to any segment than its floor."""
    c, s, reach = math.cos(theta), math.sin(theta), 0.0
    for i in range(len(outline)):
        reach = max(reach, math.hypot(outline[i, 0], outline[i, 1]))
    for j in range(len(segments)):
        ax, ay, bx, by = segments[j]
        if _apart(x, y, ax, ay, bx, by) > reach + max(floors[j], 0.0):
            continue
        ax, ay, bx, by = ax - x, ay - y, bx - x, by - y
        ax, ay, bx, by = c * ax + s * ay, c * ay - s * ax, c * bx + s * by, c * by - s * bx
        if _gap(outline, ax, ay, bx, by, floors[j] + 1e-6) < floors[j]:
            return False
    return True


@njit(cache=True)
def room(segments: Array, x: float, y: float) -> float:
    """The distance from a point to the nearest segment, at most `FAR` [m]."""
    nearest = FAR
    for j in range(len(segments)):
        nearest = min(nearest, _apart(x, y, segments[j, 0], segments[j, 1], segments[j, 2], segments[j, 3]))
    return nearest


@njit(cache=True)
def _apart(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """From a point to a segment."""
    dx, dy = bx - ax, by - ay
    length = dx * dx + dy * dy
    share = 0.0 if length == 0.0 else min(max(((x - ax) * dx + (y - ay) * dy) / length, 0.0), 1.0)
    return math.hypot(ax + share * dx - x, ay + share * dy - y)


@njit(cache=True)
def _gap(outline: Array, ax: float, ay: float, bx: float, by: float, below: float) -> float:
    """Between the outline and a segment, both in the robot's frame; exact where it is less than `below`."""
    k, gap = len(outline), -math.inf
    length = math.hypot(bx - ax, by - ay)
    low, high = math.inf, -math.inf  # of the outline across the segment
    for i in range(k):
        px, py = outline[i]
        ex, ey = outline[(i + 1) % k, 0] - px, outline[(i + 1) % k, 1] - py
        edge = math.hypot(ex, ey)
        gap = max(gap, min((ax - px) * ey - (ay - py) * ex, (bx - px) * ey - (by - py) * ex) / edge)
        if length > 0.0:
            across = ((px - ax) * (by - ay) - (py - ay) * (bx - ax)) / length
            low, high = min(low, across), max(high, across)
    if length > 0.0:
        gap = max(gap, low, -high)
    if gap <= 0.0 or gap >= below:
        return gap
    corners = math.inf
    for i in range(k):
        px, py = outline[i]
        qx, qy = outline[(i + 1) % k]
        corners = min(corners, _apart(px, py, ax, ay, bx, by), _apart(ax, ay, px, py, qx, qy), _apart(bx, by, px, py, qx, qy))
    return corners
