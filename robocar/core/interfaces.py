"""The parts of the loop, as Protocols. Every algorithm is built by a factory `build(context: Context)` of its module."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from robocar.core.command import Command
from robocar.core.geometry import Array
from robocar.core.grid import Costmap, OccupancyGrid
from robocar.core.observation import Observation
from robocar.core.plan import Belief, Goal, Path, Plan


@runtime_checkable
class GlobalPlanner(Protocol):
    """Finds a path on a costmap. Budgets are expansions or samples, never seconds."""

    def reset(self, rng: np.random.Generator) -> None: ...

    def plan(self, costmap: Costmap, start: Array, goal: Array) -> Plan:
        """Path from `start` to `goal`, both (2,) [m] in the map frame; raises a `PlanningError` where there is none."""
        ...


@runtime_checkable
class LocalPlanner(Protocol):
    """Turns a path, or only a goal and what is seen, into the next command."""

    def reset(self, rng: np.random.Generator) -> None: ...

    def command(
        self, belief: Belief, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal
    ) -> Command: ...


@runtime_checkable
class Estimator(Protocol):
    """Says where the robot is, from what it senses."""

    def reset(self, rng: np.random.Generator) -> None: ...

    def update(self, observation: Observation, command: Command) -> Belief:
        """`command` is the last one that was executed."""
        ...


@runtime_checkable
class Mapper(Protocol):
    """Draws a map from where the robot believes to be and what it senses."""

    def reset(self, rng: np.random.Generator) -> None: ...

    def update(self, belief: Belief, observation: Observation) -> None: ...

    def grid(self) -> OccupancyGrid | None:
        """A snapshot, made when asked for; None for the mapper that maps nothing."""
        ...


@runtime_checkable
class Navigator(Protocol):
    """Decides what to do next."""

    def reset(self, rng: np.random.Generator) -> None: ...

    def command(self, belief: Belief, mapper: Mapper, observation: Observation, goal: Goal | None) -> Command: ...
