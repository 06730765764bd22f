"""Texts that come from elsewhere: can they be written, and how are they shown."""

from __future__ import annotations


def is_text(text: str) -> bool:
    """Whether UTF-8 can hold it: half of a surrogate pair, as a file's name in another encoding gives it, it cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def describe(error: BaseException) -> str:
    """Type and message of an error, as one line that can be written, whatever its author did."""
    try:
        message = str(error)
    except BaseException:  # its author's, and of no interest
        message = "(its message cannot be made)"
    line = " ".join(f"{type(error).__name__}: {message}".split())
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
