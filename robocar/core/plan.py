"""What estimators believe and planners plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from robocar.core.geometry import SE2, Array, Twist, frozen_array
from robocar.core.trace import Trace
from robocar.core.work import Work


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Where an estimator thinks the robot is: world_from_robot.

    Args:
        covariance: of (x, y, theta), (3, 3) [m, m, rad], or None.
        twist: estimated velocity.
        particles: (n, 4) as x, y, theta, weight, or None.
        odom_from_robot: the pose by odometry alone, which drifts and never jumps; None where `pose` itself is such a one: then
            the odometry's frame is the map's.
    """

    pose: SE2
    covariance: Array | None = None
    twist: Twist = Twist()
    particles: Array | None = None
    trace: Trace = field(default_factory=dict)
    odom_from_robot: SE2 | None = None

    def __post_init__(self) -> None:
        odom = self.odom_from_robot
        if not (isinstance(self.pose, SE2) and isinstance(self.twist, Twist) and (odom is None or isinstance(odom, SE2))):
            raise TypeError(f"a belief needs a pose, a twist and odom_from_robot, not {self.pose!r}, {self.twist!r} and {odom!r}")
        if self.covariance is not None:
            object.__setattr__(self, "covariance", _finite(self.covariance, "covariance", (3, 3)))
        if self.particles is not None:
            object.__setattr__(self, "particles", _finite(self.particles, "particles", (len(self.particles), 4)))


def _finite(values: Array, name: str, shape: tuple[int, ...]) -> Array:
    array = frozen_array(values)
    # A finite sum has finite terms. Of a few numbers, asked for at every tick, Python makes it in half of NumPy's time.
    few = array.shape == (3, 3)
    if array.shape != shape or not ((few and math.isfinite(sum(map(sum, array.tolist())))) or np.isfinite(array).all()):
        raise ValueError(
            f"a belief's {name} are finite numbers of shape {shape}, not shape {array.shape}: {array.tolist()!r:.80}"
        )
    return array


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A polyline in the map frame, (n, 2) [m], n >= 1."""

    points: Array

    def __post_init__(self) -> None:
        points = frozen_array(self.points)
        if points.ndim != 2 or points.shape[0] < 1 or points.shape[1] != 2 or not np.all(np.isfinite(points)):
            raise ValueError(f"a path needs finite points (n, 2), not shape {points.shape}")
        object.__setattr__(self, "points", points)

    @property
    def length(self) -> float:
        """[m]"""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """Where to go: (2,) [m], with a heading [rad] or any; tolerances have Nav2's names."""

    position: Array
    heading: float | None = None
    xy_goal_tolerance: float = 0.10
    yaw_goal_tolerance: float = 0.25

    def __post_init__(self) -> None:
        position = frozen_array(self.position)
        if position.shape != (2,) or not np.all(np.isfinite(position)):
            raise ValueError(f"a goal needs a finite position (2,), not {self.position}")
        object.__setattr__(self, "position", position)
        if self.heading is not None and not math.isfinite(self.heading):
            raise ValueError(f"a goal's heading is a finite angle or None, not {self.heading}")
        for name in ("xy_goal_tolerance", "yaw_goal_tolerance"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, not {getattr(self, name)}")

    def reached(self, pose: SE2) -> bool:
        """Nav2's goal checker: within `xy_goal_tolerance`, and `yaw_goal_tolerance` where a heading is asked for."""
        if math.hypot(pose.x - self.position[0], pose.y - self.position[1]) > self.xy_goal_tolerance:
            return False
        if self.heading is None:
            return True
        return abs(math.remainder(pose.theta - self.heading, math.tau)) <= self.yaw_goal_tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What a global planner found.

    Args:
        path: from start to goal, both included.
        cost: in the planner's own measure, said in its docstring.
        work: what it took (`robocar.core.work`).
    """

    path: Path
    cost: float
    work: Work = field(default_factory=dict)
    trace: Trace = field(default_factory=dict)
