"""Where jobs run: processes of this machine, or a Dask cluster; behind one small interface of futures."""

from __future__ import annotations

import multiprocessing
import os
import re
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future, wait
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing import resource_tracker
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from robocar.core import RobocarError
from robocar.regression.worker import Job, JobOutcome, execute, pack, read_log, warm_up

CONNECT_TIMEOUT = 3.0
"""How long a scheduler may take to answer [s]."""


_ADDRESS = re.compile(r"(tcp|tls|ws|wss)://(\[[0-9a-fA-F:.%]+\]|[^\s:/\[\]]+):[0-9]{1,5}")
MOST_STARTS = 5
"""How often a process that is killed before it has begun with a job is replaced."""


class Workers(Protocol):
    """Runs jobs elsewhere. A future's result is a `JobOutcome`, whatever happens to the job and to the worker."""

    @property
    def count(self) -> int:
        """How many jobs run at once."""
        ...

    def submit(self, job: Job) -> Future[JobOutcome]: ...

    def close(self) -> None:
        """Stops at once; jobs that are not finished are lost."""
        ...


class _Slot:
    """One process that does one job after the other, and a new one when it has died.

    A pool of one, and not one pool for all: pebble gives a whole pool up when a process of it is killed between two jobs.
    """

    def __init__(self) -> None:
        self._pool: Any = None
        self._pid = 0  # of its process
        self._closed = False

    def run(self, job: Job) -> JobOutcome:
        """Does the job and waits for it."""
        for _ in range(MOST_STARTS):
            if self._closed:
                break
            try:
                pool = self._started()
                done = pool.schedule(execute, args=[job], timeout=job.limit)
                if not self._finished(pool, done):
                    if not pool.active:
                        raise BrokenProcessPool
                    self._drop()
                    return JobOutcome("died", "its process ended in the middle of the run (status 0)", read_log(job))
                outcome = _outcome(done, job)
            except (BrokenProcessPool, RuntimeError):  # killed before it had begun: the job is not to blame
                self._drop()
                continue
            if not pool.active:
                self._drop()
            return outcome
        return JobOutcome("died", "stopped" if self._closed else "its process was killed before the run began")

    def _started(self) -> Any:
        """The pool, with a process that lives.

        Raises:
            BrokenProcessPool: it does not begin.
        """
        if self._pool is not None and not _lives(self._pid):
            self._drop()
        if self._pool is None:
            pool = self._pool = _process_pool()
            self._pid = 0
            first = pool.schedule(os.getpid)
            try:
                self._pid = first.result() if self._finished(pool, first) else 0
            except Exception as error:
                raise BrokenProcessPool from error
            if not self._pid:
                raise BrokenProcessPool
        return self._pool

    def _finished(self, pool: Any, future: Future[Any]) -> bool:
        """Waits for it; False where its process has ended without a word: pebble waits on where the status is 0."""
        while pool.active and not wait([future], timeout=0.5).done:
            if self._pid and not _lives(self._pid):
                return bool(wait([future], timeout=1.0).done)
        return future.done()

    def close(self) -> None:
        """Stops at once, from another thread too."""
        self._closed = True
        self._drop()

    def _drop(self) -> None:
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.stop()
            pool.join()


class LocalWorkers:
    """Processes of this machine: each job has its limit, and a process that dies costs its own job only.

    Args:
        count: of processes; by default one per core.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count or usable_cores()
        self._jobs: SimpleQueue[tuple[Job, Future[JobOutcome]] | None] = SimpleQueue()
        self._slots = [_Slot() for _ in range(self.count)]
        self._threads = [threading.Thread(target=self._serve, args=[slot], daemon=True) for slot in self._slots]
        for thread in self._threads:
            thread.start()

    def submit(self, job: Job) -> Future[JobOutcome]:
        outcome: Future[JobOutcome] = Future()
        self._jobs.put((job, outcome))
        return outcome

    def _serve(self, slot: _Slot) -> None:
        set_deaf()
        while (item := self._jobs.get()) is not None:
            job, outcome = item
            try:
                outcome.set_result(slot.run(job))
            except BaseException as error:  # nobody may wait for ever
                outcome.set_result(JobOutcome("raised", _short(error)))

    def close(self) -> None:
        while True:  # what nobody has begun
            try:
                self._jobs.get_nowait()
            except Empty:
                break
        for _ in self._threads:
            self._jobs.put(None)
        for slot in self._slots:
            slot.close()
        for thread in self._threads:
            thread.join(timeout=30.0)


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
        if not _ADDRESS.fullmatch(address):
            raise RobocarError(f"--scheduler: expected the address of a Dask scheduler, tcp://HOST:PORT, not {address!r}")
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

    def submit(self, job: Job) -> Future[JobOutcome]:
        outcome: Future[JobOutcome] = Future()

        def finish(done: Future[JobOutcome]) -> None:
            try:
                outcome.set_result(done.result())
            except (Exception, CancelledError) as error:  # KilledWorker: the worker that should have told us is gone
                outcome.set_result(JobOutcome("died", f"the Dask worker was lost: {_short(error)}"))

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


def set_deaf(deaf: bool = True) -> None:
    """Ctrl-C reaches every process of a terminal. What is started from this thread from now on inherits that it does not hear it,
    from its first instruction on: the process that starts it hears it, and ends it."""
    if hasattr(signal, "pthread_sigmask"):  # Windows has none
        resource_tracker.ensure_running()  # which would let this thread hear again, when the first process is started
        signal.pthread_sigmask(signal.SIG_BLOCK if deaf else signal.SIG_UNBLOCK, {signal.SIGINT})


def _process_pool() -> Any:
    from pebble import ProcessPool

    # Fresh processes: a forked one would inherit the renderer's and the recorder's threads in an undefined state.
    return ProcessPool(max_workers=1, initializer=warm_up, context=multiprocessing.get_context("spawn"))


def _lives(pid: int) -> bool:
    """Whether this process of ours has not ended yet."""
    return any(child.pid == pid for child in multiprocessing.active_children())


def _outcome(done: Future[JobOutcome], job: Job) -> JobOutcome:
    from pebble import ProcessExpired

    try:
        return done.result()
    except FutureTimeoutError:
        return JobOutcome("hung", f"stopped after {job.limit:g} s of wall time", read_log(job))
    except ProcessExpired as error:
        return JobOutcome("died", f"its process died ({_exit(error.exitcode)})", read_log(job))
    except CancelledError:
        return JobOutcome("died", "stopped")
    except BrokenProcessPool:
        raise
    except Exception as error:  # a result that cannot be sent, say
        return JobOutcome("raised", _short(error), read_log(job))


def _exit(code: int | None) -> str:
    if code is None:
        return "for an unknown reason"
    return f"signal {-code}: killed, or out of memory" if code == -9 else f"signal {-code}" if code < 0 else f"status {code}"


def _short(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


_mine = threading.local()
"""The process of each thread of a Dask worker."""


def _on_cluster(job: Job) -> JobOutcome:
    """In a Dask worker: runs the job in a process of its own and returns its files."""
    if not hasattr(_mine, "slot"):
        _allow_children()
        _mine.slot = _Slot()
    folder = Path(tempfile.mkdtemp(prefix="robocar-"))
    try:
        outcome = _mine.slot.run(replace(job, out=folder))
        return replace(outcome, files=pack(folder / job.name)) if outcome.kind == "done" else outcome
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _allow_children() -> None:
    """Dask's nanny starts its workers as daemons, which multiprocessing forbids to have children; pebble ends ours with us."""
    multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
