"""Settings, `path.to.parameter=value`: of the scenario, and of the parts of a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from robocar.core import ScenarioError
from robocar.core.text import shown
from robocar.reading import parse_yaml

COMPONENTS = ("navigator", "estimator", "mapper")


def flat(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with one name for each parameter of a part: `{"navigator.controller": {"sim_time": 2}}` sets
    `navigator.controller.sim_time`, too. Equal settings are then equal.

    Raises:
        ScenarioError: a name is empty, or no text; a parameter is set twice; or a mapping holds none.
    """
    found: dict[str, Any] = {}
    for key, value in settings.items():
        if not isinstance(key, str) or not all(key.split(".")):
            raise ScenarioError(f"--set {key!s:.80}: expected path.to.parameter, with a name between the dots")
        part_of = key.partition(".")[0] in COMPONENTS
        for name, leaf in _leaves(key, value) if part_of else ((key, value),):
            if name in found:
                raise ScenarioError(f"--set {name}: it is set twice, to {found[name]!r:.80} and to {leaf!r:.80}")
            found[name] = leaf
    return found


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    if not isinstance(value, Mapping):
        yield key, value
    elif not value:
        raise ScenarioError(f"--set {key}: {{}} sets no parameter")
    else:
        for name, inner in value.items():
            if not isinstance(name, str) or not all(name.split(".")):
                raise ScenarioError(f"--set {key}: {name!r:.80} is not the name of a parameter")
            yield from _leaves(f"{key}.{name}", inner)


def split_overrides(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """`flat` settings, apart: those of the scenario, and those of the navigator, the estimator and the mapper, nested by part."""
    scenario: dict[str, Any] = {}
    components: dict[str, dict[str, Any]] = {kind: {} for kind in COMPONENTS}
    for key, value in settings.items():
        head, dot, rest = key.partition(".")
        if dot and head in components:
            _put(components[head], rest, value, key)
        elif key in COMPONENTS:
            raise ScenarioError(f"--set {key}: choose it with --{key}; --set {key}.<parameter>=<value> sets its parameters")
        else:
            scenario[key] = value
    return scenario, components


def _put(parameters: dict[str, Any], path: str, value: Any, key: str) -> None:
    """Sets `part.name` in nested mappings."""
    *parts, name = path.split(".")
    for part in parts:
        inner = parameters.setdefault(part, {})
        if not isinstance(inner, dict):
            raise ScenarioError(f"--set {key}: {part} is set to {inner!r} already, and cannot have parameters too")
        parameters = inner
    if isinstance(parameters.get(name), dict):
        raise ScenarioError(f"--set {key}: parameters of {name} are set already, so it cannot be {value!r}")
    parameters[name] = value


def parse_setting(text: str) -> tuple[str, Any]:
    """`path.to.parameter=value`, the value in YAML."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ScenarioError(f"--set {shown(text)}: expected path.to.parameter=value")
    return key.strip(), parse_yaml(value, f"--set {key.strip():.80}", ScenarioError)
