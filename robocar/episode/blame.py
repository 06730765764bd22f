"""Where in the code of a part's author an error arose, so that nobody has to read our stack to find it."""

from __future__ import annotations

import os
import sysconfig
from collections.abc import Iterator
from types import FrameType

from robocar.core.text import describe, one_line

_STDLIB = (*(sysconfig.get_paths()[name] + os.sep for name in ("stdlib", "platstdlib")), "<frozen")
_INSTALLED = tuple(sysconfig.get_paths()[name] + os.sep for name in ("purelib", "platlib"))


def describe_with_place(error: BaseException) -> str:
    """`ValueError: no way (my_planner.py, line 12, in command)`: the innermost line that is neither ours nor a library's.

    Where the author's package is installed among the libraries it is the first line outside of ours. An error that arose in our
    code alone has no place.
    """
    try:
        place = _place(error)
    except Exception:  # of an error that does not let itself be looked at
        place = ""
    return f"{describe(error)}{place}"


def _place(error: BaseException) -> str:
    if isinstance(error, SyntaxError) and error.filename:
        return _text(error.filename, error.lineno or 0)
    theirs = [step for step in _steps(error) if not _is_ours(step[0])]
    own = [step for step in theirs if not _lies_in(step[0], _STDLIB + _INSTALLED)]
    installed = [step for step in theirs if _lies_in(step[0], _INSTALLED)]
    if not own and not installed:
        return ""
    frame, line = own[-1] if own else installed[0]
    return _text(frame.f_code.co_filename, line, frame.f_code.co_name)


def _steps(error: BaseException) -> Iterator[tuple[FrameType, int]]:
    """Frames and lines, the outermost first."""
    step = error.__traceback__
    while step is not None:
        yield step.tb_frame, step.tb_lineno
        step = step.tb_next


def _is_ours(frame: FrameType) -> bool:
    return str(frame.f_globals.get("__name__", "")).partition(".")[0] == "robocar"


def _lies_in(frame: FrameType, folders: tuple[str, ...]) -> bool:
    return frame.f_code.co_filename.startswith(folders)


def _text(file: str, line: int, function: str = "") -> str:
    near = os.path.relpath(file)
    inside = f", in {function}" if function else ""
    place = one_line(f"{file if near.startswith(os.pardir) else near}, line {line}{inside}")
    return f" ({place})"
