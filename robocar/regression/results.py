"""What came out of many runs: read from a folder of run directories, kept as one Parquet file, summed up per navigator."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robocar.core import LogFormatError, OutputError
from robocar.core.text import csv_cell, shown
from robocar.reading import parse_json, read_json, read_yaml

SCHEMA = 1
"""Of `sweep.json`, of the Parquet file and of `metrics.json`; files of another schema are refused."""
PARQUET = "results.parquet"
FACTS = ("name", "scenario", "navigator", "estimator", "mapper", "seed", "settings", "status", "reason", "hash", "fingerprint")
_OURS = re.compile(r"sweep\.json|results\.(parquet|csv|json|xml)|report\.html|.*\.rrd|\..*")


@dataclass(frozen=True, slots=True)
class Row:
    """One run.

    Args:
        name: of its directory, which is its identity.
        settings: the overrides it was run with, as JSON with sorted keys.
        hash, fingerprint: None where the run was lost.
        versions: of Python and of packages; empty where nobody wrote them down.
        metrics: by name, None where the run has none.
    """

    name: str
    scenario: str
    navigator: str
    estimator: str
    mapper: str
    seed: int
    settings: str
    status: str
    reason: str
    hash: str | None
    fingerprint: str | None
    metrics: Mapping[str, float | None]
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        return self.status == "success"


@dataclass(frozen=True, slots=True)
class Results:
    """The runs of a folder or file, sorted by name.

    Args:
        source: where they were read.
        units: of the metrics, by name.
        skipped: files and folders that are no runs, or damaged ones, and why.
        sweep: the content of `sweep.json`, empty where there is none.
    """

    source: Path
    rows: tuple[Row, ...]
    units: Mapping[str, str]
    skipped: tuple[str, ...] = ()
    sweep: Mapping[str, Any] = field(default_factory=dict)


def read_results(folder: str | Path) -> Results:
    """The run directories in a folder. What else lies there, or is damaged, is named in `skipped`.

    Raises:
        LogFormatError: there is no such folder, or no run in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise LogFormatError(f"{folder}: no such folder")
    rows, units, skipped = [], {}, []
    for path in sorted(folder.iterdir()):
        if _OURS.fullmatch(path.name):
            continue
        try:
            row, found = _row(path)
        except _NotARun as error:
            skipped.append(f"{path.name}: {error}")
            continue
        rows.append(row)
        units.update(found)
    if not rows:
        raise LogFormatError(f"{folder}: no run in here" + (f" ({skipped[0]})" if skipped else ""))
    return Results(folder, tuple(rows), units, tuple(skipped), _sweep_file(folder))


def read_run(folder: str | Path) -> Row:
    """One run directory.

    Raises:
        LogFormatError: it is none, or damaged.
    """
    try:
        return _row(Path(folder))[0]
    except _NotARun as error:
        raise LogFormatError(f"{folder}: {error}") from error


def is_complete(folder: Path) -> bool:
    """Whether a run directory holds the result of a run: one that was lost, or is damaged, does not."""
    try:
        return _row(folder)[0].hash is not None
    except _NotARun:
        return False


class _NotARun(Exception):
    pass


def _row(path: Path) -> tuple[Row, dict[str, str]]:
    """A run and the units of its metrics."""
    if not path.is_dir():
        raise _NotARun("not a run directory")
    if not (path / "metrics.json").exists():
        raise _NotARun("not a run directory (no metrics.json)")
    try:
        content = read_json(path / "metrics.json", LogFormatError)
    except LogFormatError as error:
        raise _NotARun(f"metrics.json is damaged ({error})") from error
    try:
        config = read_config(path)
    except LogFormatError as error:
        raise _NotARun(f"config.yaml is damaged ({error})") from error
    try:
        if content["schema"] != SCHEMA:
            raise _NotARun(f"metrics.json of schema {content['schema']}, this is {SCHEMA}")
        metrics = {str(name): _number(metric["value"]) for name, metric in content["metrics"].items()}
        units = {str(name): str(metric["unit"]) for name, metric in content["metrics"].items()}
        facts = {name: str(content[name]) for name in ("scenario", "navigator", "estimator", "mapper", "status", "reason")}
        hashes = {name: None if content[name] is None else str(content[name]) for name in ("hash", "fingerprint")}
        seed, versions = seed_of(content["seed"]), dict(content.get("versions", {}))
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise _NotARun(f"metrics.json is damaged ({type(error).__name__}: {error})") from error
    text = settings_text(config.get("settings") or {})
    return Row(path.name, seed=seed, settings=text, metrics=metrics, versions=versions, **facts, **hashes), units  # type: ignore[arg-type]


def settings_text(settings: Mapping[str, Any]) -> str:
    """JSON with sorted keys: equal settings are equal texts."""
    return json.dumps(dict(settings), sort_keys=True, default=str)


def seed_of(value: Any) -> int:
    """A seed as files have it; ValueError for what is none."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise ValueError(f"seed must be a non-negative integer, not {shown(value)}")
    return value


def _number(value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{shown(value)} is no finite number")
    return float(value)


def read_config(run: Path) -> dict[str, Any]:
    """What a run was made from: its `config.yaml`.

    Raises:
        LogFormatError: it is missing or damaged; a run of unknown settings is not one without settings.
    """
    content = read_yaml(run / "config.yaml", LogFormatError)
    if not isinstance(content, dict) or not isinstance(content.get("settings"), dict | None):
        raise LogFormatError(f"{run / 'config.yaml'}: not the configuration of a run: no mapping with a mapping `settings`")
    return content


def _sweep_file(folder: Path) -> dict[str, Any]:
    try:
        content = read_json(folder / "sweep.json", LogFormatError)
    except LogFormatError:
        return {}
    return content if isinstance(content, dict) and content.get("schema") == SCHEMA else {}


def write_parquet(results: Results, path: str | Path) -> Path:
    """One row per run; each metric's column has its unit in the field's metadata. Written beside its place and renamed.

    Raises:
        OSError: it cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = Path(path)
    fields = [pa.field(name, pa.int64() if name == "seed" else pa.string()) for name in (*FACTS, "versions")]
    fields += [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in results.units.items()]
    about = {"robocar.schema": str(SCHEMA), "robocar.sweep": json.dumps(dict(results.sweep))}
    rows = [
        {name: getattr(row, name) for name in FACTS} | {"versions": json.dumps(dict(row.versions))} | dict(row.metrics)
        for row in results.rows
    ]
    table = pa.Table.from_pylist(rows, schema=pa.schema(fields, metadata=about))
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        pq.write_table(table, beside)
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
    return path


def read_parquet(path: str | Path) -> Results:
    """What `write_parquet` wrote.

    Raises:
        LogFormatError: something else, or of another schema.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = Path(path)
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise LogFormatError(f"{path}: not a Parquet file that can be read: {error}") from error
    about = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    if about.get("robocar.schema") != str(SCHEMA):
        found = about.get("robocar.schema", "none")
        raise LogFormatError(f"{path}: results of schema {found}, this is {SCHEMA}")
    metrics = [name for name in table.schema.names if name not in (*FACTS, "versions")]
    units = {name: table.schema.field(name).metadata[b"unit"].decode() for name in metrics}
    rows = tuple(
        Row(
            **{name: row[name] for name in FACTS},
            metrics={name: row[name] for name in metrics},
            versions=parse_json(row["versions"], f"{path}: versions", LogFormatError),
        )
        for row in table.to_pylist()
    )
    return Results(path, rows, units, (), parse_json(about.get("robocar.sweep", "{}"), str(path), LogFormatError))


def write_csv(results: Results, path: str | Path) -> Path:
    """One line per run, with the units in the head: `duration [s]`.

    Raises:
        OutputError: it cannot be written.
    """
    import csv

    try:
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            heads = [*FACTS, *(f"{name} [{unit}]" for name, unit in results.units.items())]
            writer.writerow(map(csv_cell, heads))
            for row in results.rows:
                cells = [*(getattr(row, name) for name in FACTS), *(row.metrics.get(name) for name in results.units)]
                writer.writerow(map(csv_cell, cells))
    except OSError as error:
        raise OutputError(f"{path}: cannot write: {error.strerror or error}") from error
    return Path(path)


def grouped(rows: Iterable[Row], keys: Sequence[str]) -> dict[tuple[str, ...], list[Row]]:
    """Rows with equal values of these fields, in the order of the values."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(str(getattr(row, key)) for key in keys), []).append(row)
    return dict(sorted(groups.items()))
