"""The loop: sense, estimate, map, decide, act; and what ends it.

Ground truth reaches the recorder and the judge only.
"""

from __future__ import annotations

import math
import signal
import threading
import time as wall
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import Protocol

from robocar.core import (
    SE2,
    STOP,
    Array,
    Belief,
    Command,
    Done,
    Drive,
    Estimator,
    GiveUp,
    Goal,
    Hold,
    Mapper,
    Navigator,
    Observation,
    OutputError,
    Scalar,
    Serial,
    Twist,
    wrap_angle,
)
from robocar.core.trace import Drawable
from robocar.core.truth import GroundTruth
from robocar.recording import Recorder

FORGETTING = 2.0  # [s] that a navigator may take to see that a mover has left the goal


class Car(Protocol):
    """What the loop drives: the simulation."""

    def sense(self) -> Observation: ...

    def act(self, command: Command) -> None: ...

    def ground_truth(self) -> GroundTruth: ...

    def diverged(self) -> str | None: ...

    def kidnap(self, pose: SE2) -> None: ...

    def mover_at(self, point: Array) -> str | None:
        """Name of a moving obstacle that leaves the car no room at a point (2,) [m]; asked only where there are some."""
        ...

    @property
    def busy(self) -> bool:
        """Whether the firmware executes a serial command."""
        ...


class DeadReckoning(Protocol):
    """Odometry that is always kept beside the estimator, for metrics and pictures."""

    def update(self, observation: Observation, command: Command) -> Belief: ...


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
class Episode:
    """A run in progress and, when it is over, its outcome.

    `status` is one of success, collision, timeout, stuck, no_path, missed (the car believes to have arrived, and has not),
    diverged, error, interrupted.
    """

    rules: Rules
    goal: Goal | None
    status: str = ""
    reason: str = ""
    traceback: str = ""
    ticks: list[Tick] = field(default_factory=list)
    replans: int = 0
    carried: bool = False
    _anchor: SE2 | None = None
    _anchor_time: float = 0.0
    _kidnapped: int = 0
    _standing: bool = True
    _driven: bool = False
    _taken_by: str | None = None
    _taken_at: float = -math.inf

    @property
    def done(self) -> bool:
        return bool(self.status)

    def end(self, status: str, reason: str) -> None:
        if not self.done:
            self.status, self.reason = status, reason

    def judge(self, car: Car, tick: Tick, command: Command) -> None:
        """Keeps the tick and decides whether the run is over."""
        self.ticks.append(tick)
        truth = tick.truth
        if "replans" in command.trace and isinstance(scalar := command.trace["replans"], Scalar):
            self.replans = int(scalar.value)
        problem = car.diverged()
        if problem is not None:
            self.end("diverged", problem)
        elif self.rules.end_on_contact and truth.contact and not tick.standing:
            self.end("collision", f"contact at ({truth.pose.x:.2f}, {truth.pose.y:.2f}), {truth.time:.2f} s")
        elif self.goal is not None and self.goal.reached(tick.belief.pose):
            self._arrive(self.goal, truth)
        elif isinstance(command, Done):
            self.end("success", command.reason)
        elif isinstance(command, GiveUp) and not self._mover_on_goal(car, truth):
            self.end(command.status, command.reason)
        elif truth.time >= self.rules.time_limit - 1e-9:
            taken = f": mover {mover!r} stands on the goal" if (mover := self._mover_on_goal(car, truth)) else ""
            self.end("timeout", f"not there after {self.rules.time_limit:g} s{taken}")
        elif not self._progress(car, tick):
            self.end("stuck", f"no progress for {self.rules.movement_time:g} s at ({truth.pose.x:.2f}, {truth.pose.y:.2f})")

    def _mover_on_goal(self, car: Car, truth: GroundTruth) -> str | None:
        """Which one, if any, or was until just now: whoever gives up or stands still then has to wait until the time is over."""
        if self.goal is None or not truth.movers:
            return None
        mover = car.mover_at(self.goal.position)
        if mover is not None:
            self._taken_by, self._taken_at = mover, truth.time
        return self._taken_by if truth.time - self._taken_at <= FORGETTING else None

    def _arrive(self, goal: Goal, truth: GroundTruth) -> None:
        distance = math.hypot(truth.pose.x - goal.position[0], truth.pose.y - goal.position[1])
        if distance <= self.rules.success_radius:
            self.end("success", f"reached the goal, {distance:.3f} m from it")
        else:
            self.end("missed", f"believes to be at the goal but is {distance:.2f} m from it")

    def _progress(self, car: Car, tick: Tick) -> bool:
        """Nav2's progress checker; turning, holding for a command in execution and waiting for the goal count as progress."""
        rules, truth = self.rules, tick.truth
        moved = (
            self._anchor is None
            or car.busy
            or self._anchor.distance_to(truth.pose) >= rules.movement_radius
            or abs(wrap_angle(self._anchor.theta - truth.pose.theta)) >= rules.movement_angle
        )
        if moved or (truth.time - self._anchor_time > rules.movement_time and self._mover_on_goal(car, truth)):
            self._anchor, self._anchor_time = truth.pose, truth.time
        return truth.time - self._anchor_time <= rules.movement_time

    def stands(self, car: Car, command: Command, truth: GroundTruth) -> bool:
        """Whether the car has stood still since it came to rest; `command` is the last one that was executed.

        A wall that stops a car which is told to drive does not make it stand, nor does a mover that pushes a standing car make
        it drive.
        """
        if isinstance(command, Drive):
            self._driven = command.twist != Twist()
        elif isinstance(command, Serial):
            self._driven = False
        at_rest = abs(truth.twist.v) < 0.005 and abs(truth.twist.omega) < 0.02  # no faster than creep
        self._standing = not self._driven and not car.busy and (self._standing or at_rest)
        return self._standing

    def play_events(self, car: Car, time: float) -> None:
        """What happens between two ticks, unseen by the estimators."""
        self.carried = False
        while self._kidnapped < len(self.rules.kidnaps) and self.rules.kidnaps[self._kidnapped][0] <= time + 1e-9:
            car.kidnap(self.rules.kidnaps[self._kidnapped][1])
            self._kidnapped += 1
            self._anchor = None
            self.carried = True


def navigate(
    car: Car,
    estimator: Estimator,
    mapper: Mapper,
    navigator: Navigator,
    recorder: Recorder,
    odometry: DeadReckoning,
    goal: Goal | None,
    rules: Rules,
    progress: Progress | None = None,
) -> Episode:
    """Runs until the episode is over. Errors of the parts end the episode, not the process; so does Ctrl-C.

    Raises:
        OutputError: the recording cannot be written.
    """
    episode = Episode(rules, goal)
    try:
        with _Interrupt() as interrupt:
            _loop(car, estimator, mapper, navigator, recorder, odometry, goal, episode, progress, interrupt)
    except KeyboardInterrupt:
        episode.end("interrupted", "stopped by the user")
    return episode


def _loop(
    car: Car,
    estimator: Estimator,
    mapper: Mapper,
    navigator: Navigator,
    recorder: Recorder,
    odometry: DeadReckoning,
    goal: Goal | None,
    episode: Episode,
    progress: Progress | None,
    interrupt: _Interrupt,
) -> None:
    command: Command = STOP
    while not episode.done:
        observation = car.sense()
        truth = car.ground_truth()
        dead_reckoning = odometry.update(observation, command)
        standing = episode.stands(car, command, truth)
        try:
            belief = checked_belief(estimator.update(observation, command))
            mapper.update(belief, observation)
            started = wall.perf_counter()
            command = checked(navigator.command(belief, mapper, observation, goal))
            planning_time = wall.perf_counter() - started
            recorder.log(observation, belief, mapper, command, truth, odometry=dead_reckoning.pose, planning_time=planning_time)
        except OutputError:
            raise
        except (Exception, SystemExit) as error:  # also a mapper's grid or a trace that cannot be drawn
            episode.end("error", f"{type(error).__name__}: {error}")
            episode.traceback = traceback.format_exc()
            return
        episode.judge(car, Tick(truth, belief, dead_reckoning.pose, standing, planning_time, episode.carried), command)
        if interrupt.asked:
            episode.end("interrupted", "stopped by the user")
        if not episode.done:
            episode.play_events(car, truth.time)
            car.act(command)
        if progress is not None:
            progress(truth.time, episode.rules.time_limit)


class Progress(Protocol):
    """Told after every tick how far the run has got [s]."""

    def __call__(self, time: float, time_limit: float) -> None: ...


class _Interrupt:
    """Ctrl-C ends the run after the tick that it falls into, so that log and recording stay whole; the second one breaks off."""

    def __init__(self) -> None:
        self.asked = False
        self._ours = False

    def __enter__(self) -> _Interrupt:
        # Only where Ctrl-C would raise KeyboardInterrupt here: a caller's own handler keeps its say.
        if (
            threading.current_thread() is threading.main_thread()
            and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        ):
            signal.signal(signal.SIGINT, self._ask)
            self._ours = True
        return self

    def __exit__(self, *_: object) -> None:
        if self._ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _ask(self, *_: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


def checked(command: object) -> Command:
    """The command, if it is one with finite numbers.

    Raises:
        TypeError, ValueError: it is not.
    """
    if not isinstance(command, Drive | Serial | Hold | Done | GiveUp):
        raise TypeError(f"the navigator must return a command, not {type(command).__name__}")
    numbers = [] if command.pan is None else [command.pan]
    if isinstance(command, Drive):
        numbers += [command.twist.v, command.twist.omega]
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"the navigator commanded a number that is not finite: {command}")
    text = command.line if isinstance(command, Serial) else getattr(command, "reason", "")
    if not isinstance(text, str):
        raise TypeError(f"the navigator must give a text, not {type(text).__name__}: {command}")
    _check_trace(command.trace, "navigator")
    return command


def checked_belief(belief: object) -> Belief:
    """The belief, if it is one.

    Raises:
        TypeError: it is not.
    """
    if not (isinstance(belief, Belief) and isinstance(belief.pose, SE2)):
        raise TypeError(f"the estimator must return a belief, not {type(belief).__name__}")
    _check_trace(belief.trace, "estimator")
    return belief


def _check_trace(trace: object, what: str) -> None:
    if not isinstance(trace, Mapping):
        raise TypeError(f"the {what}'s trace must be a mapping of names to drawables, not {type(trace).__name__}")
    for name, item in trace.items():
        if not (isinstance(name, str) and isinstance(item, Drawable)):
            raise TypeError(f"the {what}'s trace must be a mapping of names to drawables; {name!r} is {type(item).__name__}")
        if isinstance(item, Scalar) and not isinstance(item.value, Real):
            raise TypeError(f"the {what}'s trace must hold numbers as scalars; {name!r} is {item.value!r}")
