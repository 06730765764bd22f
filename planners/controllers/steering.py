"""What controllers that sample velocities do around the sampling: turn to the path, arrive, keep the car's accelerations."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from robocar.core import SE2, Array, Command, Drive, GiveUp, Goal, Robot, Trace, Twist
from robocar.planners.controllers.pure_pursuit import STOPPING_SHARE
from robocar.planners.geometry.outlines import SLIP, CostmapView, Outlines
from robocar.planners.tracking.moving_obstacles import near, without

SLOWEST = 0.05  # [m/s] it drives up to the goal
_HURRY = 2.0  # times the cautious speed
_STANDING = 0.01  # [m/s] slower is no driving
_PATIENCE = 1.0  # [s] to stand where the path leads away and no turn is free
_ALIGNED = 0.2  # [rad] to the path, where a turn towards it ends


@dataclass(frozen=True, slots=True)
class SteeringParameters:
    """Names are Nav2's where it has them.

    Args:
        max_vel_x: at most the car's own [m/s].
        rotate_to_heading_min_angle: where the path leads away by more, the car turns to it on the spot [rad].
        rotate_to_heading_angular_vel: at most so fast [rad/s].
        approach_deceleration: towards the goal [m/s^2].
        failure_tolerance: how long the car stands where no twist will do, before it says so [s].
        footprint_padding: kept free around the outline where there is room for it [m].
        cautious_vel: at most, where there is not [m/s].
    """

    max_vel_x: float = 0.4
    rotate_to_heading_min_angle: float = 0.785
    rotate_to_heading_angular_vel: float = 1.2
    approach_deceleration: float = 0.4
    failure_tolerance: float = 0.3
    footprint_padding: float = 0.02
    cautious_vel: float = 0.12

    def __post_init__(self) -> None:
        zero_is_fine = ("rotate_to_heading_min_angle", "failure_tolerance", "footprint_padding")
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0.0 or (value == 0.0 and name in zero_is_fine))):
                raise ValueError(f"{name} must {'not be negative' if name in zero_is_fine else 'be positive'}, not {value}")


class Steering:
    """The last twist, and the commands that follow from it.

    Raises:
        ValueError: the robot's limits are zero, crossed or not finite.
    """

    def __init__(self, robot: Robot, control_period: float, parameters: SteeringParameters) -> None:
        limits = robot.limits
        for name in ("max_vel_x", "max_vel_theta", "acc_lim_x", "acc_lim_theta"):
            if not 0.0 < getattr(limits, name) < math.inf:
                raise ValueError(f"the robot's {name} must be positive, not {getattr(limits, name)}")
        if not limits.min_vel_x <= limits.max_vel_x:
            raise ValueError(f"the robot's min_vel_x {limits.min_vel_x} lies above its max_vel_x {limits.max_vel_x}")
        self.parameters, self.limits, self._dt = parameters, limits, control_period
        self.fastest = min(parameters.max_vel_x, limits.max_vel_x)
        self.outlines = Outlines(robot.footprint, parameters.footprint_padding, self.fastest * control_period)
        """What is kept free."""
        self._radius = robot.footprint.circumscribed_radius
        self.last = Twist()
        self._time = -math.inf
        self._turning = False
        self._stands_since = -math.inf
        self._stuck_since: float | None = None

    def resume(self, time: float) -> bool:
        """Called at each tick; returns whether somebody else has driven since the last one: the car stands then."""
        interrupted = time - self._time > 1.5 * self._dt
        if interrupted:
            self.last, self._stuck_since, self._stands_since = Twist(), None, time
        self._time = time
        return interrupted

    def drive(self, v: float, omega: float, trace: Trace | None = None) -> Drive:
        """The wanted twist within the accelerations of one control period [m/s, rad/s]."""
        last, limits, dt = self.last, self.limits, self._dt
        v = min(max(v, last.v - limits.acc_lim_x * dt), last.v + limits.acc_lim_x * dt)
        omega = min(max(omega, last.omega - limits.acc_lim_theta * dt), last.omega + limits.acc_lim_theta * dt)
        self.last = Twist(float(v), float(omega))
        return Drive(self.last, trace=trace or {})

    def at_goal(self, views: list[CostmapView], pose: SE2, goal: Goal) -> Drive | None:
        """Well inside the goal's tolerance: stand, or turn to its heading where there is room; elsewhere None."""
        if math.hypot(goal.position[0] - pose.x, goal.position[1] - pose.y) > STOPPING_SHARE * goal.xy_goal_tolerance:
            return None
        turn = 0.0 if goal.heading is None else math.remainder(goal.heading - pose.theta, math.tau)
        if abs(turn) <= STOPPING_SHARE * goal.yaw_goal_tolerance:
            return self.drive(0.0, 0.0)
        for angle in (turn, turn - math.copysign(math.tau, turn)):
            if views[-1].free_turn(angle):
                return self.drive(0.0, self._turning_speed(angle))
        return self.drive(0.0, 0.0)

    def to_path(self, views: list[CostmapView], bearing: float) -> Command | None:
        """A turn on the spot towards a path that leads away [rad], if there is room for it; else None, or `GiveUp` (`stuck`) once
        the car has stood for `_PATIENCE`."""
        self._turning = abs(bearing) > (_ALIGNED if self._turning else self.parameters.rotate_to_heading_min_angle)
        if self._turning:
            for view in views:
                for angle in (bearing, bearing - math.copysign(math.tau, bearing)):
                    if view.free_turn(angle):
                        self._stands_since = self._time
                        return self.drive(0.0, self._turning_speed(angle))
        if not self._turning or abs(self.last.v) > _STANDING:
            self._stands_since = self._time
        if self._time - self._stands_since < _PATIENCE:
            return None
        self._stands_since = self._time
        return GiveUp("no room to turn to the path", "stuck")

    def highest_speed(self, view: CostmapView, left: float, movers: Array) -> float:
        """The speed from which braking at `approach_deceleration` ends at the goal, `left` metres away [m/s].

        It is slow in tight places, less so where it has to hurry out of the way of `movers` (m, 5). What makes a place tight is
        what stands there: who slows down because a mover has come close is run into.
        """
        fastest = self.fastest
        if not view.roomy:
            hurry = near(movers, view)
            if not hurry or self._tight(view, movers):
                fastest = min(fastest, (_HURRY if hurry else 1.0) * self.parameters.cautious_vel)
        return min(fastest, max(SLOWEST, math.sqrt(2.0 * self.parameters.approach_deceleration * left)))

    def _tight(self, view: CostmapView, movers: Array) -> bool:
        """Whether something that stands leaves no room around the outline."""
        standing = replace(view, costs=without(movers, view, self._radius), outline=self.outlines.roomy / view.resolution)
        return not standing.free_turn(0.0)

    def found(self) -> None:
        """There is a twist to drive."""
        self._stuck_since = None

    def stuck(self, time: float) -> Command:
        """There is none: stand, and say so after `failure_tolerance`."""
        if self._stuck_since is None:
            self._stuck_since = time
        if time - self._stuck_since >= self.parameters.failure_tolerance:
            self._stuck_since = None
            return GiveUp(
                f"no admissible velocity: everything in reach collides, or comes nearer than {1e3 * SLIP:g} mm (too tight)",
                "stuck",
            )
        return self.drive(0.0, 0.0)

    def _turning_speed(self, angle: float) -> float:
        """Towards what lies `angle` [rad] away, slow enough to stop there [rad/s]."""
        fastest = min(self.parameters.rotate_to_heading_angular_vel, self.limits.max_vel_theta)
        return math.copysign(min(fastest, math.sqrt(self.limits.acc_lim_theta * abs(angle))), angle)
