"""Navigators that take their worker with them, chosen as `bad_parts:<factory>`. Each leaves a mark in $BAD_PARTS_MARKS."""

from __future__ import annotations

import os
import signal
import sys
import time
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robocar.core import STOP, Context, Drive, Twist


class _Standing:
    """Stands still, and does something at its tenth tick."""

    def __init__(self, act: Any) -> None:
        self._act, self._tick = act, 0

    def command(self, state: Any, observation: Any, goal: Any) -> Any:
        self._tick += 1
        if self._tick == 10:
            self._act()
        return STOP


def _mark(name: str) -> int:
    """How often this was called before, over all processes."""
    folder = Path(os.environ["BAD_PARTS_MARKS"])
    before = len(list(folder.glob(f"{name}.*")))
    (folder / f"{name}.{os.getpid()}.{time.monotonic_ns()}").touch()
    return before


def _kill() -> None:
    sys.stderr.write("about to die\n")
    sys.stderr.flush()
    os.kill(os.getpid(), signal.SIGKILL)


def dies(context: Context) -> _Standing:
    """At each try."""
    return _Standing(lambda: (_mark("dies"), _kill()))


def leaves(context: Context) -> _Standing:
    """Ends its process as if all had gone well."""
    return _Standing(lambda: (_mark("leaves"), os._exit(0)))


class _Odd(BaseException):
    """Derived from what few expect."""


def raises_an_odd_error(context: Context) -> _Standing:
    _mark("raises_an_odd_error")
    raise _Odd("nobody catches me")


def cancels(context: Context) -> _Standing:
    _mark("cancels")
    raise CancelledError


def dies_once(context: Context) -> _Standing:
    return _Standing(lambda: None if _mark("dies_once") else _kill())


def hangs(context: Context) -> _Standing:
    return _Standing(lambda: (_mark("hangs"), time.sleep(3600)))


def raises_when_built(context: Context) -> _Standing:
    _mark("raises_when_built")
    raise OSError("no licence for this planner")


def raises_in_the_loop(context: Context) -> _Standing:
    def act() -> None:
        _mark("raises_in_the_loop")
        raise ZeroDivisionError("no way to divide")

    return _Standing(act)


def slow(context: Context) -> _Standing:
    """A second of wall time, so that somebody can interrupt."""
    return _Standing(lambda: (_mark("slow"), time.sleep(1.0)))


@dataclass(frozen=True)
class Parameters:
    after: int = 10_000


class _Knee:
    """Drives straight on, and turns from one tick on."""

    def __init__(self, after: int) -> None:
        self._after, self._tick = after, -1

    def command(self, state: Any, observation: Any, goal: Any) -> Any:
        self._tick += 1
        return Drive(Twist(0.2, 0.5 if self._tick >= self._after else 0.0))


def knee(context: Context) -> _Knee:
    return _Knee(context.parameters_of(Parameters).after)
