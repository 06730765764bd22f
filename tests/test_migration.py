"""Every new name in `docs/migration.md` exists. Oracle: the import system."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[1] / "docs" / "migration.md").read_text(encoding="utf-8")
ROWS = [[cell.strip(" `") for cell in line.strip("|").split(" | ")] for line in PAGE.splitlines() if line.startswith("| `")]
MODULES = [row[1] for row in ROWS if len(row) == 2 and re.fullmatch(r"robocar(\.\w+)+", row[1])]
NAMES = [f"{row[2]}.{row[0]}" for row in ROWS if len(row) == 3]


def test_the_page_names_what_has_moved() -> None:
    assert "robocar.planners.search.a_star" in MODULES
    assert "robocar.planners.search.a_star.AStarParameters" in MODULES
    assert "robocar.episode.judge.Rules" in NAMES
    assert len(MODULES) > 120


@pytest.mark.parametrize("name", [*MODULES, *NAMES])
def test_the_new_name_exists(name: str) -> None:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute)
