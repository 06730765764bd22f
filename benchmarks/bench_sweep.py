"""Sweeps: runs a minute with one worker and two, on this machine and through Dask; and 200 runs with a worker killed every ten.

python -m robocar.benchmarks.bench_sweep [speed|kills]
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robocar.regression.results import is_complete, read_results
from robocar.regression.suite import Suite, load_suite
from robocar.regression.sweep import sweep

RUNS, KILLED_RUNS, EVERY = 48, 200, 10


def suite_of(count: int, time_limit: float) -> Suite:
    """Equal runs but for their seeds."""
    block = {"scenarios": ["u-trap"], "navigators": ["a-star"], "estimators": ["truth"], "seeds": list(range(count))}
    return load_suite({"name": "bench", "settings": {"time_limit": time_limit}, "runs": [block]})


@contextmanager
def cluster(workers: int) -> Iterator[str]:
    """A Dask scheduler and its workers on this machine, joined by TCP."""
    from distributed import Client

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address, program = f"tcp://127.0.0.1:{port}", [sys.executable, "-m", "dask"]
    words = [["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]]
    words += [["worker", address, "--nthreads", "1", "--no-dashboard"]] * workers
    quiet = subprocess.DEVNULL
    started = [subprocess.Popen([*program, *w], stdout=quiet, stderr=quiet) for w in words]
    try:
        with Client(address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)  # type: ignore[unused-coroutine]
        yield address
    finally:
        for process in reversed(started):
            process.terminate()
        for process in started:
            process.wait()


def steady_rate(suite: Suite, out: Path, **where: object) -> float:
    """Runs a minute once every worker has done its first: what a long sweep has."""
    stamps: list[float] = []
    sweep(suite, out, progress=lambda *_: stamps.append(time.perf_counter()), **where)  # type: ignore[arg-type]
    first = 4  # every worker is warm by then
    return 60.0 * (len(stamps) - 1 - first) / (stamps[-1] - stamps[first])


def speed(folder: Path) -> None:
    suite = suite_of(RUNS, 20.0)
    rates = {f"processes, {n}": steady_rate(suite, folder / f"p{n}", jobs=n) for n in (1, 2)}
    for n in (1, 2):
        with cluster(n) as address:
            rates[f"Dask, {n}"] = steady_rate(suite, folder / f"d{n}", scheduler=address)
    alone = rates["processes, 1"]
    print("| workers | runs a minute | against one process |\n|---|---|---|")
    for name, rate in rates.items():
        print(f"| {name} | {rate:.0f} | {rate / alone:.2f} |")
    walls = [row.metrics["wall_time"] or 0.0 for row in read_results(folder / "p1").rows]
    print(f"\nBeside its loop a run takes {60.0 / alone - sum(walls) / len(walls):.2f} s (world, files, hand-over); one process.")


def kills(folder: Path) -> None:
    suite, killed = suite_of(KILLED_RUNS, 0.5), 0

    def kill(done: int, total: int, failed: int) -> None:
        nonlocal killed
        if done and done % EVERY == 0 and done < total:
            victim = multiprocessing.active_children()[0].pid
            assert victim is not None
            os.kill(victim, signal.SIGKILL)
            killed += 1

    swept = sweep(suite, folder / "kills", jobs=2, progress=kill)
    found = read_results(folder / "kills")
    whole = sum(is_complete(folder / "kills" / case.name) for case in suite.cases)
    names = {row.name for row in found.rows}
    counts = f"{len(found.rows)} results, {len(names)} different, {whole} complete"
    print(f"\n{killed} workers killed over {KILLED_RUNS} runs: {counts}, {len(found.skipped)} damaged, {len(swept.lost)} lost.")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as home:
        chosen = sys.argv[1:] or ["speed", "kills"]
        for task in (speed, kills):
            if task.__name__ in chosen:
                task(Path(home))
