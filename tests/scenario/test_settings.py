"""Settings, `path.to.parameter: value`. Oracles: the same settings written another way, and by hand."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import ScenarioError
from robocar.episode.spec import RunSpec
from robocar.scenario.settings import flat, split_overrides

NAMES = st.sampled_from(["a", "b", "sim_time"])
PARAMETERS = st.recursive(
    st.floats(0, 9), lambda inner: st.dictionaries(NAMES, inner, min_size=1, max_size=3).filter(bool), max_leaves=6
)


@given(st.dictionaries(NAMES, PARAMETERS, min_size=1))
def test_nested_and_dotted_settings_are_the_same(parameters: dict[str, Any]) -> None:
    """What a part gets are the mappings again, and not the caller's."""
    settings = {f"navigator.{name}": value for name, value in parameters.items()}
    dotted = flat(settings)
    assert not any(isinstance(value, dict) for value in dotted.values())
    assert flat(dotted) == dotted
    got = split_overrides(dotted)[1]["navigator"]
    assert got == parameters
    assert all(got[name] is not value for name, value in parameters.items() if isinstance(value, dict))


def test_a_mapping_may_stand_for_all_of_a_part() -> None:
    assert split_overrides(flat({"estimator": {"a": 3}, "robot": {"lidar": "none"}})) == (
        {"robot": {"lidar": "none"}},
        {"navigator": {}, "estimator": {"a": 3}, "mapper": {}},
    )


def test_equal_settings_have_one_name_and_stay_as_they_were_given() -> None:
    given = {"navigator.controller": {"sim_time": 2.5}, "navigator.controller.vx_samples": 7}
    spec = RunSpec.of("office", navigator="a-star-dwa", settings=given)
    assert given == {"navigator.controller": {"sim_time": 2.5}, "navigator.controller.vx_samples": 7}
    dotted = {"navigator.controller.vx_samples": 7, "navigator.controller.sim_time": 2.5}
    assert RunSpec.of("office", navigator="a-star-dwa", settings=dotted).name == spec.name
    assert spec.parameters["navigator"] == {"controller": {"sim_time": 2.5, "vx_samples": 7}}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({1: 1}, "--set 1: expected path.to.parameter"),
        ({"": 1}, "--set : expected path.to.parameter"),
        ({"navigator..sim_time": 1}, "--set navigator..sim_time: expected path.to.parameter, with a name between the dots"),
        ({"navigator.": 1}, "--set navigator.: expected"),
        ({".navigator": 1}, "--set .navigator: expected"),
        ({"navigator.controller": {}}, "--set navigator.controller: {} sets no parameter"),
        ({"navigator.controller": {"a": {}}}, "--set navigator.controller.a: {} sets no parameter"),
        ({"navigator.controller": {2: 1}}, "--set navigator.controller: 2 is not the name of a parameter"),
        ({"navigator.controller": {"": 1}}, "--set navigator.controller: '' is not the name of a parameter"),
        ({"navigator.a": {"b": 1}, "navigator.a.b": 2}, "--set navigator.a.b: it is set twice, to 1 and to 2"),
        ({"navigator.a.b": 2, "navigator.a": {"b": 1}}, "--set navigator.a.b: it is set twice, to 2 and to 1"),
        ({"navigator.a": 3, "navigator.a.b": 2}, "--set navigator.a.b: a is set to 3 already"),
        ({"navigator.a.b": 2, "navigator.a": 3}, "--set navigator.a: parameters of a are set already"),
        ({"estimator": 3}, "--set estimator: choose it with --estimator"),
    ],
)
def test_bad_settings(settings: dict[Any, Any], message: str) -> None:
    with pytest.raises(ScenarioError) as error:
        split_overrides(flat(settings))
    assert str(error.value).startswith(message)
