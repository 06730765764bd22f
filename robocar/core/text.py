"""Texts that come from elsewhere: can they be written, and how are they shown."""

from __future__ import annotations

import reprlib

MOST = 100
"""Characters of a value that a message shows."""

_short = reprlib.Repr()
_short.maxlevel = 3
_short.maxstring = _short.maxother = _short.maxlong = MOST
_short.maxlist = _short.maxtuple = _short.maxdict = _short.maxset = _short.maxfrozenset = 12


def is_text(text: str) -> bool:
    """Whether UTF-8 can hold it: half of a surrogate pair, as a file's name in another encoding gives it, it cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def shown(value: object) -> str:
    """A value as it is written in Python, or its beginning: what is too large to be shown is never built.

    An exception is shown by its message.
    """
    try:
        text = str(value) if isinstance(value, BaseException) else _short.repr(value)
    except Exception:  # an integer of more digits than Python writes
        text = f"({type(value).__name__} that cannot be shown)"
    text = one_line(text[: 4 * MOST])
    return text if len(text) <= MOST else f"{text[: MOST - 3]}..."


def one_line(text: str) -> str:
    """As one line that can be written: white space becomes blanks, what cannot be printed its escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in " ".join(text.split()))


def describe(error: BaseException) -> str:
    """Type and message of an error, as one line that can be written, whatever its author did."""
    try:
        message = str(error)
    except Exception:
        message = "(its message cannot be made)"
    return one_line(f"{type(error).__name__}: {message}")
