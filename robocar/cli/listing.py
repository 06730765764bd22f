"""The commands `list` and `schema`."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import tyro

from robocar.cli.output import Flag, dumps, put

KINDS = ("scenarios", "navigators", "estimators", "mappers", "experiments", "suites")


def show_list(
    what: tyro.conf.Positional[
        Literal["all", "scenarios", "navigators", "estimators", "mappers", "experiments", "suites"]
    ] = "all",
    /,
    json: Flag = False,
) -> int:
    """List what there is.

    Args:
        what: scenarios, navigators, estimators, mappers, experiments or suites; without it, all of them.
        json: as one JSON object, of all kinds with an object for each.
    """
    kinds = KINDS if what == "all" else (what,)
    found = {kind: listing(kind) for kind in kinds}
    if json:
        put(dumps(found if what == "all" else found[what]))
        return 0
    for kind, entries in found.items():
        if what == "all":
            put(f"{'' if kind == KINDS[0] else chr(10)}{kind}:")
        width = max((len(name) for name in entries), default=0)
        for name, summary in entries.items():
            put(f"{'  ' if what == 'all' else ''}{name:{width}}  {summary}")
    return 0


def listing(what: str) -> dict[str, str]:
    """Names and one-line summaries."""
    from robocar.cli.experiments import experiment_names
    from robocar.episode import registry
    from robocar.episode.algorithms import TABLES
    from robocar.scenario.load import find_scenario, load_scenario, scenario_names

    if what == "scenarios":
        return {name: load_scenario(find_scenario(name)).description for name in scenario_names()}
    if what == "experiments":
        return {name: first_line(path) for name, path in experiment_names().items()}
    if what == "suites":
        from robocar.regression.suite import find_suite, load_suite, suite_names

        return {name: load_suite(find_suite(name)).description for name in suite_names()}
    kind: Any = what[:-1]
    found = {name: entry.summary + (f" ({entry.paper})" if entry.paper else "") for name, entry in registry.names(kind).items()}
    if kind == "navigator":
        ours = TABLES[kind]  # packages of others are not imported for a list
        found = {name: f"{text}; {among_movers(name)}" if name in ours else text for name, text in found.items()}
    return dict(sorted(found.items()))


def among_movers(navigator: str) -> str:
    """What a navigator promises where something moves (`robocar.core.capabilities`)."""
    from robocar.episode import registry

    avoids = registry.capabilities("navigator", navigator).avoids_movers is not None
    return "avoids movers" if avoids else "movers are obstacles that stand"


def first_line(module: Path) -> str:
    """First line of a module's docstring, without importing it."""
    return (ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or "").partition("\n")[0]


def print_schema(kind: tyro.conf.Positional[Literal["scenario", "suite"]], /) -> int:
    """Print the JSON schema of a kind of file, for editors.

    Args:
        kind: scenario or suite.
    """
    from robocar.regression.suite import SuiteModel
    from robocar.scenario.load import json_schema

    put(dumps(json_schema() if kind == "scenario" else SuiteModel.model_json_schema()))
    return 0


COMMANDS: dict[str, Callable[..., int]] = {"list": show_list, "schema": print_schema}
