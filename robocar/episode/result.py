"""What a finished run leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from robocar.core.work import Work
from robocar.episode.fingerprint import fingerprint, versions
from robocar.formats import Trajectory
from robocar.metrics import Metric

SCHEMA = 1


class Effort(NamedTuple):
    """What a tick took: simulated time [s], wall time of the navigator [s], and what was computed (`robocar.core.work`)."""

    time: float
    seconds: float
    work: Work


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """A finished run.

    Args:
        status, reason: how it ended; `success` where the goal was reached.
        metrics: by name, see `robocar.metrics`.
        hash: sha256 over the physics state at each control tick: equal seeds, equal hash.
        truth, estimate, odometry: trajectories, at the same times.
        efforts: of the commands that say that something was computed for them.
        directory: where the files are, None if none were asked for.
        traceback: of a part that raised, else empty.
        notes: on the scenario's files: what is legal but probably not meant.
        name: of the run, which no other one has, see `robocar.episode.identity`; settings: that it was run with.
    """

    scenario: str
    navigator: str
    estimator: str
    mapper: str
    seed: int
    status: str
    reason: str
    metrics: dict[str, Metric]
    hash: str
    truth: Trajectory
    estimate: Trajectory
    odometry: Trajectory
    efforts: tuple[Effort, ...] = ()
    directory: Path | None = None
    traceback: str = ""
    notes: tuple[str, ...] = ()
    name: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        return self.status == "success"

    def value(self, metric: str) -> float | int | None:
        """The number of one metric."""
        return self.metrics[metric]["value"]

    @property
    def recording(self) -> Path | None:
        """The `.rrd` file, if one was written."""
        path = self.directory / "run.rrd" if self.directory is not None else None
        return path if path is not None and path.is_file() else None

    def summary(self) -> dict[str, Any]:
        """The content of `metrics.json`."""
        return {
            "schema": SCHEMA,
            "scenario": self.scenario,
            "navigator": self.navigator,
            "estimator": self.estimator,
            "mapper": self.mapper,
            "seed": self.seed,
            "status": self.status,
            "reason": self.reason,
            "hash": self.hash,
            "fingerprint": fingerprint(),
            "versions": versions(),
            "metrics": self.metrics,
        }
