"""The straight ways that the Operative Critical Point Bug drives."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from robocar.core import Array


class LegKind(Enum):
    """Why the robot drives."""

    GOAL = "to the goal"
    CRITICAL = "to the critical point"
    BACK = "back"
    EVADE = "out of the way"


@dataclass(slots=True, eq=False)
class Leg:
    """A straight way: turn, then drive; what it is for, its end (2,) [m], the number of the sub-goal that it leads to (-1: none),
    and how many scans in a row have called it blocked."""

    kind: LegKind
    target: Array
    subgoal: int = -1
    flags: int = 0
