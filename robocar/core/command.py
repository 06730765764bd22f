"""What a navigator wants the robot to do next."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeAlias

from robocar.core.errors import PlanningError
from robocar.core.geometry import Twist, plain_number
from robocar.core.trace import Trace
from robocar.core.work import Work


@dataclass(frozen=True, slots=True, kw_only=True)
class _Decision:
    """What every command may carry.

    Args:
        pan: turns the camera [rad].
        trace: what is to be seen of the decision; it is for eyes, no algorithm and no metric reads it.
        work: what was computed for it (`robocar.core.work`).
    """

    pan: float | None = None
    trace: Trace = field(default_factory=dict)
    work: Work = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (self.pan is None or self.pan.__class__ is float):
            object.__setattr__(self, "pan", plain_number(self.pan, "a command's pan"))


@dataclass(frozen=True, slots=True)
class Drive(_Decision):
    """Keep this twist until told otherwise."""

    twist: Twist


@dataclass(frozen=True, slots=True)
class Serial(_Decision):
    """A line for the firmware's command interpreter, e.g. `M2` (thesis, Table 3.1)."""

    line: str


@dataclass(frozen=True, slots=True)
class Hold(_Decision):
    """Send nothing: what is being executed goes on."""


@dataclass(frozen=True, slots=True)
class Done(_Decision):
    """The task is finished, for tasks without a goal, such as exploration; whether it is, the task's measure decides."""

    reason: str


@dataclass(frozen=True, slots=True)
class GiveUp(_Decision):
    """The navigator gives up.

    Args:
        reason: in words: a budget that ran out, a gap too tight for this planner, recoveries used up.
        status: `stuck`; `no_path` is a claim about the world, for who has proved it: see `because`.
    """

    reason: str
    status: str = "stuck"

    def __post_init__(self) -> None:
        _Decision.__post_init__(self)
        if self.status not in ("no_path", "stuck"):
            raise ValueError(f"a navigator gives up with no_path or stuck, not {self.status!r}")

    @classmethod
    def because(cls, error: PlanningError) -> GiveUp:
        """For a planner's reason, with the status that its class allows."""
        return cls(str(error), error.status, trace=error.trace)


Command: TypeAlias = Drive | Serial | Hold | Done | GiveUp
STOP = Drive(Twist())


def is_finite(command: Command) -> bool:
    """Whether its numbers are."""
    if not (command.pan is None or math.isfinite(command.pan)):
        return False
    return not isinstance(command, Drive) or (math.isfinite(command.twist.v) and math.isfinite(command.twist.omega))
