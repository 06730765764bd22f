"""Texts that come from elsewhere, names in files above all: can they be written, and how are they shown.

A text that is put into another language is escaped there and only there, by the function of that language: `printable` for
terminals and logs, `html_text`, `xml_text`, `csv_cell`, `markdown_text`, `figure_text` (matplotlib).
"""

from __future__ import annotations

import re
import reprlib
from html import escape

MOST = 100
"""Characters of a value that a message shows."""

_short = reprlib.Repr()
_short.maxlevel = 3
_short.maxstring = _short.maxother = _short.maxlong = MOST
_short.maxlist = _short.maxtuple = _short.maxdict = _short.maxset = _short.maxfrozenset = 12
_MARKDOWN = re.compile(r"([\\`*_{}\[\]()<>#|~!$&])")


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


def describe(error: BaseException) -> str:
    """Type and message of an error, as one line that can be written, whatever its author did."""
    try:
        message = str(error)
    except BaseException:  # its author's, and of no interest
        message = "(its message cannot be made)"
    return one_line(f"{type(error).__name__}: {message}")


def printable(text: str) -> str:
    """Without what moves a terminal's cursor, colours it or cannot be encoded; ends of lines and tabs stay."""
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in text)


def one_line(text: str) -> str:
    """`printable`, without ends of lines."""
    return printable(" ".join(text.split()))


def html_text(text: str) -> str:
    """For HTML, between tags and in attributes."""
    return escape(printable(text))


def xml_text(text: str) -> str:
    """For a library that writes XML: without the characters that XML has none for."""
    return "".join(c if c.isprintable() or c in "\n\t" else "?" for c in text)


def csv_cell(value: object) -> object:
    """For CSV: a text that a spreadsheet would take for a formula begins with an apostrophe. Numbers are themselves."""
    if not isinstance(value, str):
        return value
    text = printable(value)
    return f"'{text}" if text.lstrip().startswith(("=", "+", "-", "@")) else text


def markdown_text(text: str) -> str:
    """For Markdown, in a paragraph or in the cell of a table: every sign is itself."""
    return _MARKDOWN.sub(r"\\\1", one_line(text))


def markdown_cell(text: str) -> str:
    """For the cell of a table whose text is Markdown itself: it stays one cell, and no HTML."""
    return re.sub(r"(?<!\\)\|", r"\\|", one_line(text)).replace("<", "&lt;")


def figure_text(text: str) -> str:
    """For matplotlib, whose `$` begins a formula; a leading underscore would hide a legend's entry."""
    line = one_line(text).replace("$", r"\$")
    return f" {line}" if line.startswith("_") else line
