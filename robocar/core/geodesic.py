"""Shortest collision-free path of a disc among the blocked squares of a grid: the yardstick that runs are measured against.

Two steps. A search on a lattice finer than the grid (Lazy Theta*: Nash, Koenig, Tovey 2010, with exact lines of sight for the
disc) chooses on which side to pass each obstacle; then the path is pulled taut like a string until nothing can be cut off it any
more. The disc can drive the result, so it is never shorter than the optimum, and where the sides are right the lattice leaves no
trace in it.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core.distance import Blocked, Pyramid, lattice_distance, pyramid, segment_clear
from robocar.core.geometry import Array
from robocar.core.grid import GridMap
from robocar.core.plan import Path

MAX_NODES = 1_100_000  # of the lattice: 512 x 512 cells get half cells, small maps up to 1/16
WHOLE = 4 * MAX_NODES  # of the half cells: larger maps are searched part by part
TOUCH = 1e-6  # [cells] a disc as wide as a gap would touch both its sides, and a point a corner: it keeps this far off


@njit(cache=True)
def _search(
    tree: Pyramid,
    active: Blocked,
    fine: int,
    start: int,
    goal: int,
    radius: float,
    memory: tuple[Array, NDArray[np.int32], Blocked],
) -> NDArray[np.int64]:
    """Lazy Theta* over the active nodes (flat indices); returns the nodes of the path, goal first, empty if there is none.

    `memory` is zeros for each node: the cost [fine steps], the parent's index plus 1 (without one the cost is none yet), whether
    the node is closed. NumPy makes it outside: of its zeros only what is written to takes space, here it would all do.
    """
    rows, cols = active.shape
    cost, parent, closed = memory
    goal_row, goal_col = goal // cols, goal % cols
    cost[start], parent[start] = 0.0, start + 1
    queue: list[tuple[float, int]] = [(math.hypot(start // cols - goal_row, start % cols - goal_col), start)]
    while len(queue) > 0:
        _, node = heapq.heappop(queue)
        if closed[node]:
            continue
        row, col = node // cols, node % cols
        p = parent[node] - 1
        if not segment_clear(tree, (p % cols) / fine, (p // cols) / fine, col / fine, row / fine, radius):
            # The view that was assumed is not there: enter by the best expanded neighbour instead (SetVertex of the paper).
            cost[node], parent[node] = math.inf, 0
            for step in (1, fine):
                for i in (-step, 0, step):
                    for j in (-step, 0, step):
                        r, c = row + i, col + j
                        if not (0 <= r < rows and 0 <= c < cols) or not closed[r * cols + c]:
                            continue
                        through = cost[r * cols + c] + math.hypot(i, j)
                        if through < cost[node] and segment_clear(tree, c / fine, r / fine, col / fine, row / fine, radius):
                            cost[node], parent[node] = through, r * cols + c + 1
            if parent[node] == 0:
                continue
        closed[node] = True
        if node == goal:
            break
        p = parent[node] - 1
        for step in (1, fine):
            for i in (-step, 0, step):
                for j in (-step, 0, step):
                    r, c = row + i, col + j
                    if not (0 <= r < rows and 0 <= c < cols) or not active[r, c]:
                        continue
                    k = r * cols + c
                    if closed[k]:
                        continue
                    through = cost[p] + math.hypot(r - p // cols, c - p % cols)
                    if parent[k] == 0 or through < cost[k] - 1e-9:
                        cost[k], parent[k] = through, p + 1
                        heapq.heappush(queue, (through + math.hypot(r - goal_row, c - goal_col), k))  # type: ignore[arg-type]
    if not closed[goal]:
        return np.empty(0, dtype=np.int64)
    nodes = [np.int64(goal)]
    while nodes[-1] != start:
        nodes.append(np.int64(parent[nodes[-1]] - 1))
    return np.array(nodes)


@njit(cache=True)
def _pull_taut(tree: Pyramid, points: Array, radius: float, tolerance: float) -> Array:
    """Cut the corners of a polyline (n, 2) until no cut saves more than `tolerance` of its length; the ends stay."""
    total = 0.0
    for i in range(len(points) - 1):
        total += math.hypot(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
    least = tolerance * total / len(points)
    for _ in range(60):
        new = np.empty((2 * len(points), 2))
        new[0] = points[0]
        n, saved = 1, 0.0
        for i in range(1, len(points) - 1):
            ax, ay = new[n - 1, 0], new[n - 1, 1]
            vx, vy = points[i, 0], points[i, 1]
            bx, by = points[i + 1, 0], points[i + 1, 1]
            la, lb = math.hypot(ax - vx, ay - vy), math.hypot(bx - vx, by - vy)
            gain = la + lb - math.hypot(bx - ax, by - ay)
            if segment_clear(tree, ax, ay, bx, by, radius):
                saved += gain
                continue
            if gain <= least:
                new[n] = points[i]
                n += 1
                continue
            # Both ends of the chord lie equally far from the corner; the farthest clear chord by bisection.
            reach = min(la, lb)
            low, high, far = 0.0, 1.0, 1.0
            for _ in range(14):
                s, t = far * reach / la, far * reach / lb
                if segment_clear(tree, vx + s * (ax - vx), vy + s * (ay - vy), vx + t * (bx - vx), vy + t * (by - vy), radius):
                    low = far
                    if far == 1.0:
                        break
                else:
                    high = far
                far = 0.5 * (low + high)
            s, t = low * reach / la, low * reach / lb
            if low == 0.0:
                new[n] = points[i]
                n += 1
                continue
            px, py = vx + s * (ax - vx), vy + s * (ay - vy)
            qx, qy = vx + t * (bx - vx), vy + t * (by - vy)
            saved += low * 2.0 * reach - math.hypot(qx - px, qy - py)
            if s < 1.0:
                new[n, 0], new[n, 1] = px, py
                n += 1
            if t < 1.0:
                new[n, 0], new[n, 1] = qx, qy
                n += 1
        new[n] = points[-1]
        points = new[: n + 1].copy()
        if saved <= tolerance * total:
            break
    return points


def _entry(grid_point: Array, active: Blocked, fine: int, tree: Pyramid, radius: float) -> int:
    """The nearest active node that the disc can reach straight from a point, -1 if there is none within 1.5 cells."""
    px, py = float(grid_point[0]), float(grid_point[1])
    x, y = px * fine, py * fine
    rows, cols = active.shape
    reach = 1.5 * fine
    r, c = np.mgrid[
        max(0, math.ceil(y - reach)) : min(rows, math.floor(y + reach) + 1),
        max(0, math.ceil(x - reach)) : min(cols, math.floor(x + reach) + 1),
    ].reshape(2, -1)
    for k in np.argsort((r - y) ** 2 + (c - x) ** 2, kind="stable"):
        row, col = int(r[k]), int(c[k])
        if active[row, col] and segment_clear(tree, px, py, col / fine, row / fine, radius):
            return row * cols + col
    return -1


def geodesic_path(grid: GridMap, blocked: ArrayLike, start: ArrayLike, goal: ArrayLike, radius: float) -> Path | None:
    """Shortest path of a disc's centre that keeps the disc off all blocked squares and the centre on the grid.

    The length is never below the optimum, and within 1 % of it (at most 0.3 %, on average 0.02 %, over 140 random maps of 20 to
    70 cells a side, against a visibility graph). A gap counts if it is wider than the disc by some hundredths of a cell, on maps
    of more than 500 cells a side by some tenths if it is oblique. Diagonal neighbours leave no gap, not even for a point.

    Args:
        grid: the place; its numbers do not matter.
        blocked: (rows, cols) bool.
        start, goal: of the centre, (2,) [m] in the world.
        radius: of the disc, >= 0 [m].

    Returns:
        Polyline from start to goal, arcs as short chords outside the arc; None where the disc does not fit at an end (or the
        end lies outside the grid), or there is no way.
    """
    if not (math.isfinite(radius) and radius >= 0):
        raise ValueError(f"the radius of a disc is a number of metres >= 0, not {radius}")
    mask = np.ascontiguousarray(blocked, dtype=bool)
    if mask.shape != grid.shape:
        raise ValueError(f"blocked cells of shape {mask.shape} on a grid of shape {grid.shape}")
    start, goal = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    ends = grid.grid_from_world(np.stack([start, goal]))  # (2, 2) [cells]
    if not grid.contains(np.floor(ends[:, ::-1])).all():
        return None
    disc = radius / grid.resolution + TOUCH  # [cells]
    taut, corner = None, np.zeros(2)
    for window, least in _windows(mask.shape, ends, disc):
        corner = np.array([window[1].start, window[0].start], dtype=float)
        taut = _taut_path(np.ascontiguousarray(mask[window]), ends - corner, disc)
        if (taut is not None and _length(taut) <= least) or math.isinf(least):
            break
    if taut is None:
        return None
    points = grid.origin.transform((taut + corner) * grid.resolution)
    points[0], points[-1] = start, goal
    return Path(points)


def _taut_path(mask: Blocked, ends: Array, disc: float) -> Array | None:
    """`geodesic_path` between two points (2, 2), a polyline (n, 2), in cells."""
    tree = pyramid(mask)
    if not all(segment_clear(tree, x, y, x, y, disc) for x, y in ends):
        return None
    if segment_clear(tree, ends[0, 0], ends[0, 1], ends[1, 0], ends[1, 1], disc):
        return ends
    fine = 2
    while fine < 16 and (2 * fine * mask.shape[0] + 1) * (2 * fine * mask.shape[1] + 1) <= MAX_NODES:
        fine *= 2
    clearance = lattice_distance(mask, fine)
    # All nodes within a cell of where the disc touches, where the path may bend and squeeze; in the open the cells' centres do.
    active = (clearance >= disc) & (clearance < disc + 1.0)
    active[fine // 2 :: fine, fine // 2 :: fine] |= (clearance >= disc)[fine // 2 :: fine, fine // 2 :: fine]
    first, last = (_entry(end, active, fine, tree, disc) for end in ends)
    if first < 0 or last < 0:
        return None
    cols = active.shape[1]
    paths = []
    for here, there in ((last, first), (first, last)):  # Each direction has its own blind spots: the shorter path is the result.
        memory = (np.zeros(active.size), np.zeros(active.size, np.int32), np.zeros(active.size, np.bool_))
        nodes = _search(tree, active, fine, here, there, disc, memory)
        if len(nodes) == 0:
            return None
        between = (np.stack([nodes % cols, nodes // cols], axis=1) / fine)[:: 1 if here == last else -1]
        paths.append(_pull_taut(tree, np.concatenate([ends[:1], between, ends[1:]]), disc, 5e-5))
    return min(paths, key=_length)


def _length(points: Array) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _windows(shape: tuple[int, ...], ends: Array, disc: float) -> Iterator[tuple[tuple[slice, slice], float]]:
    """Ever larger parts (rows, cols) of a large map around both ends; and how long a path is at least that comes near the rim of
    such a part [cells], so that a shorter one has been found in it is the shortest of all. The last part is the whole map."""
    rows, cols = shape
    low, high = ends.min(axis=0), ends.max(axis=0)
    margin = max(64.0, 0.25 * math.dist(*ends)) + disc
    while 4 * rows * cols > WHOLE:
        (left, bottom), (right, top) = np.floor(low - margin).astype(int).tolist(), np.ceil(high + margin).astype(int).tolist()
        window = slice(max(0, bottom), min(rows, top)), slice(max(0, left), min(cols, right))
        inside = (bottom > 0, top < rows, left > 0, right < cols)
        if not any(inside):
            break
        # To a line beyond both ends and back, as the mirror image of one end shows. Nearer to the rim, what lies outside counts.
        apart = margin - disc - 2.0
        across = high - low
        by_side = [math.hypot(across[1 - axis], across[axis] + 2.0 * apart) for axis in (1, 1, 0, 0)]
        yield window, min(bound for bound, open_side in zip(by_side, inside, strict=True) if open_side)
        margin *= 2.0
    yield (slice(0, rows), slice(0, cols)), math.inf


def geodesic_distance(grid: GridMap, blocked: ArrayLike, start: ArrayLike, goal: ArrayLike, radius: float) -> float:
    """Length of `geodesic_path` [m]; inf where there is no way."""
    path = geodesic_path(grid, blocked, start, goal, radius)
    return math.inf if path is None else path.length
