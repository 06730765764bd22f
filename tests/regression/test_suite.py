"""Suite files: what they expand to, and everything that is wrong with one, at once.

Oracles: the product of the lists, counted by hand; the registry and the scenario folder; the directory that a real run makes.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import ScenarioError
from robocar.episode.run import run
from robocar.metrics import Tolerance
from robocar.regression.judgement import tolerances
from robocar.regression.suite import find_suite, load_suite, suite_names

GOOD: dict[str, Any] = {"name": "good", "runs": [{"scenarios": ["u-trap"]}]}


def test_a_block_is_a_product() -> None:
    block = {
        "scenarios": ["u-trap", "tilted"],
        "navigators": ["a-star", "harmonic"],
        "estimators": ["truth", "odometry"],
        "seeds": "3-5",
    }
    suite = load_suite(GOOD | {"runs": [block]})
    expected = set(product(["u-trap", "tilted"], ["a-star", "harmonic"], ["truth", "odometry"], ["none"], [3, 4, 5]))
    assert len(suite.cases) == 24
    assert {(c.scenario, c.navigator, c.estimator, c.mapper, c.seed) for c in suite.cases} == expected


def test_what_is_left_out_is_the_scenarios_default() -> None:
    (case,) = load_suite({"runs": [{"scenarios": ["thesis-field"]}]}).cases
    assert (case.navigator, case.estimator, case.mapper, case.seed) == ("dynamic-a-star", "truth", "none", 0)


def test_settings_of_a_block_go_over_those_of_the_suite_and_into_the_name(tmp_path: Path) -> None:
    content = {
        "settings": {"time_limit": 5, "robot.compass": True},
        "runs": [{"scenarios": ["u-trap"], "settings": {"time_limit": 0.3}}],
    }
    (case,) = load_suite(content).cases
    assert dict(case.settings) == {"time_limit": 0.3, "robot.compass": True}
    result = run(**case.arguments(), out=tmp_path, record=False)
    assert result.directory is not None
    assert result.directory.name == case.name


def test_scenarios_beside_the_suite_are_found(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("map: maps/u_trap.yaml\nstart: [0.8, 3.0, 0]\ngoal: [5.2, 3.0]\n")
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump({"runs": [{"scenarios": ["mine.yaml"]}]}))
    suite = load_suite(tmp_path / "suite.yaml")
    assert suite.name == "suite"
    assert suite.cases[0].scenario == str(tmp_path / "mine.yaml")


def test_all_errors_are_listed_at_once_with_the_nearest_names() -> None:
    blocks = [
        {
            "scenarios": ["u-trip", "tilted"],
            "navigators": ["a-stair"],
            "estimators": ["odometri"],
            "settings": {"robot.lidaar": "none"},
        },
        {"scenarios": ["tilted", "tilted"], "navigators": ["os:getcwd"], "settings": {"navigator.sped": 1}},
        {"scenarios": ["doors"], "settings": {"navigator.lookahead_dst": 1}},
    ]
    content = {"runs": blocks, "tolerances": {"duraton": {"absolute": 1}}}
    with pytest.raises(ScenarioError) as caught:
        load_suite(content)
    for words in (
        "unknown scenario 'u-trip' (did you mean 'u-trap'?)",
        "unknown navigator 'a-stair' (did you mean 'a-star'?)",
        "unknown estimator 'odometri' (did you mean 'odometry'?)",
        "unknown key 'robot.lidaar' (did you mean 'lidar'?)",
        "a suite runs no code: 'os:getcwd'",
        "navigator 'a-star' has no parameter 'lookahead_dst'",
        "unknown metric 'duraton' (did you mean 'duration'?)",
    ):
        assert words in str(caught.value)


@pytest.mark.parametrize(
    "blocks",
    [
        [{"scenarios": ["tilted", "tilted"]}],
        [{"scenarios": ["tilted"], "seeds": [1, 2, 1]}],
        [{"scenarios": ["tilted"]}, {"scenarios": ["tilted"], "navigators": ["a-star"]}],
    ],
)
def test_duplicate_runs_are_refused(blocks: list[Any]) -> None:
    with pytest.raises(ScenarioError, match=r"duplicate run: tilted--a-star--truth--none--s\d is named twice"):
        load_suite({"runs": blocks})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"runs": []}, "runs: List should have at least 1 item"),
        ({"rnus": []}, "unknown key 'rnus' (did you mean 'runs'?)"),
        ({"runs": [{"scenarios": ["u-trap"], "seds": [1]}]}, "unknown key 'runs.0.seds' (did you mean 'seeds'?)"),
        ({"runs": [{"scenarios": []}]}, "runs.0.scenarios: List should have at least 1 item"),
        ({"runs": [{"navigators": ["a-star"]}]}, "missing key 'runs.0.scenarios'"),
        ({"runs": [{"scenarios": ["u-trap"], "seeds": "9-3"}]}, "FIRST-LAST must ascend"),
        ({"runs": [{"scenarios": ["u-trap"], "seeds": "0-99999999999"}]}, "at most 10000 seeds"),
        ({"runs": [{"scenarios": ["u-trap"], "seeds": "a-b"}]}, "expected a list of whole numbers or FIRST-LAST"),
        ({"runs": [{"scenarios": ["u-trap"], "seeds": [True]}]}, "expected whole numbers"),
        ({"runs": [{"scenarios": ["u-trap"], "seeds": [-1]}]}, "greater than or equal to 0"),
        ({"limit": 0}, "limit: Input should be greater than 0"),
        ({"limit": float("nan")}, "limit: Input should be"),
        ({"tolerances": {"spl": {"absolut": 1}}}, "unknown key 'tolerances.spl.absolut' (did you mean 'absolute'?)"),
        ({"tolerances": {"spl": {"absolute": -1}}}, "tolerances.spl.absolute: Input should be greater than or equal to 0"),
        ({"tolerances": {"spl": {"better": "big"}}}, "tolerances.spl.better: Input should be 'lower', 'higher' or 'neither'"),
        ({"settings": {"navigator": "a-star"}}, "choose it with --navigator"),
    ],
)
def test_bad_suites_say_which_field(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_suite(GOOD | change)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"), [("runs: [\n", "line 2: not YAML"), ("- a\n", "a suite is a mapping"), ("\xff", "not UTF-8 text")]
)
def test_bad_files_are_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ScenarioError, match=words) as caught:
        load_suite(path)
    assert str(path) in str(caught.value)


def test_an_unknown_suite_lists_what_there_is() -> None:
    with pytest.raises(ScenarioError, match=r"unknown suite 'quik' \(did you mean 'quick'\?\)"):
        find_suite("quik")
    assert {"quick", "full"} <= set(suite_names())


@pytest.mark.parametrize("name", suite_names())
def test_shipped_suites_are_sound(name: str) -> None:
    """Oracle: `load_suite`'s own checks of every name in them."""
    suite = load_suite(name)
    assert suite.description
    assert len({case.name for case in suite.cases}) == len(suite.cases) > 0


def test_tolerances_change_only_what_the_suite_says() -> None:
    suite = load_suite(
        GOOD | {"tolerances": {"duration": {"relative": 0.5}, "plan_time_mean": {"better": "lower", "relative": 1.0}}}
    )
    assert suite.tolerances["duration"] == Tolerance("lower", tolerances()["duration"].absolute, 0.5)
    assert suite.tolerances["plan_time_mean"] == Tolerance("lower", 0.0, 1.0)
    assert {k: v for k, v in suite.tolerances.items() if k not in ("duration", "plan_time_mean")} == {
        k: v for k, v in tolerances().items() if k not in ("duration", "plan_time_mean")
    }


@settings(deadline=None)
@given(first=st.integers(0, 50), count=st.integers(1, 20))
def test_first_last_is_the_range(first: int, count: int) -> None:
    """Oracle: Python's range."""
    suite = load_suite({"runs": [{"scenarios": ["u-trap"], "seeds": f"{first}-{first + count - 1}"}]})
    assert [case.seed for case in suite.cases] == list(range(first, first + count))
