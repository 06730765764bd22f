"""One pose from many particles."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from robocar.core import SE2, Array

_TRIES = 16


class PoseEstimate(NamedTuple):
    """
    Args:
        pose: weighted mean, that of the heading on the circle.
        covariance: of x, y, theta, (3, 3) [m, m, rad].
        share: of the weight that it is made from.
    """

    pose: SE2
    covariance: Array
    share: float


@njit(cache=True)
def _moments(particles: Array, weights: Array, x: float, y: float, theta: float, reach: float, angle: float) -> Array:
    """Sum of the weights, means of x, y, cos and sin over the particles within `reach` [m] and `angle` [rad] of a pose, (5,)."""
    sums = np.zeros(5)
    c0, s0, least = math.cos(theta), math.sin(theta), math.cos(min(angle, math.pi))
    for i in range(len(particles)):
        dx, dy = particles[i, 0] - x, particles[i, 1] - y
        if dx * dx + dy * dy > reach * reach:
            continue
        c, s = math.cos(particles[i, 2]), math.sin(particles[i, 2])
        if c * c0 + s * s0 < least - 1e-12:
            continue
        w = weights[i]
        sums[0] += w
        sums[1] += w * particles[i, 0]
        sums[2] += w * particles[i, 1]
        sums[3] += w * c
        sums[4] += w * s
    if sums[0] > 0.0:
        sums[1:] /= sums[0]
    return sums


@njit(cache=True)
def _wrapped(angle: float) -> float:
    return angle - math.tau * math.floor(angle / math.tau + 0.5)


@njit(cache=True)
def _covariance(
    particles: Array,
    weights: Array,
    x: float,
    y: float,
    theta: float,
    near: tuple[float, float, float],
    reach: float,
    angle: float,
) -> Array:
    """About (x, y, theta), over the particles within reach of `near`, (3, 3)."""
    result, total = np.zeros((3, 3)), 0.0
    for i in range(len(particles)):
        dx, dy = particles[i, 0] - near[0], particles[i, 1] - near[1]
        turned = _wrapped(particles[i, 2] - near[2])
        if dx * dx + dy * dy > reach * reach or abs(turned) > angle + 1e-6:
            continue
        w = weights[i]
        total += w
        ex, ey = particles[i, 0] - x, particles[i, 1] - y
        et = _wrapped(particles[i, 2] - theta)
        result[0, 0] += w * ex * ex
        result[0, 1] += w * ex * ey
        result[0, 2] += w * ex * et
        result[1, 1] += w * ey * ey
        result[1, 2] += w * ey * et
        result[2, 2] += w * et * et
    result[1, 0], result[2, 0], result[2, 1] = result[0, 1], result[0, 2], result[1, 2]
    return result / total if total > 0.0 else result


def mean_of_all(particles: Array, weights: Array) -> PoseEstimate:
    """The thesis' estimate: (sum w x, sum w y, atan2(sum w sin, sum w cos)) (eq. 2.43), for particles (n, 3), weights (n,)."""
    return _about(particles, weights, 0.0, 0.0, 0.0, math.inf, math.pi)


def largest_group(particles: Array, weights: Array, reach: float, angle: float) -> PoseEstimate:
    """The same over the heaviest group of particles: those within `reach` [m] and `angle` [rad] of its own mean.

    So particles that are tried out elsewhere (a robot may have been carried off) do not pull the estimate away. Where no group
    holds half of the weight the robot is lost, and the mean and spread of all particles say so.
    """
    pointers = (np.arange(_TRIES) + 0.5) * (weights.sum() / _TRIES)
    picks = np.minimum(np.searchsorted(np.cumsum(weights), pointers), len(weights) - 1)
    best, heaviest = np.zeros(5), -1.0
    for i in picks:
        x, y, theta = particles[i]
        sums = _moments(particles, weights, x, y, theta, reach, angle)
        if sums[0] > heaviest:
            best, heaviest = sums, sums[0]
        if heaviest > 0.9:
            break
    near = (0.0, 0.0, 0.0)
    for _ in range(2):  # mean shift: the group around the group's mean
        near = best[1], best[2], math.atan2(best[4], best[3])
        best = _moments(particles, weights, *near, reach, angle)
    if not best[0] >= 0.5 * float(weights.sum()):
        return mean_of_all(particles, weights)
    return _about(particles, weights, *near, reach, angle)


def _about(particles: Array, weights: Array, x: float, y: float, theta: float, reach: float, angle: float) -> PoseEstimate:
    share, mx, my, c, s = (float(value) for value in _moments(particles, weights, x, y, theta, reach, angle))
    heading = math.atan2(s, c)
    covariance = _covariance(particles, weights, mx, my, heading, (x, y, theta), reach, angle)
    return PoseEstimate(SE2(mx, my, heading), covariance, share)
