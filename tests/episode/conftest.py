"""Fixtures of the tests of whole runs: one that is recorded, and the folder that it lies in."""

from __future__ import annotations

from pathlib import Path

import pytest

from robocar.episode.result import RunResult
from robocar.episode.run import run
from tests.episode.runs import PARTS, SHORT


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def recorded(out: Path) -> RunResult:
    return run(SHORT, **PARTS, seed=3, out=out)
