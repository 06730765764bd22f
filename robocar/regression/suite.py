"""Suites: which scenarios, navigators, estimators and seeds are run together, and what is judged how."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from robocar.core import ParameterError, RobocarError, ScenarioError, UnknownNameError
from robocar.core.suggestions import did_you_mean
from robocar.episode.identity import Identity
from robocar.episode.registry import check_parameters, find, registered
from robocar.metrics import Tolerance
from robocar.paths import MODELS
from robocar.regression.judgement import tolerances
from robocar.regression.results import settings_text
from robocar.scenario.load import find_scenario, load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.settings import COMPONENTS, flat, split_overrides
from robocar.validation import read_mapping, validated

MOST_SEEDS = 10_000


def _seeds(value: Any) -> Any:
    """`0-9` for the ten seeds from 0 to 9."""
    if isinstance(value, str):
        first, dash, last = value.partition("-")
        if not (dash and first.strip().isdecimal() and last.strip().isdecimal()):
            raise ValueError(f"expected a list of whole numbers or FIRST-LAST, not {value!r}")
        low, high = int(first), int(last)
        if not low <= high < low + MOST_SEEDS:
            raise ValueError(f"FIRST-LAST must ascend and hold at most {MOST_SEEDS} seeds, not {value!r}")
        return list(range(low, high + 1))
    if isinstance(value, list) and any(isinstance(seed, bool) for seed in value):
        raise ValueError(f"expected whole numbers, not {value!r}")
    return value


Seeds = Annotated[list[Annotated[int, Field(ge=0)]], BeforeValidator(_seeds), Field(min_length=1)]
Names = Annotated[list[str], Field(min_length=1)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ToleranceModel(_Model):
    """What differs from the default of this metric."""

    better: Literal["lower", "higher", "neither"] | None = None
    absolute: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    relative: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None


class Block(_Model):
    """Every scenario with every navigator, estimator, mapper and seed; what is left out is the scenario's default."""

    scenarios: Names
    navigators: Names | None = None
    estimators: Names | None = None
    mappers: Names | None = None
    seeds: Seeds = [0]
    settings: dict[str, Any] = {}


class SuiteModel(_Model):
    """A suite as in its YAML file.

    `settings` are as for `robocar run --set`, for all blocks or for one. `limit` is the wall time that a run may take [s],
    `record` writes recordings. `exact`: a run that no longer repeats its baseline bit by bit counts as a failure, where hashes
    can be compared. `tolerances` change what `robocar compare` lets pass.
    """

    name: str = "unnamed"
    description: str = ""
    runs: Annotated[list[Block], Field(min_length=1)]
    settings: dict[str, Any] = {}
    limit: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 600.0
    record: bool = False
    exact: bool = False
    tolerances: dict[str, ToleranceModel] = {}


@dataclass(frozen=True, slots=True)
class Case:
    """One run of a suite.

    Args:
        scenario: a name from `models/scenarios` or an absolute path; scenario_name: what the scenario calls itself.
        settings: as `robocar.run` takes them.
        name: of its run directory.
    """

    name: str
    scenario: str
    scenario_name: str
    navigator: str
    estimator: str
    mapper: str
    seed: int
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> tuple[object, ...]:
        """By what tables tell it from others."""
        return self.scenario_name, self.navigator, self.estimator, self.mapper, self.seed, settings_text(self.settings)

    def arguments(self) -> dict[str, Any]:
        """What `robocar.run` is called with."""
        return {
            "scenario": self.scenario,
            "navigator": self.navigator,
            "estimator": self.estimator,
            "mapper": self.mapper,
            "seed": self.seed,
            "settings": dict(self.settings),
        }


@dataclass(frozen=True, slots=True)
class Suite:
    """A checked suite: `cases` are its runs, `tolerances` the complete table. The other fields are those of its file."""

    name: str
    description: str
    cases: tuple[Case, ...]
    tolerances: Mapping[str, Tolerance]
    limit: float
    record: bool
    exact: bool


def suite_names() -> list[str]:
    """Suites that come with Robocar."""
    return sorted(file.stem for file in (MODELS / "suites").glob("*.yaml"))


def find_suite(name: str | Path) -> Path:
    """The file of a suite given by name or path.

    Raises:
        ScenarioError: there is none; the message lists what there is.
    """
    path = Path(name).expanduser()
    if path.suffix or len(path.parts) > 1:
        if os.path.isfile(path):
            return path
        raise ScenarioError(f"{name}: no such file")
    shipped = MODELS / "suites" / f"{name}.yaml"
    if shipped.is_file():
        return shipped
    known = suite_names()
    raise ScenarioError(f"unknown suite {str(name)!r}{did_you_mean(str(name), known)}; known: {', '.join(known)}")


def load_suite(source: str | Path | Mapping[str, Any], *, navigators: Sequence[str] = (), seeds: Sequence[int] = ()) -> Suite:
    """A suite from a name, a file or a mapping with the same keys, with every name in it checked.

    Args:
        navigators: run these instead of the suite's; here also `package.module:factory`, which a file may not name.
        seeds: run these instead of the suite's.

    Raises:
        ScenarioError: everything that is wrong with it, at once.
    """
    if isinstance(source, Mapping):
        content, where, folder = dict(source), str(source.get("name", "suite")), Path.cwd()
    else:
        path = find_suite(source)
        content, where, folder = read_mapping(path, "a suite"), str(path), path.resolve().parent
        content.setdefault("name", path.stem)
    model = validated(SuiteModel, content, where)
    for seed in seeds:
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise ScenarioError(f"a seed must be a non-negative integer, not {seed!r}")
    check = _Check(folder)
    cases = tuple(case for i, block in enumerate(model.runs) for case in check.block(model, block, i, navigators, seeds))
    check.duplicates(cases)
    changes = {metric: change.model_dump(exclude_none=True) for metric, change in model.tolerances.items()}
    for metric in changes:
        if metric not in (judged := tolerances()):
            known = f"; known: {', '.join(judged)}"
            check.errors.append(f"tolerances: unknown metric {metric!r}{did_you_mean(metric, judged)}{known}")
    if check.errors:
        raise ScenarioError(f"{where}: " + "; ".join(dict.fromkeys(check.errors)))
    return Suite(model.name, model.description, cases, tolerances(changes), model.limit, model.record, model.exact)


class _Check:
    """Expands blocks into cases and collects what is wrong with them."""

    def __init__(self, folder: Path) -> None:
        self.errors: list[str] = []
        self._folder = folder

    def block(
        self, suite: SuiteModel, block: Block, number: int, navigators: Sequence[str], seeds: Sequence[int]
    ) -> Iterator[Case]:
        where = f"runs.{number}"
        try:
            settings = flat({**suite.settings, **block.settings})
            scenario_settings, given = split_overrides(settings)
        except ScenarioError as error:
            self.errors.append(f"{where}.settings: {error}")
            return
        chosen = {
            "navigator": list(navigators) or block.navigators,
            "estimator": block.estimators,
            "mapper": block.mappers,
        }
        good = {kind: self._known(kind, found, where, kind == "navigator" and bool(navigators)) for kind, found in chosen.items()}
        for scenario in block.scenarios:
            found = self._scenario(scenario, scenario_settings, where)
            if found is None:
                continue
            source, loaded, identity = found
            defaults = {kind: [getattr(loaded.defaults, kind)] for kind in COMPONENTS}
            choices = [defaults[kind] if chosen[kind] is None else good[kind] for kind in COMPONENTS]
            for kind, choice in zip(COMPONENTS, choices, strict=True):
                self._parameters(kind, choice, given[kind], where)
            for (navigator, estimator, mapper), seed in product(product(*choices), seeds or block.seeds):
                parts = {"navigator": navigator, "estimator": estimator, "mapper": mapper}
                name = identity.run_name(parts, seed, settings)
                yield Case(name, source, loaded.name, seed=seed, settings=settings, **parts)

    def duplicates(self, cases: Sequence[Case]) -> None:
        """Tables and comparisons tell runs by their scenario's name, their parts, their seed and their settings."""
        seen: dict[object, Case] = {}
        for case in cases:
            first = seen.setdefault(case.key, case)
            if first is not case:
                twice = "is named twice" if first.scenario == case.scenario else f"is of {first.scenario} and of {case.scenario}"
                self.errors.append(f"duplicate run: {case.name} {twice}")

    def _known(self, kind: str, wanted: Sequence[str] | None, where: str, from_command_line: bool) -> list[str]:
        good = []
        for name in wanted or ():
            if ":" in name and not from_command_line:
                self.errors.append(f"{where}.{kind}s: a suite runs no code: {name!r} may only be given on the command line")
                continue
            try:
                (find if from_command_line else registered)(kind, name)  # type: ignore[arg-type]
            except UnknownNameError as error:
                self.errors.append(str(error) if from_command_line else f"{where}.{kind}s: {error}")
            else:
                good.append(name)
        return good

    def _scenario(self, name: str, settings: Mapping[str, Any], where: str) -> tuple[str, Scenario, Identity] | None:
        try:
            beside = self._folder / name
            path = beside if ("/" in name or Path(name).suffix) and os.path.isfile(beside) else find_scenario(name)
            source = name if path.parent == MODELS / "scenarios" and path.stem == name else str(path.resolve())
            loaded = load_scenario(path, settings)
            for map_field in ("map", *(["prior"] if loaded.prior not in ("none", "truth") else [])):
                loaded.file(map_field)
            identity = Identity.of(loaded)
        except RobocarError as error:
            self.errors.append(f"{where}.scenarios: {error}")
            return None
        return source, loaded, identity

    def _parameters(self, kind: str, chosen: Sequence[str], given: Mapping[str, Any], where: str) -> None:
        for name in chosen if given else ():
            try:
                check_parameters(kind, name, given)  # type: ignore[arg-type]
            except ParameterError as error:
                self.errors.append(f"{where}.settings: {error}")
