"""What localization works on: how far the robot has moved since the last tick, and which landmarks it sees now."""

from __future__ import annotations

import colorsys
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robocar.core import SE2, Circles, Command, Context, Detection, Observation, ScenarioError, Trace, Twist
from robocar.estimation.landmarks.balls import HUES, Ball, BallDetector, BallParameters
from robocar.estimation.odometry.odometry import OdometryEstimator

_MEMORY = 2.0  # [s] older pictures are not used


@dataclass(frozen=True, slots=True)
class Sensed:
    """
    Args:
        step: robot_from_next_robot since the last tick.
        commanded: whether the step comes from speeds and not from wheels or poses.
        twist: of the robot.
        odom_from_robot: the pose by odometry alone, from wherever the robot was first.
        detections: of landmarks, in the robot's frame of now.
        trace: the balls found in a new picture.
    """

    step: SE2
    commanded: bool
    twist: Twist
    odom_from_robot: SE2
    detections: tuple[Detection, ...]
    trace: Trace


class Senses:
    """Odometry from whatever there is, and landmarks from pictures, logs and ideal sensors.

    A detection that arrives late is moved by the odometry since it was made. One that repeats the last of the same landmark
    while the robot stands still says nothing new, its error being the same again, and is left out.
    """

    def __init__(self, context: Context, estimator: str) -> None:
        """
        Raises:
            ScenarioError: the robot has no camera, or there are no landmarks.
        """
        if not context.robot.camera:
            raise ScenarioError(f"estimator {estimator!r} needs a camera and the car has none; fit it: robot.camera=true")
        if not context.landmarks:
            raise ScenarioError(f"estimator {estimator!r} needs landmarks, and the scenario has none")
        self._detector = BallDetector(context.landmarks, context.part("detector").parameters_of(BallParameters))
        self._odometry = OdometryEstimator(replace(context.part("odometry"), start=SE2()))
        self._pose = SE2()
        self._past: deque[tuple[float, SE2]] = deque()
        self._commanded = False
        self._last: dict[str, tuple[SE2, Detection]] = {}

    def update(self, observation: Observation, command: Command) -> Sensed:
        """The next observation, not older than the one before."""
        belief = self._odometry.update(observation, command)
        step = self._pose.inverse() @ belief.pose
        if belief.pose == self._pose:
            step = SE2()  # without the rounding of a pose against itself
        self._pose = belief.pose
        if observation.twist is not None:
            self._commanded = True
        elif observation.wheel_angles is not None or observation.odom_pose is not None:
            self._commanded = False
        self._past.append((observation.time, self._pose))
        while self._past[0][0] < observation.time - _MEMORY:
            self._past.popleft()
        seen = observation.landmarks
        trace: Trace = {}
        if observation.image is not None:
            found = self._detector.identify(observation.image)
            seen += tuple(detection for _, detection in found)
            trace = {"balls": circles([ball for ball, _ in found])}
        current = (self._now(detection) for detection in seen)
        detections = tuple(d for d in current if d is not None and self._is_new(d))
        return Sensed(step, self._commanded, belief.twist, self._pose, detections, trace)

    def _now(self, detection: Detection) -> Detection | None:
        """The detection as it would be made now; None where it is too old."""
        if not (math.isfinite(detection.bearing) and math.isfinite(detection.range) and detection.range > 0):
            return None
        then = None
        for time, pose in reversed(self._past):
            then = pose
            if time <= detection.time + 1e-9:
                break
        else:
            if detection.time < self._past[0][0] - _MEMORY:
                return None
        assert then is not None
        if then == self._pose:
            return detection
        now_from_then = self._pose.inverse() @ then
        x, y = now_from_then.apply(detection.range * math.cos(detection.bearing), detection.range * math.sin(detection.bearing))
        return replace(detection, bearing=math.atan2(y, x), range=math.hypot(x, y))

    def _is_new(self, detection: Detection) -> bool:
        """Whether anything has changed since the last detection of this name."""
        last = self._last.get(detection.landmark)
        if last is not None:
            pose, before = last
            still = pose.distance_to(self._pose) < 1e-3 and abs(math.remainder(pose.theta - self._pose.theta, math.tau)) < 2e-3
            same_bearing = abs(math.remainder(detection.bearing - before.bearing, math.tau)) < 2e-3
            if still and same_bearing and abs(detection.range - before.range) < 0.005 * detection.range:
                return False
        self._last[detection.landmark] = self._pose, detection
        return True


def circles(balls: Sequence[Ball]) -> Circles:
    """Balls as the recording shows them on the picture that they were found in."""
    return Circles(
        np.array([ball.pixel for ball in balls]).reshape(-1, 2),
        np.array([ball.radius for ball in balls]),
        tuple(_rgb(*HUES[ball.color]) for ball in balls),
        tuple(ball.color for ball in balls),
    )


def _rgb(low: float, high: float) -> tuple[int, int, int]:
    """The pure colour in the middle of two hues [deg]."""
    red, green, blue = colorsys.hsv_to_rgb((0.5 * (low + high) / 360.0) % 1.0, 1.0, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)
