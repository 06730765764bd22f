"""YAML files that people write: read, and validated into a pydantic model with errors in our words."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from robocar.core import ScenarioError
from robocar.core.suggestions import did_you_mean
from robocar.core.text import shown
from robocar.reading import read_yaml

Model = TypeVar("Model", bound=BaseModel)
Schema: TypeAlias = dict[str, Any]


def _no_flag(value: Any) -> Any:
    """YAML's `yes` and `on` are flags, which Python would take for the number 1."""
    if isinstance(value, bool):
        raise ValueError(f"expected a number, not {value}")
    return value


Finite = Annotated[float, BeforeValidator(_no_flag), Field(allow_inf_nan=False)]
NotNegative = Annotated[float, BeforeValidator(_no_flag), Field(ge=0, allow_inf_nan=False)]
NotPositive = Annotated[float, BeforeValidator(_no_flag), Field(le=0, allow_inf_nan=False)]
Positive = Annotated[float, BeforeValidator(_no_flag), Field(gt=0, allow_inf_nan=False)]
Count = Annotated[int, BeforeValidator(_no_flag), Field(gt=0, le=2**53)]
"""As far as floats count."""

_MOST_ERRORS = 20  # of one file that are shown

_POSITIVE = (
    "period",
    "timestep",
    "control_period",
    "max_range",
    "beam_width",
    "resolution",
    "width",
    "height",
    "opening",
    "beams",
)


_PLAUSIBLE = {
    "": (0.0, 1e6),
    "timestep": (1e-4, 0.05),
    "control_period": (1e-3, 10.0),
    "period": (1e-4, 1e4),
    "max_range": (1e-3, 1e4),
    "beams": (1, 10_000),
    "width": (1e-3, 4096),
    "height": (1e-3, 4096),
    "resolution": (1e-4, 1e3),
    "friction_std": (0.0, 1.0),
    "wheel_radius_std": (0.0, 0.5),
}
"""What physics and sensors can do at all; 0 is judged by `_POSITIVE`."""


def read_mapping(path: Path, what: str) -> dict[str, Any]:
    """The mapping in a YAML file; `what` it is, for the message.

    Raises:
        ScenarioError: the file cannot be read, or holds none; with the line where there is one.
    """
    content = read_yaml(path, ScenarioError)
    if not isinstance(content, dict):
        raise ScenarioError(f"{path}: {what} is a mapping of keys to values, not {type(content).__name__}")
    return content


def refuse_senseless(cls: Any, values: Mapping[str, Any], where: str = "") -> None:
    """Parameters of the dataclass `cls` come without negative numbers, and what divides (periods, sizes, ranges) without zeros.

    A period that is zero by default may be zero: as often as possible.

    Raises:
        ValueError: one of `values` makes no sense; the message says which and what would.
    """
    defaults = {field.name: field.default for field in fields(cls)}
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        path = f"{where}.{name}" if where else name
        zero_is_fine = name not in _POSITIVE or defaults[name] == 0
        # An int may be larger than any float.
        if not (abs(value) <= sys.float_info.max and (value >= 0 if zero_is_fine else value > 0)):
            raise ValueError(f"{path}: expected a finite number {'from 0 on' if zero_is_fine else 'above 0'}, not {shown(value)}")
        low, high = _PLAUSIBLE.get(name, _PLAUSIBLE[""])
        if value != 0 and not low <= value <= high:
            raise ValueError(f"{path}: expected a number from {low:g} to {high:g}, not {shown(value)}")
        if name == "dropout" and value > 1:
            raise ValueError(f"{path}: expected a share of the readings, 0 to 1, not {value}")


def validated(model: type[Model], content: Mapping[str, Any], where: str) -> Model:
    """The content as a `model`.

    Raises:
        ScenarioError: naming `where` and every field that is wrong, its value and what would be valid.
    """
    try:
        return model.model_validate(dict(content))
    except ValidationError as error:
        found = error.errors(include_url=False)
        more = [f"and {len(found) - _MOST_ERRORS} more"] if len(found) > _MOST_ERRORS else []
        schema = model.model_json_schema()
        raise ScenarioError(f"{where}: " + "; ".join([*(_explain(schema, e) for e in found[:_MOST_ERRORS]), *more])) from error


def _explain(schema: Schema, error: Any) -> str:
    """One pydantic error of the model with this schema in our words."""
    location = [part for part in error["loc"] if not (isinstance(part, str) and ("[" in part or part.startswith("function-")))]
    field = ".".join(str(part) for part in location)
    if error["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        known = _keys_at(schema, location[:-1])
        return f"unknown key {field!r}{_meant(schema, str(location[-1]), known)}; known: {', '.join(known)}"
    if error["type"] == "missing" and isinstance(location[-1], int):
        return f"{'.'.join(map(str, location[:-1]))}: number {location[-1] + 1} is missing"
    if error["type"] == "missing":
        return f"missing key {field!r}"
    if error["type"] == "too_long":
        return f"{field}: at most {error['ctx']['max_length']} numbers, not {shown(error['input'])}"
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        return f"{field}: {message}" if field else message
    return f"{field}: {message}, not {shown(error['input'])}"


def _meant(schema: Schema, key: str, known: Sequence[str]) -> str:
    """A key of another place under its own name, rather than a similar one of this place, rather than one of another place."""
    places: dict[str, list[str]] = {}
    for path in _paths(schema):
        places.setdefault(path.rpartition(".")[2], []).append(path)
    if key not in places and (near := did_you_mean(key, known)):
        return near
    names = [key] if key in places else difflib.get_close_matches(key, places, n=1, cutoff=0.8)
    found = [path for name in names for path in places[name]]
    return f" (did you mean {' or '.join(map(repr, found))}?)" if found else ""


def _paths(schema: Schema) -> list[str]:
    """Dotted paths of all keys that are not in a list."""
    found: list[str] = []
    to_do = [(name,) for name in _keys_at(schema, ())]
    while to_do:
        path = to_do.pop(0)
        found.append(".".join(path))
        to_do += [(*path, name) for name in _keys_at(schema, path)]
    return found


def _keys_at(schema: Schema, location: Sequence[int | str]) -> list[str]:
    """Valid keys of the part of the model that a location leads to."""
    node = schema
    for part in location:
        inner = node.get("items") if isinstance(part, int) else node.get("properties", {}).get(part)
        node = inner or node.get("additionalProperties") or {}
        for choice in (node, *node.get("anyOf", []), *node.get("allOf", [])):
            if "$ref" in choice:
                node = schema["$defs"][choice["$ref"].rpartition("/")[2]]
                break
    return [key for key in node.get("properties", {}) if key != "folder"]
