"""The files of one run: written beside their place and renamed when complete."""

from __future__ import annotations

import glob
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import yaml

from robocar.core import OccupancyGrid, OutputError
from robocar.episode.fingerprint import fingerprint, versions
from robocar.episode.map_watch import decided
from robocar.episode.result import RunResult
from robocar.episode.spec import RunSpec
from robocar.formats import save_ros_map, write_tum
from robocar.recording import Recorder, Scenery


class RunDirectory:
    """The files of one run: written beside their place and renamed when complete, so a broken run never looks whole.

    `path` is where to write; a run that ends by an exception leaves nothing but what `path` then holds (a recording, say), under
    a name that starts with a dot and ends with `.partial`.

    Args:
        out: the folder that the run's directory is made in.
        force: replace an existing run.
    """

    def __init__(self, out: str | Path, spec: RunSpec, force: bool) -> None:
        self.spec, self.name = spec, spec.name
        self.final = Path(out) / self.name
        self.path = Path(out) / f".{self.name}.{os.getpid()}.partial"
        self._force = force

    def __enter__(self) -> RunDirectory:
        try:
            if self.final.exists() and not self._force:
                raise OutputError(f"{self.final}: this run exists already; --force replaces it")
            shutil.rmtree(self.path, ignore_errors=True)  # of a killed process that had our number
            self.path.mkdir(parents=True)
            (self.path / "config.yaml").write_text(yaml.safe_dump(_config(self.spec), sort_keys=False))
        except OSError as error:
            raise OutputError(f"{self.final.parent}: cannot write a run here: {error.strerror or error}") from error
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and not (self.path / "run.rrd").is_file():
            shutil.rmtree(self.path, ignore_errors=True)  # it had not begun: nothing to look into
        if isinstance(error, OSError):
            raise OutputError(f"{self.path}: cannot write: {error.strerror or error}") from error

    @staticmethod
    def clear(out: Path, name: str) -> None:
        """Removes half-written directories of this run, of processes that were killed; none may be at work on it."""
        for pattern in ("partial", "replaced"):
            for left in out.glob(f".{glob.escape(name)}.*.{pattern}"):
                shutil.rmtree(left, ignore_errors=True)

    def recorder(self, scenery: Scenery, live: bool, subject: dict[str, str]) -> Recorder:
        """Writes `run.rrd`; `subject` says what is recorded, e.g. `{"scenario": ...}`."""
        from robocar.recording import RerunRecorder  # takes most of a second to import

        properties = {**subject, **self.spec.parts, "seed": self.spec.seed}
        run_id = self.spec.recording_id
        return RerunRecorder(self.path / "run.rrd", run_id=run_id, scenery=scenery, live=live, properties=properties)

    def file(self, result: RunResult, grid: OccupancyGrid | None) -> RunResult:
        """Writes a finished run, with the map that it drew, and gives the directory its name; the result that knows where it is.

        Raises:
            OSError: another process has finished the same run meanwhile, and nobody asked to replace it.
        """
        for name, trajectory in (("truth", result.truth), ("estimate", result.estimate), ("odometry", result.odometry)):
            write_tum(self.path / f"{name}.tum", trajectory.times, trajectory.poses)
        if grid is not None:
            save_ros_map(decided(grid), self.path / "map")
        if result.traceback:
            (self.path / "error.txt").write_text(result.traceback)
        (self.path / "metrics.json").write_text(json.dumps(result.summary(), indent=1) + "\n")
        return replace(result, directory=self._complete())

    def _complete(self) -> Path:
        if self._force and self.final.exists():
            old = self.final.with_name(f".{self.name}.{os.getpid()}.replaced")
            os.rename(self.final, old)
            os.rename(self.path, self.final)
            shutil.rmtree(old)
        else:
            os.rename(self.path, self.final)
        return self.final


def _config(spec: RunSpec) -> dict[str, object]:
    """What `config.yaml` holds: enough to run it again."""
    return {
        "scenario": spec.scenario.model_dump(mode="json"),
        "folder": str(spec.scenario.folder),  # where the scenario's files are looked for
        **spec.parts,
        "seed": spec.seed,
        "settings": json.loads(json.dumps(dict(spec.settings), default=str)),  # whatever Python was handed, YAML can hold
        "digest": spec.digest,
        "versions": versions(),
        "fingerprint": fingerprint(),
    }
