"""What parts return, checked where they hand it to the loop; and how long the navigator took."""

from __future__ import annotations

import math
import time as wall
from collections.abc import Mapping
from numbers import Real

import numpy as np

from robocar.core import (
    Command,
    Done,
    Drive,
    Estimator,
    GiveUp,
    Goal,
    Hold,
    MapView,
    Navigator,
    Observation,
    OccupancyGrid,
    Scalar,
    Serial,
    State,
    Twist,
)
from robocar.core.command import is_finite
from robocar.core.text import is_text
from robocar.core.trace import Drawable, LazyTrace

_MOST_WORK = 2**53  # up to which floating-point numbers are exact


class CheckedEstimator:
    """An estimator whose states are states."""

    def __init__(self, estimator: Estimator) -> None:
        self._estimator = estimator

    def update(self, observation: Observation, command: Command) -> State:
        """Its state.

        Raises:
            TypeError: it returns none.
        """
        return checked_state(self._estimator.update(observation, command))


def drawn(view: MapView | None) -> OccupancyGrid | None:
    """The map as it is now; None where none is drawn.

    Raises:
        TypeError: its grid is none.
    """
    grid = None if view is None else view.grid()
    if grid is not None and not isinstance(grid, OccupancyGrid):
        raise TypeError(f"a map's grid must be an occupancy grid or None, not {type(grid).__name__}")
    return grid


class CheckedNavigator:
    """A navigator whose commands are commands. `seconds`: of wall time that its last one took."""

    def __init__(self, navigator: Navigator) -> None:
        self._navigator = navigator
        self.seconds = math.nan

    def command(self, state: State, observation: Observation, goal: Goal | None) -> Command:
        """Its command.

        Raises:
            TypeError, ValueError: it returns none with finite numbers.
        """
        started = wall.perf_counter()
        command = self._navigator.command(state, observation, goal)
        self.seconds = wall.perf_counter() - started
        return checked(command)


def checked(command: object) -> Command:
    """The command, if it is one with finite numbers.

    Raises:
        TypeError, ValueError: it is not.
    """
    text = ""
    if isinstance(command, Drive):
        if not isinstance(command.twist, Twist):
            raise TypeError(f"the navigator must drive with a twist, not {type(command.twist).__name__}")
    elif isinstance(command, Serial):
        text = command.line
    elif isinstance(command, Done | GiveUp):
        text = command.reason
    elif not isinstance(command, Hold):
        raise TypeError(f"the navigator must return a command, not {type(command).__name__}")
    if not is_finite(command):
        raise ValueError(f"the navigator commanded a number that is not finite: {command}")
    if not isinstance(text, str):
        raise TypeError(f"the navigator must give a text, not {type(text).__name__}: {command}")
    if not is_text(text):
        raise ValueError(f"the navigator gave a text that UTF-8 cannot hold: {text!a:.80}")
    _check_trace(command.trace, "navigator")
    _check_work(command.work, "navigator")
    return command


def checked_state(state: object) -> State:
    """The state, if it is one.

    Raises:
        TypeError: it is not.
    """
    if not isinstance(state, State):
        raise TypeError(f"the estimator must return a state, not {type(state).__name__}")
    if state.map is not None and not all(hasattr(state.map, name) for name in ("grid", "revision", "complete")):
        raise TypeError(f"the state's map must have grid(), revision and complete; {type(state.map).__name__} has not")
    _check_trace(state.belief.trace, "estimator")
    _check_work(state.work, "estimator")
    return state


def _check_trace(trace: object, what: str) -> None:
    """What a lazy trace holds is made, and found wrong, only where somebody looks."""
    if trace.__class__ is LazyTrace or trace == {}:  # in nearly every tick
        return
    if not isinstance(trace, Mapping):
        raise TypeError(f"the {what}'s trace must be a mapping of names to drawables, not {type(trace).__name__}")
    for name, item in trace.items():
        if not (isinstance(name, str) and isinstance(item, Drawable)):
            raise TypeError(f"the {what}'s trace must be a mapping of names to drawables; {name!r} is {type(item).__name__}")
        if isinstance(item, Scalar) and not _is_float(item.value):
            raise TypeError(f"the {what}'s trace must hold numbers as scalars; {name!r} is {item.value!r:.80}")


def _is_float(value: object) -> bool:
    if not isinstance(value, Real):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def _check_work(work: object, what: str) -> None:
    if work == {}:  # in nearly every tick
        return
    if not isinstance(work, Mapping) or not all(
        isinstance(unit, str) and is_text(unit) and isinstance(count, int | np.integer) and 0 <= count <= _MOST_WORK
        for unit, count in work.items()
    ):
        raise TypeError(f"the {what}'s work must map units to counts from 0 to 2^53, not {work!a:.80}")
