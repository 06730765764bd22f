"""What is run: a scenario, the parts that drive it, a seed and settings."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict

from robocar.core import ScenarioError
from robocar.episode.registry import find
from robocar.scenario.load import load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.settings import flat, split_overrides


class RunOptions(TypedDict, total=False):
    """What `robocar.run` takes beside the scenario and the output.

    Args:
        navigator, estimator, mapper: registered names or `package.module:factory`; the scenario's defaults otherwise.
        seed: of all noise, tolerances and sampling.
        settings: what `--set` takes, e.g. `{"robot.lidar": "hokuyo", "navigator.controller.max_vel_x": 0.2}`.
    """

    navigator: str | None
    estimator: str | None
    mapper: str | None
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
    """

    scenario: Scenario
    navigator: str
    estimator: str
    mapper: str
    seed: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        scenario: str | Path | Mapping[str, Any] | Scenario,
        navigator: str | None = None,
        estimator: str | None = None,
        mapper: str | None = None,
        seed: int = 0,
        settings: Mapping[str, Any] | None = None,
    ) -> RunSpec:
        """See `robocar.run`.

        Raises:
            ScenarioError, UnknownNameError: bad input.
        """
        settings = flat(settings or {})
        scenario_settings, parameters = split_overrides(settings)
        checked_seed(seed)
        loaded = load_scenario(scenario, scenario_settings)
        chosen = {
            "navigator": navigator or loaded.defaults.navigator,
            "estimator": estimator or loaded.defaults.estimator,
            "mapper": mapper or loaded.defaults.mapper,
        }
        for kind, name in chosen.items():
            find(kind, name)  # type: ignore[arg-type]
        return cls(loaded, **chosen, seed=seed, settings=settings, parameters=parameters)

    @property
    def parts(self) -> dict[str, str]:
        """Names of navigator, estimator and mapper, by kind."""
        return {"navigator": self.navigator, "estimator": self.estimator, "mapper": self.mapper}

    @property
    def name(self) -> str:
        """Of the run's directory, see `run_name`."""
        return run_name(self.scenario.name, self.parts, self.seed, self.settings)


def run_name(scenario: str, parts: Mapping[str, str], seed: int, settings: Mapping[str, Any]) -> str:
    """`<scenario>--<navigator>--<estimator>--<mapper>--s<seed>[--<8 hex of the settings>]`."""
    words = [scenario, parts["navigator"], parts["estimator"], parts["mapper"], f"s{seed}"]
    if settings:
        text = json.dumps(dict(sorted(settings.items())), sort_keys=True, default=str)
        words.append(hashlib.sha256(text.encode()).hexdigest()[:8])
    return "--".join(word.replace("/", "_").replace(":", "_") for word in words)


def checked_seed(seed: object) -> int:
    """The seed, if it is one.

    Raises:
        ScenarioError: it is not.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ScenarioError(f"the seed must be a non-negative integer, not {seed!r}")
    return seed
