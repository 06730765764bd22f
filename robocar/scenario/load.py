"""Scenarios found by name or path, and read with overrides."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robocar.core import ScenarioError
from robocar.core.suggestions import did_you_mean
from robocar.paths import MODELS
from robocar.scenario.model import Scenario
from robocar.validation import read_mapping, validated


def scenario_names() -> list[str]:
    """Scenarios that come with Robocar."""
    return sorted(file.stem for file in (MODELS / "scenarios").glob("*.yaml"))


def find_scenario(name: str) -> Path:
    """The file of a scenario given by name or path.

    Raises:
        ScenarioError: there is none; the message lists what there is.
    """
    if Path(name).suffix or "/" in name:
        path = Path(name).expanduser()
        if os.path.isfile(path):
            return path
        raise ScenarioError(f"{name}: no such file")
    path = MODELS / "scenarios" / f"{name}.yaml"
    if path.is_file():
        return path
    known = scenario_names()
    raise ScenarioError(f"unknown scenario {name!r}{did_you_mean(name, known)}; known: {', '.join(known)}")


def load_scenario(source: str | Path | Mapping[str, Any] | Scenario, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """A scenario from a name, a file, a mapping or another scenario, with dotted overrides (`{"robot.lidar": "hokuyo"}`).

    Raises:
        ScenarioError: no such file, not YAML, unknown keys or bad values; the message names each field.
    """
    if isinstance(source, Scenario):
        content, where, folder = source.model_dump(), source.name, source.folder
    elif isinstance(source, Mapping):
        content, where, folder = dict(source), str(source.get("name", "scenario")), Path.cwd()
    else:
        path = find_scenario(str(source))
        content, where, folder = read_mapping(path, "a scenario"), str(path), path.resolve().parent
        if "folder" in content:
            raise ScenarioError(f"{path}: unknown key 'folder'")
        content.setdefault("name", path.stem)
    for key, value in (overrides or {}).items():
        _put(content, key, value)
    return validated(Scenario, content | {"folder": folder}, where)


def _put(content: dict[str, Any], key: str, value: Any) -> None:
    """Sets a dotted key in nested mappings; that it exists is checked when the result is validated."""
    *parents, last = key.split(".")
    if "folder" in (*parents, last)[:1]:  # no key of the file
        raise ScenarioError("unknown key 'folder'")
    for parent in parents:
        inner = content.get(parent)
        content[parent] = inner = dict(inner) if isinstance(inner, Mapping) else {}
        content = inner
    content[last] = value


def json_schema() -> dict[str, Any]:
    """The JSON schema of scenario files, for editors."""
    schema = Scenario.model_json_schema()
    schema["properties"].pop("folder", None)
    return schema
