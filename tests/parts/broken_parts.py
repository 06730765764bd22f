"""Parts as somebody else may write them: simple ones, and ones that go wrong. Chosen as `broken_parts:<factory>`."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import Any

import numpy as np

from robocar.core import SE2, STOP, Belief, Context, Done, Drive, GiveUp, Points, Scalar, Serial, State, Twist
from robocar.core.capabilities import declares

BEFORE = 5  # ticks that go well


@dataclass(frozen=True)
class Parameters:
    speed: float = 0.3


class Scripted:
    """A navigator that answers by the number of the tick."""

    def __init__(self, answer: Callable[[int], Any]) -> None:
        self._answer, self._tick = answer, -1

    def command(self, state: Any, observation: Any, goal: Any) -> Any:
        self._tick += 1
        return self._answer(self._tick)


def _then(make: Callable[[], Any]) -> Callable[[Context], Scripted]:
    """Stands still for some ticks, then does this."""
    return lambda context: Scripted(lambda tick: STOP if tick < BEFORE else make())


def _raise(error: BaseException) -> Any:
    raise error


def straight(context: Context) -> Scripted:
    speed = context.parameters_of(Parameters).speed
    return Scripted(lambda tick: Drive(Twist(speed)))


def spin(context: Context) -> Scripted:
    return Scripted(lambda tick: Drive(Twist(0.0, 0.5)))


def still(context: Context) -> Scripted:
    return Scripted(lambda tick: STOP)


done = _then(lambda: Done("seen all"))
give_up = _then(lambda: GiveUp("walled in", "stuck"))
nan = _then(lambda: Drive(Twist(math.nan, 0.0)))
nan_pan = _then(lambda: Drive(Twist(), pan=math.inf))
raises = _then(lambda: _raise(ZeroDivisionError("no way to divide")))
exits = _then(lambda: _raise(SystemExit(0)))
none = _then(lambda: None)
tuple_of_speeds = _then(lambda: (0.1, 0.2))
serial_number = _then(lambda: Serial(5))  # type: ignore[arg-type]
no_trace = _then(lambda: Drive(Twist(), trace=None))  # type: ignore[arg-type]
odd_trace = _then(lambda: Drive(Twist(), trace={"what": 5}))  # type: ignore[dict-item]
word_scalar = _then(lambda: Drive(Twist(), trace={"what": Scalar("much")}))  # type: ignore[arg-type]
huge_scalar = _then(lambda: Drive(Twist(), trace={"what": Scalar(10**400)}))
huge_work = _then(lambda: Drive(Twist(), work={"replans": 10**400}))
half_unit = _then(lambda: Drive(Twist(), work={"\udcff": 1}))
half_text = _then(lambda: Done("\udcff"))
no_twist = _then(lambda: Drive(None))  # type: ignore[arg-type]
word_twist = _then(lambda: Drive(Twist("fast")))  # type: ignore[arg-type]
half_message = _then(lambda: _raise(ValueError("\udcff")))
two_lines = _then(lambda: _raise(ValueError("first\nsecond\x1b[31m")))
no_message = _then(lambda: _raise(Speechless()))


class Odd(BaseException):
    """Derived from what few expect."""


class Mute(BaseException):
    def __str__(self) -> str:
        raise Odd("no words")


odd_error = _then(lambda: _raise(Odd("nobody catches me")))
generator_exit = _then(lambda: _raise(GeneratorExit("x")))
cancels = _then(lambda: _raise(CancelledError()))
no_message_either = _then(lambda: _raise(Mute()))
half_line = _then(lambda: Serial("\udcff"))


class Speechless(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


def drawn_late(context: Context) -> Scripted:
    """What it shows last is shown too soon after the one before, so that it has to wait for the end."""
    good, bad = Points(np.zeros((3, 2))), Points(np.zeros((3, 5)))
    last = {BEFORE - 2: Drive(Twist(), trace={"what": good}), BEFORE - 1: Done("", trace={"what": bad})}
    return Scripted(lambda tick: last.get(tick, STOP))


undrawable = _then(lambda: Drive(Twist(), trace={"what": Points(np.zeros(3))}))


class Estimator:
    """An estimator that answers by the number of the tick."""

    def __init__(self, answer: Callable[[int], Any]) -> None:
        self._answer, self._tick = answer, -1

    def update(self, observation: Any, command: Any) -> Any:
        self._tick += 1
        return self._answer(self._tick)


def _estimates(make: Callable[[], Any]) -> Callable[[Context], Estimator]:
    return lambda context: Estimator(lambda tick: Belief(SE2()) if tick < BEFORE else make())


estimator_raises = _estimates(lambda: _raise(RuntimeError("lost")))
estimator_nan = _estimates(lambda: Belief(SE2(math.nan, 0.0, 0.0)))
estimator_none = _estimates(lambda: None)
estimator_covariance = _estimates(lambda: Belief(SE2(), covariance=np.eye(2)))
estimator_covariance_nan = _estimates(lambda: Belief(SE2(), covariance=np.full((3, 3), math.nan)))
estimator_particles = _estimates(lambda: Belief(SE2(), particles=np.zeros((5, 3))))
estimator_twist = _estimates(lambda: Belief(SE2(), twist=(0.1, 0.0)))  # type: ignore[arg-type]
estimator_column_twist = _estimates(lambda: Belief(SE2(), twist=Twist(np.array([0.1]), 0.0)))  # type: ignore[arg-type]
estimator_huge = _estimates(lambda: Belief(SE2(), twist=Twist(10**400, 0.0)))
estimator_odom = _estimates(lambda: Belief(SE2(), odom_from_robot=(0.0, 0.0, 0.0)))  # type: ignore[arg-type]
estimator_state = _estimates(lambda: State.of(Belief(SE2())))


def _slam(make: Callable[[], Any]) -> Callable[[Context], Estimator]:
    return declares(maps=True)(lambda context: Estimator(lambda tick: State.of(Belief(SE2())) if tick < BEFORE else make()))


class BrokenMap:
    """A map, and a mapper, whose grid is not to be had."""

    revision, complete = 0, False

    def __init__(self, answer: Callable[[], Any]) -> None:
        self._answer = answer

    def update(self, belief: Any, observation: Any) -> None: ...

    def grid(self) -> Any:
        return self._answer()


slam_frames = _slam(lambda: State(Belief(SE2()), None, SE2()))  # type: ignore[arg-type]
slam_belief = _slam(lambda: State(None, SE2(), SE2()))  # type: ignore[arg-type]
slam_no_map = _slam(lambda: State.of(Belief(SE2()), 42))  # type: ignore[arg-type]
slam_raises = _slam(lambda: State.of(Belief(SE2()), BrokenMap(lambda: _raise(RuntimeError("no paper")))))
slam_text = _slam(lambda: State.of(Belief(SE2()), BrokenMap(lambda: "a map")))


def mapper_raises(context: Context) -> BrokenMap:
    return BrokenMap(lambda: _raise(RuntimeError("no paper")))


def mapper_array(context: Context) -> BrokenMap:
    return BrokenMap(lambda: np.zeros((3, 3)))


def at_goal(context: Context) -> Estimator:
    """Believes to be where the short scenario's goal is."""
    return Estimator(lambda tick: Belief(SE2(1.2, 0.4)))


def factory_raises(context: Context) -> Scripted:
    raise OSError("no licence")


no_factory = 5
