"""Names of algorithms, and what may be set on them. Oracles: the modules that the entries name; the design's list of names."""

from __future__ import annotations

import importlib
from dataclasses import is_dataclass, replace
from typing import Any, get_args

import numpy as np
import pytest

from robocar.core import SE2, Context, Estimator, Landmark, Mapper, Navigator, OccupancyGrid, ParameterError, UnknownNameError
from robocar.core.suggestions import did_you_mean
from robocar.episode.registry import Kind, build, find, names, parameters
from robocar.episode.run import simulate
from robocar.sim.car import FitOut, describe
from robocar.sim.sensors.parameters import SensorParameters

KINDS: tuple[Kind, ...] = get_args(Kind)
WORLD = {"map": "maps/thesis_field.yaml", "start": [0.3, 0.3, 0]}
PROTOCOLS = {"navigator": Navigator, "estimator": Estimator, "mapper": Mapper}
ENTRIES = [(kind, name) for kind in KINDS for name in sorted(names(kind))]


@pytest.fixture(scope="module")
def context() -> Context:
    """A car that carries everything, on a known field with one ball."""
    everything = {f"robot.{name}": True for name in ("compass", "camera", "top_camera")} | {"robot.lidar": "scan360"}
    simulation = simulate(WORLD, settings=everything | {"robot.sonars": "ring"})
    simulation.close()
    free = OccupancyGrid(np.zeros((50, 70), dtype=np.int8), 0.05)
    ball = Landmark("ball", "blue", np.array([3.5, 0.0, 0.4]), 0.1)
    return Context(simulation.robot, free, SE2(0.3, 0.3), (ball,), {}, np.random.default_rng(0), 0.05)


def test_the_names_of_the_first_issue_are_there() -> None:
    assert {"dynamic-a-star", "a-star"} <= set(names("navigator"))
    assert {"truth", "odometry", "odometry-compass"} <= set(names("estimator"))
    assert set(names("mapper")) >= {"none"}


@pytest.mark.parametrize(("kind", "name"), ENTRIES)
def test_every_entry_builds_what_its_kind_promises(kind: Kind, name: str, context: Context) -> None:
    part = build(kind, name, context)
    assert isinstance(part, PROTOCOLS[kind])
    part.reset(np.random.default_rng(1))
    entry = find(kind, name)
    assert 10 <= len(entry.summary) <= 130
    assert "\n" not in entry.summary + entry.paper


@pytest.mark.parametrize(("kind", "name"), [(k, n) for k, n in ENTRIES if find(k, n).parameters])
def test_every_parameter_may_be_set_to_its_default_and_not_to_nonsense(kind: Kind, name: str, context: Context) -> None:
    """The defaults are those of the dataclasses, which the entry's modules hold."""
    entry = find(kind, name)
    classes = [getattr(importlib.import_module(p.partition(":")[0]), p.partition(":")[2]) for p in entry.parameters]
    assert all(is_dataclass(cls) for cls in classes)
    defaults = parameters(entry)
    assert set(defaults) == set().union(*(cls.__dataclass_fields__ for cls in classes))
    build(kind, name, replace(context, parameters=dict(defaults)))
    for key in defaults:
        with pytest.raises(ParameterError, match=rf"parameter {key} takes a"):
            build(kind, name, replace(context, parameters={key: [object()]}))


@pytest.mark.parametrize("kind", KINDS)
def test_unknown_names_list_the_known_ones(kind: Kind) -> None:
    with pytest.raises(UnknownNameError) as error:
        find(kind, "nothing-like-it")
    assert all(name in str(error.value) for name in names(kind))


@pytest.mark.parametrize(("kind", "name"), ENTRIES)
def test_a_letter_lost_names_what_was_meant(kind: Kind, name: str) -> None:
    # `bug` may mean bug1 or bug2.
    with pytest.raises(UnknownNameError, match=rf"did you mean '{name[:-1]}.'"):
        find(kind, name[:-1])


def test_nothing_near_is_nothing_meant() -> None:
    assert did_you_mean("qqq", ["a-star", "truth"]) == ""
    assert did_you_mean("trut", ["a-star", "truth"]) == " (did you mean 'truth'?)"


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("no_such_module:build", "there is no module 'no_such_module'"),
        ("broken_parts:no_such_name", "'broken_parts' has no function or class 'no_such_name'"),
        ("broken_parts:", "has no function or class ''"),
        (":build", "cannot be imported"),
        (".relative:build", "cannot be imported"),
        ("broken_module:build", "'broken_module' cannot be imported: ZeroDivisionError: division by zero"),
    ],
)
def test_paths_that_lead_nowhere(path: str, message: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_module.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UnknownNameError) as error:
        find("navigator", path)
    assert message in str(error.value)


def test_parameters_of_a_third_partys_dataclass_are_checked(context: Context) -> None:
    build("navigator", "broken_parts:straight", replace(context, parameters={"speed": 0.1}))
    with pytest.raises(ParameterError, match=r"no parameter 'sped' \(did you mean 'speed'\?\); it has: speed"):
        build("navigator", "broken_parts:straight", replace(context, parameters={"sped": 0.1}))
    with pytest.raises(ParameterError, match="speed takes a float"):
        build("navigator", "broken_parts:straight", replace(context, parameters={"speed": "fast"}))


def test_a_third_party_without_one_looks_at_its_parameters_itself(
    context: Context, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "free_form.py").write_text("def build(context):\n    return context.parameters\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert build("navigator", "free_form:build", replace(context, parameters={"anything": 3})) == {"anything": 3}


@pytest.mark.parametrize(
    ("module", "text", "known"),
    [
        (
            "plain",
            "@dataclass\nclass Parameters:\n    gain: float = 1.0\n@dataclass\nclass PlainParameters:\n    other: int = 1\n",
            {"gain"},
        ),
        ("wall_shy_too", "@dataclass\nclass WallShyTooParameters:\n    weight: float = 1.0\n", {"weight"}),
        # Dataclasses for the module's own use say nothing about what the factory takes.
        (
            "own_use",
            "@dataclass\nclass SensorParameters:\n    a: int = 1\n@dataclass\nclass _OwnUseParameters:\n    b: int = 1\n",
            set(),
        ),
        ("borrowed", "from robocar.planners.search.a_star import AStarParameters as Parameters\n", {"metric", "weight"}),
    ],
)
def test_which_dataclass_a_factory_by_path_takes_its_parameters_from(
    module: str, text: str, known: set[str], tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`Parameters`, wherever it comes from, or the one called after the module; no other."""
    (tmp_path / f"{module}.py").write_text(f"from dataclasses import dataclass\n{text}def build(context):\n    return context\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert set(parameters(find("navigator", f"{module}:build"))) == known


def test_ours_without_parameters_take_none(context: Context) -> None:
    with pytest.raises(ParameterError, match="estimator 'truth' has no parameter 'x'; it has: none"):
        build("estimator", "truth", replace(context, parameters={"x": 1}))


def test_the_robot_that_factories_see_has_the_fit_out_that_was_chosen() -> None:
    simulation = simulate(WORLD, settings={"robot.sonars": "ring"})
    simulation.close()
    assert len(simulation.robot.sonars) == 16
    again = describe(FitOut(sonars="ring"), SensorParameters(), simulation.model)
    assert [s.robot_from_sensor for s in again.sonars] == [s.robot_from_sensor for s in simulation.robot.sonars]
