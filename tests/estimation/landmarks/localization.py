"""A kinematic world for localization tests: a car that drives exactly, sees landmarks with known noise, and is told so."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from robocar.core import SE2, Calibration, Context, Detection, Footprint, Landmark, Limits, Observation, Reading, Robot, Twist

MARKS = tuple(
    Landmark(color, color, np.array([x, y, 0.4]), 0.1)
    for color, x, y in (("blue", 3.5, 0.0), ("green", 3.5, 2.5), ("orange", 0.0, 2.5), ("red", 0.0, 0.0))
)
ROBOT = Robot(
    Footprint.circle(0.15),
    Limits(-0.2, 0.4, 1.5, 0.8, 4.0),
    Calibration(0.042, np.array([1.0, 100.0]), np.array([0.23, 0.23])),
    200,
    camera=True,
)
BEARING_STD, RANGE_STD = 0.03, 0.05
PERIOD = 0.1


def context(start: SE2 | None, seed: int = 0, marks: tuple[Landmark, ...] = MARKS, **parameters) -> Context:
    return Context(ROBOT, None, start, marks, parameters, np.random.default_rng(seed), PERIOD)


def sight(pose: SE2, mark: Landmark, time: float, rng: np.random.Generator | None = None, name: str | None = None) -> Detection:
    """The landmark as seen from a pose, with noise where a generator is given."""
    x, y = pose.inverse_apply(float(mark.position[0]), float(mark.position[1]))
    noise = rng.standard_normal(2) if rng is not None else np.zeros(2)
    bearing, distance = math.atan2(y, x) + BEARING_STD * noise[0], math.hypot(x, y) + RANGE_STD * noise[1]
    return Detection(time, name or mark.name, bearing, max(0.05, distance), np.diag([BEARING_STD**2, RANGE_STD**2]))


def drive(
    start: SE2, duration: float, seed: int, carried: dict[float, SE2] | None = None, scale: float = 1.0
) -> Iterator[tuple[Observation, SE2]]:
    """Circles in the field, one landmark seen at every second tick; odometry as poses, with a little noise; the true pose.

    Args:
        carried: poses that the car is put at, by time; its odometry does not notice.
        scale: the car really turns by this share of what its odometry says.
    """
    rng = np.random.default_rng(seed)
    true, reckoned = start, SE2()
    for k in range(round(duration / PERIOD)):
        time = k * PERIOD
        true = (carried or {}).get(round(time, 6), true)
        seen = (sight(true, MARKS[(k // 2) % 4], time, rng),) if k % 2 == 0 else ()
        yield Observation(time, odom_pose=Reading(time, reckoned), landmarks=seen), true
        twist = Twist(0.25, 0.5 + 0.3 * math.sin(0.2 * time))
        noisy = Twist(twist.v + 0.005 * rng.standard_normal(), twist.omega + 0.01 * rng.standard_normal())
        true = true @ Twist(twist.v, scale * twist.omega).step(PERIOD)
        reckoned = reckoned @ noisy.step(PERIOD)
