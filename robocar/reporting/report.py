"""Finds and runs the scripts in `experiments/`, and writes what they find out."""

from __future__ import annotations

import importlib
import importlib.util
import json
import multiprocessing
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robocar.core import OutputError, UnknownNameError
from robocar.episode.registry import did_you_mean
from robocar.reporting.terminal import sweep_bar

if TYPE_CHECKING:
    from robocar.episode.run import RunResult


def experiment_names() -> dict[str, Path]:
    """Name and file of every experiment (benchmarks, which begin with `bench_`, are none)."""
    spec = importlib.util.find_spec("robocar.experiments")
    if spec is None or not spec.submodule_search_locations:
        return {}
    folder = Path(next(iter(spec.submodule_search_locations)))
    return {f.stem: f for f in sorted(folder.glob("*.py")) if not f.stem.startswith(("_", "bench_"))}


def run_experiment(name: str, out: Path, quick: bool) -> None:
    """Run `experiments.<name>.main(folder, quick)`; the results go to `<out>/<name>/`.

    Raises:
        UnknownNameError: there is no such experiment.
    """
    known = experiment_names()
    if name not in known:
        raise UnknownNameError(f"unknown experiment {name!r}{did_you_mean(name, known)}; known: {', '.join(known)}")
    importlib.import_module(f"robocar.experiments.{name}").main(Path(out) / name, quick)


@dataclass(slots=True)
class Report:
    """What an experiment found: numbers for `summary.json`, tables and text for `report.md`."""

    folder: Path
    title: str
    numbers: dict[str, dict[str, Any]] = field(default_factory=dict)
    text: list[str] = field(default_factory=list)

    def number(self, name: str, value: float | int | None, unit: str, paper: float | None = None) -> None:
        """One result, beside the paper's where it has one."""
        self.numbers[name] = {"value": value, "unit": unit, "paper": paper}

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], caption: str = "") -> None:
        """A Markdown table."""
        lines = [caption, ""] if caption else []
        lines += ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
        lines += ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows]
        self.text.append("\n".join(lines))

    def say(self, paragraph: str) -> None:
        """A paragraph of the report."""
        self.text.append(paragraph)

    def write(self) -> Path:
        """Writes `summary.json` and `report.md`, and returns the latter."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / "summary.json").write_text(json.dumps(self.numbers, indent=1) + "\n")
            path = self.folder / "report.md"
            path.write_text(f"# {self.title}\n\n" + "\n\n".join(self.text) + "\n")
        except OSError as error:
            raise OutputError(f"{self.folder}: cannot write: {error.strerror or error}") from error
        return path


def _cell(value: object) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def run_many(jobs: Sequence[Mapping[str, Any]]) -> list[RunResult]:
    """`robocar.run(**job)` for each job, in processes of their own, one per core; results in the order of the jobs.

    On a terminal, a bar shows how far it is.
    """
    workers = min(len(jobs), os.cpu_count() or 1)
    results: list[RunResult] = []
    # Fresh processes: a forked one would inherit the renderer's and the recorder's threads in an undefined state.
    with sweep_bar() as update, ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for result in pool.map(_run_one, jobs):
            results.append(result)
            if update:
                update(len(results), len(jobs), 0)
    return results


def _run_one(job: Mapping[str, Any]) -> RunResult:
    from robocar.episode.run import run

    return run(**job)
