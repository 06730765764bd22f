"""Dead reckoning from wheel encoders, alone or with a compass.

Thesis, eq. 3.1-3.5: pulses become distances of the left and the right wheels, their mean is the distance travelled and their
difference over the track is the turn (the thesis counts clockwise positive; REP-103 counts counter-clockwise: theta = (r -
l) / track). The track is the *effective* one of a skid-steered car, see `Calibration`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from robocar.core import SE2, Belief, Command, Context, Observation, Twist, WheelAngles, wrap_angle
from robocar.core.robot import Calibration

_STILL = SE2()
_WINDOW = 8  # readings over which speed and curvature are measured: single ticks turn by a few coarse pulses only


class WheelOdometry:
    """Adds up wheel angles to a pose."""

    def __init__(self, calibration: Calibration, start: SE2) -> None:
        self._calibration = calibration
        self.pose = start
        self.twist = Twist()
        self._history: deque[tuple[float, WheelAngles]] = deque(maxlen=_WINDOW)

    @property
    def counting(self) -> bool:
        """Whether a reading has come yet."""
        return bool(self._history)

    def update(self, time: float, angles: WheelAngles) -> SE2:
        """Moves on to a new reading of the encoders and returns the step: robot_from_next_robot."""
        radius = self._calibration.wheel_radius
        if not self._history:
            self._history.append((time, angles))
            return SE2()
        last = self._history[-1][1]
        self._history.append((time, angles))
        first_time, first = self._history[0]
        mean, difference = _mean_and_difference(first, angles, radius)
        track = self._calibration.effective_track(mean, difference / self._calibration.effective_track(mean, difference))
        span = time - first_time
        if span > 0:
            self.twist = Twist(mean / span, difference / track / span)
        distance, difference = _mean_and_difference(last, angles, radius)
        step = Twist(distance, difference / track).step(1.0)
        self.pose = self.pose @ step
        return step


def _mean_and_difference(start: WheelAngles, end: WheelAngles, radius: float) -> tuple[float, float]:
    """Mean of what the left and the right wheels have rolled, and right minus left [m]."""
    left, right = radius * (end.left - start.left), radius * (end.right - start.right)
    return 0.5 * (left + right), right - left


@dataclass(frozen=True, slots=True)
class OdometryParameters:
    """
    Args:
        distance_std: of the distance per square root of the metre driven [m].
        turn_std: of the turn per square root of the radian turned [rad]; drift_std: of the heading per square root of the
            metre [rad].
    """

    distance_std: float = 0.005
    turn_std: float = 0.01
    drift_std: float = 0.01


class OdometryEstimator:
    """`odometry`: the believed pose is what the wheels say; its covariance grows without bound.

    Also takes what logs hold instead of wheel angles: a twist, kept until the next one (MRCLAM), or a pose (CARMEN).
    """

    def __init__(self, context: Context) -> None:
        self._parameters = context.parameters_of(OdometryParameters)
        start = context.start or SE2()
        self._wheels = WheelOdometry(context.robot.calibration, start)
        self._covariance = np.zeros((3, 3))
        self._pose = start
        self._twist = Twist()
        self._time: float | None = None
        self._last_odom: SE2 | None = None

    def update(self, observation: Observation, command: Command) -> Belief:
        step = self._step(observation)
        self._covariance = propagate(self._covariance, self._pose, step, self._parameters)
        self._pose = self._pose @ step
        return Belief(self._pose, self._covariance, self._twist)

    def _step(self, observation: Observation) -> SE2:
        """robot_from_next_robot since the last observation, from whichever odometry there is."""
        if observation.wheel_angles is not None:
            reading = observation.wheel_angles
            step = self._wheels.update(reading.time, reading.value)
            self._twist = self._wheels.twist
            return step
        if self._wheels.counting:  # between two readings: the next one brings all of the way
            return SE2()
        if observation.odom_pose is not None:
            pose = observation.odom_pose.value
            step = self._last_odom.inverse() @ pose if self._last_odom is not None else SE2()
            self._last_odom = pose
            return step
        elapsed = observation.time - self._time if self._time is not None else 0.0
        self._time = observation.time
        step = self._twist.step(elapsed)
        if observation.twist is not None:
            self._twist = observation.twist.value
        return step


class CompassOdometryEstimator(OdometryEstimator):
    """`odometry-compass`: as `odometry`, with the heading corrected by each compass reading (a Kalman filter of the heading)."""

    COMPASS_STD = math.radians(0.5)

    def update(self, observation: Observation, command: Command) -> Belief:
        belief = super().update(observation, command)
        if observation.compass is None:
            return belief
        covariance = self._covariance
        gain = covariance[:, 2] / (covariance[2, 2] + self.COMPASS_STD**2)
        x, y, theta = gain * wrap_angle(observation.compass.value - self._pose.theta)
        self._pose = SE2(self._pose.x + x, self._pose.y + y, self._pose.theta + theta)
        self._covariance = covariance - np.outer(gain, covariance[2])
        return Belief(self._pose, self._covariance, self._twist)


def propagate(covariance: np.ndarray, pose: SE2, step: SE2, parameters: OdometryParameters) -> np.ndarray:
    """Covariance (3, 3) of world_from_robot after a step: first order, noise in the robot's frame grows with the way."""
    if step == _STILL:
        return covariance
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    jacobian = np.array([[1.0, 0.0, -s * step.x - c * step.y], [0.0, 1.0, c * step.x - s * step.y], [0.0, 0.0, 1.0]])
    way, turn = math.hypot(step.x, step.y), abs(step.theta)
    along = parameters.distance_std**2 * way
    moved = jacobian @ covariance @ jacobian.T
    moved[0, 0] += c * c * along
    moved[0, 1] += c * s * along
    moved[1, 0] += c * s * along
    moved[1, 1] += s * s * along
    moved[2, 2] += parameters.turn_std**2 * turn + parameters.drift_std**2 * way
    return moved


def build(context: Context) -> OdometryEstimator:
    """`odometry`"""
    return OdometryEstimator(context)


def build_with_compass(context: Context) -> CompassOdometryEstimator:
    """`odometry-compass`"""
    return CompassOdometryEstimator(context)
