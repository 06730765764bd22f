"""Which run it is: a digest of the whole effective configuration, and the readable name that carries it where needed.

Two different runs never share a digest. A name without one is that of a scenario that comes with Robocar, as it is, with
registered parts and no settings: there the words say everything.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from robocar.core import LogFormatError
from robocar.formats import file_kind, read_ros_yaml
from robocar.scenario.load import load_scenario, scenario_names
from robocar.scenario.model import Scenario
from robocar.sim.robot_model import robot_names

SHORT = 8
"""Digits of a digest in a name: among runs with the same words."""
_FILES = ("map", "prior", "robot.model")
"""Settings that name files: their content counts, which stands in the scenario's digest."""
_WORD = re.compile(r"[^\W_]\w*(\.\w+)*(-\w+(\.\w+)*)*")
"""A scenario's name that can stand in a run's name as it is: not hidden, no separator of names or folders in it."""
_PART = re.compile(r"[^\W_]+([.-][^\W_]+)*|\w+(\.\w+)*:[^\W_]+")
"""A part's: a registered one, or `module:factory`, whose colon becomes the last underscore, and nothing else does."""


def digest(*facts: Any) -> str:
    """16 hexadecimal digits of anything that JSON can hold, arrays too."""
    text = json.dumps(facts, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else repr(value)


def scenario_digest(scenario: Scenario) -> str:
    """Of all that a scenario says of the world: the content of its files instead of their places, and no default written out.

    Its description and its default parts are no part of the world.

    Raises:
        RobocarError: a file that it names cannot be read.
    """
    content = scenario.model_dump(mode="json", exclude_defaults=True, exclude={"description", "defaults"})
    content["map"] = _map_digest(scenario.file("map"))
    if scenario.prior not in ("truth", "none"):
        content["prior"] = _map_digest(scenario.file("prior"))
    if scenario.robot.model not in robot_names():
        content["robot"]["model"] = path_digest(scenario.robot_model().folder)
    return digest(content)


@dataclass(frozen=True, slots=True)
class Identity:
    """What a run is named after: a scenario, or a log.

    Args:
        name: what it calls itself; digest: of its content.
        shipped: whether it is the scenario that comes with Robocar under its name, as it is.
    """

    name: str
    digest: str
    shipped: bool = False

    @classmethod
    def of(cls, scenario: Scenario) -> Identity:
        """See `scenario_digest`."""
        found = scenario_digest(scenario)
        return cls(scenario.name, found, _shipped_digest(scenario.name) == found)

    def run_digest(self, parts: Mapping[str, str], seed: int, settings: Mapping[str, Any]) -> str:
        """Of the whole effective configuration.

        Args:
            parts: see `robocar.episode.given.part_identity`.
            settings: see `robocar.scenario.settings.flat`.
        """
        return digest(
            self.name, self.digest, dict(parts), seed, {key: value for key, value in settings.items() if key not in _FILES}
        )

    def run_name(self, parts: Mapping[str, str], seed: int, settings: Mapping[str, Any]) -> str:
        """`<scenario>--<navigator>--<estimator>--<mapper>--s<seed>[--<8 digits of the digest>]`: a folder's name.

        Args:
            parts, settings: as for the digest.
        """
        words = [self.name, *(parts[kind] for kind in ("navigator", "estimator", "mapper"))]
        plain = self.shipped and not settings and _WORD.fullmatch(self.name) and all(map(_PART.fullmatch, words[1:]))
        mark = [] if plain else [self.run_digest(parts, seed, settings)[:SHORT]]
        return "--".join([*map(_as_word, words), f"s{seed}", *mark])


@cache
def _shipped_digest(name: str) -> str | None:
    """Of the scenario that comes with Robocar under this name; as it was first, where somebody edits it meanwhile."""
    return scenario_digest(load_scenario(name)) if name in scenario_names() else None


def _as_word(word: str) -> str:
    """A name of a file on any system: no separators, nothing hidden, nothing that cannot be written."""
    plain = re.sub(r"[^\w.-]", "_", word.partition("#")[0])
    return re.sub(r"^[.-]", "_", re.sub(r"-{2,}", "-", plain)) or "_"


def _map_digest(path: Path) -> str:
    """A map_server map is two files."""
    return digest(path_digest(path), path_digest(read_ros_yaml(path).image) if file_kind(path) == "ros_map" else None)


def path_digest(path: Path) -> str:
    """Of a file's bytes, or of the files in a folder with their names.

    Raises:
        LogFormatError: it cannot be read.
    """
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file() and not file.name.startswith("."))
        return digest(*((file.relative_to(path).as_posix(), path_digest(file)) for file in files))
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError) as error:
        raise LogFormatError(f"{path}: cannot be read: {error}") from error
