"""The page of the documentation that lists the project's metrics: `python -m robocar.metrics.page docs/metrics.md` writes it."""

from __future__ import annotations

import sys
from pathlib import Path

from robocar.core.text import markdown_cell
from robocar.metrics import Declaration, Tolerance, declared

_INTRODUCTION = """# Metrics

Written from the declarations in `robocar/metrics` by `python -m robocar.metrics.page docs/metrics.md`. Formulas and sources are
in the docstrings there. A metric that a run does not have is `null` in `metrics.json`. A metric *needs* what its function takes:
where a log does not hold it, the metric is `null`, as clearances and contacts are in the replay of a log.

`robocar compare` calls a change *better* or *worse* when it exceeds both margins of its tolerance, one in the metric's unit and
one relative to the baseline; a suite's `tolerances` change them. Metrics marked *wall clock* depend on the load of the machine.

A package adds its own metrics: it decorates a function with `robocar.metrics.metric` (an example is in
`robocar/metrics/declaration.py`) and names the module in the entry-point group `robocar.metrics`. From Python it is enough to
import the module before the run; worker processes find a module by its entry point only.
"""
_SECTIONS = {
    None: "Every run",
    "localized": "Runs with an estimator other than the oracle",
    "drawn": "Runs that draw a map",
    "movers": "Runs among moving obstacles",
}


def page() -> str:
    """The whole page, in Markdown. Metrics of other packages are not on it."""
    own = [declaration for declaration in declared().values() if declaration.module.startswith("robocar.")]
    parts = [_INTRODUCTION]
    for where, title in _SECTIONS.items():
        parts.append(f"\n## {title}\n\n| metric | unit | better | tolerance | needs | what it is |\n|---|---|---|---|---|---|\n")
        parts += [_line(declaration) for declaration in own if declaration.where == where]
    return "".join(parts)


def _line(declaration: Declaration) -> str:
    tolerance = declaration.tolerance
    better = "not judged" if tolerance.better == "neither" else tolerance.better
    needs = ", ".join(f"`{need}`" for need in declaration.needs)
    clock = " (wall clock)" if declaration.wall_clock else ""
    cells = [f"`{declaration.name}`", declaration.unit, better, _margins(tolerance, declaration.unit), needs]
    cells.append(declaration.summary + clock)
    return "| " + " | ".join(map(markdown_cell, cells)) + " |\n"


def _margins(tolerance: Tolerance, unit: str) -> str:
    if tolerance.better == "neither":
        return ""
    absolute = f"{tolerance.absolute:g}{'' if unit == '1' else f' {unit}'}" if tolerance.absolute else ""
    relative = f"{100 * tolerance.relative:g} %" if tolerance.relative else ""
    return ", ".join(part for part in (absolute, relative) if part) or "any change"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
