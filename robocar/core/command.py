"""What a navigator wants the car to do next."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

from robocar.core.geometry import Twist
from robocar.core.trace import Trace


@dataclass(frozen=True, slots=True)
class Drive:
    """Keep this twist until told otherwise; `pan` turns the camera [rad]."""

    twist: Twist
    pan: float | None = None
    trace: Trace = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Serial:
    """A line for the firmware's command interpreter, e.g. `M2` (thesis, Table 3.1)."""

    line: str
    pan: float | None = None
    trace: Trace = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Hold:
    """Send nothing: what is being executed goes on."""

    pan: float | None = None
    trace: Trace = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Done:
    """The task is finished (for tasks without a goal, such as exploration)."""

    reason: str
    pan: float | None = None
    trace: Trace = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class GiveUp:
    """The navigator sees no way (`status` is `no_path`) or no progress (`stuck`)."""

    reason: str
    status: str = "no_path"
    pan: float | None = None
    trace: Trace = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.status not in ("no_path", "stuck"):
            raise ValueError(f"a navigator gives up with no_path or stuck, not {self.status!r}")


Command: TypeAlias = Drive | Serial | Hold | Done | GiveUp
STOP = Drive(Twist())
