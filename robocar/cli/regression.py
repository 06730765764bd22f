"""The commands `sweep`, `results`, `compare` and `report`. Heavy imports wait until a command needs them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from robocar.cli.output import Flag, dumps, fail, put
from robocar.cli.run import find_modules_here


@dataclass(frozen=True)
class SweepArguments:
    """
    Args:
        suite: a name from models/suites or a file.
        jobs: how many runs at once on this machine; by default one per core.
        scheduler: tcp://HOST:PORT of a Dask scheduler whose workers do the runs.
        out: folder of the run directories; by default runs/<suite>.
        resume: go on with what is missing in a folder that holds runs already.
        navigator: run this one instead of the suite's, package.module:factory too; may be repeated.
        seed: run this one instead of the suite's; may be repeated.
        junit: also write JUnit XML.
        json: print the results on stdout.
        debug: show tracebacks.
    """

    suite: tyro.conf.Positional[str]
    jobs: int | None = None
    scheduler: str | None = None
    out: Path | None = None
    resume: Flag = False
    navigator: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    seed: tyro.conf.UseAppendAction[tuple[int, ...]] = ()
    junit: Path | None = None
    json: Flag = False
    debug: Flag = False


def sweep_suite(args: Annotated[SweepArguments, tyro.conf.arg(name="")]) -> int:
    """Run a suite: scenarios, navigators, estimators and seeds, on all cores or on a cluster."""
    from robocar.regression.suite import load_suite
    from robocar.regression.sweep import sweep
    from robocar.reporting.terminal import say, sweep_bar

    if args.jobs is not None and args.jobs < 1:
        fail(f"--jobs takes a positive integer, not {args.jobs}")
    find_modules_here(*args.navigator)
    loaded = load_suite(args.suite, navigators=args.navigator, seeds=args.seed)
    folder = args.out or Path("runs") / loaded.name
    try:
        with sweep_bar() as progress:
            swept = sweep(loaded, folder, jobs=args.jobs, scheduler=args.scheduler, resume=args.resume, progress=progress)
    except KeyboardInterrupt:
        say(f"interrupted; --resume goes on with what is not complete in {folder}")
        return 130
    results(folder, junit=args.junit, json=args.json)
    say(f"{swept.done} runs done, {swept.before} were there already, {len(swept.lost)} lost: {folder}")
    for name in swept.lost:
        say(f"lost: {folder / name / 'error.txt'}")
    return 1 if swept.lost else 0


def results(
    folder: tyro.conf.Positional[Path],
    /,
    by: Literal["navigator", "scenario", "estimator"] = "navigator",
    csv: Path | None = None,
    junit: Path | None = None,
    baseline: Path | None = None,
    json: Flag = False,
    debug: Flag = False,
) -> int:
    """Sum up the runs of a folder: success, SPL, time, length, clearance and errors per navigator.

    Args:
        folder: of run directories, or a Parquet file or a baseline.
        by: one line per navigator, or per scenario or estimator and navigator.
        csv: also write all runs and metrics as CSV.
        junit: also write JUnit XML.
        baseline: also write the runs as a baseline for `robocar compare`.
        json: print everything on stdout.
        debug: show tracebacks.
    """
    from robocar.regression import baseline as baselines
    from robocar.regression import tables
    from robocar.regression.results import write_csv
    from robocar.reporting.terminal import say, show

    found = baselines.read_any(folder)
    keys = ("navigator",) if by == "navigator" else (by, "navigator")
    show(tables.results_table(found, keys), data_follows=json)
    for skipped in found.skipped:
        say(f"skipped: {skipped}")
    if found.skipped:
        say(f"{len(found.skipped)} entries of {folder} are no runs")
    if csv is not None:
        write_csv(found, csv)
    if junit is not None:
        tables.write_junit(junit, str(found.sweep.get("suite", folder.name)), tables.junit_of_results(found))
    if baseline is not None:
        about = {key: found.sweep[key] for key in ("suite", "exact") if key in found.sweep}
        say(f"baseline of {len(found.rows)} runs: {baselines.write_baseline(found.rows, found.units, baseline, about)}")
    if json:
        put(dumps(tables.results_json(found, keys)))
    return 0


@dataclass(frozen=True)
class CompareArguments:
    """
    Args:
        base: earlier runs: a folder, a Parquet file, a baseline, or one run directory.
        new: the runs to judge, of the same kinds.
        exact: a run that no longer repeats its hash counts as worse; by default what the suite says.
        subset: runs that are only in the base do not count as worse.
        out: of two single runs: the recording of both.
        junit: also write JUnit XML.
        json: print the comparison on stdout.
        debug: show tracebacks.
    """

    base: tyro.conf.Positional[Path]
    new: tyro.conf.Positional[Path]
    exact: Flag = False
    subset: Flag = False
    out: Path = Path("divergence.rrd")
    junit: Path | None = None
    json: Flag = False
    debug: Flag = False


def compare_runs(args: Annotated[CompareArguments, tyro.conf.arg(name="")]) -> int:
    """Compare runs with earlier ones; the exit status is 1 when something got worse. Of two single runs: where they part."""
    from robocar.regression import tables
    from robocar.regression.baseline import read_any
    from robocar.regression.compare import compare
    from robocar.reporting.terminal import say

    base, new = args.base, args.new
    if (base / "metrics.json").is_file() and (new / "metrics.json").is_file():
        from robocar.regression.divergence import describe, find_divergence
        from robocar.regression.divergence import to_json as divergence_json

        divergence = find_divergence(base, new, args.out)
        say(describe(divergence))
        if args.json:
            put(dumps(divergence_json(divergence)))
        return 0 if divergence.first is None else 1
    old, now = read_any(base), read_any(new)
    for side in (old, now):
        for skipped in side.skipped:
            say(f"skipped: {side.source / skipped}")
    found = compare(old, now, exact=True if args.exact else None, subset=args.subset)
    say(tables.comparison_text(found))
    if args.junit is not None:
        tables.write_junit(args.junit, f"{base} and {new}", tables.junit_of_comparison(found))
    if args.json:
        put(dumps(tables.comparison_json(found)))
    return 1 if found.failures else 0


def report(folder: tyro.conf.Positional[Path], /, out: Path | None = None, debug: Flag = False) -> int:
    """Write one HTML page on the runs of a folder: tables, box plots, success matrix, trajectories; readable without a network.

    Args:
        folder: of run directories.
        out: the page; by default <folder>/report.html.
        debug: show tracebacks.
    """
    from robocar.regression.report import write_report

    put(str(write_report(folder, out)))
    return 0


COMMANDS: dict[str, Callable[..., int]] = {
    "sweep": sweep_suite,
    "results": results,
    "compare": compare_runs,
    "report": report,
}
