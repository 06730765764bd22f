"""What ends a robot's part of an episode, and how: arrival, contact, time, lack of progress."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

from robocar.core import SE2, Belief, Command, Done, Drive, GiveUp, Goal, MapView, Serial, Twist, wrap_angle
from robocar.core.truth import GroundTruth
from robocar.core.work import Work
from robocar.episode.body import Body, Physics
from robocar.episode.outcome import Outcome
from robocar.episode.result import Effort

Measure: TypeAlias = Callable[[SE2, MapView | None], tuple[bool, str]]
"""Whether a task without a goal is done, and why, from the true pose at the beginning and the map that was drawn."""

FORGETTING = 2.0  # [s] that a navigator may take to see that a mover has left the goal


@dataclass(frozen=True, slots=True)
class Rules:
    """What ends an episode.

    Args:
        time_limit: [s].
        end_on_contact: the first contact while the car moves ends it.
        success_radius: the car must truly be this near to the goal when it believes to be there [m].
        movement_radius, movement_angle, movement_time: progress checker (Nav2's `required_movement_radius`,
            `movement_time_allowance`): moving this far or turning this much within this time is progress.
        kidnaps: (time, pose) at which the car is put somewhere else.
    """

    time_limit: float = 120.0
    end_on_contact: bool = True
    success_radius: float = 0.25
    movement_radius: float = 0.10
    movement_angle: float = 0.30
    movement_time: float = 20.0
    kidnaps: tuple[tuple[float, SE2], ...] = ()


@dataclass(slots=True)
class Tick:
    """One row of the log."""

    truth: GroundTruth
    belief: Belief
    odometry: SE2
    standing: bool
    plan_time: float
    carried: bool  # somebody put the car here since the last tick


@dataclass(slots=True)
class Judge(Outcome):
    """Watches one robot, and says when its part of the episode is over and how it ended.

    `status` is one of success, collision, timeout, stuck, no_path, missed (the robot believes that its task is done, and it is
    not), diverged, error, interrupted; empty while it goes on. What a navigator says of itself is no success.

    Args:
        world, robot: what is watched.
        goal: where the robot shall go, None for tasks of another kind.
        measure: of a task without a goal; without one no `Done` is a success.
    """

    rules: Rules
    goal: Goal | None
    world: Physics
    robot: Body
    measure: Measure | None = None
    ticks: list[Tick] = field(default_factory=list)
    efforts: list[Effort] = field(default_factory=list)
    carried: bool = False
    _anchor: SE2 | None = None
    _anchor_time: float = 0.0
    _kidnapped: int = 0
    _standing: bool = True
    _driven: bool = False
    _taken_by: str | None = None
    _taken_at: float = -math.inf

    def judge(self, tick: Tick, command: Command, work: Work, view: MapView | None = None) -> None:
        """Keeps the tick and decides whether it is over; `work` is what was computed in it, `view` the map that is drawn."""
        self.ticks.append(tick)
        if work:
            self.efforts.append(Effort(tick.truth.time, tick.plan_time, dict(work)))
        truth = tick.truth
        problem = self.world.diverged()
        if problem is not None:
            self.end("diverged", problem)
        elif self.rules.end_on_contact and truth.contact and not tick.standing:
            self.end("collision", f"contact at ({truth.pose.x:.2f}, {truth.pose.y:.2f}), {truth.time:.2f} s")
        elif self.goal is not None and self.goal.reached(tick.belief.pose):
            self._arrive(self.goal, truth)
        elif isinstance(command, Done):
            self._finish(command, truth, view)
        elif isinstance(command, GiveUp) and not self._mover_on_goal(truth):
            self.end(command.status, command.reason)
        elif truth.time >= self.rules.time_limit - 1e-9:
            taken = f": mover {mover!r} stands on the goal" if (mover := self._mover_on_goal(truth)) else ""
            self.end("timeout", f"not there after {self.rules.time_limit:g} s{taken}")
        elif not self._progress(tick):
            self.end("stuck", f"no progress for {self.rules.movement_time:g} s at ({truth.pose.x:.2f}, {truth.pose.y:.2f})")

    def _mover_on_goal(self, truth: GroundTruth) -> str | None:
        """Which one, if any, or was until just now: whoever gives up or stands still then has to wait until the time is over."""
        if self.goal is None or not truth.movers:
            return None
        mover = self.world.mover_at(self.goal.position, self.robot)
        if mover is not None:
            self._taken_by, self._taken_at = mover, truth.time
        return self._taken_by if truth.time - self._taken_at <= FORGETTING else None

    def _arrive(self, goal: Goal, truth: GroundTruth) -> None:
        distance = math.hypot(truth.pose.x - goal.position[0], truth.pose.y - goal.position[1])
        if distance <= self.rules.success_radius:
            self.end("success", f"reached the goal, {distance:.3f} m from it")
        else:
            self.end("missed", f"believes to be at the goal but is {distance:.2f} m from it")

    def _finish(self, command: Done, truth: GroundTruth, view: MapView | None) -> None:
        """The navigator says that it is done: success where that is measured, else `missed`."""
        if self.goal is not None:
            turn = 0.0 if self.goal.heading is None else abs(wrap_angle(truth.pose.theta - self.goal.heading))
            if turn > self.goal.yaw_goal_tolerance:
                self.end("missed", f"says that it is done ({command.reason}) but is {turn:.2f} rad off the goal's heading")
            else:
                self._arrive(self.goal, truth)
            return
        done, why = (False, "this task has no measure") if self.measure is None else self.measure(self.ticks[0].truth.pose, view)
        self.end("success", f"{command.reason}; {why}") if done else self.end("missed", f"{command.reason}; but {why}")

    def _progress(self, tick: Tick) -> bool:
        """Nav2's progress checker; turning, holding for a command in execution and waiting for the goal count as progress."""
        rules, truth = self.rules, tick.truth
        moved = (
            self._anchor is None
            or self.robot.busy
            or self._anchor.distance_to(truth.pose) >= rules.movement_radius
            or abs(wrap_angle(self._anchor.theta - truth.pose.theta)) >= rules.movement_angle
        )
        if moved or (truth.time - self._anchor_time > rules.movement_time and self._mover_on_goal(truth)):
            self._anchor, self._anchor_time = truth.pose, truth.time
        return truth.time - self._anchor_time <= rules.movement_time

    def stands(self, command: Command, truth: GroundTruth) -> bool:
        """Whether the car has stood still since it came to rest; `command` is the last one that was executed. Asked once a tick.

        A wall that stops a car which is told to drive does not make it stand, nor does a mover that pushes a standing car make
        it drive.
        """
        if isinstance(command, Drive):
            self._driven = command.twist != Twist()
        elif isinstance(command, Serial):
            self._driven = False
        at_rest = abs(truth.twist.v) < 0.005 and abs(truth.twist.omega) < 0.02  # no faster than creep
        self._standing = not self._driven and not self.robot.busy and (self._standing or at_rest)
        return self._standing

    def play_events(self, time: float) -> None:
        """What happens between two ticks, unseen by the estimators."""
        self.carried = False
        while self._kidnapped < len(self.rules.kidnaps) and self.rules.kidnaps[self._kidnapped][0] <= time + 1e-9:
            self.robot.kidnap(self.rules.kidnaps[self._kidnapped][1])
            self._kidnapped += 1
            self._anchor = None
            self.carried = True
