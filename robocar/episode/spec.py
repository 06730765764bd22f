"""What is run: a scenario, the parts that drive it, a seed and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypedDict

from robocar.core import ParameterError, RobocarError, ScenarioError
from robocar.episode.algorithms import Kind
from robocar.episode.given import Part, part_identity, part_name
from robocar.episode.identity import SHORT, Identity
from robocar.episode.registry import find, parameters
from robocar.scenario.load import load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.settings import flat, split_overrides


class RunOptions(TypedDict, total=False):
    """What `robocar.run` takes beside the scenario and the output.

    Args:
        navigator, estimator, mapper: registered names, `package.module:factory`, or a class or factory itself, which is called
            with the `Context`; the scenario's defaults otherwise.
        seed: of all noise, tolerances and sampling.
        settings: what `--set` takes, e.g. `{"robot.lidar": "hokuyo", "navigator.controller.max_vel_x": 0.2}`.
    """

    navigator: Part | None
    estimator: Part | None
    mapper: Part | None
    seed: int
    settings: Mapping[str, Any] | None


@dataclass(frozen=True)
class RunSpec:
    """One run, whole: equal specifications are equal runs.

    Args:
        scenario: with the settings that are its own.
        navigator, estimator, mapper: names of the parts.
        settings: as given, those of the scenario too.
        parameters: those of the settings that are the parts' own, by kind of part, nested.
        given: what was asked for, by kind of part: the names, or the classes and factories that were handed over themselves.
        log: digest of what is replayed, empty where the scenario is simulated.
    """

    scenario: Scenario
    navigator: str
    estimator: str
    mapper: str
    seed: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    given: Mapping[Kind, Part] = field(default_factory=dict)
    log: str = ""

    @classmethod
    def of(
        cls,
        scenario: str | Path | Mapping[str, Any] | Scenario,
        navigator: Part | None = None,
        estimator: Part | None = None,
        mapper: Part | None = None,
        seed: int = 0,
        settings: Mapping[str, Any] | None = None,
    ) -> RunSpec:
        """See `robocar.run`.

        Raises:
            ScenarioError, UnknownNameError: bad input.
        """
        settings = flat(settings or {})
        scenario_settings, own = split_overrides(settings)
        checked_seed(seed)
        try:
            loaded = load_scenario(scenario, scenario_settings)
        except ScenarioError as error:
            asked: dict[Kind, Part | None] = {"navigator": navigator, "estimator": estimator, "mapper": mapper}
            hint = _parameters_meant(scenario, scenario_settings, asked)
            raise ScenarioError(f"{error}{hint}") from error
        chosen: dict[Kind, Part] = {
            "navigator": navigator or loaded.defaults.navigator,
            "estimator": estimator or loaded.defaults.estimator,
            "mapper": mapper or loaded.defaults.mapper,
        }
        for kind, part in chosen.items():
            find(kind, part)
        names = [part_name(part) for part in chosen.values()]
        return cls(loaded, *names, seed=seed, settings=settings, parameters=own, given=chosen)

    @property
    def parts(self) -> dict[str, str]:
        """Names of navigator, estimator and mapper, by kind."""
        return {"navigator": self.navigator, "estimator": self.estimator, "mapper": self.mapper}

    def part(self, kind: Kind) -> Part:
        """What builds a part: its name, or what was handed over."""
        return self.given.get(kind, getattr(self, kind))

    @cached_property
    def identity(self) -> Identity:
        """What the run is named after."""
        return Identity(self.scenario.name, self.log) if self.log else Identity.of(self.scenario)

    @cached_property
    def digest(self) -> str:
        """Of the whole effective configuration, see `robocar.episode.identity`.

        Raises:
            ParameterError: see `part_identity`.
        """
        return self.identity.run_digest(self._identities, self.seed, self.settings)

    @cached_property
    def name(self) -> str:
        """Of the run's directory, its baseline and its kept recording. Raises as `digest` does."""
        return self.identity.run_name(self._identities, self.seed, self.settings)

    @property
    def _identities(self) -> dict[str, str]:
        return {kind: part_identity(self.part(kind)) for kind in ("navigator", "estimator", "mapper")}

    @property
    def label(self) -> str:
        """Its name; empty where a part was handed over that has none, see `part_identity`."""
        try:
            return self.name
        except ParameterError:
            return ""

    @property
    def recording_id(self) -> str:
        """Its name with the digest, always: viewers show only one of two recordings with one id."""
        mark = self.digest[:SHORT]
        return self.name if self.name.endswith(f"--{mark}") else f"{self.name}--{mark}"


def _parameters_meant(source: Any, settings: Mapping[str, Any], chosen: Mapping[Kind, Part | None]) -> str:
    """Which of the settings that no scenario has are parameters of the parts: `--set lookahead_dist=0.3`."""
    strangers = {key.rpartition(".")[2]: key for key in settings if key.partition(".")[0] not in Scenario.model_fields}
    if not strangers:
        return ""
    try:
        defaults = load_scenario(source).defaults
        paths = [
            (f"{kind}.{path}", kind, part_name(part or getattr(defaults, kind)))
            for kind, part in chosen.items()
            for path in parameters(find(kind, part or getattr(defaults, kind)))
            if path.rpartition(".")[2] in strangers
        ]
    except RobocarError:
        return ""
    return "".join(f"; {strangers[path.rpartition('.')[2]]!r}: {kind} {name!r} has {path!r}" for path, kind, name in paths)


def checked_seed(seed: object) -> int:
    """The seed, if it is one.

    Raises:
        ScenarioError: it is not.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ScenarioError(f"the seed must be a non-negative integer, not {seed!r}")
    return seed
