"""Where the robot may be after a step, given what its wheels or its speeds said.

Two models (thesis, eq. 2.37-2.39; Thrun, Burgard and Fox, Probabilistic Robotics, 2005, sections 5.3 and 5.4): by odometry,
whose step is taken as a turn, a straight move and a turn, each with noise; and by velocity, an arc with noise on both speeds
and a final turn.

One difference from the book: its variances grow with the square of the step, so that the noise of a way depends on how many
steps it is cut into. Here a step's *variance* is proportional to its length (the thesis' b in eq. 2.37 and 2.38): n short
steps add up to the noise of a long one, whatever the rate of the sensor.

    variance of a turn      alpha1 |turn| + alpha2 |way|      alpha1 [rad], alpha2 [rad^2/m]
    variance of a way       alpha3 |way| + alpha4 |turn|      alpha3 [m], alpha4 [m^2/rad]
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, NamedTuple

import numpy as np
from numba import njit

from robocar.core import SE2, Array

Noise = Literal["normal", "triangular"]


class Alphas(NamedTuple):
    """See the module's table."""

    alpha1: float
    alpha2: float
    alpha3: float
    alpha4: float


def draw(rng: np.random.Generator, shape: tuple[int, int], kind: Noise) -> Array:
    """Noise of mean 0 and variance 1: normal (thesis, eq. 2.37) or triangular within +-sqrt(6) (eq. 2.38)."""
    if kind == "normal":
        return rng.standard_normal(shape)
    return bounded(rng, shape) * math.sqrt(6.0)


def bounded(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Triangular noise within -1 and 1, mean 0, variance 1/6; costs half of the normal distribution's."""
    noise = rng.random(shape)
    noise -= rng.random(shape)
    return noise


@njit(cache=True)
def turn_move_turn(x: float, y: float, theta: float) -> tuple[float, float, float]:
    """The step robot_from_next_robot as rot1 [rad], trans [m], rot2 [rad] (thesis, after eq. 3.19).

    A robot that backs up does not turn round, move and turn round again: trans is negative then. Of one that moves less than a
    tenth of a millimetre the direction is not known: it is taken to move along an arc.
    """
    trans = math.hypot(x, y)
    if trans < 1e-4:
        return 0.5 * theta, x, 0.5 * theta
    rot1 = math.atan2(y, x)
    if abs(rot1) > 0.5 * math.pi:
        rot1 -= math.copysign(math.pi, rot1)
        trans = -trans
    return rot1, trans, theta - rot1


@njit(cache=True)
def _spreads(rot1: float, trans: float, rot2: float, alphas: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Standard deviations of the three parts of a step."""
    a1, a2, a3, a4 = alphas
    way, turn = abs(trans), abs(rot1) + abs(rot2)
    return math.sqrt(a1 * abs(rot1) + 0.5 * a2 * way), math.sqrt(a3 * way + a4 * turn), math.sqrt(a1 * abs(rot2) + 0.5 * a2 * way)


@njit(cache=True)
def sample_odometry(
    particles: Array,
    x: float,
    y: float,
    theta: float,
    alphas: tuple[float, float, float, float],
    noise: Array,
    biases: Array,
    bias_std: float,
) -> None:
    """Moves particles (n, 3) by the step (x, y, theta) = robot_from_next_robot, each with its own noise (n, 3) of variance 1.

    Each particle has its opinion of the scales of way and turn: 1 + bias_std times its `biases` (n, 2).

    Thrun, Burgard and Fox 2005, Table 5.6, with the variances of the module's table.
    """
    rot1, trans, rot2 = turn_move_turn(x, y, theta)
    s1, s2, s3 = _spreads(rot1, trans, rot2, alphas)
    for i in range(len(particles)):
        turn = 1.0 + bias_std * biases[i, 1]
        heading = particles[i, 2] + turn * rot1 + s1 * noise[i, 0]
        way = (1.0 + bias_std * biases[i, 0]) * trans + s2 * noise[i, 1]
        particles[i, 0] += way * math.cos(heading)
        particles[i, 1] += way * math.sin(heading)
        particles[i, 2] = heading + turn * rot2 + s3 * noise[i, 2]


@njit(cache=True)
def sample_velocity(
    particles: Array,
    v: float,
    omega: float,
    dt: float,
    alphas: tuple[float, float, float, float],
    noise: Array,
    biases: Array,
    bias_std: float,
) -> None:
    """Moves particles (n, 3) along arcs: v [m/s] and omega [rad/s] for dt [s], and a final turn, with noise (n, 3) of variance 1.

    Each particle has its opinion of the scales of v and omega: 1 + bias_std times its `biases` (n, 2).

    Thesis, eq. 2.39; Thrun, Burgard and Fox 2005, Table 5.3, with the variances of the module's table; those of a turn go half to
    omega and half to the final turn gamma.
    """
    if dt <= 0.0:
        return
    a1, a2, a3, a4 = alphas
    way, turn = abs(v * dt), abs(omega * dt)
    s_way = math.sqrt(a3 * way + a4 * turn)
    s_turn = math.sqrt(0.5 * (a1 * turn + a2 * way))
    for i in range(len(particles)):
        length = (1.0 + bias_std * biases[i, 0]) * v * dt + s_way * noise[i, 0]
        angle = (1.0 + bias_std * biases[i, 1]) * omega * dt + s_turn * noise[i, 1]
        heading = particles[i, 2]
        # The chord of the arc: its length is sinc(angle / 2) of the arc's, half the turn to the side.
        half = 0.5 * angle
        chord = length * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
        particles[i, 0] += chord * math.cos(heading + half)
        particles[i, 1] += chord * math.sin(heading + half)
        particles[i, 2] = heading + angle + s_turn * noise[i, 2]


def propagate(covariance: Array, pose: SE2, step: SE2, alphas: Alphas, bias_std: float) -> Array:
    """Covariance after a step, to first order, with the odometry model's noise: for Kalman filters.

    Args:
        covariance: of x, y, theta and of the biases of way and turn, which do not change, (5, 5).
        pose: world_from_robot before the step; step: robot_from_next_robot, with the biases that are believed in.
    """
    rot1, trans, rot2 = turn_move_turn(step.x, step.y, step.theta)
    spreads = np.array(_spreads(rot1, trans, rot2, alphas))
    heading = pose.theta + rot1
    c, s = math.cos(heading), math.sin(heading)
    by_pose = np.eye(5)
    by_pose[:2, 2] = -trans * s, trans * c
    by_pose[:2, 3] = bias_std * trans * c, bias_std * trans * s
    by_pose[:2, 4] = -0.5 * bias_std * step.theta * trans * s, 0.5 * bias_std * step.theta * trans * c
    by_pose[2, 4] = bias_std * step.theta
    by_noise = np.zeros((5, 3))
    by_noise[:3] = [[-trans * s, c, 0.0], [trans * c, s, 0.0], [1.0, 0.0, 1.0]]
    return by_pose @ covariance @ by_pose.T + (by_noise * spreads**2) @ by_noise.T


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """Noise of the motion; see the module's table for the alphas.

    Args:
        model: `odometry`, `velocity`, or `auto`: the velocity model where the log holds speeds instead of wheels or poses.
        noise: `normal` or `triangular`.
        alpha1, alpha2, alpha3, alpha4: of the odometry model: identified for the Robocar from its physics, with the tolerances
            that each run draws (`experiments/motion_noise.py`).
        velocity_alpha1, ...: of the velocity model. Speeds that were commanded and not measured: a tenth of the way and of
            the turn over a metre and a radian, as no such robot is known better beforehand.
        bias_std, velocity_bias_std: by what share way and turn may be off, always alike, for wheels (the track of a skid-steered
            car depends on its load) and for commanded speeds: estimated along the way.
    """

    model: str = "auto"
    noise: str = "normal"
    alpha1: float = 2e-4
    alpha2: float = 2e-4
    alpha3: float = 5e-5
    alpha4: float = 2e-5
    velocity_alpha1: float = 0.01
    velocity_alpha2: float = 0.01
    velocity_alpha3: float = 0.01
    velocity_alpha4: float = 0.001
    bias_std: float = 0.02
    velocity_bias_std: float = 0.1

    def __post_init__(self) -> None:
        if self.model not in ("auto", "odometry", "velocity"):
            raise ValueError(f"model is auto, odometry or velocity, not {self.model!r}")
        if self.noise not in ("normal", "triangular"):
            raise ValueError(f"noise is normal or triangular, not {self.noise!r}")
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{field.name} must be a finite number from 0 on, not {value}")

    def by_velocity(self, commanded: bool) -> bool:
        """Which model is meant, for odometry that is `commanded` speeds or not."""
        return self.model == "velocity" or (self.model == "auto" and commanded)

    def bias(self, velocity: bool) -> float:
        """Standard deviation of the biases of the velocity or of the odometry model."""
        return self.velocity_bias_std if velocity else self.bias_std

    def alphas(self, velocity: bool) -> Alphas:
        """Of the velocity or of the odometry model."""
        if velocity:
            return Alphas(self.velocity_alpha1, self.velocity_alpha2, self.velocity_alpha3, self.velocity_alpha4)
        return Alphas(self.alpha1, self.alpha2, self.alpha3, self.alpha4)


def move(
    particles: Array, biases: Array, step: SE2, velocity: bool, parameters: MotionParameters, rng: np.random.Generator
) -> None:
    """Moves particles (n, 3) by one step of the odometry, robot_from_next_robot, with the noise of the model.

    Args:
        biases: of way and turn that each believes in, in units of their standard deviation, (n, 2).
    """
    if step == SE2():
        return
    noise = draw(rng, (len(particles), 3), parameters.noise)  # type: ignore[arg-type]
    alphas = parameters.alphas(velocity)
    if velocity:
        way, turn = arc_of(step)
        sample_velocity(particles, way, turn, 1.0, alphas, noise, biases, parameters.bias(velocity))
    else:
        sample_odometry(particles, step.x, step.y, step.theta, alphas, noise, biases, parameters.bias(velocity))


def arc_of(step: SE2) -> tuple[float, float]:
    """Length [m] and turn [rad] of the arc that leads to where the step does; its chord points half the turn to the side."""
    half = 0.5 * step.theta
    chord = step.x * math.cos(half) + step.y * math.sin(half)
    return chord * (half / math.sin(half) if abs(half) > 1e-6 else 1.0), step.theta
