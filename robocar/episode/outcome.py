"""How a robot's part of an episode ended, and what ends it when a part of ours or of others fails."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from robocar.core import MapView, OccupancyGrid, OutputError
from robocar.core.text import describe
from robocar.episode.blame import describe_with_place
from robocar.episode.checked import drawn
from robocar.recording import Recorder


@dataclass(slots=True, kw_only=True)
class Outcome:
    """Empty while it goes on.

    Args:
        status: see `robocar.episode.result.RunResult`.
        reason: in words.
        traceback: of the error, where one ended it.
    """

    status: str = ""
    reason: str = ""
    traceback: str = ""

    @property
    def done(self) -> bool:
        return bool(self.status)

    def end(self, status: str, reason: str) -> None:
        """Ends it, unless it is over already."""
        if not self.done:
            self.status, self.reason = status, reason

    @contextmanager
    def failures(self) -> Iterator[None]:
        """What a part raises in here is the outcome, even where another was found before; the process goes on.

        Raises:
            OutputError: the recording cannot be written.
        """
        try:
            yield
        except (OutputError, KeyboardInterrupt):
            raise
        except BaseException as error:  # whatever it is derived from; also a mapper's grid or a trace that cannot be drawn
            self.status, self.reason = "error", describe_with_place(error)
            self.traceback = _traceback(error)

    def finish(self, recorder: Recorder, view: MapView | None) -> OccupancyGrid | None:
        """Records what still waits; the map as it is now. An error in either is the outcome."""
        with self.failures():
            recorder.finish()
        with self.failures():
            return drawn(view)
        return None


def _traceback(error: BaseException) -> str:
    try:
        text = "".join(traceback.format_exception(error))
    except BaseException:  # of an error that does not let itself be looked at
        text = describe(error)
    return text.encode(errors="backslashreplace").decode()
