"""What parts return, checked where they hand it to the loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real

from robocar.core import SE2, Belief, Command, Done, Drive, GiveUp, Hold, Scalar, Serial
from robocar.core.trace import Drawable


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
