"""Everything that Robocar raises on purpose, one class per cause, under one root.

The message of each error names what is wrong (file, line or field, value) and what would have been valid; the command
line prints it as one line and exits with status 2.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from robocar.core.text import one_line

MOST = 4000
"""Characters of a message: lists of all that is wrong, or of all that is known, are long."""


class RobocarError(Exception):
    """Root of all errors that name a cause outside the code: a file, an argument, a world without a way.

    Its message is one line that can be written, whatever a parser's message, a name or a value that stands in it is.
    """

    def __str__(self) -> str:
        text = one_line(super().__str__())
        return text if len(text) <= MOST else f"{text[:MOST]}..."


class MapFormatError(RobocarError):
    """A map, world or scenario file from outside that cannot be read."""


class LogFormatError(RobocarError):
    """A recorded log that cannot be read."""


class ScenarioError(RobocarError):
    """A scenario file, override or combination of components that makes no sense."""


class UnknownNameError(RobocarError):
    """A name that is not registered; the message lists the valid ones."""


class ParameterError(RobocarError):
    """A parameter that does not exist or lies outside its range."""


class OutputError(RobocarError):
    """A run directory that exists already, cannot be written, or whose disk is full."""


class MetricError(RobocarError):
    """The module of a metric that cannot be imported."""


class MapTooLarge(RobocarError):
    """A map that grows beyond what memory holds."""


class PlanningError(RobocarError):
    """Root of the reasons for which a planner returns no plan.

    `status` is what a navigator that gives up for this reason may claim: `stuck`, unless the class says that there is no way.

    Args:
        trace: what the planner shows of its search all the same, see `robocar.core.trace`.
    """

    status: ClassVar[Literal["no_path", "stuck"]] = "stuck"

    def __init__(self, message: str = "", trace: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.trace: Mapping[str, Any] = trace or {}


class StartOccupied(PlanningError):
    """The robot does not fit at the start."""


class GoalOccupied(PlanningError):
    """The robot does not fit at the goal."""


class OutsideMap(PlanningError):
    """Start or goal lies outside the map."""


class NoPathFound(PlanningError):
    """The search is complete, and found no way through this planner's cells.

    This is no proof: cells are coarse, outlines are padded, and what was seen may have been misplaced or may go away.
    """


class Unreachable(NoPathFound):
    """The map that the robot was given proves that there is no way (`robocar.planners.geometry.reachability`)."""

    status = "no_path"


class BudgetExhausted(PlanningError):
    """The planner's budget of iterations, samples or expansions ran out before it found a path: there may be one."""
