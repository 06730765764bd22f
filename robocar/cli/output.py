"""How commands speak: data on stdout, errors as one line on stderr."""

from __future__ import annotations

import json
import sys
from typing import Any, NoReturn

import tyro

Flag = tyro.conf.FlagCreatePairsOff[bool]


def complain(message: str) -> None:
    """Bad input: one line on stderr."""
    sys.stderr.write(f"error: {' '.join(message.split())}\n")


def fail(message: str) -> NoReturn:
    """Bad input: one line, and status 2."""
    complain(message)
    sys.exit(2)


def put(text: str) -> None:
    """A line of data."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def dumps(content: Any) -> str:
    """JSON as we print it."""
    return json.dumps(content, indent=1)
