"""The parts of the loop, as Protocols. Every algorithm is built by a factory `build(context: Context)` of its module.

All that a part needs, its random generator and start state too, comes with its construction: a new run builds new parts, so there
is no method that resets one.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from robocar.core.command import Command, Drive
from robocar.core.geometry import Array
from robocar.core.grid import Costmap, OccupancyGrid
from robocar.core.observation import Observation
from robocar.core.plan import Belief, Goal, Path, Plan
from robocar.core.state import State


@runtime_checkable
class GlobalPlanner(Protocol):
    """Finds a path on a costmap. Budgets are expansions or samples, never seconds."""

    def plan(self, costmap: Costmap, start: Array, goal: Array) -> Plan:
        """Path from `start` to `goal`, both (2,) [m] in the costmap's frame; raises a `PlanningError` where there is none."""
        ...


@runtime_checkable
class Controller(Protocol):
    """Turns a path, or only a goal and what is seen, into the next command; Nav2's controller (local planner)."""

    def command(
        self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal
    ) -> Command: ...


@runtime_checkable
class EvadingController(Controller, Protocol):
    """A controller that can also get out of the way of what comes."""

    def evade(self, state: State, costmap: Costmap | None, observation: Observation) -> Drive | None:
        """The command for somebody else's manoeuvre that something comes too near to; None where nothing comes."""
        ...


@runtime_checkable
class PoseEstimator(Protocol):
    """Says where the robot is, from what it senses."""

    def update(self, observation: Observation, command: Command) -> Belief:
        """`command` is the last one that was executed."""
        ...


@runtime_checkable
class Mapper(Protocol):
    """Draws a map from where the robot believes to be and what it senses."""

    def update(self, belief: Belief, observation: Observation) -> None: ...

    def grid(self) -> OccupancyGrid | None:
        """A snapshot, made when asked for; None before the first reading."""
        ...


@runtime_checkable
class Estimator(Protocol):
    """Says where the robot is and what the world looks like: a SLAM system, or the `Cascade` of a pose estimator and a mapper."""

    def update(self, observation: Observation, command: Command) -> State:
        """`command` is the last one that was executed."""
        ...


@runtime_checkable
class Navigator(Protocol):
    """Decides what to do next."""

    def command(self, state: State, observation: Observation, goal: Goal | None) -> Command: ...
