"""Where a recording goes: the file, and a viewer beside it."""

from __future__ import annotations

import logging
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings

from robocar.core import OutputError

_UNWRITTEN: list[rr.RecordingStream] = []
"""Recordings whose writer failed: held for ever, since Rerun would wait for that writer when it drops them."""

FLUSH_TIMEOUT = 60.0  # [s] of real time; only a writer that died takes so long
ROOM = 1 << 20  # a disk with less room is full [B]
_FOOTER = b"RRF2FOOT"


def _recording(run_id: str) -> rr.RecordingStream:
    # Chunks end where the recorder flushes, not where Rerun's clock says.
    return rr.RecordingStream("robocar", recording_id=run_id, send_properties=False, batcher_config=rr.ChunkBatcherConfig.NEVER())


class _OwnedBlueprint:
    """A blueprint that knows the stream that Rerun makes for it.

    A stream in memory holds itself (Rerun 0.41), so the one behind `default_blueprint` has to be closed: else it stays, with its
    two threads, for as long as the process.
    """

    def __init__(self, views: rrb.Blueprint) -> None:
        self._views = views
        self._stream: rr.RecordingStream | None = None

    def to_blueprint(self) -> _OwnedBlueprint:
        return self

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._views._log_to_stream(stream)

    def close(self) -> None:
        if self._stream is not None:
            self._stream.disconnect()
            self._stream = None


@contextmanager
def _owned(views: rrb.Blueprint) -> Iterator[Any]:
    blueprint = _OwnedBlueprint(views)
    try:
        yield blueprint
    finally:
        blueprint.close()


def _viewer_path() -> str | None:
    """The viewer beside this Python, so that an environment need not be activated; None: wherever PATH has it."""
    path = Path(sys.executable).with_name("rerun")
    return str(path) if path.is_file() else None


class Streams:
    """Sends everything to the file and, if there is one, to the viewer. The file must not fail, the viewer may.

    Args:
        path: of the file.
        run_id: of the recording.
        views: the blueprint.
        live: open a viewer; a text is the address of one that runs already, e.g. `rerun+http://127.0.0.1:9876/proxy`.

    Raises:
        OutputError: the file cannot be opened.
    """

    def __init__(self, path: Path, run_id: str, views: rrb.Blueprint, live: bool | str) -> None:
        self._path = path
        self._file = _recording(run_id)
        self._viewer: rr.RecordingStream | None = None
        try:
            # Rerun waits for ever for a writer that failed at the first byte.
            if self._free_bytes() < ROOM:
                raise OutputError(self._failure("cannot write the recording"))
            with _owned(views) as blueprint:
                self._file.save(path, default_blueprint=blueprint)
        except (RuntimeError, OSError) as error:
            raise OutputError(f"{path}: cannot write the recording: {error}") from error
        self._file.set_log_time_enabled(False)
        if live:
            self._open_viewer(run_id, views, live)

    def _open_viewer(self, run_id: str, views: rrb.Blueprint, live: bool | str) -> None:
        viewer = self._viewer = _recording(run_id)
        viewer.set_log_time_enabled(False)

        def connect() -> None:
            with _owned(views) as blueprint:
                if live is True:
                    path = _viewer_path()
                    rr.spawn(hide_welcome_screen=True, default_blueprint=blueprint, recording=viewer, executable_path=path)
                else:
                    viewer.connect_grpc(str(live), default_blueprint=blueprint)

        self._to_viewer(connect)

    def log(self, entity: str, *parts: Any, static: bool = True) -> None:
        """Static data; what changes goes through `send_columns`."""
        self._file.log(entity, *parts, static=static, strict=True)
        if (viewer := self._viewer) is not None:
            self._to_viewer(lambda: viewer.log(entity, *parts, static=static))

    def send_columns(self, entity: str, indexes: Iterable[Any], columns: Iterable[Any]) -> None:
        """Rows of an entity."""
        indexes, columns = list(indexes), list(columns)
        self._file.send_columns(entity, indexes, columns, strict=True)
        if (viewer := self._viewer) is not None:
            self._to_viewer(lambda: viewer.send_columns(entity, indexes, columns))

    def send_property(self, name: str, values: Any) -> None:
        """One row for the whole run."""
        self._file.send_property(name, values)

    def flush(self) -> None:
        """Wait until everything is written.

        Raises:
            OutputError: it cannot be written; the streams are closed then.
        """
        if (viewer := self._viewer) is not None:
            self._to_viewer(lambda: viewer.flush(timeout_sec=FLUSH_TIMEOUT))
        if self._free_bytes() < ROOM:
            self._give_up()
            raise OutputError(self._failure())
        try:
            self._file.flush(timeout_sec=FLUSH_TIMEOUT)
        except RuntimeError as error:
            self._give_up()
            raise OutputError(self._failure()) from error

    def _give_up(self) -> None:
        """Closes the file as far as that goes: Rerun waits for ever for a writer that has failed, and only then."""
        _UNWRITTEN.append(self._file)
        closing = threading.Thread(target=self._file.disconnect, daemon=True)
        closing.start()
        closing.join(timeout=5.0)

    def close(self) -> None:
        """Finish the file.

        Raises:
            OutputError: it is not complete.
        """
        if self._viewer is not None:
            self._viewer.disconnect()
            self._viewer = None
        self._file.disconnect()
        # Rerun keeps every recording, with its two threads, until it is told to drop those that nobody holds any more.
        del self._file
        with suppress(RuntimeError):  # a viewer that never answered
            rerun_bindings.flush_and_cleanup_orphaned_recordings()
        # The footer is written on disconnecting, when nobody is told of a full disk.
        with self._path.open("rb") as file:
            file.seek(-min(64, self._path.stat().st_size), os.SEEK_END)
            if _FOOTER not in file.read():
                raise OutputError(self._failure())

    def _to_viewer(self, action: Callable[[], None]) -> None:
        """A viewer that was closed, or never opened, ends the showing, not the run."""
        try:
            action()
        except (RuntimeError, OSError) as error:
            logging.getLogger(__name__).warning("the viewer is gone, the recording goes on: %s", error)
            self._viewer = None

    def _free_bytes(self) -> int:
        disk = os.statvfs(self._path.parent)
        return disk.f_bavail * disk.f_frsize

    def _failure(self, what: str = "the recording is incomplete") -> str:
        free = self._free_bytes()
        cause = f"the disk is full ({free} bytes free)" if free < ROOM else "writing failed"
        return f"{self._path}: {what}: {cause}"
