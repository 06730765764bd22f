"""How likely what is seen is from where a particle stands.

Each model multiplies, over what is seen, `(1 - outlier) * match + outlier`, where `match` in [0, 1] is 1 at perfect agreement:
without the constant a single wrong sighting would end the true hypothesis. A sighting that may be of one of several landmarks
(balls of one colour) is matched with the mean over them.

`match` is exp(-d^2 / 2), d the distance in standard deviations. At the true pose its mean over the sensor's errors is
2^(-n / 2) for n measured numbers: `EXPECTED_MATCH`. The errors of ranges have a split normal distribution (two halves of normal
distributions that meet at their peaks), as some sensors read short more often and farther than long.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array, Detection, Landmark


class Sightings(NamedTuple):
    """Detections as arrays, m of them; those of unknown landmarks left out.

    Args:
        values: bearing [rad], range [m], 1 / variance of the bearing, of a range that is too long, of one too short, (m, 5).
        first: where the places of each begin in `places`, (m + 1,).
        places: positions of the landmarks that each may be of, (k, 2) [m].
    """

    values: Array
    first: NDArray[np.int64]
    places: Array

    def __len__(self) -> int:  # type: ignore[override]
        return len(self.values)


class Atlas:
    """Which landmarks a name stands for: a landmark's own name, or its colour."""

    def __init__(self, landmarks: Sequence[Landmark]) -> None:
        names: dict[str, list[Array]] = {}
        for mark in landmarks:
            for name in {mark.name, mark.color} - {""}:
                names.setdefault(name, []).append(np.asarray(mark.position, dtype=float)[:2])
        self._places: Mapping[str, Array] = {name: np.array(places) for name, places in names.items()}
        self._known: dict[tuple[str, ...], tuple[NDArray[np.int64], Array]] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __contains__(self, name: str) -> bool:
        return name in self._places

    def places(self, name: str) -> Array:
        """(k, 2) [m]"""
        return self._places[name]

    def sightings(self, detections: Sequence[Detection], bearing_std: float, range_std: float) -> Sightings:
        """Detections of known landmarks as arrays.

        Args:
            bearing_std, range_std: what is added to each detection's own, in squares; the latter as a share of its range.
        """
        names, rows = [], []
        for d in detections:
            if d.landmark in self._places and math.isfinite(d.bearing) and math.isfinite(d.range):
                names.append(d.landmark)
                (own_bearing, _), (_, own_range) = d.covariance.tolist()
                added = (range_std * d.range) ** 2
                too_long, too_short = own_range + added, own_range * d.short_tail**2 + added
                rows.append((d.bearing, d.range, 1.0 / (own_bearing + bearing_std**2), 1.0 / too_long, 1.0 / too_short))
        first, places = self._tables(tuple(names))
        return Sightings(np.array(rows).reshape(-1, 5), first, places)

    def _tables(self, names: tuple[str, ...]) -> tuple[NDArray[np.int64], Array]:
        """`first` and `places` for these names; made once, as the same few combinations are seen again and again."""
        if names not in self._known:
            places = [self._places[name] for name in names]
            first = np.zeros(len(names) + 1, dtype=np.int64)
            np.cumsum([len(p) for p in places], out=first[1:])
            self._known[names] = first, np.concatenate(places) if places else np.empty((0, 2))
        return self._known[names]


@njit(cache=True)
def reweigh(weights: Array, likelihoods: Array) -> float:
    """Multiplies weights (n,) of sum 1 by likelihoods (n,) and normalizes them; returns the mean likelihood.

    Where it is 0 or not finite, the weights become equal.
    """
    total = 0.0
    for i in range(len(weights)):
        weights[i] *= likelihoods[i]
        total += weights[i]
    if total > 0.0 and math.isfinite(total):
        weights /= total
        return total
    weights[:] = 1.0 / len(weights)
    return 0.0


class Matches(NamedTuple):
    """How well m sightings fit to n particles.

    Args:
        values: of each landmark that the sightings may be of, (k, n), between 0 and 1.
        first: where the landmarks of each sighting begin in `values`, (m + 1,).
    """

    values: Array
    first: NDArray[np.int64]

    def likelihoods(self, outlier: float) -> Array:
        """Of all sightings together, (n,)."""
        return _products(self.values, self.first, outlier)

    def explained(self, weights: Array) -> float:
        """Mean match of the sightings over particles of these weights (n,), sum 1, by the landmarks that fit best.

        With the weights *after* these sightings its expectation is `EXPECTED_MATCH`, however widely the particles are spread:
        pose and sighting are then a draw from one joint distribution, prior times sensor model, and averaging over the
        posterior and then over sightings is averaging over that (posterior predictive check: Rubin 1984; Cook, Gelman and
        Rubin 2006). Where no particle is near the truth it is near 0.
        """
        return _explained(self.values, self.first, weights)


def bearing_range(particles: Array, seen: Sightings) -> Matches:
    """Sightings by bearing and range: a von Mises and a split normal distribution.

    Thrun, Burgard and Fox 2005, Table 6.4; on the circle, the normal distribution's counterpart takes 2 (1 - cos) for the square
    of the angle, which costs no arcus tangent.
    """
    # Columns in a row each: the compiler then takes several particles at once.
    x, y, headings = np.ascontiguousarray(particles.T)
    matches = np.empty((len(seen.places), len(particles)))
    _bearing_range_exponents(x, y, np.cos(headings), np.sin(headings), *seen, matches)
    np.exp(matches, out=matches)  # numpy's is vectorized and five times as fast as the compiler's
    return Matches(matches, seen.first)


def ranges(particles: Array, seen: Sightings) -> Matches:
    """The distances alone: the thesis' model in simulation (section 3.5). Headings follow from the motion."""
    matches = np.empty((len(seen.places), len(particles)))
    _range_exponents(particles, seen.values, seen.first, seen.places, matches)
    np.exp(matches, out=matches)
    return Matches(matches, seen.first)


@njit(cache=True, error_model="numpy")
def _bearing_range_exponents(
    xs: Array,
    ys: Array,
    cosines: Array,
    sines: Array,
    values: Array,
    first: NDArray[np.int64],
    places: Array,
    exponents: Array,
) -> None:
    """Logarithms of the matches of the k places that the sightings may be of, (k, n)."""
    for m in range(len(values)):
        cb, sb = math.cos(values[m, 0]), math.sin(values[m, 0])
        reading, bearing_weight = values[m, 1], values[m, 2]
        too_long, too_short = 0.5 * values[m, 3], 0.5 * values[m, 4]
        for j in range(first[m], first[m + 1]):
            x, y = places[j, 0], places[j, 1]
            row = exponents[j]
            for i in range(len(xs)):
                ux, uy = cosines[i] * cb - sines[i] * sb, sines[i] * cb + cosines[i] * sb
                dx, dy = x - xs[i], y - ys[i]
                square = dx * dx + dy * dy + 1e-18
                inverse = 1.0 / math.sqrt(square)
                off = square * inverse - reading
                range_weight = too_short if off > 0.0 else too_long
                row[i] = ((ux * dx + uy * dy) * inverse - 1.0) * bearing_weight - off * off * range_weight


@njit(cache=True, error_model="numpy")
def _range_exponents(particles: Array, values: Array, first: NDArray[np.int64], places: Array, exponents: Array) -> None:
    for m in range(len(values)):
        for j in range(first[m], first[m + 1]):
            for i in range(len(particles)):
                dx, dy = places[j, 0] - particles[i, 0], places[j, 1] - particles[i, 1]
                off = math.sqrt(dx * dx + dy * dy) - values[m, 1]
                exponents[j, i] = -0.5 * off * off * (values[m, 4] if off > 0.0 else values[m, 3])


@njit(cache=True, error_model="numpy")
def _products(matches: Array, first: NDArray[np.int64], outlier: float) -> Array:
    """Over the sightings, of the mean matches (k, n) over the places of each, with the constant for outliers: (n,)."""
    likelihoods = np.ones(matches.shape[1])
    for m in range(len(first) - 1):
        share = (1.0 - outlier) / (first[m + 1] - first[m])
        if first[m + 1] - first[m] == 1:
            row = matches[first[m]]
            for i in range(len(likelihoods)):
                likelihoods[i] *= share * row[i] + outlier
        else:
            for i in range(len(likelihoods)):
                total = 0.0
                for j in range(first[m], first[m + 1]):
                    total += matches[j, i]
                likelihoods[i] *= share * total + outlier
    return likelihoods


@njit(cache=True, error_model="numpy")
def _explained(matches: Array, first: NDArray[np.int64], weights: Array) -> float:
    total = 0.0
    for m in range(len(first) - 1):
        for i in range(len(weights)):
            best = 0.0
            for j in range(first[m], first[m + 1]):
                best = max(best, matches[j, i])
            total += weights[i] * best
    return total / (len(first) - 1)


COLOUR_HEADINGS: dict[frozenset[str], float] = {
    frozenset(("green", "blue")): 0.0,
    frozenset(("orange", "green")): 0.5 * math.pi,
    frozenset(("red", "orange")): math.pi,
    frozenset(("blue", "red")): -0.5 * math.pi,
}
"""What the thesis' robot knows: its heading where it sees these two balls at once, right-handed [rad]."""

_HEADING_STD = 0.35  # [rad] over the field, the middle of the two balls lies this far from the heading that the pair stands for


def headings(particles: Array, seen: Sequence[tuple[str, float]]) -> Matches:
    """The thesis' four colour pairs (section 3.5), its robot's model: a von Mises distribution of the heading.

    Args:
        particles: (n, 3).
        seen: colours and bearings [rad] of the balls in one picture; the pair's heading is taken to lie in their middle.
    """
    pairs = []
    for i, (one, bearing) in enumerate(seen):
        for other, other_bearing in seen[i + 1 :]:
            heading = COLOUR_HEADINGS.get(frozenset((one, other)))
            if heading is None:
                continue
            middle = bearing + 0.5 * math.remainder(other_bearing - bearing, math.tau)
            pairs.append(np.exp((np.cos(particles[:, 2] + middle - heading) - 1.0) / _HEADING_STD**2))
    return Matches(np.array(pairs).reshape(-1, len(particles)), np.arange(len(pairs) + 1))


class Expected(NamedTuple):
    """Mean and standard deviation of a match at the true pose."""

    mean: float
    std: float

    @classmethod
    def over(cls, count: int) -> Expected:
        """Of exp(-d^2 / 2) for `count` normal errors: the mean of its k-th power is (1 + k)^(-count / 2)."""
        mean, square = 2.0 ** (-count / 2), 3.0 ** (-count / 2)
        return cls(mean, math.sqrt(square - mean * mean))

    def least(self, rate: float, sigmas: float) -> float:
        """What an exponential average of this rate is above, up to so many of its standard deviations; 0 at rate 0."""
        return self.mean - sigmas * self.std * math.sqrt(rate / (2.0 - rate)) if rate > 0.0 else 0.0


EXPECTED_MATCH: Mapping[str, Expected] = {
    "bearing-range": Expected.over(2),
    "ranges": Expected.over(1),
    "headings": Expected.over(1),
}
"""By model: by how many numbers a sighting is judged."""
