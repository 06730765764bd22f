"""Which particles live on: resampling schemes, and how many particles are needed.

Each scheme gives indices into the particles; the expected number of copies of particle i is n w_i.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array

Indices = NDArray[np.int64]


@njit(cache=True)
def _wheel(weights: Array, start: int, draws: Array) -> Indices:
    n = len(weights)
    step = 2.0 * weights.max()
    index, beta = start, 0.0
    chosen = np.empty(len(draws), dtype=np.int64)
    for k in range(len(draws)):
        beta += draws[k] * step
        while beta > weights[index]:
            beta -= weights[index]
            index = (index + 1) % n
        chosen[k] = index
    return chosen


def wheel(weights: Array, count: int, rng: np.random.Generator) -> Indices:
    """The resampling wheel (thesis, Fig. 2.12): steps of U(0, 1) times twice the largest weight along a ring of the weights.

    Args:
        weights: of the particles, sum 1, (n,).
        count: how many to choose.

    Returns:
        Indices (count,).
    """
    return _wheel(weights, int(rng.integers(len(weights))), rng.random(count))


@njit(cache=True)
def _systematic(weights: Array, count: int, offset: float) -> Indices:
    chosen = np.empty(count, dtype=np.int64)
    total, i = weights[0], 0
    scale = weights.sum() / count
    for k in range(count):
        while (k + offset) * scale > total and i < len(weights) - 1:
            i += 1
            total += weights[i]
        chosen[k] = i
    return chosen


def systematic(weights: Array, count: int, rng: np.random.Generator) -> Indices:
    """Low-variance resampling (Thrun, Burgard and Fox 2005, Table 4.4): one draw, evenly spaced pointers; see `wheel`.

    Particle i is copied floor(n w_i) or ceil(n w_i) times.
    """
    return _systematic(weights, count, rng.random())


def residual(weights: Array, count: int, rng: np.random.Generator) -> Indices:
    """floor(n w_i) copies of each, the rest drawn from what is left over (Liu and Chen 1998, section 3); see `wheel`."""
    expected = count * weights / weights.sum()
    copies = np.floor(expected).astype(np.int64)
    missing = count - int(copies.sum())
    if missing > 0:
        rest = np.maximum(expected - copies, 0.0)
        rest = np.full(len(rest), 1.0 / len(rest)) if rest.sum() <= 0.0 else rest / rest.sum()
        np.add.at(copies, rng.choice(len(weights), missing, p=rest), 1)
    return np.repeat(np.arange(len(weights)), copies)[:count]


SCHEMES: dict[str, Callable[[Array, int, np.random.Generator], Indices]] = {
    "wheel": wheel,
    "systematic": systematic,
    "residual": residual,
}


@njit(cache=True)
def scattered(particles: Array, weights: Array, chosen: Indices, size: float, angle: float, noise: Array) -> Array:
    """Copies of the chosen particles (n, 3), each moved by Delta (1 - w) g with g within [-1, 1] (thesis, eq. 2.42).

    Args:
        size, angle: Delta of the position [m] and of the heading [rad].
        noise: g of each, (n, 3); the thesis cuts a normal distribution, here `motion_models.bounded` needs no cutting.
    """
    copies = np.empty((len(chosen), 3))
    for k in range(len(chosen)):
        i = chosen[k]
        share = 1.0 - weights[i]
        copies[k, 0] = particles[i, 0] + size * share * noise[k, 0]
        copies[k, 1] = particles[i, 1] + size * share * noise[k, 1]
        copies[k, 2] = particles[i, 2] + angle * share * noise[k, 2]
    return copies


@njit(cache=True)
def shrunk(values: Array, chosen: Indices, shrink: float, least: float, noise: Array) -> Array:
    """Copies of slowly changing parameters with a little new variety, but drawn towards their mean by as much as it adds.

    Liu and West, Combined Parameter and State Estimation in Simulation-Based Filtering (2001), section 10.3.3.

    Args:
        values: of the particles, (n, m); chosen: which of them live on, (k,).
        shrink: share of the distance to the mean that is kept, up to 1; least: standard deviation that is always added.
        noise: numbers of mean 0 and variance 1/6 (`motion_models.bounded`), (k, m).
    """
    count, columns = len(chosen), values.shape[1]
    copies = np.empty((count, columns))
    for j in range(columns):
        total = squares = 0.0
        for k in range(count):
            value = values[chosen[k], j]
            total += value
            squares += value * value
        mean = total / count
        spread = math.sqrt(max(0.0, squares / count - mean * mean) * (1.0 - shrink * shrink)) + least
        spread *= math.sqrt(6.0)
        for k in range(count):
            copies[k, j] = mean + shrink * (values[chosen[k], j] - mean) + spread * noise[k, j]
    return copies


def effective_size(weights: Array) -> float:
    """N_eff = 1 / sum of the squared weights, which sum to 1 (Kong, Liu and Wong 1994)."""
    return 1.0 / float(weights @ weights)


def kld_size(bins: int, error: float, z: float) -> float:
    """How many samples keep the Kullback-Leibler distance to a distribution over `bins` bins below `error`.

    Fox, Adapting the Sample Size in Particle Filters Through KLD-Sampling (2003), eq. 14.

    Args:
        z: quantile of the standard normal distribution for the wanted confidence.
    """
    if bins < 2:
        return 1.0
    k = bins - 1
    a = 2.0 / (9.0 * k)
    return k / (2.0 * error) * (1.0 - a + math.sqrt(a) * z) ** 3


@njit(cache=True)
def occupied_bins(particles: Array, chosen: Indices, size: float, angle: float) -> int:
    """How many bins of `size` [m] by `size` by `angle` [rad] the chosen particles (n, 3) lie in."""
    keys = np.empty(len(chosen), dtype=np.int64)
    sectors = max(1, round(math.tau / angle))
    for k in range(len(chosen)):
        x, y, theta = particles[chosen[k], 0], particles[chosen[k], 1], particles[chosen[k], 2]
        sector = int((theta % math.tau) * sectors / math.tau) % sectors
        column, row = math.floor(x / size), math.floor(y / size)
        keys[k] = (((column & 0xFFFFF) << 20) | (row & 0xFFFFF)) * sectors + sector
    keys.sort()
    count = 1
    for k in range(1, len(keys)):
        count += keys[k] != keys[k - 1]
    return count
