"""Every new name in `docs/migration.md` exists. Oracles: the import system, and the registry."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from robocar.episode.registry import names, parameters

PAGE = (Path(__file__).parents[1] / "docs" / "migration.md").read_text(encoding="utf-8")
ROWS = [[cell.strip(" `") for cell in line.strip("|").split(" | ")] for line in PAGE.splitlines() if line.startswith("| `")]
MODULES = [row[1] for row in ROWS if len(row) == 2 and re.fullmatch(r"robocar(\.\w+)+", row[1])]
NAMES = [f"{row[2]}.{row[0]}" for row in ROWS if len(row) == 3]
PARAMETERS = re.findall(r"^\| (navigator|estimator|mapper)\.(\w+) \| (.+) \| (.+) \|$", PAGE, re.MULTILINE)
"""Kind, part, algorithms, and the part's parameters."""
NESTED = 461
"""Nested parameters of all algorithms when they were nested; those that come later have no old name."""


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


def test_the_page_has_every_parameter_that_was_nested() -> None:
    said = {
        (kind, algorithm, f"{part}.{name}")
        for kind, part, algorithms, listed in PARAMETERS
        for algorithm in re.findall(r"`(.+?)`", algorithms)
        for name in re.findall(r"`(.+?)`", listed)
    }
    for kind, algorithm, name in said:
        assert name in parameters(names(kind)[algorithm])
    assert len(said) == NESTED
