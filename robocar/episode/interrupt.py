"""Ctrl-C during a run."""

from __future__ import annotations

import signal
import threading


class Interrupt:
    """Ctrl-C ends the run after the tick that it falls into, so that log and recording stay whole; the second one breaks off."""

    def __init__(self) -> None:
        self.asked = False
        self._ours = False

    def __enter__(self) -> Interrupt:
        # Only where Ctrl-C would raise KeyboardInterrupt here: a caller's own handler keeps its say.
        if (
            threading.current_thread() is threading.main_thread()
            and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        ):
            signal.signal(signal.SIGINT, self._ask)
            self._ours = True
        return self

    def __exit__(self, *_: object) -> None:
        if self._ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _ask(self, *_: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
