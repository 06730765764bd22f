"""What the command line shows: progress, tables, lists, the viewer."""

from __future__ import annotations

import ast
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from robocar.core import OutputError, RobocarError

if TYPE_CHECKING:
    from robocar.episode.run import RunResult

_CONSOLE = Console(stderr=True, highlight=False, soft_wrap=True)


def say(what: str | Table) -> None:
    """To the person at the terminal: stderr, so that stdout stays free for data."""
    _CONSOLE.print(what, markup=False) if isinstance(what, str) else _CONSOLE.print(what)


def show(table: Table, data_follows: bool) -> None:
    """A wide table: on stdout, unless that is kept for data. In a pipe it is as wide as it needs to be."""
    console = Console(stderr=data_follows, highlight=False)
    if not console.is_terminal:
        console = Console(stderr=data_follows, highlight=False, width=240)
    console.print(table)


@contextmanager
def progress_bar() -> Iterator:
    """A bar of simulated time on a terminal; nothing in a pipe."""
    if not _CONSOLE.is_terminal:
        yield None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[info]}"), TimeElapsedColumn())
    with Progress(*columns, console=_CONSOLE, transient=True) as bar:
        task = bar.add_task("simulating", total=None, info="")
        shown = -1.0

        def update(time: float, time_limit: float) -> None:
            nonlocal shown
            if time - shown >= 0.5:
                shown = time
                bar.update(task, completed=time, total=time_limit, info=f"{time:.0f} s of at most {time_limit:g} s")

        yield update


@contextmanager
def sweep_bar() -> Iterator:
    """A bar of finished runs on a terminal, with their rate and what is left; nothing in a pipe."""
    if not _CONSOLE.is_terminal:
        yield None
        return
    columns = (
        TextColumn("{task.completed:.0f}/{task.total:.0f} runs"),
        BarColumn(),
        TextColumn("{task.fields[info]}"),
        TimeRemainingColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=_CONSOLE, transient=True) as bar:
        task, started, first = bar.add_task("runs", total=1, info=""), time.monotonic(), None

        def update(done: int, total: int, failed: int) -> None:
            nonlocal first
            first = done if first is None else first
            rate = 60.0 * (done - first) / max(time.monotonic() - started, 1e-3)
            bar.update(task, completed=done, total=total, info=f"{rate:.0f} a minute" + (f", {failed} lost" if failed else ""))

        yield update


def metrics_table(result: RunResult) -> Table:
    """All metrics of a run."""
    title = f"{result.scenario}: {result.navigator}, {result.estimator}, {result.mapper}, seed {result.seed}"
    table = Table(title=title, title_justify="left", show_header=False, box=None, padding=(0, 1))
    table.add_column(justify="left")
    table.add_column(justify="right")
    table.add_column(justify="left")
    for name, metric in result.metrics.items():
        value, unit = metric["value"], metric["unit"]
        text = "-" if value is None else f"{value:d}" if isinstance(value, int) else f"{value:.4g}"
        table.add_row(name, text, "" if unit == "1" else unit)
    return table


def listing(what: str) -> dict[str, str]:
    """Names and one-line summaries."""
    from robocar.episode import registry
    from robocar.reporting.report import experiment_names
    from robocar.scenario.model import find_scenario, load_scenario, scenario_names

    if what == "scenarios":
        return {name: load_scenario(find_scenario(name)).description for name in scenario_names()}
    if what == "experiments":
        return {name: first_line(path) for name, path in experiment_names().items()}
    if what == "suites":
        from robocar.regression.suite import find_suite, load_suite, suite_names

        return {name: load_suite(find_suite(name)).description for name in suite_names()}
    entries = registry.names(what[:-1])  # type: ignore[arg-type]
    return {name: entry.summary + (f" ({entry.paper})" if entry.paper else "") for name, entry in sorted(entries.items())}


def first_line(module: Path) -> str:
    """First line of a module's docstring, without importing it."""
    return (ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or "").partition("\n")[0]


def view(run: Path, web: bool) -> int:
    """Open a run's recording in the Rerun viewer."""
    recording = run / "run.rrd" if run.is_dir() else run
    if not recording.is_file():
        raise OutputError(f"{run}: there is no recording here")
    command = [sys.executable, "-m", "rerun", str(recording)] + (["--web-viewer"] if web else [])
    try:
        return subprocess.run(command, check=False).returncode
    except OSError as error:
        raise RobocarError(f"cannot start the Rerun viewer: {error}") from error
