"""Obstacles that are discs: distances to them, and the shortest path of a disc among them, both exact."""

from __future__ import annotations

import heapq
import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from robocar.core.distance import convex_distance
from robocar.core.geometry import Array, frozen_array

TOUCH = 1e-9  # [m] nearer than touching, within rounding


@njit(cache=True)
def _nearest(discs: Array, polygon: Array) -> float:
    best = math.inf
    x, y = polygon[0, 0], polygon[0, 1]
    reach = 0.0
    for i in range(len(polygon)):
        reach = max(reach, math.hypot(polygon[i, 0] - x, polygon[i, 1] - y))
    centre = np.empty((1, 2))
    for k in range(len(discs)):
        if math.hypot(discs[k, 0] - x, discs[k, 1] - y) - reach - discs[k, 2] >= best:
            continue
        centre[0, 0], centre[0, 1] = discs[k, 0], discs[k, 1]
        best = min(best, convex_distance(polygon, centre) - discs[k, 2])
    return max(best, 0.0)


class Discs:
    """Circular obstacles.

    Args:
        discs: x, y of the centres and radii, (n, 3) [m].
    """

    def __init__(self, discs: ArrayLike) -> None:
        self.array = frozen_array(np.asarray(discs, dtype=float).reshape(-1, 3))
        if not (np.isfinite(self.array).all() and np.all(self.array[:, 2] >= 0)):
            raise ValueError("discs need finite centres and radii that are not negative")
        self._discs = self.array.copy()  # writable, as what numba compiled for is
        self.distance(np.zeros((1, 2)))  # compiled before the control loop starts

    def distance(self, polygon: ArrayLike) -> float:
        """From a convex polygon (n, 2) [m], corners counter-clockwise, to the nearest disc [m]; 0 where they touch or overlap."""
        return float(_nearest(self._discs, np.array(polygon, dtype=float, order="C")))


@njit(cache=True)
def _clear(circles: Array, i: int, j: int, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether a segment keeps out of all circles but `i` and `j`, which it is tangent to."""
    dx, dy = x1 - x0, y1 - y0
    length = dx * dx + dy * dy
    per_length = 1.0 / length if length > 0.0 else 0.0
    for k in range(len(circles)):
        fx, fy, r = circles[k, 0] - x0, circles[k, 1] - y0, circles[k, 2] - TOUCH
        t = min(1.0, max(0.0, (fx * dx + fy * dy) * per_length))
        fx -= t * dx
        fy -= t * dy
        if fx * fx + fy * fy < r * r and r > 0.0 and k != i and k != j:
            return False
    return True


@njit(cache=True)
def _bitangents(circles: Array) -> Array:
    """Free common tangents: circle i, circle j, angle of the tangent point on i and on j, length, (m, 5)."""
    n = len(circles)
    found = np.empty((64, 5))
    m = 0
    for i in range(n):
        for j in range(i + 1, n):
            dx, dy = circles[j, 0] - circles[i, 0], circles[j, 1] - circles[i, 1]
            d = math.hypot(dx, dy)
            along = math.atan2(dy, dx)
            for crossing in (-1.0, 1.0):  # inner tangents pass between the circles
                total = circles[i, 2] - crossing * circles[j, 2]
                if d == 0.0 or abs(total) > d:
                    continue
                for side in (-1.0, 1.0):
                    a = along + side * math.acos(total / d)
                    b = a if crossing > 0.0 else a + math.pi
                    x0, y0 = circles[i, 0] + circles[i, 2] * math.cos(a), circles[i, 1] + circles[i, 2] * math.sin(a)
                    x1, y1 = circles[j, 0] + circles[j, 2] * math.cos(b), circles[j, 1] + circles[j, 2] * math.sin(b)
                    if not _clear(circles, i, j, x0, y0, x1, y1):
                        continue
                    if m == len(found):
                        larger = np.empty((2 * m, 5))
                        larger[:m] = found
                        found = larger
                    found[m, 0], found[m, 1], found[m, 2], found[m, 3] = float(i), float(j), a % math.tau, b % math.tau
                    found[m, 4] = math.hypot(x1 - x0, y1 - y0)
                    m += 1
    return found[:m]


@njit(cache=True)
def _arc_clear(circles: Array, i: int, start: float, length: float) -> bool:
    """Whether the arc of circle `i` from angle `start` on, counter-clockwise for `length` [rad], keeps out of all others."""
    x, y, r = circles[i, 0], circles[i, 1], circles[i, 2]
    for k in range(len(circles)):
        if k == i:
            continue
        dx, dy = circles[k, 0] - x, circles[k, 1] - y
        d, other = math.hypot(dx, dy), circles[k, 2]
        if d >= r + other - TOUCH or r - d >= other - TOUCH:  # apart, or the other lies inside
            continue
        if other - d >= r - TOUCH:  # this one lies inside the other
            return False
        half = math.acos(min(1.0, max(-1.0, (d * d + r * r - other * other) / (2.0 * d * r))))  # of the arc that it covers
        into = (math.atan2(dy, dx) - half - start) % math.tau  # where the covered arc begins, seen from the start
        if into < length - 1e-9 or into + 2.0 * half > math.tau + 1e-9:
            return False
    return True


def disc_geodesic(discs: ArrayLike, start: ArrayLike, goal: ArrayLike, radius: float) -> float:
    """Length of the shortest path of a disc's centre among discs, on an open plane.

    The obstacles grow by the radius, so a point moves among circles. Its shortest path consists of their common tangents and of
    arcs of them (Chang and others, Shortest paths for disc obstacles, 2005); Dijkstra's search over all free ones is exact.

    Args:
        discs: x, y, radius of the obstacles, (n, 3) [m].
        start, goal: of the centre, (2,) [m].
        radius: of the moving disc [m].

    Returns:
        [m]; inf where the disc does not fit at an end, or there is no way.
    """
    discs = np.asarray(discs, dtype=float).reshape(-1, 3)
    ends = np.array([[*np.asarray(start, dtype=float), 0.0], [*np.asarray(goal, dtype=float), 0.0]])
    if not (np.isfinite(ends).all() and math.isfinite(radius) and radius >= 0):
        raise ValueError(f"start {start}, goal {goal} and radius {radius} must be finite numbers, the radius not negative")
    grown = np.unique(discs + np.array([0.0, 0.0, radius]), axis=0)
    gap = np.hypot(*(grown[:, None, :2] - ends[:, :2]).transpose(2, 0, 1)) - grown[:, 2:]  # (n, 2)
    if np.any(gap < -TOUCH):
        return math.inf
    if np.array_equal(ends[0], ends[1]):
        return 0.0
    circles = np.ascontiguousarray(np.concatenate([ends, grown]))
    return _dijkstra(circles, _bitangents(circles))


def _dijkstra(circles: Array, tangents: Array) -> float:
    """From circle 0 to circle 1, both points, along tangents and along the arcs between their ends."""
    owner = tangents[:, :2].astype(int).ravel()  # node 2 k and 2 k + 1 are the ends of tangent k
    angle = tangents[:, 2:4].ravel()
    neighbours: list[list[tuple[int, float]]] = [[] for _ in owner]
    for k, length in enumerate(tangents[:, 4]):
        neighbours[2 * k].append((2 * k + 1, length))
        neighbours[2 * k + 1].append((2 * k, length))
    for i in np.unique(owner):
        nodes = np.flatnonzero(owner == i)
        nodes = nodes[np.argsort(angle[nodes], kind="stable")]
        for a, b in zip(nodes, np.roll(nodes, -1), strict=True):
            turn = float(angle[b] - angle[a]) % math.tau
            if a != b and (circles[i, 2] == 0.0 or _arc_clear(circles, int(i), float(angle[a]), turn)):
                neighbours[a].append((int(b), turn * circles[i, 2]))
                neighbours[b].append((int(a), turn * circles[i, 2]))
    queue = [(0.0, int(node)) for node in np.flatnonzero(owner == 0)]
    cost = np.full(len(owner), math.inf)
    while queue:
        length, node = heapq.heappop(queue)
        if owner[node] == 1:
            return float(length)
        if length >= cost[node]:
            continue
        cost[node] = length
        for other, step in neighbours[node]:
            if length + step < cost[other]:
                heapq.heappush(queue, (length + step, other))
    return math.inf
