"""Baselines: what runs came out as, as a small text file that is reviewed and kept under version control."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from robocar.core import LogFormatError
from robocar.core.text import describe, shown
from robocar.formats.files import write_atomically
from robocar.metrics import declared
from robocar.reading import read_json
from robocar.regression.results import SCHEMA, Results, Row, read_parquet, read_results, read_run, seed_of

KIND = "robocar-baseline"
DIGITS = 6
"""Of the metrics that are kept: far below every tolerance, and short enough to read."""
_FACTS = ("scenario", "navigator", "estimator", "mapper", "seed", "settings")


def write_baseline(
    rows: Iterable[Row], units: Mapping[str, str], path: str | Path, about: Mapping[str, Any] | None = None
) -> Path:
    """The outcome, the hash and the metrics of each run, three lines a run; metrics of the wall clock are left out.

    Args:
        about: what else the head shall say, e.g. the suite's name.

    Raises:
        OutputError: it cannot be written.
    """
    rows = sorted(rows, key=lambda row: row.name)
    versions = [dict(kept) for kept in dict.fromkeys(tuple(sorted(row.versions.items())) for row in rows if row.versions)]
    of_the_clock = {name for name, declaration in declared().items() if declaration.wall_clock}
    used = {name for row in rows for name in row.metrics if name not in of_the_clock}
    head = {
        "schema": SCHEMA,
        "kind": KIND,
        **(about or {}),
        "versions": versions,
        "units": {name: unit for name, unit in units.items() if name in used},
    }
    lines = [f" {json.dumps(key)}: {json.dumps(value)}," for key, value in head.items()]
    blocks = []
    for row in rows:
        facts = {name: getattr(row, name) for name in _FACTS} | {"settings": json.loads(row.settings)}
        outcome = {"status": row.status, "hash": row.hash, "fingerprint": row.fingerprint}
        if len(versions) > 1:
            outcome["versions"] = versions.index(dict(row.versions)) if row.versions else None
        metrics = {name: _short(value) for name, value in row.metrics.items() if name not in of_the_clock}
        parts = [json.dumps(facts)[1:-1], json.dumps(outcome)[1:-1], f'"metrics": {json.dumps(metrics)}']
        blocks.append(f"  {json.dumps(row.name)}: {{\n   " + ",\n   ".join(parts) + "\n  }")
    text = "{\n" + "\n".join(lines) + '\n "runs": {\n' + ",\n".join(blocks) + "\n }\n}\n"
    write_atomically(path, text.encode())
    return Path(path)


def _short(value: float | None) -> float | int | None:
    if value is None:
        return None
    rounded = float(f"{value:.{DIGITS}g}")
    return int(rounded) if rounded.is_integer() and abs(rounded) < 1e15 else rounded


def read_baseline(path: str | Path) -> Results:
    """What `write_baseline` wrote.

    Raises:
        LogFormatError: no such file, something else, damaged, or of another schema.
    """
    path = Path(path)
    content = read_json(path, LogFormatError)
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise LogFormatError(f'{path}: no baseline ("kind" is not "{KIND}"); `robocar results DIR --baseline FILE` writes one')
    if content.get("schema") != SCHEMA:
        raise LogFormatError(
            f"{path}: a baseline of schema {content.get('schema')}, this robocar knows {SCHEMA}; write it anew with this version"
        )
    try:
        rows = tuple(_row(name, run, content["versions"]) for name, run in content["runs"].items())
        units = {str(name): str(unit) for name, unit in content["units"].items()}
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError, IndexError) as error:
        raise LogFormatError(f"{path}: a damaged baseline ({shown(describe(error))})") from error
    return Results(path, rows, units, (), {key: content[key] for key in ("suite", "exact") if key in content})


def _row(name: str, run: Mapping[str, Any], versions: list[dict[str, str]]) -> Row:
    which = run.get("versions", 0 if versions else None)
    metrics = {str(metric): None if value is None else float(value) for metric, value in run["metrics"].items()}
    facts = {key: str(run[key]) for key in ("scenario", "navigator", "estimator", "mapper", "status")}
    return Row(
        name=name,
        seed=seed_of(run["seed"]),
        settings=json.dumps(run["settings"], sort_keys=True),
        reason="",
        hash=run["hash"],
        fingerprint=run["fingerprint"],
        metrics=metrics,
        versions={} if which is None else versions[which],
        **facts,
    )


def read_any(path: str | Path) -> Results:
    """A folder of runs, one run directory, a Parquet file of results or a baseline.

    Raises:
        LogFormatError: it is none of these, or cannot be read.
    """
    path = Path(path)
    if os.path.isdir(path):
        if (path / "metrics.json").exists():
            return Results(path, (read_run(path),), {})
        return read_results(path)
    if not os.path.exists(path):
        raise LogFormatError(f"{path}: no such file or folder")
    return read_parquet(path) if path.suffix == ".parquet" else read_baseline(path)
