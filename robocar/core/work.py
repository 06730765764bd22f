"""What is computed for a decision, as counts: the same on every machine.

Estimators, planners and navigators say what they did (`State.work`, `Plan.work`, `Command.work`), and metrics count it. The units
are listed here, once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

Work: TypeAlias = Mapping[str, int]
"""Counts by unit."""

UNITS: dict[str, str] = {
    "replans": "decisions made anew: plans after the first one for a goal, straight motions of a bug, choices of a frontier",
    "expansions": "nodes or cells that a search expanded",
    "samples": "points that a sampling planner drew",
    "cycles": "cycles of an iterative solver over its grid",
}
"""Unit and what one of it is."""


def total(*works: Work) -> dict[str, int]:
    """The sums by unit."""
    sums: dict[str, int] = {}
    for work in works:
        for unit, count in work.items():
            sums[unit] = sums.get(unit, 0) + int(count)  # NumPy's integers would overflow
    return sums
