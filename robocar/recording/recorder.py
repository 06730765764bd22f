"""What the loop tells a recorder, and the recorder that records nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from robocar.core import SE2, Belief, Command, Mapper, Observation
from robocar.core.truth import GroundTruth


@runtime_checkable
class Recorder(Protocol):
    """Sees every tick of a run, after the command has gone to the car."""

    def log(
        self,
        observation: Observation,
        belief: Belief,
        mapper: Mapper,
        command: Command,
        truth: GroundTruth | None,
        *,
        odometry: SE2 | None = None,
        planning_time: float | None = None,
    ) -> None:
        """One tick.

        Args:
            observation: what was sensed.
            belief: what the estimator made of it.
            mapper: asked for its grid now and then, not at every tick.
            command: what the navigator answered.
            truth: the simulator's state, None where nobody knows it (recorded logs).
            odometry: world_from_robot by dead reckoning alone.
            planning_time: what the navigator took for its answer [s]; leave it out where recordings must compare equal.

        Raises:
            OutputError: the recording cannot be written.
        """
        ...

    def close(self, result: Mapping[str, Any] | None = None) -> None:
        """Finish the recording; `result` is the content of `metrics.json`, None if there is none.

        Raises:
            OutputError: the recording cannot be written.
        """
        ...


class NullRecorder:
    """Records nothing."""

    def log(
        self,
        observation: Observation,
        belief: Belief,
        mapper: Mapper,
        command: Command,
        truth: GroundTruth | None,
        *,
        odometry: SE2 | None = None,
        planning_time: float | None = None,
    ) -> None:
        pass

    def close(self, result: Mapping[str, Any] | None = None) -> None:
        pass
