"""Cones of rays: what a camera sees of a ball is one. Fitted to rays of its rim, with outliers among them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robocar.core import Array

_BINS = 24
_SHARES = np.array([3, 4, 6, 9])  # a sample spans this part of the rim between its points: 1 / share


@njit(cache=True)
def tangents(axis: Array) -> tuple[float, float, float, float, float]:
    """Unit vectors at right angles to a unit vector: right = (a, 0, b), down = (c, d, e), as OpenCV's camera frame names them."""
    length = math.hypot(axis[0], axis[2])
    a, b = axis[2] / length, -axis[0] / length
    return a, b, axis[1] * b, length, -axis[1] * a


@njit(cache=True)
def around(axis: Array, units: Array) -> Array:
    """Angles of rays (n, 3) around the axis (3,) in [0, 2 pi), from right over down, (n,) [rad]."""
    a, b, c, d, e = tangents(axis / math.sqrt(np.sum(axis * axis)))
    angles = np.empty(len(units))
    for i in range(len(units)):
        x, y, z = units[i, 0], units[i, 1], units[i, 2]
        angles[i] = math.atan2(c * x + d * y + e * z, a * x + b * z) % math.tau
    return angles


@njit(cache=True)
def arc(angles: Array) -> float:
    """Share of the directions around an axis in which there are rays (n,) [rad]; few rays are counted in fewer directions."""
    bins = min(_BINS, max(6, len(angles) // 2))
    seen = np.zeros(bins, dtype=np.bool_)
    for i in range(len(angles)):
        seen[int(angles[i] * (bins / math.tau)) % bins] = True
    return np.sum(seen) / bins


@njit(cache=True)
def covariance(angles: Array, std: float) -> Array:
    """Of (axis to the right, axis downwards, half angle) from n rays of the rim, each off by `std`, (3, 3) [rad^2].

    Least squares: the angle between ray i and the axis changes by (cos phi_i, sin phi_i) with the axis, phi_i as in `around`.
    """
    information = np.diag(np.full(3, 1e-3))
    for i in range(len(angles)):
        row = np.array([math.cos(angles[i]), math.sin(angles[i]), 1.0])
        for j in range(3):
            for k in range(3):
                information[j, k] += row[j] * row[k]
    return std**2 * np.linalg.inv(information)  # type: ignore[return-value]


@njit(cache=True)
def _near(units: Array, axis: Array, half_angle: float, tolerance: float, near: NDArray[np.bool_]) -> int:
    """Marks the rays within `tolerance` of the cone; returns how many."""
    # Cosines are cheaper, and exact at both bounds.
    high = math.cos(max(0.0, half_angle - tolerance))
    low = math.cos(half_angle + tolerance)
    count = 0
    for i in range(len(units)):
        cosine = units[i, 0] * axis[0] + units[i, 1] * axis[1] + units[i, 2] * axis[2]
        near[i] = low < cosine and (cosine < high or half_angle < tolerance)
        count += near[i]
    return count


@njit(cache=True)
def fit(units: Array, tolerance: float) -> tuple[Array, float, NDArray[np.bool_]]:
    """The cone that most rays lie on.

    Random sample consensus (Fischler and Bolles 1981), but with samples of three rays spread evenly over the rim and over parts
    of it, so that the same rays always give the same cone; then least squares on the inliers.

    Args:
        units: unit vectors, (n, 3), n >= 6.
        tolerance: how far an inlier may be off the cone [rad].

    Returns:
        Axis (3,), half angle [rad] and inliers (n,); half angle 0 where fewer than 6 rays lie on any cone.
    """
    n = len(units)
    middle = np.zeros(3)
    for i in range(n):
        middle += units[i]
    order = np.argsort(around(middle, units), kind="mergesort")  # Numba's quicksort: see tests/test_architecture.py
    axis, half_angle, most = middle, 0.0, 0
    near = np.zeros(n, dtype=np.bool_)
    for share in _SHARES:
        step = max(1, n // share)
        for start in range(0, n, max(1, n // 16)):
            a, b, c = units[order[start]], units[order[(start + step) % n]], units[order[(start + 2 * step) % n]]
            # All three have the same projection on this direction.
            tip = np.cross(a, b) + np.cross(b, c) + np.cross(c, a)
            length = math.sqrt(np.sum(tip * tip))
            if length < 1e-12:
                continue
            tip /= length
            cosine = np.sum(tip * a)
            if cosine < 0:
                tip, cosine = -tip, -cosine
            angle = math.acos(min(1.0, cosine))
            count = _near(units, tip, angle, tolerance, near)
            if count > most:
                axis, half_angle, most = tip, angle, count
    for _ in range(3):
        if most < 6:
            break
        _near(units, axis, half_angle, tolerance, near)
        # Rays u of a cone: u . w = 1 with w = axis / cos(half angle). Solved for w - axis, so that a narrow cone loses no digits.
        matrix, right = np.zeros((3, 3)), np.zeros(3)
        for i in range(n):
            if near[i]:
                u = units[i]
                rest = 1.0 - (u[0] * axis[0] + u[1] * axis[1] + u[2] * axis[2])
                for j in range(3):
                    right[j] += u[j] * rest
                    for k in range(3):
                        matrix[j, k] += u[j] * u[k]
        if abs(np.linalg.det(matrix)) < 1e-18:  # rays of one plane
            most = 0
            break
        w = axis + np.linalg.solve(matrix, right)
        length = math.sqrt(np.sum(w * w))
        axis, half_angle = w / length, math.acos(min(1.0, 1.0 / length))
        most = _near(units, axis, half_angle, tolerance, near)
    if most < 6:
        return axis, 0.0, near
    return axis, half_angle, near
