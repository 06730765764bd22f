"""Rigid motions of the plane: poses, twists and angles.

Frames stand in the names: `world_from_robot @ robot_from_sonar` is `world_from_sonar`. REP-103: metres, radians, x forward,
y left, counter-clockwise positive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

Array = NDArray[np.float64]


def wrap_angle(angle: float) -> float:
    """The same direction in (-pi, pi] [rad]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles: ArrayLike) -> Array:
    """`wrap_angle` for arrays of any shape [rad]."""
    wrapped = np.remainder(np.asarray(angles, dtype=float) + math.pi, math.tau) - math.pi
    return np.where(wrapped == -math.pi, math.pi, wrapped)


def plain_number(value: Any, name: str) -> float:
    """A number of any kind as a float of Python's own.

    Raises:
        TypeError: it is none, or an array. ValueError: it is too large.
    """
    if isinstance(value, str | bytes) or np.ndim(value) > 0:
        raise TypeError(f"{name} is a number, not {value!r:.80}")
    try:
        return float(value)
    except TypeError as error:
        raise TypeError(f"{name} is a number, not {value!r:.80}") from error
    except (OverflowError, ValueError) as error:
        raise ValueError(f"{name} is too large, or no number: {type(value).__name__}") from error


def frozen_array(values: ArrayLike, dtype: DTypeLike = float) -> NDArray:
    """A read-only array; a copy unless nobody else can change it (read-only, and no view of an array that is not).

    A copy lies in bytes, which nobody can make writable again: what several parts share no part can change.
    """
    array = np.asarray(values, dtype=dtype)
    if array.flags.writeable or not (array.base is None or array.base.__class__ is bytes):
        array = np.ndarray(array.shape, array.dtype, array.tobytes())
    return array


@dataclass(frozen=True, slots=True)
class SE2:
    """A pose, or the transform `a_from_b` between two frames of the plane.

    `a_from_b @ b_from_c` composes, `a_from_b.inverse()` is `b_from_a`, `a_from_b.transform(points)` maps points of frame b
    into frame a. The angle is kept in (-pi, pi].
    """

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    def __post_init__(self) -> None:
        if not (self.x.__class__ is self.y.__class__ is self.theta.__class__ is float):  # as nearly always
            object.__setattr__(self, "x", plain_number(self.x, "a pose's x"))
            object.__setattr__(self, "y", plain_number(self.y, "a pose's y"))
            object.__setattr__(self, "theta", plain_number(self.theta, "a pose's theta"))
        if not (math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.theta)):
            raise ValueError(f"a pose needs finite numbers, not ({self.x}, {self.y}, {self.theta})")
        object.__setattr__(self, "theta", wrap_angle(self.theta))

    def __matmul__(self, other: SE2) -> SE2:
        c, s = math.cos(self.theta), math.sin(self.theta)
        return SE2(self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y, self.theta + other.theta)

    def inverse(self) -> SE2:
        c, s = math.cos(self.theta), math.sin(self.theta)
        return SE2(-c * self.x - s * self.y, s * self.x - c * self.y, -self.theta)

    def transform(self, points: ArrayLike) -> Array:
        """Points (..., 2) [m] of the inner frame in the outer frame."""
        points = np.asarray(points, dtype=float)
        c, s = math.cos(self.theta), math.sin(self.theta)
        x, y = points[..., 0], points[..., 1]
        moved = np.empty(points.shape)
        moved[..., 0] = self.x + c * x - s * y
        moved[..., 1] = self.y + s * x + c * y
        return moved

    def apply(self, x: float, y: float) -> tuple[float, float]:
        """`transform` of one point, in plain numbers."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return self.x + c * x - s * y, self.y + s * x + c * y

    def inverse_apply(self, x: float, y: float) -> tuple[float, float]:
        """A point of the outer frame in the inner one, in plain numbers."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        dx, dy = x - self.x, y - self.y
        return c * dx + s * dy, c * dy - s * dx

    @property
    def position(self) -> Array:
        """(2,) [m]"""
        return np.array([self.x, self.y])

    def as_array(self) -> Array:
        """(3,) x, y [m], theta [rad]"""
        return np.array([self.x, self.y, self.theta])

    def distance_to(self, other: SE2) -> float:
        """Distance of the two origins [m]."""
        return math.hypot(other.x - self.x, other.y - self.y)


@dataclass(frozen=True, slots=True)
class Twist:
    """Forward speed [m/s] and turning rate [rad/s] of the robot in its own frame."""

    v: float = 0.0
    omega: float = 0.0

    def __post_init__(self) -> None:
        if not (self.v.__class__ is self.omega.__class__ is float):  # as nearly always
            object.__setattr__(self, "v", plain_number(self.v, "a twist's v"))
            object.__setattr__(self, "omega", plain_number(self.omega, "a twist's omega"))

    def step(self, dt: float) -> SE2:
        """Exact motion along the arc for `dt` [s]: robot_from_next_robot (velocity motion model, thesis eq. 2.39)."""
        turn = self.omega * dt
        if abs(turn) < 1e-9:
            return SE2(self.v * dt, 0.5 * self.v * dt * turn, turn)
        radius = self.v / self.omega
        return SE2(radius * math.sin(turn), radius * 2.0 * math.sin(0.5 * turn) ** 2, turn)  # 1 - cos, without cancelling


def shift(before: SE2, now: SE2, around: SE2, reach: float) -> float:
    """How far two placements of the same frame put what lies within `reach` [m] of a pose in it apart, at most [m]."""
    turn = abs(math.remainder(now.theta - before.theta, math.tau))
    return math.dist(before.apply(around.x, around.y), now.apply(around.x, around.y)) + turn * reach
