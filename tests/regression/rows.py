"""Runs made up for tests."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robocar.regression.results import Results, Row

UNITS = {"duration": "s", "spl": "1", "min_clearance": "m", "wall_time": "s", "contacts": "1"}
VERSIONS = {"python": "3.11", "numpy": "2.4.6"}


def row(scenario: str = "room", navigator: str = "a-star", seed: int = 0, status: str = "success", **more: Any) -> Row:
    settings = more.pop("settings", "{}")
    facts = {"hash": f"{scenario}-{navigator}-{seed}", "fingerprint": "here", "versions": VERSIONS} | {
        key: more.pop(key) for key in ("hash", "fingerprint", "versions") if key in more
    }
    metrics = {"duration": 10.0, "spl": 0.9, "min_clearance": 0.2, "wall_time": 1.0, "contacts": 0.0} | more
    name = f"{scenario}--{navigator}--truth--none--s{seed}" + ("" if settings == "{}" else "--0123abcd")
    return Row(name, scenario, navigator, "truth", "none", seed, settings, status, "because", metrics=metrics, **facts)


def results(*rows: Row, **sweep: Any) -> Results:
    return Results(Path("somewhere"), rows, UNITS, (), sweep)


def write_run(folder: Path, one: Row, **changes: Any) -> Path:
    """A run directory, as far as results are read from it."""
    path = folder / one.name
    path.mkdir(parents=True)
    metrics: Mapping[str, Any] = {name: {"value": value, "unit": UNITS[name]} for name, value in one.metrics.items()}
    content = {"schema": 1, "metrics": metrics, "versions": dict(one.versions)}
    content |= {key: getattr(one, key) for key in ("scenario", "navigator", "estimator", "mapper", "seed", "status", "reason")}
    content |= {"hash": one.hash, "fingerprint": one.fingerprint} | changes
    (path / "metrics.json").write_text(json.dumps(content))
    (path / "config.yaml").write_text(f"settings: {one.settings}\n")
    return path
