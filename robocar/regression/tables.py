"""Results and comparisons as tables for people, JSON for programs and JUnit XML for CI systems."""

from __future__ import annotations

import xml.etree.ElementTree as xml
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from robocar.core import OutputError
from robocar.core.text import one_line, xml_text
from robocar.regression.compare import Comparison, describe, settings_note
from robocar.regression.results import Results, Row, grouped
from robocar.regression.statistics import IntervalEstimate, mean, share

COLUMNS = ("spl", "duration", "path_length", "min_clearance", "position_rmse")
"""Metrics of the table."""
OF_SUCCESSES = frozenset({"duration", "path_length"})
"""These say something only of runs that reached the goal."""


@dataclass(frozen=True, slots=True)
class Line:
    """Runs of one group.

    Args:
        group: what they have in common.
        success: share of them that reached the goal; errors: how many ended by an error.
        metrics: means; None where no run has the metric.
    """

    group: tuple[str, ...]
    runs: int
    success: IntervalEstimate
    errors: int
    metrics: dict[str, IntervalEstimate | None]


def summary(rows: Iterable[Row], keys: Sequence[str] = ("navigator",), columns: Sequence[str] = COLUMNS) -> list[Line]:
    """Success rates with Wilson's interval and means with bootstrap intervals, per group of equal `keys`."""
    lines = []
    for group, members in grouped(rows, keys).items():
        done = [row for row in members if row.success]
        means = {name: mean([row.metrics.get(name) for row in (done if name in OF_SUCCESSES else members)]) for name in columns}
        errors = sum(row.status == "error" for row in members)
        lines.append(Line(group, len(members), share(len(done), len(members)), errors, means))
    return lines


def results_table(results: Results, keys: Sequence[str] = ("navigator",)) -> Table:
    """For the terminal."""
    table = Table(box=None, padding=(0, 1))
    for key in keys:
        table.add_column(Text(key))
    for head in (
        "runs",
        "success [95 %]",
        *(f"{name} {_unit(results.units.get(name, ''))}".strip() for name in COLUMNS),
        "errors",
    ):
        table.add_column(Text(one_line(head)), justify="right")
    for line in summary(results.rows, keys):
        cells = [str(line.runs), interval(line.success, ".2f"), *(interval(line.metrics[name]) for name in COLUMNS)]
        table.add_row(*(Text(one_line(cell)) for cell in (*line.group, *cells, str(line.errors))))
    return table


def interval(estimate: IntervalEstimate | None, form: str = ".3g") -> str:
    """`0.95 [0.91, 0.98]`"""
    if estimate is None:
        return "–"
    if estimate.low is None or estimate.high is None:
        return f"{estimate.value:{form}}"
    return f"{estimate.value:{form}} [{estimate.low:{form}}, {estimate.high:{form}}]"


def _unit(unit: str) -> str:
    return "" if unit in ("", "1") else f"[{unit}]"


def results_json(results: Results, keys: Sequence[str] = ("navigator",)) -> dict[str, Any]:
    """One object: the groups with all metrics, and the runs."""
    return {
        "groups": [
            dict(zip(keys, line.group, strict=True))
            | {"runs": line.runs, "errors": line.errors, "success": asdict(line.success)}
            | {"metrics": {name: None if found is None else asdict(found) for name, found in line.metrics.items()}}
            for line in summary(results.rows, keys, tuple(results.units))
        ],
        "units": dict(results.units),
        "runs": [asdict(row) for row in results.rows],
        "skipped": list(results.skipped),
    }


def comparison_text(found: Comparison) -> str:
    """What a person wants to know, the worst last."""
    identical = sum(pair.identical for pair in found.pairs)
    lines = [f"{len(found.pairs)} runs on both sides: {identical} identical, {len(found.changed)} behave differently"]
    lines += [f"hashes not compared, {why}; metrics are" for why in found.why_not_hashes]
    if note := settings_note(found.pairs):
        lines.append(f"settings: {note}")
    if found.added:
        lines.append(f"{len(found.added)} runs are new: {_some(found.added)}")
    if found.missing:
        lines.append(f"{len(found.missing)} runs are missing: {_some(found.missing)}")
    lines += [f"{pair.new.name}: {pair.base.status} became {pair.new.status}: {pair.verdict}" for pair in found.outcomes]
    counts = {verdict: len(found.of(verdict)) for verdict in ("better", "worse", "unchanged")}
    lines.append("metrics (per scenario and navigator): " + ", ".join(f"{n} {verdict}" for verdict, n in counts.items()))
    lines += [f"  {describe(change)}" for verdict in ("better", "worse") for change in found.of(verdict)]
    if found.exact and found.changed:
        names = _some([pair.new.name for pair in found.changed])
        lines.append(f"{len(found.changed)} runs behave differently (another hash): {names}")
    failed = len(found.failures)
    lines.append(f"{failed} regressions" if failed else "no regression")
    return "\n".join(lines)


def _some(names: Sequence[str], most: int = 5) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def comparison_json(found: Comparison) -> dict[str, Any]:
    """One object."""
    return {
        "pairs": len(found.pairs),
        "identical": sum(pair.identical for pair in found.pairs),
        "changed": [pair.new.name for pair in found.changed],
        "outcomes": [
            {"run": pair.new.name, "base": pair.base.status, "new": pair.new.status, "verdict": pair.verdict}
            for pair in found.outcomes
        ],
        "metrics": [asdict(change) for change in found.metrics],
        "missing": list(found.missing),
        "added": list(found.added),
        "hashes_not_compared": list(found.why_not_hashes),
        "failures": list(found.failures),
    }


def write_junit(path: Path, suite: str, cases: Iterable[tuple[str, str, str | None]]) -> None:
    """JUnit XML as CI systems read it: (class name, name, what failed or None) per test case.

    Raises:
        OutputError: it cannot be written.
    """
    rows = list(cases)
    failed = sum(problem is not None for *_, problem in rows)
    root = xml.Element("testsuites")
    node = xml.SubElement(
        root, "testsuite", name=xml_text(suite), tests=str(len(rows)), failures=str(failed), errors="0", skipped="0"
    )
    for group, name, problem in rows:
        case = xml.SubElement(node, "testcase", classname=xml_text(group), name=xml_text(name))
        if problem is not None:
            xml.SubElement(case, "failure", message=xml_text(problem)).text = xml_text(problem)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        xml.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot write: {error.strerror or error}") from error


def junit_of_results(results: Results) -> list[tuple[str, str, str | None]]:
    """A run that did not reach its goal is a failed test."""
    return [
        (f"{row.scenario}.{row.navigator}", row.name, None if row.success else f"{row.status}: {row.reason}")
        for row in results.rows
    ]


def junit_of_comparison(found: Comparison) -> list[tuple[str, str, str | None]]:
    """A run, and each metric of a group of runs, that got worse is a failed test."""
    problems = {
        pair.new.name: f"{pair.base.status} became {pair.new.status}" for pair in found.outcomes if pair.verdict == "worse"
    }
    if found.exact:
        for pair in found.changed:
            problems.setdefault(pair.new.name, "behaves differently (another hash)")
    cases = [(f"{p.new.scenario}.{p.new.navigator}", p.new.name, problems.get(p.new.name)) for p in found.pairs]
    cases += [
        (f"{c.key[0]}.{c.key[1]}", f"{', '.join(c.key)}: {c.metric}", describe(c) if c.verdict == "worse" else None)
        for c in found.metrics
    ]
    return cases + [("missing", name, None if found.subset else "is missing") for name in found.missing]
