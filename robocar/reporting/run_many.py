"""Many runs at once, for experiments."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any

from robocar.regression.pool import set_deaf
from robocar.reporting.terminal import sweep_bar

if TYPE_CHECKING:
    from robocar.episode.result import RunResult


def run_many(jobs: Sequence[Mapping[str, Any]]) -> list[RunResult]:
    """`robocar.run(**job)` for each job, in processes of their own, one per core; results in the order of the jobs.

    On a terminal, a bar shows how far it is.
    """
    workers = min(len(jobs), os.cpu_count() or 1)
    results: list[RunResult] = []
    # Fresh processes: a forked one would inherit the renderer's and the recorder's threads in an undefined state.
    with sweep_bar() as update, ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            set_deaf()
            found = pool.map(_run_one, jobs)
            set_deaf(False)
            if update:
                update(0, len(jobs), 0)
            for result in found:
                results.append(result)
                if update:
                    update(len(results), len(jobs), 0)
        except KeyboardInterrupt:
            for process in multiprocessing.active_children():  # they do not hear it
                process.terminate()
            raise
    return results


def _run_one(job: Mapping[str, Any]) -> RunResult:
    from robocar.episode.run import run

    return run(**job)
