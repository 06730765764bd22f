"""Damaged files of every format: no traceback, no hang above 5 s, no memory above 1 GiB (`tests/formats/mutation.py`)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(not hasattr(__import__("signal"), "SIGALRM"), reason="stops what hangs by a signal of Unix")
LONG = pytest.mark.skipif(not os.environ.get("ROBOCAR_LONG_TESTS"), reason="takes minutes: set ROBOCAR_LONG_TESTS=1")
ROOT = Path(__file__).parents[2]
PART = 500


def findings(first: int, last: int) -> list[str]:
    """All that went wrong with files `first` to `last`, each part read by a process of its own."""
    command = [sys.executable, "-m", "tests.formats.mutation", str(first), str(last)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=580)
    lines = done.stdout.splitlines()
    if done.returncode or not lines or not lines[-1].startswith("read "):
        return [*lines, f"the process ended with {done.returncode}: {done.stderr[-2000:]}"]
    megabytes = int(lines[-1].split()[2])
    return [*lines[:-1], *([f"{megabytes} MB"] if megabytes > 1024 else [])]


def test_some_damaged_files() -> None:
    assert findings(0, 200) == []


@LONG
@pytest.mark.parametrize("first", range(0, 10_000, PART))
def test_ten_thousand_damaged_files(first: int) -> None:
    assert findings(first, first + PART) == []
