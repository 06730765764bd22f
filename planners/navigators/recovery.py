"""Recovery behaviours: what a navigator tries before it gives up, in Nav2's order: clear the costmaps, back up, spin, wait."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from robocar.core import SE2, STOP, Array, Context, Costmap, Drive, Observation, Robot, Text, Twist
from robocar.core.compiling import trial_robot, warm_up
from robocar.core.trace import merged
from robocar.planners.geometry.escape import CELLS, Escape
from robocar.planners.geometry.outlines import CostmapView, Outlines
from robocar.planners.geometry.surfaces import REACH, surfaces

_ORDER = ("clear", "back_up", "spin", "wait")
_SWERVE = 3.0  # [1/m] curvature of the arcs tried backwards, where straight back is not free
_ROOM = 0.02  # [m] free around the circumscribed circle is room to turn
_STEADY = 0.3  # [s] a behaviour ends when it has had no free twist for so long


@dataclass(frozen=True, slots=True)
class RecoveryParameters:
    """Names are Nav2's where it has them.

    Args:
        backup_dist, backup_speed: how far and how fast it backs up [m, m/s].
        spin_dist, rotational_vel: how far and how fast it turns on the spot [rad, rad/s].
        wait_duration: [s].
        number_of_retries: recoveries at most, until the robot gets `required_movement_radius` away from where they began.
        required_movement_radius, movement_time_allowance: where the robot has not come so far in this time, that is lost
            progress, and it recovers [m, s].
        scan_timeout: a range sensor that has sent nothing for so long is dead, and the car stands [s].
    """

    backup_dist: float = 0.2
    backup_speed: float = 0.1
    spin_dist: float = 1.57
    rotational_vel: float = 1.0
    wait_duration: float = 4.0
    number_of_retries: int = 12
    required_movement_radius: float = 0.5
    movement_time_allowance: float = 10.0
    scan_timeout: float = 0.5

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if name == "number_of_retries":
                if value < 0:
                    raise ValueError(f"{name} must not be negative, not {value}")
            elif not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive, not {value}")


class Recovery:
    """Chooses the next behaviour and carries it out, off what the costmap shows.

    A behaviour that finds no room ends early; the caller then plans again, and asks for the next one where that fails.
    """

    def __init__(self, robot: Robot, control_period: float, parameters: RecoveryParameters | None = None) -> None:
        self.parameters = parameters or RecoveryParameters()
        self._limits, self._dt = robot.limits, control_period
        self._outlines = Outlines(robot.footprint, 0.0)
        self._escape = Escape(robot, _ROOM, CELLS)
        self.count = self._waits = 0
        self.message = ""
        self._began_at: Array | None = None
        self._running = ""
        self._last = Twist()
        _warm_up()

    @property
    def running(self) -> bool:
        return bool(self._running)

    def next(self, reason: str, pose: SE2, time: float) -> str | None:
        """Starts the next behaviour and returns its name (`clear` is the caller's); None where all have been tried in vain."""
        if self._began_at is None or math.dist(self._began_at, pose.position) > self.parameters.required_movement_radius:
            self._began_at, self.count = pose.position, 0
        if self.count >= self.parameters.number_of_retries:
            return None
        name = _ORDER[self.count % len(_ORDER)]
        self.count += 1
        self.message = f"recovery {self.count}, {name.replace('_', ' ')}: {reason}"
        self.start(name, pose, time)
        return name

    def wait(self, reason: str, pose: SE2, time: float) -> None:
        """Waits, and turns in between, without counting: for what may go away by itself."""
        self._waits += 1
        name = "wait" if self._waits % 2 else "spin"
        self.message = f"waiting: {reason}"
        self.start(name, pose, time)

    def start(self, name: str, pose: SE2, time: float) -> None:
        """Begins a behaviour: `back_up`, `spin` or `wait`; `clear` takes no time."""
        self._running = "" if name == "clear" else name
        self._escape.stop()
        self._escapes = name == "back_up"  # asked for, where there is no room to turn
        self._start, self._time, self._free_time = pose, time, time
        self._last, self._heading, self._turned = Twist(), pose.theta, 0.0

    def step(self, pose: SE2, costmap: Costmap | None, time: float) -> Drive | None:
        """The next command of the running behaviour; None when it is over, the car stands then."""
        if not self._running:
            return None
        known = surfaces(costmap, pose, REACH)
        if self._escapes and not self._escape.roomy(pose, known):
            self._escape.begin(pose, known)
        self._escapes = False
        if self._escape.running:
            escaping = self._escape.command(pose, known, self._dt)
            if escaping is None:
                self._running = ""
                return None
            return replace(escaping, trace=merged(escaping.trace, {"recovery": Text(self.message, "WARN")}))
        view = self._outlines.views(costmap, pose)[0]
        roomy = self._escape.roomy(pose, known)
        twist = {"back_up": self._back_up, "spin": self._spin, "wait": self._wait}[self._running](pose, view, roomy, time)
        if twist is None:
            if self._last == Twist():
                self._running = ""
                return None
            twist = Twist()
        limits, last = self._limits, self._last
        dv, dw = limits.acc_lim_x * self._dt, limits.acc_lim_theta * self._dt
        self._last = Twist(min(max(twist.v, last.v - dv), last.v + dv), min(max(twist.omega, last.omega - dw), last.omega + dw))
        return Drive(self._last, trace={"recovery": Text(self.message, "WARN")})

    def _back_up(self, pose: SE2, view: CostmapView, roomy: bool, time: float) -> Twist | None:
        """Straight back, while there is room to turn: where there is none, only an `Escape` moves the car."""
        p = self.parameters
        speed = min(p.backup_speed, -self._limits.min_vel_x)
        left = p.backup_dist - pose.distance_to(self._start)
        if left <= 0.0 or speed <= 0.0 or time - self._time > 4.0 * p.backup_dist / speed:
            return None
        probe = min(left, 0.1)
        free, curvature = max((view.free_arc(k, -probe)[0], -abs(k), k) for k in (0.0, _SWERVE, -_SWERVE))[::2]
        if not roomy or free < 0.5 * probe:
            return self._blocked(time)
        self._free_time = time
        return Twist(-speed, -curvature * speed)

    def _spin(self, pose: SE2, view: CostmapView, roomy: bool, time: float) -> Twist | None:
        p = self.parameters
        self._turned += math.remainder(pose.theta - self._heading, math.tau)
        self._heading = pose.theta
        left = p.spin_dist - abs(self._turned)
        if left <= 0.0 or time - self._time > 4.0 * p.spin_dist / p.rotational_vel:
            return None
        if not roomy:
            return self._blocked(time)
        self._free_time = time
        return Twist(0.0, min(p.rotational_vel, self._limits.max_vel_theta))

    def _wait(self, pose: SE2, view: CostmapView, roomy: bool, time: float) -> Twist | None:
        return Twist() if time - self._time < self.parameters.wait_duration else None

    def _blocked(self, time: float) -> Twist | None:
        return Twist() if time - self._free_time < _STEADY else None


class Watch:
    """Lost progress, and sensors that have stopped sending."""

    def __init__(self, parameters: RecoveryParameters) -> None:
        self.parameters = parameters
        self._anchor: SE2 | None = None
        self._since = 0.0
        self._heard: dict[str, float] = {}

    def restart(self) -> None:
        """Progress counts from now on."""
        self._anchor = None

    def lost_progress(self, pose: SE2, time: float) -> bool:
        """Nav2's progress checker."""
        if self._anchor is None or self._anchor.distance_to(pose) >= self.parameters.required_movement_radius:
            self._anchor, self._since = pose, time
        return time - self._since > self.parameters.movement_time_allowance

    def silent(self, observation: Observation) -> str:
        """Which kind of range sensor has sent nothing for `scan_timeout`, once it had; empty where none."""
        time = observation.time
        for name, new in (("laser", observation.lidar is not None), ("sonars", bool(observation.sonars))):
            if new:
                self._heard[name] = time
        return " and ".join(name for name, last in self._heard.items() if time - last > self.parameters.scan_timeout + 1e-9)


@warm_up
def _warm_up() -> None:
    recovery = Recovery(trial_robot(), 0.1)
    for name in _ORDER:
        recovery.start(name, SE2(), 0.0)
        recovery.step(SE2(), Costmap(np.zeros((3, 3), dtype=np.uint8), 1.0), 0.0)


def build(context: Context) -> Recovery:
    """The behaviours for the context's robot, with their parameters."""
    return Recovery(context.robot, context.control_period, context.parameters_of(RecoveryParameters))


def standing(message: str) -> Drive:
    """Stand, and say why."""
    return Drive(STOP.twist, trace={"recovery": Text(message, "WARN")})
