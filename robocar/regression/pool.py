"""Where jobs run: processes of this machine, or a Dask cluster; behind one small interface of futures."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import tempfile
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from robocar.core import RobocarError
from robocar.regression.worker import Job, Outcome, execute, pack, read_log, warm_up

CONNECT_TIMEOUT = 3.0
"""How long a scheduler may take to answer [s]."""


class Workers(Protocol):
    """Runs jobs elsewhere. A future's result is an `Outcome`, whatever happens to the job and to the worker."""

    @property
    def count(self) -> int:
        """How many jobs run at once."""
        ...

    def submit(self, job: Job) -> Future[Outcome]: ...

    def close(self) -> None:
        """Stops at once; jobs that are not finished are lost."""
        ...


class LocalWorkers:
    """Processes of this machine: each job has its limit, and a process that dies costs its own job only.

    Args:
        count: of processes; by default one per core.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count or usable_cores()
        self._pool = _process_pool(self.count)

    def submit(self, job: Job) -> Future[Outcome]:
        outcome: Future[Outcome] = Future()

        def finish(done: Future[Outcome]) -> None:
            outcome.set_result(_outcome(done, job))

        self._pool.schedule(execute, args=[job], timeout=job.limit).add_done_callback(finish)
        return outcome

    def close(self) -> None:
        self._pool.stop()
        self._pool.join()


class DaskWorkers:
    """The workers of a Dask scheduler. Their runs travel back as files: no folder need be shared.

    Each worker lets a process of its own do the work, as `LocalWorkers` does, so that a run that hangs or dies takes nothing
    else with it.

    Args:
        address: `tcp://HOST:PORT`.

    Raises:
        RobocarError: nobody answers there, nobody has joined, or the extra `cluster` is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            raise RobocarError("--scheduler needs Dask: pip install 'robocar[cluster]'") from error
        try:
            # Keeps Dask's own heartbeat and connection warnings away from the terminal.
            self._client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, ValueError, FutureTimeoutError) as error:
            raise RobocarError(f"{address}: no Dask scheduler answers within {CONNECT_TIMEOUT:g} s ({_short(error)})") from error
        threads: Any = self._client.nthreads()
        self.count = sum(threads.values())
        if self.count == 0:
            self._client.close()
            raise RobocarError(f"{address}: no worker has joined this scheduler; start one with: dask worker {address}")
        self._executor: Any = self._client.get_executor(pure=False)

    def submit(self, job: Job) -> Future[Outcome]:
        outcome: Future[Outcome] = Future()

        def finish(done: Future[Outcome]) -> None:
            try:
                outcome.set_result(done.result())
            except (Exception, CancelledError) as error:  # KilledWorker: the worker that should have told us is gone
                outcome.set_result(Outcome("died", f"the Dask worker was lost: {_short(error)}"))

        self._executor.submit(_on_cluster, job).add_done_callback(finish)
        return outcome

    def close(self) -> None:
        with suppress(Exception):  # a scheduler that is gone needs no farewell
            self._executor.shutdown(wait=False, cancel_futures=True)
        with suppress(Exception):
            self._client.close(timeout=CONNECT_TIMEOUT)


@contextmanager
def workers(jobs: int | None = None, scheduler: str | None = None) -> Iterator[Workers]:
    """The workers that the command line asks for, stopped at the end.

    Raises:
        RobocarError: see `DaskWorkers`.
    """
    found: Workers = LocalWorkers(jobs) if scheduler is None else DaskWorkers(scheduler)
    try:
        yield found
    finally:
        found.close()


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _process_pool(count: int) -> Any:
    from pebble import ProcessPool

    # Fresh processes: a forked one would inherit the renderer's and the recorder's threads in an undefined state.
    return ProcessPool(max_workers=count, initializer=warm_up, context=multiprocessing.get_context("spawn"))


def _outcome(done: Future[Outcome], job: Job) -> Outcome:
    from pebble import ProcessExpired

    try:
        return done.result()
    except FutureTimeoutError:
        return Outcome("hung", f"stopped after {job.limit:g} s of wall time", read_log(job))
    except ProcessExpired as error:
        return Outcome("died", f"its process died ({_exit(error.exitcode)})", read_log(job))
    except CancelledError:
        return Outcome("died", "stopped")
    except Exception as error:  # a result that cannot be sent, say
        return Outcome("raised", _short(error), read_log(job))


def _exit(code: int | None) -> str:
    if code is None:
        return "for an unknown reason"
    return f"signal {-code}: killed, or out of memory" if code == -9 else f"signal {-code}" if code < 0 else f"status {code}"


def _short(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


_pool: Any = None


def _on_cluster(job: Job) -> Outcome:
    """In a Dask worker: runs the job in a process of its own and returns its files."""
    from distributed import get_worker

    global _pool
    if _pool is None:
        _allow_children()
        _pool = _process_pool(get_worker().state.nthreads)
    folder = Path(tempfile.mkdtemp(prefix="robocar-"))
    try:
        local = replace(job, out=folder)
        outcome = _outcome(_pool.schedule(execute, args=[local], timeout=job.limit), local)
        return replace(outcome, files=pack(folder / job.name)) if outcome.kind == "done" else outcome
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _allow_children() -> None:
    """Dask's nanny starts its workers as daemons, which multiprocessing forbids to have children; pebble ends ours with us."""
    multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
