"""What a terminal shows: messages, tables, progress."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from robocar.core.text import one_line, printable

if TYPE_CHECKING:
    from robocar.episode.result import RunResult

_CONSOLE = Console(stderr=True, highlight=False, soft_wrap=True)


def say(what: str | Table) -> None:
    """To the person at the terminal: stderr, so that stdout stays free for data."""
    _CONSOLE.print(printable(what), markup=False) if isinstance(what, str) else _CONSOLE.print(what)


def show(table: Table, data_follows: bool) -> None:
    """A wide table: on stdout, unless that is kept for data. In a pipe it is as wide as it needs to be."""
    console = Console(stderr=data_follows, highlight=False)
    if not console.is_terminal:
        console = Console(stderr=data_follows, highlight=False, width=240)
    console.print(table)


@contextmanager
def progress_bar() -> Iterator:
    """A bar of simulated time on a terminal, with what is left of the limit in wall time; nothing in a pipe."""
    if not _CONSOLE.is_terminal:
        yield None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[info]}"),
        TimeElapsedColumn(),
        TextColumn("at most"),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
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
    table = Table(title=Text(one_line(title)), title_justify="left", show_header=False, box=None, padding=(0, 1))
    table.add_column(justify="left")
    table.add_column(justify="right")
    table.add_column(justify="left")
    for name, metric in result.metrics.items():
        value, unit = metric["value"], metric["unit"]
        text = "-" if value is None else f"{value:d}" if isinstance(value, int) else f"{value:.4g}"
        table.add_row(*(Text(one_line(cell)) for cell in (name, text, "" if unit == "1" else str(unit))))
    return table
