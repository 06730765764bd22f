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

import yaml

from robocar.core import LogFormatError, OutputError
from robocar.core.text import csv_cell

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
    try:
        content = json.loads((path / "metrics.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise _NotARun("not a run directory (no metrics.json)") from None
    except (OSError, ValueError) as error:
        raise _NotARun(f"metrics.json is damaged ({error})") from error
    try:
        if content["schema"] != SCHEMA:
            raise _NotARun(f"metrics.json of schema {content['schema']}, this is {SCHEMA}")
        metrics = {str(name): _number(metric["value"]) for name, metric in content["metrics"].items()}
        units = {str(name): str(metric["unit"]) for name, metric in content["metrics"].items()}
        facts = {name: str(content[name]) for name in ("scenario", "navigator", "estimator", "mapper", "status", "reason")}
        hashes = {name: None if content[name] is None else str(content[name]) for name in ("hash", "fingerprint")}
        seed, versions = int(content["seed"]), dict(content.get("versions", {}))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _NotARun(f"metrics.json is damaged ({type(error).__name__}: {error})") from error
    settings = read_yaml(path / "config.yaml").get("settings") or {}
    text = settings_text(settings)
    return Row(path.name, seed=seed, settings=text, metrics=metrics, versions=versions, **facts, **hashes), units  # type: ignore[arg-type]


def settings_text(settings: Mapping[str, Any]) -> str:
    """JSON with sorted keys: equal settings are equal texts."""
    return json.dumps(dict(settings), sort_keys=True, default=str)


def _number(value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r} is no finite number")
    return float(value)


def read_yaml(path: Path) -> dict[str, Any]:
    """A mapping; empty where the file is missing or something else."""
    try:
        # The C loader is ten times faster, where it was built in.
        content = yaml.load(path.read_bytes(), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (OSError, yaml.YAMLError, UnicodeDecodeError):
        return {}
    return content if isinstance(content, dict) else {}


def _sweep_file(folder: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / "sweep.json").read_text())
    except (OSError, ValueError):
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
            versions=json.loads(row["versions"]),
        )
        for row in table.to_pylist()
    )
    return Results(path, rows, units, (), json.loads(about.get("robocar.sweep", "{}")))


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
