"""How commands speak: data on stdout, errors as one line on stderr."""

from __future__ import annotations

import json
import sys
from typing import Any, NoReturn

import tyro

Flag = tyro.conf.FlagCreatePairsOff[bool]


def complain(message: str) -> None:
    """Bad input: one line on stderr."""
    from robocar.core.text import one_line

    sys.stderr.write(f"error: {one_line(message)}\n")


def fail(message: str) -> NoReturn:
    """Bad input: one line, and status 2."""
    complain(message)
    sys.exit(2)


def put(text: str) -> None:
    """Lines of data."""
    from robocar.core.text import printable

    sys.stdout.write(printable(text) + "\n")
    sys.stdout.flush()


def dumps(content: Any) -> str:
    """JSON as we print it."""
    return json.dumps(content, indent=1)
