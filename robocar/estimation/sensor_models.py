"""How likely what is seen is from where a particle stands.

Each model multiplies, over what is seen, `(1 - outlier) * match + outlier`, where `match` in [0, 1] is 1 at perfect agreement:
without the constant a single wrong sighting would end the true hypothesis. A sighting that may be of one of several landmarks
(balls of one colour) is matched with the mean over them.
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
        values: bearing [rad], range [m], 1 / variance of the bearing, 1 / variance of the range, (m, 4).
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
                variances = own_bearing + bearing_std**2, own_range + (range_std * d.range) ** 2
                rows.append((d.bearing, d.range, 1.0 / variances[0], 1.0 / variances[1]))
        first, places = self._tables(tuple(names))
        return Sightings(np.array(rows).reshape(-1, 4), first, places)

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


@njit(cache=True, error_model="numpy")
def bearing_range(
    particles: Array, values: Array, first: NDArray[np.int64], places: Array, outlier: float, likelihoods: Array
) -> None:
    """Likelihoods (n,) of sightings by bearing and range: a von Mises and a normal distribution.

    Thrun, Burgard and Fox 2005, Table 6.4; on the circle, the normal distribution's counterpart takes 2 (1 - cos) for the
    square of the angle, which costs no arcus tangent.
    """
    rays = np.stack((np.cos(values[:, 0]), np.sin(values[:, 0])), axis=1)
    for i in range(len(particles)):
        c, s = math.cos(particles[i, 2]), math.sin(particles[i, 2])
        product = 1.0
        for k in range(len(values)):
            ux, uy = c * rays[k, 0] - s * rays[k, 1], s * rays[k, 0] + c * rays[k, 1]
            match = 0.0
            for j in range(first[k], first[k + 1]):
                dx, dy = places[j, 0] - particles[i, 0], places[j, 1] - particles[i, 1]
                distance = math.sqrt(dx * dx + dy * dy) + 1e-12
                off = distance - values[k, 1]
                square = 2.0 * (1.0 - (ux * dx + uy * dy) / distance) * values[k, 2] + off * off * values[k, 3]
                if square < 80.0:
                    match += math.exp(-0.5 * square)
            product *= (1.0 - outlier) * match / (first[k + 1] - first[k]) + outlier
        likelihoods[i] = product


@njit(cache=True, error_model="numpy")
def ranges(particles: Array, values: Array, first: NDArray[np.int64], places: Array, outlier: float, likelihoods: Array) -> None:
    """Likelihoods (n,) of the distances alone: the thesis' model in simulation (section 3.5). Headings follow from the motion."""
    for i in range(len(particles)):
        product = 1.0
        for k in range(len(values)):
            match = 0.0
            for j in range(first[k], first[k + 1]):
                dx, dy = places[j, 0] - particles[i, 0], places[j, 1] - particles[i, 1]
                off = math.sqrt(dx * dx + dy * dy) - values[k, 1]
                match += math.exp(-0.5 * min(80.0, off * off * values[k, 3]))
            product *= (1.0 - outlier) * match / (first[k + 1] - first[k]) + outlier
        likelihoods[i] = product


COLOUR_HEADINGS: dict[frozenset[str], float] = {
    frozenset(("green", "blue")): 0.0,
    frozenset(("orange", "green")): 0.5 * math.pi,
    frozenset(("red", "orange")): math.pi,
    frozenset(("blue", "red")): -0.5 * math.pi,
}
"""What the thesis' robot knows: its heading where it sees these two balls at once, right-handed [rad]."""

_HEADING_STD = 0.35  # [rad] over the field, the middle of the two balls lies this far from the heading that the pair stands for


def headings(particles: Array, seen: Sequence[tuple[str, float]], outlier: float) -> Array:
    """Likelihoods (n,) by the thesis' four colour pairs (section 3.5), its robot's model: a von Mises distribution of the
    heading.

    Args:
        particles: (n, 3).
        seen: colours and bearings [rad] of the balls in one picture; the pair's heading is taken to lie in their middle.
        outlier: see the module.
    """
    likelihoods = np.ones(len(particles))
    for i, (one, bearing) in enumerate(seen):
        for other, other_bearing in seen[i + 1 :]:
            heading = COLOUR_HEADINGS.get(frozenset((one, other)))
            if heading is None:
                continue
            middle = bearing + 0.5 * math.remainder(other_bearing - bearing, math.tau)
            match = np.exp((np.cos(particles[:, 2] + middle - heading) - 1.0) / _HEADING_STD**2)
            likelihoods *= (1.0 - outlier) * match + outlier
    return likelihoods
