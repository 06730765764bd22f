"""The rules of `robocar.planners.bugs.open_points`, jump after jump with numpy: an oracle for its kernel.

Left out: beams so near to each other, or readings so different, that no line can be fitted through them in doubles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robocar.core import Array
from robocar.planners.tracking.panorama import ScanPanorama


class Jump(NamedTuple):
    """From the last beam on something near to the first one past it, by `turn`: counter-clockwise is positive."""

    near: int
    distance: float
    far: float
    turn: float

    @property
    def side(self) -> int:
        return 1 if self.turn > 0.0 else -1


class Line(NamedTuple):
    """A straight surface 1 / r = p cos b + q sin b."""

    coefficients: Array
    covariance: Array
    straight: bool

    def at(self, bearing: float) -> tuple[float, float]:
        """1 / r there, and its standard deviation."""
        row = np.array([math.cos(bearing), math.sin(bearing)])
        return float(row @ self.coefficients), math.sqrt(max(0.0, row @ self.covariance @ row))


def polar(distance: float, bearing: float) -> Array:
    return distance * np.array([math.cos(bearing), math.sin(bearing)])


def jumps(bearings: Array, ranges: Array, seen: ScanPanorama, range_jump: float) -> list[Jump]:
    """Neighbouring beams whose ranges differ by more than `range_jump`, with no more than two lost ones between them."""
    found = []
    for i in range(len(ranges)):
        j = (i + 1) % len(ranges)
        between = (bearings[j] - bearings[i]) % math.tau
        a, b = min(ranges[i], seen.max_range), min(ranges[j], seen.max_range)
        if 0.0 < between <= 3.5 * seen.spacing and abs(a - b) > range_jump and min(a, b) > 0.0:
            found.append(Jump(i, a, b, between) if a < b else Jump(j, b, a, -between))
    return found


def surface(bearings: Array, ranges: Array, jump: Jump, spacing: float) -> tuple[Array, Array]:
    """Up to five beams that end at the jump, the last one first: bearings from that one, and ranges."""
    places = [(jump.near - k * jump.side) % len(ranges) for k in range(min(5, len(ranges)))]
    off = [math.remainder(bearings[place] - bearings[jump.near], math.tau) for place in places]
    hits = [
        0.0 < ranges[place] < math.inf and abs(b) <= 3.5 * k * spacing
        for k, (place, b) in enumerate(zip(places, off, strict=True))
    ]
    m = [*hits, False].index(False)
    return np.array(off[:m]), ranges[places[:m]]


def line_through(b: Array, r: Array, std: float) -> Line:
    """Weighted least squares: the noise of 1 / r is std / r^2."""
    matrix = np.column_stack([np.cos(b), np.sin(b)])
    coefficients = np.array(np.linalg.lstsq(matrix * r[:, None] ** 2, r, rcond=None)[0], dtype=float)
    off = np.abs(1.0 / r - matrix @ coefficients)
    covariance = std**2 * np.array(np.linalg.inv(matrix.T @ np.diag(r**4) @ matrix), dtype=float)
    return Line(coefficients, covariance, bool(np.all(off <= 4.0 * max(std, 1e-3) / r**2)))


def stands_alone(b: Array, r: Array, std: float) -> bool:
    """Whether the last beam is off the line of those before it: it may have met another face of a corner."""
    if len(r) <= 3:
        return False
    expected, spread = line_through(b[1:], r[1:], std).at(0.0)
    return abs(1.0 / r[0] - expected) > 1.5 * math.hypot(spread, std / r[0] ** 2)


def longest_line(b: Array, r: Array, std: float) -> tuple[int, Line | None]:
    """The most beams before the jump that lie on one line, and the line."""
    for m in range(len(r), 1, -1):
        line = line_through(b[:m], r[:m], std)
        if line.straight:
            return m, line
    return min(len(r), 1), None


def open_point(bearings: Array, ranges: Array, seen: ScanPanorama, jump: Jump, std: float) -> list[float] | None:
    """The row of `open_point_rows`; None where the surface goes on."""
    near, d, far, turn = jump
    sure, beyond, at, edge, alone = True, d, d, bearings[near] + 0.5 * turn, False
    b, r = surface(bearings, ranges, jump, seen.spacing)
    if seen.thin:
        alone = stands_alone(b, r, std)
        beams, line = longest_line(b, r, std)
        if line is not None:
            expected, spread = line.at(turn)
            noise = 4.0 * math.hypot(spread, std / far**2)
            if 1.0 / far > expected + noise or (far >= seen.max_range and expected < 1.0 / far):
                return None
            sure = 1.0 / far < expected - noise
            next_one = 1.0 / max(expected, 1e-6)  # where the next beam would meet it
            beyond = min(next_one, far)
            half, _ = line.at(0.5 * turn)
            if beams < 3:  # two beams always lie on a line
                edge = bearings[near]
            elif half > 0.0:
                at = min(max(1.0 / half, d - 3.0 * std), 0.5 * (d + next_one) + 3.0 * std, far)
    last, place, following = polar(d, bearings[near]), polar(at, edge), polar(beyond, bearings[near] + turn)
    before, ahead, along = math.dist(last, place), math.dist(place, following), following - last
    if alone:
        k = (near - jump.side) % len(ranges)
        along = last - polar(ranges[k], bearings[k])
        ahead = float(np.hypot(*along))
    length = np.hypot(*along)
    unit = along / length if length > 1e-9 else np.zeros(2)
    return [*(seen.origin + place), edge, at, jump.side, float(sure), before, ahead, *unit]


def rows(seen: ScanPanorama, range_jump: float, range_std: float) -> Array:
    """What `open_point_rows` finds, (k, 10)."""
    answered = ~np.isnan(seen.ranges)
    bearings, ranges = seen.bearings[answered], seen.ranges[answered]
    if len(ranges) < 3:
        return np.empty((0, 10))
    points = [open_point(bearings, ranges, seen, jump, range_std) for jump in jumps(bearings, ranges, seen, range_jump)]
    return np.array([point for point in points if point is not None]).reshape(-1, 10)
