"""Fixtures of all tests."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Test data that nobody here wrote: `$ROBOCAR_DATA`, else `../shared/data` beside the project; skipped if absent."""
    default = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    path = Path(os.environ.get("ROBOCAR_DATA") or default)
    if not path.is_dir():
        pytest.skip(f"no test data at {path} (set ROBOCAR_DATA)")
    return path
