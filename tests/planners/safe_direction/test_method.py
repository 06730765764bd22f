"""One decision of safe-direction navigation. Oracle: the same by scipy and in plain Python, as one would write it down."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from robocar.core import SE2, Array
from robocar.planners.safe_direction.fan import shortest_direction
from robocar.planners.safe_direction.method import Decision, Directions, SafeDirectionParameters
from robocar.planners.safe_direction.view import Readings, Sector, window
from robocar.planners.search.transforms import distance_transform
from tests.planners.kinematic import car


def edt(mask: np.ndarray) -> Array:
    return np.asarray(ndimage.distance_transform_edt(~mask)) if mask.any() else np.full(mask.shape, math.inf)


def surroundings(seed: int) -> tuple[Readings, float]:
    """Boxes at random around a robot that stands anywhere on its cell; a part of the cells is unseen. And its heading [rad]."""
    rng = np.random.default_rng(seed)
    pose = SE2(*rng.uniform(-2.0, 2.0, 2))
    grid = window(pose, 1.5, 0.05)
    rows, cols = grid.shape
    occupied, free = np.zeros((rows, cols), dtype=bool), np.ones((rows, cols), dtype=bool)
    for mask, count in ((occupied, rng.integers(0, 9)), (free, rng.integers(1, 4))):
        for row, col, height, width in zip(*rng.integers(0, rows, (2, count)), *rng.integers(1, 14, (2, count)), strict=True):
            mask[row : row + height, col : col + width] = mask is occupied
    free &= ~occupied
    free[[0, -1]] = free[:, [0, -1]] = occupied[[0, -1]] = occupied[:, [0, -1]] = False
    return Readings(grid, free, occupied, *grid.grid_from_world(pose.position).tolist()), float(rng.uniform(-3.0, 3.0))


def turned(a: float, b: float) -> float:
    return (a - b + math.pi) % math.tau - math.pi


def written_down(
    seen: Readings, heading: float, goal: Array, p: SafeDirectionParameters, sector: Sector, radii: tuple[float, float]
):
    """The decision's parts: clearance, distance, contact distances, N, and heading, |p_L|, p_SF, p_D, alpha of the choice."""
    r, n = p.resolution, p.number_of_directions
    row, col = int(seen.y), int(seen.x)
    room, beside = edt(~seen.free) - 0.5, edt(seen.occupied)
    gx, gy = (v / r for v in seen.grid.origin.inverse_apply(*goal))
    headings = heading + np.linspace(-0.5 * sector.width, 0.5 * sector.width, n, endpoint=not sector.whole)
    steps, counted = int(sector.reach / r / 0.5), min(p.safe_range, sector.reach) / r
    for radius in radii:
        growth = (radius + p.padding) / r
        clearance = room - max(0.0, min(growth, room[row, col] - 0.5))
        blocked = beside < 0.5 + max(0.0, min(growth + 0.5, beside[row, col] - 0.5 - 0.5))
        distance = distance_transform(blocked, (gy, gx), "euclidean", (row, col))
        lengths, totals = np.zeros(n), np.zeros(n)
        for k, at in enumerate(headings):
            total, i = 0.0, 1
            while i <= steps:
                y, x = math.floor(seen.y + i * 0.5 * math.sin(at)), math.floor(seen.x + i * 0.5 * math.cos(at))
                if not (0 <= y < room.shape[0] and 0 <= x < room.shape[1]) or clearance[y, x] <= 0.0:
                    break
                total += clearance[y, x] if i * 0.5 <= counted else 0.0
                i += 1
            lengths[k], totals[k] = (i - 1) * 0.5 * r, total * 0.5 * r**2
        short = shortest_direction(distance, seen.x, seen.y, (gx, gy), sector.reach / r)
        if short is None:
            continue

        def nearest(at: float, headings: Array = headings) -> int:
            return int(np.argmin([abs(turned(heading, at)) for heading in headings]))

        d = s = nearest(short)
        for sense in (1, -1):
            for k in range(1, n):
                i = (d + sense * k) % n
                if not sector.whole and not 0 <= d + sense * k < n:
                    break
                if abs(turned(headings[i], short)) > 0.5 * p.safe_sector + 1e-9:
                    break
                if lengths[i] < min(p.max_step, sector.reach, lengths[d]) - 1e-9:
                    break
                s = i if totals[i] > totals[s] * (1.0 + 1e-9) else s
        enough = totals[s] <= 0.0 or totals[d] / totals[s] > p.delta or s == d
        alpha, safe = 0.0 if enough else p.alpha, float(headings[s])
        px = alpha * math.cos(safe) + (1.0 - alpha) * math.cos(short)
        py = alpha * math.sin(safe) + (1.0 - alpha) * math.sin(short)
        target = math.atan2(py, px)
        return clearance, distance, lengths, totals, (target, float(lengths[nearest(target)]), safe, short, alpha)
    return clearance, distance, lengths, totals, None


def parts(found: Decision):
    c = found.choice
    chosen = None if c is None else (c.heading, c.length, c.safe, c.shortest, c.alpha)
    return found.clearance, found.distance, found.fan.lengths, found.fan.totals, chosen


@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([0.3, 0.6, 1.0]))
@settings(max_examples=60, deadline=None)
def test_a_quick_decision_is_the_plain_one(seed: int, whole: bool, alpha: float) -> None:
    """Bit for bit: both readings, both growths, the fan and the choice, all round and in a sector, goals in and out of sight.

    Only cases where the shortest direction lies in the sector: the turn has a test of its own.
    """
    seen, heading = surroundings(seed)
    rng = np.random.default_rng([seed, 1])
    p = SafeDirectionParameters(alpha=alpha, number_of_directions=91, max_range=1.5)
    sector, outline = Sector(math.tau if whole else 1.9 * math.pi, 1.5), car(()).footprint
    method = Directions(car(()), sector, p)
    room = edt(seen.occupied)
    inside = seen.grid.world_from_cell(np.argwhere(room > 7.0))  # a goal in an obstacle has a test of its own
    away = rng.uniform(2.5, 9.0) * np.array([math.cos(seed), math.sin(seed)]) + seen.grid.world_from_cell(np.array([[30, 30]]))[0]
    goal = rng.permutation(inside)[0] if len(inside) and rng.random() < 0.5 else away
    found = method.decide(seen, heading, goal)
    if found.choice is not None and found.choice.turn:
        heading = found.choice.shortest
        found = method.decide(seen, heading, goal)
    expected = written_down(seen, heading, goal, p, sector, (outline.circumscribed_radius, outline.inscribed_radius))
    for ours, theirs in zip(parts(found)[:4], expected[:4], strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert parts(found)[4] == expected[4]
