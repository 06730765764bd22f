"""Regulated pure pursuit: follows a path smoothly and never drives into what the costmap shows.

The arc to a point of the path a lookahead distance ahead is driven (Coulter, CMU-RI-TR-92-01: kappa = 2 y / L^2); the speed is
regulated by curvature, by nearness of obstacles and by the way left (Macenski, Singh, Martin and Gines, Regulated Pure Pursuit
for Robot Path Tracking, Autonomous Robots 47, 2023). Added here: the whole outline is checked along the arc, the lookahead
shrinks where the arc would touch something, and the car gets out of where it can neither go on nor turn (`Escape`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import SE2, Belief, Context, Costmap, Drive, GiveUp, Goal, Observation, Path, Points, Robot, State, Text, Twist
from robocar.core.compiling import trial_robot, warm_up
from robocar.core.trace import Drawable
from robocar.planners.geometry.escape import CELLS, Escape
from robocar.planners.geometry.outlines import SLIP, CostmapView, Outlines
from robocar.planners.geometry.polyline import nearest_on_path, point_ahead
from robocar.planners.geometry.surfaces import REACH, surfaces

STOPPING_SHARE = 0.5
"""Of `Goal.xy_goal_tolerance`: the car stops here, well inside, since its belief may be off."""

_TOUCHING = 1e-3  # [m] an arc that is free no farther is blocked
_BEHIND = 2.3  # [rad] away from the heading, either way round is about as long
_ALIGNED = 0.05  # [rad] less is not worth turning for
_STRIDE = 0.01  # [m] no corner goes farther in a control period where there is no room but for slip
_PATIENCE = 10.0  # [s] without getting `_AWAY` from where it was first blocked, after which it is too tight there
_AWAY = 0.3  # [m]


@dataclass(frozen=True, slots=True)
class PurePursuitParameters:
    """Names are Nav2's where it has them.

    Args:
        desired_linear_vel: where nothing slows it down [m/s].
        lookahead_dist: along the path [m].
        use_rotate_to_heading: whether it turns on the spot where the path leads away by more than `rotate_to_heading_min_angle`
            [rad], at most at `rotate_to_heading_angular_vel` [rad/s].
        regulated_linear_scaling_min_radius: tighter arcs are driven proportionally slower [m].
        regulated_linear_scaling_min_speed: but not slower than this [m/s].
        proximity_slowdown: share of the speed that is lost where costs are highest.
        approach_deceleration: towards the goal [m/s^2].
        min_approach_linear_velocity: the slowest it drives up to the goal [m/s].
        footprint_padding: kept free around the outline where there is room for it, else `outlines.SLIP` [m].
        cautious_vel: of any corner, at most, where there is not [m/s].
    """

    desired_linear_vel: float = 0.4
    lookahead_dist: float = 0.25
    use_rotate_to_heading: bool = True
    rotate_to_heading_min_angle: float = 0.785
    rotate_to_heading_angular_vel: float = 1.2
    regulated_linear_scaling_min_radius: float = 0.3
    regulated_linear_scaling_min_speed: float = 0.08
    proximity_slowdown: float = 0.5
    approach_deceleration: float = 0.4
    min_approach_linear_velocity: float = 0.05
    footprint_padding: float = 0.01
    cautious_vel: float = 0.12

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            zero_is_fine = name in ("footprint_padding", "proximity_slowdown", "rotate_to_heading_min_angle")
            if not (math.isfinite(value) and (value > 0 or (zero_is_fine and value == 0) or isinstance(value, bool))):
                raise ValueError(f"{name} must be positive, not {value}")
        if self.proximity_slowdown >= 1.0:
            raise ValueError(f"proximity_slowdown must be below 1, not {self.proximity_slowdown}")


@dataclass(frozen=True, slots=True)
class _Arc:
    """An arc ahead: its curvature [1/m], how far it is free [m], the highest cost on it, the bearing of the carrot [rad], the way
    left to the end of the path [m], and the carrot [m]."""

    curvature: float
    free: float
    highest: float
    bearing: float
    left: float
    carrot: tuple[float, float]


class PurePursuit:
    """Path follower for a car that turns on the spot."""

    def __init__(self, robot: Robot, control_period: float, parameters: PurePursuitParameters | None = None) -> None:
        self.parameters = parameters or PurePursuitParameters()
        self._limits, self._dt = robot.limits, control_period
        p = self.parameters
        self._outlines = Outlines(
            robot.footprint, p.footprint_padding, min(p.desired_linear_vel, robot.limits.max_vel_x) * control_period
        )
        self._cautious_vel = min(p.cautious_vel, _STRIDE / control_period)
        self._last = Twist()
        self._path: Path | None = None
        self._points = np.empty((0, 2))
        self._segment = 0
        self._held_up = False  # where it was to drive, braking would end in an obstacle
        self._escape = Escape(robot, self.parameters.footprint_padding, CELLS)
        self._blocked = False
        self._blocked_at: tuple[SE2, float] | None = None
        _warm_up()

    def command(
        self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal
    ) -> Drive | GiveUp:
        """`drive`, or `GiveUp` (`stuck`) where the way has been blocked at one place for `_PATIENCE`: it is too tight."""
        drive = self.drive(state, path, costmap, observation, goal)
        pose, time = state.belief.pose, observation.time
        if self._blocked_at is not None and self._blocked_at[0].distance_to(pose) > _AWAY:
            self._blocked_at = None
        if self._blocked:
            at, since = self._blocked_at = self._blocked_at or (pose, time)
            if time - since > _PATIENCE:
                self._blocked_at = None
                where = f"too tight at ({at.x:.2f}, {at.y:.2f})"
                return GiveUp(f"{where}: no way on that leaves {1e3 * SLIP:g} mm beside the outline", "stuck")
        return drive

    def drive(self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal) -> Drive:
        """The twist for the next control period.

        Args:
            path: to follow; None is the straight way to the goal.
            costmap: obstacles; None is a world without.
        """
        pose, self._blocked = state.belief.pose, False
        if self._escape.running and (escaping := self._escaping(costmap, pose)) is not None:
            return escaping
        views = self._outlines.views(costmap, pose)
        if math.hypot(goal.position[0] - pose.x, goal.position[1] - pose.y) <= STOPPING_SHARE * goal.xy_goal_tolerance:
            return self._align(views[-1], costmap, pose, goal)
        if path is None:
            self._points, self._segment, self._path = np.array([[pose.x, pose.y], goal.position]), 0, None
        elif path is not self._path:
            self._points, self._segment, self._path = np.array(path.points), 0, path
        trace: dict[str, Drawable] = {}
        if self._held_up:
            self._held_up = False
            return self._get_out(costmap, pose, trace)
        # What seems to touch the car may be beside it: nothing but a way out keeps off it.
        if views[0].touching and self._last == Twist() and (escaping := self._begun(costmap, pose)) is not None:
            return escaping
        for view in views:
            arc = self._best_arc(view, pose)
            trace["lookahead"] = Points(np.array([arc.carrot]))
            turns = self.parameters.use_rotate_to_heading and abs(arc.bearing) > self.parameters.rotate_to_heading_min_angle
            if abs(arc.bearing) > _ALIGNED and (turns or arc.free <= _TOUCHING):
                turning = self._turn(view, arc.bearing, trace)
                if turning is not None:
                    return turning
            if arc.free > _TOUCHING:
                return self._drive_arc(view, arc, trace)
        return self._get_out(costmap, pose, trace)

    def _best_arc(self, view: CostmapView, pose: SE2) -> _Arc:
        """The arc to the carrot, or to a nearer one where it would touch something; if all do, the one that is free the
        longest."""
        lookahead = self.parameters.lookahead_dist
        self._segment, share, _ = nearest_on_path(self._points, self._segment, pose.x, pose.y, 1.0 + 4.0 * lookahead)
        best = None
        for _ in range(3):
            x, y, left = point_ahead(self._points, self._segment, share, lookahead)
            dx, dy = x - pose.x, y - pose.y
            distance = math.hypot(dx, dy)
            bearing = math.remainder(math.atan2(dy, dx) - pose.theta, math.tau)
            # kappa = 2 y / L^2 with y = L sin(bearing); the arc turns by twice the bearing. What lies behind is turned to first.
            ahead = min(max(bearing, -math.pi / 2), math.pi / 2)
            curvature = 2.0 * math.sin(ahead) / max(distance, 1e-6)
            length = distance if abs(ahead) < 1e-6 else 2.0 * ahead / curvature
            free, highest = view.free_arc(curvature, length)
            whole = free >= length
            if best is None:
                best = _Arc(curvature, free, highest, bearing, left, (x, y))
            elif whole or free > best.free:
                best = _Arc(curvature, free, highest, best.bearing, best.left, best.carrot)
            if whole or abs(bearing) > math.pi / 2:
                break
            lookahead *= 0.5
        assert best is not None
        return best

    def _regulated(self, arc: _Arc) -> float:
        """Speed along an arc [m/s]."""
        p, limits = self.parameters, self._limits
        speed = fastest = min(p.desired_linear_vel, limits.max_vel_x)
        speed *= min(1.0, 1.0 / max(abs(arc.curvature) * p.regulated_linear_scaling_min_radius, 1e-9))
        speed *= 1.0 - p.proximity_slowdown * arc.highest / 252.0
        speed = max(speed, p.regulated_linear_scaling_min_speed)
        # Braking at these decelerations ends at the goal, or before what stands on the arc.
        speed = min(speed, max(p.min_approach_linear_velocity, math.sqrt(2.0 * p.approach_deceleration * arc.left)))
        speed = min(speed, math.sqrt(limits.acc_lim_x * arc.free))
        speed = min(speed, limits.max_vel_theta / max(abs(arc.curvature), 1e-9))
        return min(speed, fastest)

    def _turning_speed(self, angle: float) -> float:
        """Towards what lies `angle` [rad] away, slow enough to stop there [rad/s]."""
        fastest = min(self.parameters.rotate_to_heading_angular_vel, self._limits.max_vel_theta)
        return math.copysign(min(fastest, math.sqrt(self._limits.acc_lim_theta * abs(angle))), angle)

    def _turn(self, view: CostmapView, angle: float, trace: dict[str, Drawable]) -> Drive | None:
        """On the spot by `angle` [rad], or the other way round; None where neither is free.

        To what lies behind it goes on the way that it turns already: a target that shifts a little must not turn it to and fro.
        """
        ways = [angle, angle - math.copysign(math.tau, angle)]
        if abs(angle) > _BEHIND and angle * self._last.omega < 0.0:
            ways.reverse()
        for way in ways:
            if view.free_turn(way):
                return self._drive(view, 0.0, self._turning_speed(way), trace)
        return None

    def _align(self, view: CostmapView, costmap: Costmap | None, pose: SE2, goal: Goal) -> Drive:
        """At the goal: stand, or turn to its heading."""
        turn = 0.0 if goal.heading is None else math.remainder(goal.heading - pose.theta, math.tau)
        if abs(turn) <= STOPPING_SHARE * goal.yaw_goal_tolerance:
            return self._drive(view, 0.0, 0.0)
        # turning as far as it goes would end in what is in the way: noise hides it now and then
        return self._turn(view, turn, {}) or self._get_out(costmap, pose, {})

    def _get_out(self, costmap: Costmap | None, pose: SE2, trace: dict[str, Drawable]) -> Drive:
        """Out of where the car can neither go on nor turn: it stops, and then drives to where it has more room."""
        self._blocked = True
        if self._last == Twist() and (escaping := self._begun(costmap, pose)) is not None:
            return escaping
        self._last = Twist()
        return Drive(Twist(), trace=trace | {"pure_pursuit": Text("blocked on all sides", "WARN")})

    def _begun(self, costmap: Costmap | None, pose: SE2) -> Drive | None:
        """The first command of a way out; None where there is none."""
        return self._escaping(costmap, pose) if self._escape.begin(pose, surfaces(costmap, pose, REACH)) else None

    def _escaping(self, costmap: Costmap | None, pose: SE2) -> Drive | None:
        """The next command of the way out; None where it is over."""
        escaping = self._escape.command(pose, surfaces(costmap, pose, REACH), self._dt)
        if escaping is not None:
            self._last = escaping.twist
        return escaping

    def _drive_arc(self, view: CostmapView, arc: _Arc, trace: dict[str, Drawable]) -> Drive:
        """Along an arc: its curvature is kept while the car speeds up, and turning sets the pace where it takes longer."""
        reach = self._limits.acc_lim_theta * self._dt
        v = min(self._regulated(arc), self._last.v + self._limits.acc_lim_x * self._dt)
        v = max(v, self._last.v - self._limits.acc_lim_x * self._dt)
        omega = min(max(arc.curvature * v, self._last.omega - reach), self._last.omega + reach)
        if abs(omega) < abs(arc.curvature * v):
            v = max(0.0, omega / arc.curvature, self._last.v - self._limits.acc_lim_x * self._dt)
        return self._drive(view, v, omega, trace)

    def _drive(self, view: CostmapView, v: float, omega: float, trace: dict[str, Drawable] | None = None) -> Drive:
        """The wanted twist within the accelerations, unless braking from it would end in an obstacle: then the car stops at once,
        and if it stands already, it gets out."""
        limits, dt, last = self._limits, self._dt, self._last
        if not view.roomy:  # slip is a share of the way
            share = min(1.0, self._cautious_vel / max(abs(v) + view.reach * abs(omega), 1e-9))
            v, omega = share * v, share * omega
        v = min(max(v, last.v - limits.acc_lim_x * dt), last.v + limits.acc_lim_x * dt)
        omega = min(max(omega, last.omega - limits.acc_lim_theta * dt), last.omega + limits.acc_lim_theta * dt)
        if abs(v) > 1e-6:
            braking = math.copysign(abs(v) * dt + v * v / (2.0 * limits.acc_lim_x), v)
            safe = view.free_arc(omega / v, braking)[0] >= abs(braking)
        else:
            safe = view.free_turn(omega * dt + math.copysign(omega * omega / (2.0 * limits.acc_lim_theta), omega))
        self._held_up = not safe and last == Twist()
        self._last = Twist(v, omega) if safe else Twist()
        return Drive(self._last, trace=trace or {})


@warm_up
def _warm_up() -> None:
    """An arc and a turn."""
    path, goal = Path(np.array([[0.0, 0.0], [1.0, 0.0]])), Goal(np.array([1.0, 0.0]))
    for pose in (SE2(), SE2(0.0, 0.0, 1.5)):
        PurePursuit(trial_robot(), 0.1).command(State.of(Belief(pose)), path, None, Observation(0.0), goal)


def build(context: Context) -> PurePursuit:
    """The follower for the context's robot, with its parameters."""
    return PurePursuit(context.robot, context.control_period, context.parameters_of(PurePursuitParameters))
