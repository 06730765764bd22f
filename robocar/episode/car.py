"""What the loop drives, as Protocols."""

from __future__ import annotations

from typing import Protocol

from robocar.core import SE2, Array, Belief, Command, Observation
from robocar.core.truth import GroundTruth


class Car(Protocol):
    """What the loop drives: the simulation."""

    def sense(self) -> Observation: ...

    def act(self, command: Command) -> None: ...

    def ground_truth(self) -> GroundTruth: ...

    def diverged(self) -> str | None: ...

    def kidnap(self, pose: SE2) -> None: ...

    def mover_at(self, point: Array) -> str | None:
        """Name of a moving obstacle that leaves the car no room at a point (2,) [m]; asked only where there are some."""
        ...

    @property
    def busy(self) -> bool:
        """Whether the firmware executes a serial command."""
        ...


class DeadReckoning(Protocol):
    """Odometry that is always kept beside the estimator, for metrics and pictures."""

    def update(self, observation: Observation, command: Command) -> Belief: ...
