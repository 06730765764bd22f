"""Two different runs never share a name; equal ones always do. Oracle: the difference that was made, and the files' content."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import ParameterError
from robocar.episode.given import part_identity, part_name
from robocar.episode.identity import Identity, scenario_digest
from robocar.episode.replay import replay
from robocar.episode.run import run
from robocar.episode.spec import RunSpec
from robocar.scenario.load import load_scenario, scenario_names
from robocar.scenario.map_scenario import map_scenario
from tests.episode.runs import PARTS, SHORT

ROOM = "######\n#....#\n#....#\n######\n"
CHANGES: dict[str, Any] = {
    "start": [0.4, 0.3, 0], "goal": [1.2, 0.5], "prior": "none", "border": "open", "time_limit": 29.0, "wall_height": 0.4,
    "movers": [{"name": "cart", "cylinder": [0.1, 0.3], "waypoints": [[2.0, 2.0]]}], "start_known": False,
    "events": [{"time": 1.0, "kidnap": [0.5, 0.5, 0.0]}], "on_contact": "continue", "robot": {"compass": True},
    "unknown_obstacles": [{"box": [0.1, 0.1, 0.1], "pose": [2.0, 1.0, 0.0]}], "progress": {"movement_time_allowance": 5.0},
}  # fmt: skip


def name(scenario: Any, **options: Any) -> str:
    return RunSpec.of(scenario, **options).name


def test_each_part_of_the_configuration_makes_another_run() -> None:
    base: dict[str, Any] = {"scenario": SHORT, **PARTS}
    others = [base | {"scenario": SHORT | {key: value}} for key, value in CHANGES.items()]
    others += [base | {"scenario": SHORT | {"robot": {"physics": {"timestep": 0.004}}}}]
    others += [base | {"seed": 1}, base | {"navigator": "theta-star"}, base | {"estimator": "truth"}, base | {"mapper": "sonar"}]
    others += [base | {"settings": {key: value}} for key, value in (("time_limit", 30), ("navigator.controller.max_vel_x", 0.1))]
    specs = [RunSpec.of(**options) for options in [base, *others]]
    for which in ([spec.name for spec in specs], [spec.recording_id for spec in specs], [spec.digest for spec in specs]):
        assert len(set(which)) == len(specs) == 21
    assert name(SHORT | {"description": "words"}, **PARTS) == name(**base)
    assert name(SHORT | {"time_limit": float(SHORT["time_limit"])}, **PARTS) == name(**base)


def test_a_scenario_that_comes_with_robocar_is_known_by_its_name(tmp_path: Path) -> None:
    """And by nothing else: a file of this name is another scenario, unless it says the same."""
    for scenario in scenario_names():
        assert re.fullmatch(rf"{scenario}(--[a-z0-9-]+?){{3}}--s7", name(scenario, seed=7)), scenario
    content = yaml.safe_load((Path(__file__).parents[2] / "models/scenarios/tilted.yaml").read_text())
    mine = tmp_path / "tilted.yaml"
    mine.write_text(yaml.safe_dump(content))
    assert name(mine) == name("tilted")
    mine.write_text(yaml.safe_dump(content | {"time_limit": 77}))
    first = RunSpec.of(mine)
    mine.write_text(yaml.safe_dump(content | {"time_limit": 78}))
    second = RunSpec.of(mine)
    assert len({first.name, second.name, name("tilted")}) == 3
    assert len({first.recording_id, second.recording_id, RunSpec.of("tilted").recording_id}) == 3


def test_the_content_of_a_map_counts_and_not_its_place(tmp_path: Path) -> None:
    def at(file: Path, text: str = ROOM) -> str:
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
        return name(map_scenario(str(file), None, "1.5,1.5", "3.5,1.5"))

    first = at(tmp_path / "map.v1.txt")
    assert first.startswith("map.v1--")
    assert at(tmp_path / "map.v2.txt") != first
    assert at(tmp_path / "elsewhere" / "map.v1.txt") == first
    assert at(tmp_path / "other" / "map.v1.txt", ROOM.replace("....", "...#", 1)) != first


def test_a_map_server_map_is_two_files(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(
        "{image: m.pgm, resolution: 1, origin: [0, 0, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.2}"
    )
    scenario = {"map": str(tmp_path / "m.yaml"), "start": [1, 1, 0]}
    digests = set()
    for grey in (0, 254):
        (tmp_path / "m.pgm").write_text(f"P2\n2 2\n255\n{grey} 254 254 254\n")
        digests.add(scenario_digest(load_scenario(scenario)))
    assert len(digests) == 2


WORDS = st.text(st.characters(codec=None), min_size=1, max_size=12)  # surrogates too


@settings(max_examples=300, deadline=None)
@given(st.lists(WORDS, min_size=4, max_size=4), st.lists(WORDS, min_size=4, max_size=4))
def test_names_are_files_and_different_words_are_different_names(one: list[str], other: list[str]) -> None:
    found = []
    for words in (one, other):
        parts = dict(zip(("navigator", "estimator", "mapper"), words[1:], strict=True))
        found.append(Identity(words[0], "", shipped=True).run_name(parts, 0, {}))
        assert re.fullmatch(r"[\w][\w.-]*", found[-1])
        assert found[-1].encode()
    assert (found[0] == found[1]) == (one == other)


def test_words_that_read_alike_do_not_collide() -> None:
    def of(*words: str) -> str:
        return Identity(words[0], "", shipped=True).run_name(
            dict(zip(("navigator", "estimator", "mapper"), words[1:], strict=True)), 0, {}
        )

    assert of("a--b", "c", "d", "e") != of("a", "b--c", "d", "e")
    assert len({of("r", part, "d", "e") for part in ("a_b:c", "a:b_c", "a_b_c", "a.b:c", "a_b.c", "a:b.c")}) == 6
    assert of("a-", "b", "d", "e") != of("a", "-b", "d", "e")
    assert of("tilted", "wall_shy:build", "truth", "none") == "tilted--wall_shy_build--truth--none--s0"
    assert of("thesis-field", "a-star", "truth", "none") == "thesis-field--a-star--truth--none--s0"


class Stands:
    def __init__(self, context: Any) -> None: ...

    def command(self, state: Any, observation: Any, goal: Any) -> Any: ...


def made(value: Any) -> Any:
    return lambda context: (value, Stands(context))[1]


GAIN = 1


def test_parts_handed_over_are_told_apart() -> None:
    """A loop variable of a notebook is a global one."""
    global GAIN
    assert part_identity(Stands) == part_name(Stands) == f"{__name__}:Stands"
    several = [made(1), made(2), made("1"), made([1, 2]), made({"a": 1}), partial(Stands, 1), partial(Stands, 2), made(Stands)]
    assert len({part_identity(part) for part in several}) == len(several)
    assert part_identity(made((1, "a"))) == part_identity(made((1, "a")))
    over_a_global = lambda context: (GAIN, Stands(context))[1]  # noqa: E731
    first = part_identity(over_a_global)
    GAIN = 2
    assert part_identity(over_a_global) != first
    with pytest.raises(ParameterError, match="holds an object of type object, by which two runs cannot be told apart"):
        part_identity(made(object()))
    assert run(SHORT | {"time_limit": 0.1}, navigator=lambda c: Stands(c)).status == "error"  # needs no name without files


def test_replays_of_different_runs_are_different_runs(tmp_path: Path) -> None:
    """With one and the same seed of the estimator."""
    names = set()
    for navigator, seed in (("a-star", 0), ("a-star", 1), ("theta-star", 0)):
        made = run(SHORT | {"time_limit": 0.5}, navigator=navigator, estimator="odometry", seed=seed, out=tmp_path / "runs")
        assert made.directory is not None
        names.add(replay(made.directory, seed=5).name)
        assert replay(made.directory, seed=5).name in names
    assert len(names) == 3
