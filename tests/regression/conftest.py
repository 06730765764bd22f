"""A short scenario, and a way to sweep it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from robocar.regression.suite import Suite, load_suite
from robocar.regression.sweep import Swept, sweep

SHORT = "map: maps/thesis_field.yaml\nstart: [0.3, 0.3, 0]\ngoal: [1.2, 0.4]\ntime_limit: {}\n"


@pytest.fixture
def short(tmp_path: Path) -> str:
    """A scenario file of half a second of driving; relative names beside it are found by the suites of `make_suite`."""
    path = tmp_path / "short.yaml"
    path.write_text(SHORT.format(0.5))
    return str(path)


@pytest.fixture
def far(tmp_path: Path) -> str:
    """The same with time to reach the goal."""
    path = tmp_path / "far.yaml"
    path.write_text(SHORT.format(20))
    return str(path)


def suite_of(scenario: str, navigators: tuple[str, ...] = ("a-star",), **more: Any) -> Suite:
    block: Mapping[str, Any] = {"scenarios": [scenario], "seeds": more.pop("seeds", [0])}
    return load_suite({"name": "test", "runs": [block], **more}, navigators=navigators)


Sweep = Callable[..., Swept]
run_sweep = sweep
