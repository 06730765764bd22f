"""Settings, `path.to.parameter=value`: of the scenario, and of the parts of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from robocar.core import ScenarioError

COMPONENTS = ("navigator", "estimator", "mapper")


def split_overrides(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """`--set` pairs, apart: those of the scenario, and those of the navigator, the estimator and the mapper."""
    scenario: dict[str, Any] = {}
    components: dict[str, dict[str, Any]] = {kind: {} for kind in COMPONENTS}
    for key, value in settings.items():
        head, dot, rest = key.partition(".")
        if dot and head in components:
            components[head][rest] = value
        elif key in COMPONENTS:
            raise ScenarioError(f"--set {key}: choose it with --{key}; --set {key}.<parameter>=<value> sets its parameters")
        else:
            scenario[key] = value
    return scenario, components


def parse_setting(text: str) -> tuple[str, Any]:
    """`path.to.parameter=value`, the value in YAML."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ScenarioError(f"--set {text!r}: expected path.to.parameter=value")
    try:
        return key.strip(), yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise ScenarioError(f"--set {text!r}: the value is not YAML") from error
