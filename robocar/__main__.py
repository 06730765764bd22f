"""The console script `robocar`, and `python -m robocar`: whatever happens from the first import on ends with one line."""

from __future__ import annotations

import os
import sys
from typing import NoReturn

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def main() -> NoReturn:
    """Imports and runs the command line. Ctrl-C is answered with one line, however early it comes."""
    sys.unraisablehook = _unraisable
    try:
        from robocar.cli import main as command_line

        command_line()
    except BaseException as error:
        if isinstance(error, SystemExit) or not _was_ctrl_c(error):
            raise
        _leave()


def _was_ctrl_c(error: BaseException | None) -> bool:
    """Some libraries raise an error of their own when Ctrl-C falls into their import."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _unraisable(about: sys.UnraisableHookArgs) -> None:
    """Where nothing can be raised (in a callback of a library), Ctrl-C would be lost with a traceback."""
    if issubclass(about.exc_type, KeyboardInterrupt):
        _leave()
    sys.__unraisablehook__(about)


def _leave() -> NoReturn:
    """At once: libraries that are half imported need no farewell, nor do they get a second Ctrl-C to complain about."""
    sys.stderr.write("interrupted\n")
    sys.stderr.flush()
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
