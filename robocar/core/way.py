"""The way from start to goal on a map of any size: how long it is about, and what it leads through."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core.distance import Blocked, lattice_distance
from robocar.core.errors import MapTooLarge
from robocar.core.geodesic import geodesic_path
from robocar.core.grid import GridMap
from robocar.core.plan import Path

EXACT = 300_000
"""Cells up to which the way is `geodesic_path`; on larger maps one along the lines of the grid, at most 8 % longer."""

LARGEST = 25_000_000
"""Cells up to which a way is looked for: it takes 1.5 GB then."""

_STRAIGHT, _DIAGONAL = 5, 7  # steps, close to 1 : sqrt(2)
_FAR = 2**31 - 1


@njit(cache=True)
def _wave(free: Blocked, source: int, target: int) -> NDArray[np.int32]:
    """Steps from `source` to the nodes inside a blocked frame, until `target` is reached (Dial, 1969: buckets, not a heap)."""
    cols = free.shape[1]
    open_nodes = free.ravel()
    steps = np.full(open_nodes.size, _FAR, dtype=np.int32)
    moves = np.array([1, -1, cols, -cols, cols + 1, cols - 1, -cols + 1, -cols - 1])
    first = np.full(8, -1, dtype=np.int64)  # of each bucket: an entry is a node and the next entry
    nodes, following = np.empty(1 << 16, dtype=np.int32), np.empty(1 << 16, dtype=np.int32)
    spare, used, waiting = -1, 1, 1
    steps[source] = 0
    nodes[0], following[0], first[0] = source, -1, 0
    level = 0
    while waiting > 0:
        entry = first[level & 7]
        if entry < 0:
            level += 1
            continue
        first[level & 7] = following[entry]
        node = nodes[entry]
        following[entry], spare = spare, entry
        waiting -= 1
        if steps[node] != level:
            continue
        if node == target:
            break
        for k in range(8):
            other = node + moves[k]
            # A diagonal step needs both nodes beside it.
            if not open_nodes[other] or (k >= 4 and not (open_nodes[node + (moves[2] if k < 6 else moves[3])])):
                continue
            if k >= 4 and not open_nodes[node + (1 if k == 4 or k == 6 else -1)]:
                continue
            there = level + (_STRAIGHT if k < 4 else _DIAGONAL)
            if there >= steps[other]:
                continue
            steps[other] = there
            if spare >= 0:
                new, spare = spare, following[spare]
            else:
                new, used = used, used + 1
                if new == len(nodes):
                    nodes, following = np.concatenate((nodes, nodes)), np.concatenate((following, following))
            nodes[new], following[new] = other, first[there & 7]
            first[there & 7] = new
            waiting += 1
    return steps


@njit(cache=True)
def _descend(steps: NDArray[np.int32], cols: int, node: int) -> NDArray[np.int64]:
    """The nodes from one that was reached down to the source."""
    moves = np.array([1, -1, cols, -cols, cols + 1, cols - 1, -cols + 1, -cols - 1])
    way = [node]
    while steps[node] > 0:
        lowest = node
        for k in range(8):
            other = node + moves[k]
            if steps[other] != _FAR and steps[other] + (_STRAIGHT if k < 4 else _DIAGONAL) == steps[node]:
                lowest = other
                break
        node = lowest
        way.append(node)
    return np.array(way)


def find_way(grid: GridMap, blocked: ArrayLike, start: ArrayLike, goal: ArrayLike, radius: float) -> Path | None:
    """About the shortest path of a disc's centre; see `geodesic_path` for the arguments.

    Returns:
        None where there is none, or the disc does not fit at an end.

    Raises:
        MapTooLarge: it has more than `LARGEST` cells.
    """
    if np.size(blocked) > LARGEST:
        raise MapTooLarge(f"no way is looked for on a map of {np.size(blocked)} cells, only up to {LARGEST}")
    mask = np.ascontiguousarray(blocked, dtype=bool)
    if mask.size <= EXACT:
        return geodesic_path(grid, mask, start, goal, radius)
    ends = np.stack([np.asarray(start, dtype=float), np.asarray(goal, dtype=float)])
    at = grid.grid_from_world(ends)
    if not grid.contains(np.floor(at[:, ::-1])).all():
        return None
    clearance = lattice_distance(mask, 1) * grid.resolution
    corners = [np.floor(point) + offset for point in at for offset in np.array([(0, 0), (1, 0), (0, 1), (1, 1)])]
    for room in (radius, radius - math.sqrt(0.5) * grid.resolution):  # a gap that has no node in it is found by the second
        free = np.pad(clearance >= max(room, 1e-9), 1)
        cols = free.shape[1]
        flat = [int(y + 1) * cols + int(x + 1) for x, y in corners]
        open_ends = [[node for node in flat[k : k + 4] if free.flat[node]] for k in (0, 4)]
        if not all(open_ends):
            continue
        source, target = open_ends[0][0], open_ends[1][0]
        steps = _wave(free, source, target)
        if steps[target] == _FAR:
            continue
        nodes = _descend(steps, cols, target)[::-1]
        points = np.stack([nodes % cols - 1, nodes // cols - 1], axis=1) * grid.resolution
        return Path(np.concatenate([ends[:1], grid.origin.transform(points), ends[1:]]))
    return None


def length_over(grid: GridMap, cells: ArrayLike, points: ArrayLike, carried: ArrayLike | None = None) -> float:
    """How much of a polyline (n, 2) [m] leads over marked cells (rows, cols) [m], to a tenth of a cell.

    Args:
        carried: points that were not driven to from the one before, (n,) bool.
    """
    marked, points = np.asarray(cells, dtype=bool), np.asarray(points, dtype=float).reshape(-1, 2)
    if len(points) < 2 or not marked.any():
        return 0.0
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if carried is not None:
        lengths = np.where(np.asarray(carried, dtype=bool)[1:], 0.0, lengths)
    pieces = np.maximum(1, np.ceil(lengths / (0.1 * grid.resolution))).astype(np.intp)
    piece = np.repeat(np.arange(len(lengths)), pieces)
    nth = np.arange(len(piece)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    share = ((nth + 0.5) / pieces[piece])[:, None]
    at = grid.cell_from_world(points[:-1][piece] * (1.0 - share) + points[1:][piece] * share)
    inside = grid.contains(at)
    over = np.zeros(len(piece), dtype=bool)
    over[inside] = marked[at[inside, 0], at[inside, 1]]
    return float((over * (lengths / pieces)[piece]).sum())


def through(unknown: float, length: float) -> str:
    """As a person reads it: `path through unknown: 10.4 m of 21.7 m`."""
    return f"path through unknown: {unknown:.1f} m of {length:.1f} m"
