"""What a worker process does with one job, and what it says of it."""

from __future__ import annotations

import errno
import faulthandler
import os
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from robocar.core import OutputError
from robocar.core.text import describe
from robocar.episode.run_directory import RunDirectory

ROOM = 1 << 20
"""A disk with less room is full [B]."""
LOGS = ".logs"
"""Folder of what workers print, one file per run that is not done yet."""


@dataclass(frozen=True, slots=True)
class Job:
    """One run.

    Args:
        name: of its run directory, which is made in the folder `out`.
        arguments: of `robocar.run`, without `out`, `record` and `force`.
        limit: wall time after which the worker is killed [s].
    """

    name: str
    arguments: Mapping[str, Any]
    out: Path
    record: bool = False
    limit: float = 600.0

    @property
    def log(self) -> Path:
        return self.out / LOGS / f"{self.name}.log"


@dataclass(frozen=True, slots=True)
class JobOutcome:
    """What became of a job.

    Args:
        kind: `done`: its run directory is complete, however the run itself ended; `raised`, `died`, `hung`: there is none;
            `full`: the disk is, so there can be none.
        reason: one line; log: what the worker printed, with its stacks.
        files: of the run directory, by name, where it lies on a disk that only the worker sees.
    """

    kind: Literal["done", "raised", "died", "hung", "full"]
    reason: str = ""
    log: str = ""
    files: Mapping[str, bytes] | None = None


def execute(job: Job) -> JobOutcome:
    """Runs the job in this process; whatever the run raises is in the outcome."""
    with _log(job):
        try:
            from robocar.episode.run import run

            run(**job.arguments, out=job.out, record=job.record, force=True)
        except BaseException as error:  # whatever it is derived from: what escapes here, nobody waits for
            traceback.print_exc()
            kind = "full" if _is_full(job.out, error) else "raised"
            return JobOutcome(kind, describe(error), traceback.format_exc())
    return JobOutcome("done")


def warm_up() -> None:
    """The imports that every run needs, before the first one is timed or limited."""
    import robocar.episode.run  # noqa: F401


def _is_full(folder: Path, error: BaseException) -> bool:
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        cause = cause.__cause__
    return isinstance(error, OutputError) and room(folder) < ROOM


def room(folder: Path) -> int:
    """Free bytes of the disk that a folder is on."""
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize


@contextmanager
def _log(job: Job) -> Iterator[None]:
    """All that is printed goes to the job's log, also by libraries; where a run hangs or crashes, its stack is in there."""
    try:
        job.log.parent.mkdir(parents=True, exist_ok=True)
        file = job.log.open("w")
    except OSError:  # a full disk: the run itself will say so
        yield
        return
    with file:
        saved = [os.dup(number) for number in (1, 2)]
        for number in (1, 2):
            os.dup2(file.fileno(), number)
        faulthandler.enable(file)
        faulthandler.dump_traceback_later(max(0.8 * job.limit, job.limit - 1.0), file=file)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
            faulthandler.disable()
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError, AttributeError):
                    stream.flush()
            for number, copy in zip((1, 2), saved, strict=True):
                os.dup2(copy, number)
                os.close(copy)


def read_log(job: Job) -> str:
    """What the worker has printed, at most the last 100 kB."""
    try:
        return job.log.read_bytes()[-100_000:].decode(errors="replace")
    except OSError:
        return ""


def clear(job: Job) -> None:
    """Removes what a job leaves beside its run directory: its log, and half-written directories of killed workers."""
    job.log.unlink(missing_ok=True)
    RunDirectory.clear(job.out, job.name)


def pack(folder: Path) -> dict[str, bytes]:
    """The files of a run directory."""
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir()) if file.is_file()}
