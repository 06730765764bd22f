"""YAML files that people write (scenarios, suites): read, and validated into a pydantic model with errors in our words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from robocar.core import ScenarioError
from robocar.core.suggestions import did_you_mean

Model = TypeVar("Model", bound=BaseModel)


def read_mapping(path: Path, what: str) -> dict[str, Any]:
    """The mapping in a YAML file; `what` it is, for the message.

    Raises:
        ScenarioError: the file cannot be read, or holds none; with the line where there is one.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: cannot be read: {error}") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}:" if mark is not None else ""
        raise ScenarioError(f"{path}:{line} not YAML: {getattr(error, 'problem', error)}") from error
    if not isinstance(content, dict):
        raise ScenarioError(f"{path}: {what} is a mapping of keys to values, not {type(content).__name__}")
    return content


def validated(model: type[Model], content: Mapping[str, Any], where: str) -> Model:
    """The content as a `model`.

    Raises:
        ScenarioError: naming `where` and every field that is wrong, its value and what would be valid.
    """
    try:
        return model.model_validate(dict(content))
    except ValidationError as error:
        raise ScenarioError(f"{where}: " + "; ".join(_explain(model, e) for e in error.errors())) from error


def _explain(model: type[BaseModel], error: Any) -> str:
    """One pydantic error in our words."""
    location = [part for part in error["loc"] if not (isinstance(part, str) and ("[" in part or part.startswith("function-")))]
    field = ".".join(str(part) for part in location)
    if error["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        known = _keys_at(model, location[:-1])
        return f"unknown key {field!r}{did_you_mean(str(location[-1]), known)}; known: {', '.join(known)}"
    if error["type"] == "missing" and isinstance(location[-1], int):
        return f"{'.'.join(map(str, location[:-1]))}: number {location[-1] + 1} is missing"
    if error["type"] == "missing":
        return f"missing key {field!r}"
    if error["type"] == "too_long":
        return f"{field}: at most {error['ctx']['max_length']} numbers, not {error['input']!r}"
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        return f"{field}: {message}" if field else message
    return f"{field}: {message}, not {error['input']!r}"


def _keys_at(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """Valid keys of the part of the model that a location leads to."""
    schema = model.model_json_schema()
    node: dict[str, Any] = schema
    for part in location:
        inner = node.get("items") if isinstance(part, int) else node.get("properties", {}).get(part)
        node = inner or node.get("additionalProperties") or {}
        for choice in (node, *node.get("anyOf", []), *node.get("allOf", [])):
            if "$ref" in choice:
                node = schema["$defs"][choice["$ref"].rpartition("/")[2]]
                break
    return [key for key in node.get("properties", {}) if key != "folder"]
