"""Exact distances to obstacles on a grid: distance transforms, and the clearance of points and footprints.

An obstacle is the whole square of a blocked cell, not its centre. Outside the grid nothing is blocked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core.distance_kernels import Blocked, squared_to_centres, squared_to_squares
from robocar.core.geometry import Array
from robocar.core.grid import GridMap

EMPTY = np.int32(2**31 - 1)


class Pyramid(NamedTuple):
    """A grid at full, half, quarter ... size: the bounds of what is blocked inside each square of cells, in one flat array.

    Args:
        cells: the full size, level 0, where a box is the cell itself, (rows, cols).
        boxes: left, low, right, high [cells] of the blocked squares of the levels from 1 on, (n, 4), each row by row;
            `EMPTY` where nothing is blocked.
        starts: where each level starts in `boxes`, that of level 0 not used, and the end of all, (levels + 1,).
        widths: its number of columns, (levels,).
    """

    cells: Blocked
    boxes: NDArray[np.int32]
    starts: NDArray[np.int64]
    widths: NDArray[np.int64]


def distance_transform(blocked: ArrayLike, resolution: float = 1.0) -> Array:
    """Distance from the centre of every cell to the nearest blocked cell's *centre*.

    Felzenszwalb and Huttenlocher, Distance Transforms of Sampled Functions (2012), sections 2 and 3: linear in the cells.

    Args:
        blocked: (rows, cols) bool.
        resolution: side of a cell [m].

    Returns:
        (rows, cols) [m]; 0 on blocked cells, inf where nothing is blocked.
    """
    distance = squared_to_centres(_mask(blocked))
    np.sqrt(distance, out=distance)
    distance *= resolution
    return distance


def lattice_distance(blocked: ArrayLike, subdivision: int) -> Array:
    """Exact distance from the nodes of a finer lattice to the nearest blocked *square*, in cells.

    Node (i, j) lies at column j / subdivision, row i / subdivision (`GridMap.grid_from_world`). The sides of all squares lie on
    lattice lines, so the point of a square nearest to a node is a node too, and the transform between nodes is exact.

    Args:
        blocked: (rows, cols) bool.
        subdivision: steps per cell; with an even number the centres of the cells are nodes.

    Returns:
        (subdivision * rows + 1, subdivision * cols + 1) [cells], inf where nothing is blocked.
    """
    blocked = _mask(blocked)
    rows, cols = blocked.shape
    nodes = np.zeros((subdivision * rows + 1, subdivision * cols + 1), dtype=bool)
    fine = np.repeat(np.repeat(blocked, subdivision, axis=0), subdivision, axis=1)
    for i in (0, 1):
        for j in (0, 1):  # A node belongs to a square where any of its four fine cells does.
            nodes[i : i + fine.shape[0], j : j + fine.shape[1]] |= fine
    del fine
    distance = squared_to_centres(nodes)
    np.sqrt(distance, out=distance)
    distance /= subdivision
    return distance


def obstacle_distance(blocked: ArrayLike, resolution: float) -> Array:
    """Exact distance from the centre of every cell to the nearest blocked cell's *square*.

    Args:
        blocked: (rows, cols) bool.
        resolution: side of a cell [m].

    Returns:
        (rows, cols) [m]; 0 on blocked cells, inf where nothing is blocked.
    """
    distance = squared_to_squares(_mask(blocked))
    np.sqrt(distance, out=distance)
    distance /= 2
    distance *= resolution
    return distance


@njit(cache=True)
def _point_segment(px: float, py: float, x0: float, y0: float, x1: float, y1: float) -> float:
    """Squared distance from a point to a segment."""
    dx, dy = x1 - x0, y1 - y0
    length = dx * dx + dy * dy
    t = 0.0
    if length > 0.0:
        t = min(1.0, max(0.0, ((px - x0) * dx + (py - y0) * dy) / length))
    ex, ey = x0 + t * dx - px, y0 + t * dy - py
    return ex * ex + ey * ey


@njit(cache=True)
def _point_box(px: float, py: float, left: float, low: float, right: float, high: float) -> float:
    """Squared distance from a point to a solid, axis-parallel box."""
    dx = max(left - px, 0.0, px - right)
    dy = max(low - py, 0.0, py - high)
    return dx * dx + dy * dy


@njit(cache=True)
def _segment_box(x0: float, y0: float, x1: float, y1: float, left: float, low: float, right: float, high: float) -> float:
    """Squared distance from a segment to a solid, axis-parallel box."""
    best = min(_point_box(x0, y0, left, low, right, high), _point_box(x1, y1, left, low, right, high))
    if best == 0.0:
        return 0.0
    dx, dy = x1 - x0, y1 - y0
    if max(x0, x1) >= left and min(x0, x1) <= right and max(y0, y1) >= low and min(y0, y1) <= high:
        # The bounds overlap, so the segment misses the box only if all corners lie on one side of its line.
        a = dx * (low - y0) - dy * (left - x0)
        b = dx * (low - y0) - dy * (right - x0)
        c = dx * (high - y0) - dy * (left - x0)
        d = dx * (high - y0) - dy * (right - x0)
        if min(a, b, c, d) <= 0.0 <= max(a, b, c, d):
            return 0.0
    best = min(best, _point_segment(left, low, x0, y0, x1, y1), _point_segment(right, low, x0, y0, x1, y1))
    return min(best, _point_segment(left, high, x0, y0, x1, y1), _point_segment(right, high, x0, y0, x1, y1))


@njit(cache=True)
def _inside(px: float, py: float, polygon: Array) -> bool:
    """Whether a point lies in a convex polygon with counter-clockwise corners."""
    n = len(polygon)
    for i in range(n):
        j = (i + 1) % n
        dx, dy = polygon[j, 0] - polygon[i, 0], polygon[j, 1] - polygon[i, 1]
        if dx * (py - polygon[i, 1]) - dy * (px - polygon[i, 0]) < 0.0:
            return False
    return n > 2


@njit(cache=True)
def _polygon_box(polygon: Array, left: float, low: float, right: float, high: float) -> float:
    """Squared distance from a convex polygon to a solid box: no edge near and the box not inside means far."""
    if _inside(left, low, polygon):
        return 0.0
    best = math.inf
    n = len(polygon)
    for i in range(n):
        j = (i + 1) % n
        best = min(best, _segment_box(polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1], left, low, right, high))
    return best


@njit(cache=True)
def _box(tree: Pyramid, level: int, row: int, col: int) -> tuple[float, float, float, float]:
    """left, low, right, high of what is blocked in a square of a level; `EMPTY` where nothing is, and outside the grid."""
    width = tree.widths[level]
    if level == 0:
        if row >= tree.cells.shape[0] or col >= width or not tree.cells[row, col]:
            return float(EMPTY), 0.0, 0.0, 0.0
        return float(col), float(row), col + 1.0, row + 1.0
    k = tree.starts[level] + row * width + col
    if col >= width or k >= tree.starts[level + 1]:
        return float(EMPTY), 0.0, 0.0, 0.0
    return float(tree.boxes[k, 0]), float(tree.boxes[k, 1]), float(tree.boxes[k, 2]), float(tree.boxes[k, 3])


@njit(cache=True)
def _tree_clearance(tree: Pyramid, polygon: Array) -> float:
    """Distance in cells from a convex polygon to the nearest blocked square: branch and bound over the pyramid."""
    left, right = polygon[:, 0].min(), polygon[:, 0].max()
    low, high = polygon[:, 1].min(), polygon[:, 1].max()
    cx, cy = 0.5 * (left + right), 0.5 * (low + high)
    radius = 0.0
    for i in range(len(polygon)):
        radius = max(radius, math.hypot(polygon[i, 0] - cx, polygon[i, 1] - cy))
    levels = len(tree.widths)
    if _box(tree, levels - 1, 0, 0)[0] == EMPTY:
        return math.inf
    stack = np.empty((3 * levels + 1, 3), dtype=np.int64)
    bounds = np.empty(3 * levels + 1)
    stack[0, 0], stack[0, 1], stack[0, 2], bounds[0] = levels - 1, 0, 0, 0.0
    top, best = 1, math.inf  # squared
    while top > 0 and best > 0.0:
        top -= 1
        if bounds[top] >= best:
            continue
        level, row, col = stack[top, 0], stack[top, 1], stack[top, 2]
        if level == 0:
            best = min(best, _polygon_box(polygon, float(col), float(row), col + 1.0, row + 1.0))
            continue
        level -= 1
        first = top
        for child_row in range(2 * row, 2 * row + 2):
            for child_col in range(2 * col, 2 * col + 2):
                x, y, x_end, y_end = _box(tree, level, child_row, child_col)
                if x == EMPTY:
                    continue
                dx = max(x - right, 0.0, left - x_end)
                dy = max(y - high, 0.0, low - y_end)
                around = max(0.0, math.sqrt(_point_box(cx, cy, x, y, x_end, y_end)) - radius)
                bound = max(dx * dx + dy * dy, around * around)
                if bound >= best:
                    continue
                k = top
                while k > first and bounds[k - 1] < bound:  # The nearest child goes on top of the stack.
                    bounds[k] = bounds[k - 1]
                    stack[k] = stack[k - 1]
                    k -= 1
                stack[k, 0], stack[k, 1], stack[k, 2], bounds[k] = level, child_row, child_col, bound
                top += 1
    return math.sqrt(best)


@njit(cache=True)
def _tree_query(tree: Pyramid, frame: Array, polygons: Array) -> NDArray[np.float64]:
    """Clearance [m] of polygons (m, n, 2) in the world; `frame` is x, y, cos, sin of the grid's origin and the resolution."""
    result = np.empty(len(polygons))
    corners = polygons.shape[1]
    local = np.empty((corners, 2))
    for m in range(len(polygons)):
        for i in range(corners):
            dx, dy = polygons[m, i, 0] - frame[0], polygons[m, i, 1] - frame[1]
            local[i, 0] = (frame[2] * dx + frame[3] * dy) / frame[4]
            local[i, 1] = (frame[2] * dy - frame[3] * dx) / frame[4]
        result[m] = _tree_clearance(tree, local) * frame[4]
    return result


@njit(cache=True)
def segment_clear(
    tree: Pyramid,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    radius: float,
) -> bool:
    """Whether a disc can move straight: no blocked square nearer to the segment than `radius` (grid coordinates, in cells)."""
    levels = len(tree.widths)
    if _box(tree, levels - 1, 0, 0)[0] == EMPTY:
        return True
    limit = radius * radius
    left, right = min(x0, x1) - radius, max(x0, x1) + radius
    low, high = min(y0, y1) - radius, max(y0, y1) + radius
    stack = np.empty((3 * levels + 1, 3), dtype=np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = levels - 1, 0, 0
    top = 1
    while top > 0:
        top -= 1
        level, row, col = stack[top, 0], stack[top, 1], stack[top, 2]
        if level == 0:  # Only a grid of one cell starts here.
            return _segment_box(x0, y0, x1, y1, 0.0, 0.0, 1.0, 1.0) >= limit
        level -= 1
        for child_row in range(2 * row, 2 * row + 2):
            for child_col in range(2 * col, 2 * col + 2):
                x, y, x_end, y_end = _box(tree, level, child_row, child_col)
                if x == EMPTY:
                    continue
                if x > right or x_end < left or y > high or y_end < low:
                    continue
                if _segment_box(x0, y0, x1, y1, x, y, x_end, y_end) < limit:
                    if level == 0:
                        return False
                    stack[top, 0], stack[top, 1], stack[top, 2] = level, child_row, child_col
                    top += 1
    return True


def pyramid(blocked: ArrayLike) -> Pyramid:
    """The pyramid of blocked cells (rows, cols)."""
    cells = _mask(blocked)
    rows, cols = cells.shape
    widths, starts = [cols], [0, 0]
    while rows * cols > 1:
        rows, cols = (rows + 1) // 2, (cols + 1) // 2
        widths.append(cols)
        starts.append(starts[-1] + rows * cols)
    tree = Pyramid(cells, np.full((starts[-1], 4), EMPTY, np.int32), np.array(starts), np.array(widths))
    _fill(tree)
    return tree


@njit(cache=True)
def _fill(tree: Pyramid) -> None:
    """The boxes of each level from those of the level below: nothing is needed beside them, however large the map is."""
    for level in range(1, len(tree.widths)):
        width = tree.widths[level]
        for k in range(tree.starts[level], tree.starts[level + 1]):
            row, col = (k - tree.starts[level]) // width, (k - tree.starts[level]) % width
            for child_row in range(2 * row, 2 * row + 2):
                for child_col in range(2 * col, 2 * col + 2):
                    left, low, right, high = _box(tree, level - 1, child_row, child_col)
                    if left == EMPTY:
                        continue
                    if tree.boxes[k, 0] == EMPTY:
                        tree.boxes[k, 2] = tree.boxes[k, 3] = 0
                    tree.boxes[k, 0], tree.boxes[k, 1] = min(tree.boxes[k, 0], left), min(tree.boxes[k, 1], low)
                    tree.boxes[k, 2], tree.boxes[k, 3] = max(tree.boxes[k, 2], right), max(tree.boxes[k, 3], high)


class ClearanceField:
    """Exact distances from points and footprints anywhere in the world to the blocked squares of one grid.

    A pyramid of the blocked cells, built once, is searched by branch and bound, nearest square first; a query takes microseconds.

    Args:
        grid: the place; its numbers do not matter.
        blocked: (rows, cols) bool.
    """

    def __init__(self, grid: GridMap, blocked: ArrayLike) -> None:
        blocked = _mask(blocked)
        if blocked.shape != grid.shape:
            raise ValueError(f"blocked cells of shape {blocked.shape} on a grid of shape {grid.shape}")
        self._tree = pyramid(blocked)
        origin = grid.origin
        self._frame = np.array([origin.x, origin.y, math.cos(origin.theta), math.sin(origin.theta), grid.resolution])
        self.points(np.zeros((1, 2)))  # compiles before the control loop starts

    def points(self, points: ArrayLike) -> Array:
        """Distance of world points (n, 2) [m] to the nearest blocked square, (n,) [m]; 0 inside, inf if nothing is blocked."""
        points = np.array(points, dtype=float, order="C")
        return _tree_query(self._tree, self._frame, points[:, None, :])

    def footprint(self, vertices: ArrayLike) -> float:
        """Distance of a convex polygon to the nearest blocked square.

        Args:
            vertices: corners in the world, counter-clockwise, (n, 2) [m] (`Footprint.at`).

        Returns:
            [m]; 0 where they touch or overlap, inf where nothing is blocked.
        """
        vertices = np.array(vertices, dtype=float, order="C")
        return float(_tree_query(self._tree, self._frame, vertices[None])[0])


def footprint_clearance(grid: GridMap, blocked: ArrayLike, vertices: ArrayLike) -> float:
    """`ClearanceField.footprint` for a single question; many questions about one grid ask a `ClearanceField`."""
    return ClearanceField(grid, blocked).footprint(vertices)


@njit(cache=True)
def convex_distance(a: Array, b: Array) -> float:
    """`polygon_distance` for other kernels: contiguous arrays of floats."""
    if _inside(a[0, 0], a[0, 1], b) or _inside(b[0, 0], b[0, 1], a):
        return 0.0
    best = math.inf
    for i in range(len(a)):
        p, q = a[i], a[(i + 1) % len(a)]
        for j in range(len(b)):
            r, s = b[j], b[(j + 1) % len(b)]
            side_r = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
            side_s = (q[0] - p[0]) * (s[1] - p[1]) - (q[1] - p[1]) * (s[0] - p[0])
            side_p = (s[0] - r[0]) * (p[1] - r[1]) - (s[1] - r[1]) * (p[0] - r[0])
            side_q = (s[0] - r[0]) * (q[1] - r[1]) - (s[1] - r[1]) * (q[0] - r[0])
            if side_r * side_s < 0.0 and side_p * side_q < 0.0:
                return 0.0
            best = min(best, _point_segment(p[0], p[1], r[0], r[1], s[0], s[1]))
            best = min(best, _point_segment(r[0], r[1], p[0], p[1], q[0], q[1]))
    return math.sqrt(best)


def polygon_distance(a: ArrayLike, b: ArrayLike) -> float:
    """Distance of two convex polygons (n, 2), (m, 2) [m], corners counter-clockwise; 0 where they touch or overlap.

    One corner makes a point, two a segment: a cylinder's clearance is that of its centre less its radius.
    """
    return float(convex_distance(np.array(a, dtype=float, order="C"), np.array(b, dtype=float, order="C")))


def _mask(blocked: ArrayLike) -> Blocked:
    # A copy, as for corners above: numba compiles anew for read-only arrays, and must not do so in the control loop.
    blocked = np.array(blocked, dtype=bool, order="C")
    if blocked.ndim != 2 or blocked.size == 0:
        raise ValueError(f"blocked cells need rows and columns, not shape {blocked.shape}")
    return blocked
