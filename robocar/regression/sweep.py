"""Runs a suite: every finished run is on disk at once, and a run that goes wrong costs itself only."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol

import yaml

from robocar.core import OutputError, ScenarioError
from robocar.episode.result import SCHEMA
from robocar.formats.files import write_atomically
from robocar.regression import results
from robocar.regression.pool import Workers, usable_cores, workers
from robocar.regression.suite import Case, Suite
from robocar.regression.worker import LOGS, ROOM, Job, JobOutcome, clear, room
from robocar.scenario.load import load_scenario
from robocar.scenario.settings import split_overrides

TRIES = 2
"""How often a run is begun whose worker dies, hangs or raises."""
SWEEP_FILE = "sweep.json"


class SweepProgress(Protocol):
    """Told at the start and after every run."""

    def __call__(self, done: int, total: int, failed: int) -> None: ...


@dataclass(frozen=True, slots=True)
class Swept:
    """What a sweep did.

    Args:
        folder: of the run directories.
        total: runs of the suite; before: those that were complete when it began; done: those that it finished.
        lost: names of the runs whose workers died, hung or raised at each try; they are reported as `error`.
    """

    folder: Path
    total: int
    before: int
    done: int
    lost: tuple[str, ...]


def sweep(
    suite: Suite,
    out: str | Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    progress: SweepProgress | None = None,
) -> Swept:
    """Run all cases that `out` has no complete run of.

    A run is done when its directory stands under its name; then only. One whose worker dies, exceeds the suite's limit or raises
    is tried once more and then filed as `error` with its log; resuming tries it again.

    Args:
        out: gets one run directory per case, `sweep.json` and `results.parquet`.
        jobs: processes on this machine, by default one per core; scheduler: `tcp://HOST:PORT` of a Dask cluster instead.
        resume: go on in a folder that holds runs already.
        progress: told at the start and after every run.

    Raises:
        OutputError: the folder holds runs and nobody asked to resume; another sweep is at work in it; the disk is full.
        ScenarioError: a run that is there was made from another version of its scenario.
        RobocarError: see `robocar.regression.pool.DaskWorkers`.
        KeyboardInterrupt: Ctrl-C; what is complete stays.
    """
    folder = Path(out)
    with _locked(folder):
        try:
            missing = {case.name: case for case in _missing(suite, folder, resume)}
            todo = [Job(case.name, case.arguments(), folder, suite.record, suite.limit) for case in missing.values()]
            total, before = len(suite.cases), len(suite.cases) - len(todo)
            for job in todo:
                clear(job)  # what a killed sweep left
            _describe(suite, folder)
            lost = _run(todo, missing, folder, jobs, scheduler, progress or _silent, total) if todo else []
            results.write_parquet(results.read_results(folder), folder / results.PARQUET)
        except OSError as error:
            done = sum(results.is_complete(folder / case.name) for case in suite.cases)
            why = f"{error.strerror or error}; {done} of {len(suite.cases)} runs are complete; --resume goes on with the others"
            raise OutputError(f"{folder}: {why}") from error
    return Swept(folder, total, before, len(todo), tuple(sorted(lost)))


def _run(
    todo: Sequence[Job],
    cases: Mapping[str, Case],
    folder: Path,
    jobs: int | None,
    scheduler: str | None,
    progress: SweepProgress,
    total: int,
) -> list[str]:
    """All jobs, of a suite of so many runs; returns the names of those that were lost."""
    lost: list[str] = []
    before = total - len(todo)
    count = None if jobs is None and scheduler else min(jobs or usable_cores(), len(todo))
    try:
        with workers(count, scheduler) as found:
            progress(before, total, 0)
            for done, (job, outcome) in enumerate(_finished(todo, found), start=before + 1):
                if outcome.kind != "done":
                    _file_loss(folder, cases[job.name], outcome)
                    lost.append(job.name)
                clear(job)
                progress(done, total, len(lost))
    finally:  # the workers have stopped: what they left half-done is nobody's
        for job in todo:
            clear(job)
        shutil.rmtree(folder / LOGS, ignore_errors=True)
    return lost


def _silent(done: int, total: int, failed: int) -> None:
    pass


def _finished(jobs: Sequence[Job], found: Workers) -> Iterator[tuple[Job, JobOutcome]]:
    """Jobs as they are finished, each once, with their last outcome; those that go wrong get a second try."""
    running: dict[Future[JobOutcome], tuple[Job, int]] = {}
    ready: SimpleQueue[Future[JobOutcome]] = SimpleQueue()

    def begin(job: Job, tries: int) -> None:
        future = found.submit(job)
        running[future] = (job, tries)
        future.add_done_callback(ready.put)

    for job in jobs:
        begin(job, 1)
    while running:
        future = ready.get()
        job, tries = running.pop(future)
        outcome = future.result()
        if outcome.kind == "done" and outcome.files is not None:
            _unpack(job, outcome.files)
        elif outcome.kind == "full":
            raise OSError(None, f"the disk is full ({room(job.out)} bytes free)")
        elif outcome.kind != "done" and results.is_complete(job.out / job.name):
            outcome = JobOutcome("done")  # it died on its way home, its run was on disk already
        elif outcome.kind != "done" and tries < TRIES:
            if room(job.out) < ROOM:
                raise OSError(None, f"the disk is full ({room(job.out)} bytes free)")
            begin(job, tries + 1)
            continue
        yield job, outcome


def _missing(suite: Suite, folder: Path, resume: bool) -> list[Case]:
    """The cases without a complete run, and room for them: what is damaged or was lost is removed."""
    there = [case for case in suite.cases if (folder / case.name).exists()]
    if not resume and any(folder.glob("*/metrics.json")):
        done = sum(results.is_complete(folder / case.name) for case in there)
        raise OutputError(f"{folder}: holds runs already, {done} of these {len(suite.cases)}; --resume goes on with the others")
    _refuse_stale(suite, folder)
    scenarios: dict[tuple[str, str], Any] = {}
    complete = set()
    for case in there:
        path = folder / case.name
        if not results.is_complete(path):
            shutil.rmtree(path)
            continue
        key = (case.scenario, json.dumps(dict(case.settings), sort_keys=True, default=str))
        if key not in scenarios:
            loaded = load_scenario(case.scenario, split_overrides(case.settings)[0])
            scenarios[key] = loaded.model_dump(mode="json")
        made_from = results.read_config(path).get("scenario")
        if made_from != scenarios[key]:
            raise ScenarioError(f"{path}: {_STALE}")
        complete.add(case.name)
    return [case for case in suite.cases if case.name not in complete]


_STALE = "was run when the scenario was another one; remove it, or sweep into another folder"


def _refuse_stale(suite: Suite, folder: Path) -> None:
    """Tables would take a run of a scenario as it was for one of the scenario as it is."""
    names, keys = {case.name for case in suite.cases}, {case.key for case in suite.cases}
    for path in sorted(folder.glob("*/metrics.json")):
        if path.parent.name not in names and results.is_complete(path.parent):
            row = results.read_run(path.parent)
            if (row.scenario, row.navigator, row.estimator, row.mapper, row.seed, row.settings) in keys:
                raise ScenarioError(f"{path.parent}: {_STALE}")


def _describe(suite: Suite, folder: Path) -> None:
    """What `compare` and `report` need to know of the suite, beside its runs."""
    content = {
        "schema": results.SCHEMA,
        "suite": suite.name,
        "description": suite.description,
        "exact": suite.exact,
        "tolerances": {metric: asdict(tolerance) for metric, tolerance in suite.tolerances.items()},
        "runs": [case.name for case in suite.cases],
    }
    write_atomically(folder / SWEEP_FILE, (json.dumps(content, indent=1) + "\n").encode())


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One sweep per folder at a time; the lock falls with the process that holds it, however it ends."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = os.open(folder / ".sweep.lock", os.O_CREAT | os.O_RDWR, 0o644)
    except OSError as error:
        raise OutputError(f"{folder}: cannot write here: {error.strerror or error}") from error
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise OutputError(f"{folder}: another sweep is at work here; wait for it, or take another folder") from error
        yield
    finally:
        os.close(file)


def _file_loss(folder: Path, case: Case, outcome: JobOutcome) -> None:
    """A run directory for a run that never came to its end: `error`, without hash and metrics, with the worker's log."""
    partial = folder / f".{case.name}.{os.getpid()}.partial"
    partial.mkdir()
    reason = f"{outcome.reason}, {TRIES} times"
    content = {
        "schema": SCHEMA,
        "scenario": case.scenario_name,
        "navigator": case.navigator,
        "estimator": case.estimator,
        "mapper": case.mapper,
        "seed": case.seed,
        "status": "error",
        "reason": reason,
        "hash": None,
        "fingerprint": None,
        "versions": {},
        "metrics": {},
    }
    (partial / "config.yaml").write_text(yaml.safe_dump({"settings": json.loads(json.dumps(dict(case.settings), default=str))}))
    (partial / "error.txt").write_text(f"{reason}\n\n{outcome.log}")
    (partial / "metrics.json").write_text(json.dumps(content, indent=1) + "\n")
    os.rename(partial, folder / case.name)


def _unpack(job: Job, files: Mapping[str, bytes]) -> None:
    """A run directory that came from elsewhere, complete or not at all."""
    partial = job.out / f".{job.name}.{os.getpid()}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    for name, content in files.items():
        (partial / Path(name).name).write_bytes(content)
    if (job.out / job.name).exists():
        shutil.rmtree(job.out / job.name)
    os.rename(partial, job.out / job.name)
