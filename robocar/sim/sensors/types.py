"""The types of sensors that there are, and their parameters."""

from __future__ import annotations

import importlib
import importlib.metadata
import pkgutil
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter, create_model

from robocar.core import UnknownNameError
from robocar.core.suggestions import did_you_mean
from robocar.core.text import describe
from robocar.sim import sensors
from robocar.sim.sensors.sensor import SensorType
from robocar.validation import refuse_senseless

GROUP = "robocar.sensors"
"""Entry points by which other packages add types."""

Overrides = Mapping[str, Mapping[str, Any]]
"""Parameters by type and name, e.g. `{"sonar": {"range_std": 0.0}}`."""


def sensor_types() -> Mapping[str, SensorType[Any]]:
    """All of them by name."""
    return _types_in(tuple(sensors.__path__))


@cache
def _types_in(folders: tuple[str, ...]) -> Mapping[str, SensorType[Any]]:
    found: dict[str, SensorType[Any]] = {}
    for module in pkgutil.iter_modules(folders, f"{sensors.__name__}."):
        declared = getattr(importlib.import_module(module.name), "SENSOR", None)  # helpers of the folder declare none
        if declared is not None:
            found[module.name.rpartition(".")[2]] = declared
    for point in importlib.metadata.entry_points(group=GROUP):
        found.setdefault(point.name, loaded(point))
    return MappingProxyType(found)


def loaded(point: importlib.metadata.EntryPoint) -> SensorType[Any]:
    """What a package declares.

    Raises:
        UnknownNameError: it cannot be imported, or is no type of sensor.
    """
    what = f"sensor {point.name!r} = {point.value} of {point.dist.name if point.dist else 'a package'}"
    try:
        declared = point.load()
    except Exception as error:  # whatever the module does while it is imported
        raise UnknownNameError(f"{what} cannot be imported: {describe(error)}") from error
    if not isinstance(declared, SensorType):
        raise UnknownNameError(f"{what} must be a SensorType, not {type(declared).__name__}")
    return declared


def sensor_type(name: str) -> SensorType[Any]:
    """The type of this name.

    Raises:
        UnknownNameError: there is none; the message lists what there is.
    """
    known = sensor_types()
    if name not in known:
        raise UnknownNameError(f"unknown type of sensor {name!r}{did_you_mean(name, known)}; known: {', '.join(sorted(known))}")
    return known[name]


def checked_overrides(given: Any) -> dict[str, dict[str, Any]]:
    """Parameters by type, each of its parameter's type; only those that were given.

    Raises:
        ValueError: an unknown type or parameter, or a value that makes no sense (pydantic's ValidationError, or a plain one).
    """
    declared = {name: kind.parameters for name, kind in sensor_types().items()}
    valid = _section(tuple(declared.items())).model_validate(given)
    for name, values in dict(given).items():
        numbers = {field.name for field in fields(declared[name]) if type(field.default) in (int, float)}
        if flags := [key for key, value in values.items() if isinstance(value, bool) and key in numbers]:
            raise ValueError(f"{name}.{flags[0]}: expected a number, not {values[flags[0]]}")
    chosen = {name: {key: getattr(getattr(valid, name), key) for key in values} for name, values in dict(given).items()}
    for name, values in chosen.items():
        refuse_senseless(declared[name], values, name)
    return chosen


@cache
def _section(declared: tuple[tuple[str, type], ...]) -> type[BaseModel]:
    """What a scenario's `robot.sensors` may hold, as pydantic's model."""
    sections: dict[str, Any] = {name: (parameters, None) for name, parameters in declared}
    return create_model("Sensors", __config__=ConfigDict(extra="forbid"), **sections)


def overrides_schema() -> dict[str, Any]:
    """The JSON schema of what `checked_overrides` takes."""
    properties = {name: _schema(kind.parameters) for name, kind in sensor_types().items()}
    return {"type": "object", "additionalProperties": False, "properties": properties}


@cache
def _schema(parameters: type) -> dict[str, Any]:
    return TypeAdapter(parameters).json_schema()


def parameters_of(name: str, *layers: Mapping[str, Any]) -> Any:
    """The parameters of type `name`; later layers override earlier ones, and all of them the defaults."""
    chosen = {key: value for layer in layers for key, value in layer.items()}
    return sensor_type(name).parameters(**chosen)
