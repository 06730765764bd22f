"""What the loop drives, as Protocols: a robot in a world."""

from __future__ import annotations

from typing import Any, Protocol

from robocar.core import SE2, Array, Belief, Command, Observation
from robocar.core.truth import GroundTruth


class Body(Protocol):
    """A robot of the world."""

    def sense(self) -> Observation:
        """What is new since it was last asked."""
        ...

    def act(self, command: Command) -> None:
        """Hands a command over; it takes effect with the world's next step."""
        ...

    def kidnap(self, pose: SE2) -> None: ...

    @property
    def busy(self) -> bool:
        """Whether the firmware executes a serial command."""
        ...


class Physics(Protocol):
    """The world with its robots."""

    def step(self) -> None:
        """Lets the world go on for one control period."""
        ...

    def ground_truth(self, robot: Any) -> GroundTruth: ...

    def diverged(self) -> str | None: ...

    def mover_at(self, point: Array, robot: Any) -> str | None:
        """Name of a moving obstacle that leaves the robot no room at a point (2,) [m]; asked only where there are some."""
        ...


class DeadReckoning(Protocol):
    """Odometry that is always kept beside the estimator, for metrics and pictures."""

    def update(self, observation: Observation, command: Command) -> Belief: ...
