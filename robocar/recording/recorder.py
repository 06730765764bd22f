"""What the loop tells a recorder, and the recorder that records nothing."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

from robocar.core import SE2, Command, Observation, State
from robocar.core.truth import GroundTruth

_NO_SIGNALS: Mapping[str, float] = MappingProxyType({})


@runtime_checkable
class Recorder(Protocol):
    """Sees every tick of a run, after the command has gone to the car."""

    def log(
        self,
        observation: Observation,
        state: State,
        command: Command,
        truth: GroundTruth | None,
        *,
        odometry: SE2 | None = None,
        planning_time: float | None = None,
        signals: Mapping[str, float] = _NO_SIGNALS,
    ) -> None:
        """One tick.

        Args:
            observation: what was sensed.
            state: what the estimator made of it; its map is asked for its grid now and then, not at every tick.
            command: what the navigator answered.
            truth: the simulator's state, None where nobody knows it (recorded logs).
            odometry: world_from_robot by dead reckoning alone.
            planning_time: what the navigator took for its answer [s]; leave it out where recordings must compare equal.
            signals: further numbers of this tick, time series by name.

        Raises:
            OutputError: the recording cannot be written.
        """
        ...

    def finish(self) -> None:
        """Writes what still waits to be drawn, before the result is made.

        Raises:
            Exception: something cannot be drawn; it is forgotten, and all else is written.
            OutputError: the recording cannot be written.
        """
        ...

    def close(self, result: Mapping[str, Any] | None = None) -> None:
        """Close the recording; `result` is the content of `metrics.json`, None if there is none.

        Raises:
            OutputError: the recording cannot be written.
        """
        ...


class NullRecorder:
    """Records nothing."""

    def log(
        self,
        observation: Observation,
        state: State,
        command: Command,
        truth: GroundTruth | None,
        *,
        odometry: SE2 | None = None,
        planning_time: float | None = None,
        signals: Mapping[str, float] = _NO_SIGNALS,
    ) -> None:
        pass

    def finish(self) -> None:
        pass

    def close(self, result: Mapping[str, Any] | None = None) -> None:
        pass
