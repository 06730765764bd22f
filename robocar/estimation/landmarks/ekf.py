"""An extended Kalman filter on the same detections as the particle filter, to compare with.

Thrun, Burgard and Fox, Probabilistic Robotics (2005), Table 7.2, with the odometry or the velocity model of `motion_models`.
Bearings of
real robots have heavy tails: a detection that is less likely than one in a hundred counts less, its covariance
being widened until it is just that likely (covariance inflation, as in robust Kalman filtering after Huber). A robot that does
not know its start finds it from the first two landmarks that it sees at once or one after the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import SE2, Array, Belief, Command, Context, Detection, Observation, Scalar, Text, Twist
from robocar.core.trace import Drawable
from robocar.estimation.landmarks.particle_filter import sight_lines
from robocar.estimation.landmarks.senses import Senses
from robocar.estimation.landmarks.sensor_models import Atlas
from robocar.estimation.odometry.motion_models import MotionParameters, arc_of, propagate

_LOST_STD = (10.0, 10.0, math.pi)  # [m], [m], [rad] before two landmarks were seen


@dataclass(frozen=True, slots=True)
class KalmanParameters:
    """
    Args:
        bearing_std, range_std: added in squares to what a detection says of itself [rad], [share of the range].
        gate: squared Mahalanobis distance from which on a detection counts less; 9.21 is the 99th percentile with two degrees
            of freedom.
        initial_std_xy, initial_std_theta: of the start, if it is known [m], [rad].
    """

    bearing_std: float = 0.015
    range_std: float = 0.02
    gate: float = 9.21
    initial_std_xy: float = 0.02
    initial_std_theta: float = 0.03

    def __post_init__(self) -> None:
        for name in ("bearing_std", "range_std", "initial_std_xy", "initial_std_theta"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ValueError(f"{name} must be a finite number from 0 on, not {getattr(self, name)}")
        if not self.gate > 0:
            raise ValueError(f"gate must be positive, not {self.gate}")


class KalmanFilterEstimator:
    """`ekf`"""

    def __init__(self, context: Context) -> None:
        self._parameters = context.parameters_of(KalmanParameters)
        self._motion = context.part("motion").parameters_of(MotionParameters)
        self._senses = Senses(context, "ekf")
        self._atlas = Atlas(context.landmarks)
        self._pose = context.start or SE2()
        p = self._parameters
        known = context.start is not None
        std = (p.initial_std_xy, p.initial_std_xy, p.initial_std_theta) if known else _LOST_STD
        # Of x, y, theta and the biases of way and turn, in units of their standard deviation.
        self._covariance = np.diag(np.square([*std, 1.0, 1.0]))
        self._biases = np.zeros(2)
        # Where landmarks were seen in the frame of the odometry, until two tell where the robot is.
        self._found = known
        self._odometry = SE2()
        self._spots: dict[str, tuple[float, float]] = {}

    def update(self, observation: Observation, command: Command) -> Belief:
        sensed = self._senses.update(observation, command)
        if sensed.step != SE2():
            self._move(sensed.step, self._motion.by_velocity(sensed.commanded))
        trace: dict[str, Drawable] = {**sensed.trace}
        for detection in sensed.detections:
            if detection.landmark not in self._atlas:
                continue
            if self._found:
                trace["localization/surprise"] = Scalar(self._correct(detection))
            elif self._find(detection):
                trace["localization/state"] = Text("two landmarks tell where the car is")
        if sensed.detections and self._found:
            trace["sightings"] = sight_lines(self._pose, sensed.detections)
        return Belief(self._pose, self._covariance[:3, :3], sensed.twist, None, trace, sensed.odom_from_robot)

    def _move(self, step: SE2, velocity: bool) -> None:
        way, turn = arc_of(step)
        std = self._motion.bias(velocity)
        way_scale, turn_scale = (float(scale) for scale in 1.0 + std * self._biases)
        step = Twist(way_scale * way, turn_scale * turn).step(1.0)
        self._covariance = propagate(self._covariance, self._pose, step, self._motion.alphas(velocity), std)
        self._pose = self._pose @ step
        self._odometry = self._odometry @ step

    def _correct(self, detection: Detection) -> float:
        """Takes in one detection, as one of the landmark that fits best; returns its squared Mahalanobis distance."""
        best: tuple[float, Array, Array, Array] | None = None
        p = self._parameters
        noise = detection.covariance + np.diag([p.bearing_std**2, (p.range_std * detection.range) ** 2])
        # A reading that is too short may be farther off than one that is too long: a split normal distribution.
        short = noise + np.diag([0.0, (detection.short_tail**2 - 1.0) * detection.covariance[1, 1]])
        for place in self._atlas.places(detection.landmark):
            dx, dy = place[0] - self._pose.x, place[1] - self._pose.y
            square = dx * dx + dy * dy
            distance = math.sqrt(square)
            if distance < 1e-6:
                continue
            bearing = math.atan2(dy, dx) - self._pose.theta
            innovation = np.array([math.remainder(detection.bearing - bearing, math.tau), detection.range - distance])
            jacobian = np.zeros((2, 5))
            jacobian[:, :3] = [dy / square, -dx / square, -1.0], [-dx / distance, -dy / distance, 0.0]
            spread = jacobian @ self._covariance @ jacobian.T + (short if innovation[1] < 0.0 else noise)
            surprise = float(innovation @ np.linalg.solve(spread, innovation))
            if best is None or surprise < best[0]:
                best = surprise, innovation, jacobian, spread
        if best is None:
            return 0.0
        surprise, innovation, jacobian, spread = best
        spread = spread * max(1.0, surprise / p.gate)
        gain = np.linalg.solve(spread, jacobian @ self._covariance).T
        x, y, theta, *biases = gain @ innovation
        self._biases += biases
        self._pose = SE2(self._pose.x + float(x), self._pose.y + float(y), self._pose.theta + float(theta))
        covariance = self._covariance - gain @ spread @ gain.T
        self._covariance = 0.5 * (covariance + covariance.T)
        return surprise

    def _find(self, detection: Detection) -> bool:
        """Keeps where a landmark lies in the odometry's frame; true when two of them give the pose."""
        places = self._atlas.places(detection.landmark)
        if len(places) > 1:  # which of them is it?
            return False
        reach = detection.range * math.cos(detection.bearing), detection.range * math.sin(detection.bearing)
        self._spots[detection.landmark] = self._odometry.apply(*reach)
        if len(self._spots) < 2:
            return False
        world_from_odometry, error = align(
            np.array(list(self._spots.values())), np.array([self._atlas.places(name)[0] for name in self._spots])
        )
        self._pose = world_from_odometry @ self._odometry
        self._covariance[:3] = 0.0
        self._covariance[:, :3] = 0.0
        self._covariance[[0, 1, 2], [0, 1, 2]] = error**2, error**2, 0.1**2
        self._found = True
        return True


def align(points: Array, places: Array) -> tuple[SE2, float]:
    """The motion that brings points (n, 2) onto places (n, 2) with the least squares of what is left, n >= 2 (Arun et al. 1987).

    Returns:
        places_from_points, and a bound on its error: 0.2 m, or what is left over where that is more [m].
    """
    a, b = points - points.mean(axis=0), places - places.mean(axis=0)
    theta = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    turn = SE2(theta=theta)
    x, y = places.mean(axis=0) - turn.transform(points.mean(axis=0))
    left = np.linalg.norm(turn.transform(a) - b, axis=1).max()
    return SE2(float(x), float(y), theta), max(0.2, float(left))


def build(context: Context) -> KalmanFilterEstimator:
    """`ekf`"""
    return KalmanFilterEstimator(context)
