"""Names of algorithms, and what may be set on them. Oracles: the modules that the entries name; the design's list of names."""

from __future__ import annotations

import importlib
import re
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from robocar.core import SE2, Context, Landmark, Mapper, Navigator, OccupancyGrid, ParameterError, PoseEstimator, UnknownNameError
from robocar.core.suggestions import did_you_mean
from robocar.core.truth import GroundTruth
from robocar.episode.registry import Kind, build, find, names, parameters
from robocar.episode.run import simulate
from robocar.scenario.settings import split_overrides
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_model import RobotModel

KINDS: tuple[Kind, ...] = get_args(Kind)
WORLD = {"map": "maps/thesis_field.yaml", "start": [0.3, 0.3, 0]}
PROTOCOLS = {"navigator": Navigator, "estimator": PoseEstimator, "mapper": Mapper}
ENTRIES = [(kind, name) for kind in KINDS for name in sorted(names(kind))]


@pytest.fixture(scope="module")
def context() -> Context:
    """A car that carries everything, on a known field with one ball."""
    everything = {f"robot.{name}": True for name in ("compass", "camera", "top_camera")} | {"robot.lidar": "scan360"}
    world = simulate(WORLD, settings=everything | {"robot.sonars": "ring"})
    world.close()
    free = OccupancyGrid(np.zeros((50, 70), dtype=np.int8), 0.05)
    ball = Landmark("ball", "blue", np.array([3.5, 0.0, 0.4]), 0.1)
    rng, truth = np.random.default_rng(0), GroundTruth(0.0, SE2(0.3, 0.3))
    return Context(world.robot.robot, free, SE2(0.3, 0.3), (ball,), {}, rng, 0.05, oracle=lambda: truth)


def test_the_names_of_the_first_issue_are_there() -> None:
    assert {"dynamic-a-star", "a-star"} <= set(names("navigator"))
    assert {"truth", "odometry", "odometry-compass"} <= set(names("estimator"))
    assert set(names("mapper")) >= {"none"}


@pytest.mark.parametrize(("kind", "name"), ENTRIES)
def test_every_entry_builds_what_its_kind_promises(kind: Kind, name: str, context: Context) -> None:
    part = build(kind, name, context)
    assert (part is None) if (kind, name) == ("mapper", "none") else isinstance(part, PROTOCOLS[kind])
    entry = find(kind, name)
    assert 10 <= len(entry.summary) <= 130
    assert "\n" not in entry.summary + entry.paper


@pytest.mark.parametrize(("kind", "name"), [(k, n) for k, n in ENTRIES if find(k, n).parameters])
def test_every_parameter_may_be_set_to_its_default_and_not_to_nonsense(kind: Kind, name: str, context: Context) -> None:
    """The defaults are those of the dataclasses, which the entry's modules hold."""
    entry = find(kind, name)
    fields = [
        (part, field)
        for part, paths in entry.parameters.items()
        for path in paths
        for field in getattr(importlib.import_module(path.partition(":")[0]), path.partition(":")[2]).__dataclass_fields__
    ]
    defaults = parameters(entry)
    assert [f"{part}.{field}".lstrip(".") for part, field in fields] == list(defaults)  # and no name twice
    build(kind, name, replace(context, parameters=nested(defaults)))
    for key in defaults:
        with pytest.raises(ParameterError, match=rf"parameter {re.escape(key)} takes a"):
            build(kind, name, replace(context, parameters=nested({key: [object()]})))


def nested(parameters: dict[str, Any]) -> dict[str, Any]:
    """As `--set` gives them to a factory."""
    return split_overrides({f"navigator.{key}": value for key, value in parameters.items()})[1]["navigator"]


@pytest.mark.parametrize(("kind", "name"), [(k, n) for k, n in ENTRIES if find(k, n).parameters])
def test_a_flat_name_of_a_part_is_answered_with_the_nested_one(kind: Kind, name: str, context: Context) -> None:
    """What was `navigator.sim_time` is `navigator.controller.sim_time`; a name of the algorithm itself stays."""
    known = parameters(find(kind, name))
    flat = sorted({path.rpartition(".")[2] for path in known} - set(known))
    for key in flat:
        with pytest.raises(ParameterError, match=rf"no parameter '{key}'; it is now {kind}\.\w+\.{key}\b"):
            build(kind, name, replace(context, parameters={key: 1.0}))


@pytest.mark.parametrize(
    ("kind", "method", "wanted"),
    [
        (
            "navigator",
            "def command(self, belief, mapper, observation, goal): ...",
            r"command\(state, observation, goal\) -> Command",
        ),
        (
            "navigator",
            "def command(self, belief, mapper, observation=None, goal=None): ...",
            r"command\(state, observation, goal\) -> Command",
        ),
        ("navigator", "command = property(lambda self: 1 / 0)", r"\.command: ZeroDivisionError: division by zero"),
        ("navigator", "command = 5", r"has no method command\(state, observation, goal\) -> Command"),
        ("navigator", "def step(self, state): ...", r"has no method command\(state, observation, goal\) -> Command"),
        ("estimator", "def update(self, observation): ...", r"update\(observation, command\) -> Belief"),
        ("mapper", "def update(self, state, observation, more): ...", r"update\(belief, observation\)"),
    ],
)
def test_a_part_of_an_old_style_is_refused_with_the_signature_that_is_needed(
    kind: Kind, method: str, wanted: str, context: Context, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At its construction: nobody has to wait for the first tick."""
    module = f"old_style_{abs(hash((kind, method)))}"
    (tmp_path / f"{module}.py").write_text(f"class Old:\n    {method}\n\n\ndef build(context):\n    return Old()\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ParameterError, match=rf"{kind} '{module}:build': Old.*{wanted}"):
        build(kind, f"{module}:build", context)


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


def test_a_third_partys_factory_declares_parameters_by_part(
    context: Context, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ours have them: the same names, the same refusals."""
    (tmp_path / "by_part.py").write_text(
        "from dataclasses import dataclass\n"
        "from robocar.core import declares\n"
        "from robocar.planners.controllers.dwa import DwaParameters\n"
        "@dataclass(frozen=True)\nclass Mine:\n    gain: float = 1.0\n"
        "class Navigator:\n    def command(self, state, observation, goal): ...\n"
        "@declares(parameters={'': (Mine,), 'controller': (DwaParameters,)})\n"
        "def build(context):\n"
        "    navigator = Navigator()\n"
        "    navigator.gain = context.parameters_of(Mine).gain\n"
        "    navigator.sim_time = context.part('controller').parameters_of(DwaParameters).sim_time\n"
        "    return navigator\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    given = {"gain": 2.0, "controller": {"sim_time": 3.0}}
    built = build("navigator", "by_part:build", replace(context, parameters=given))
    assert (built.gain, built.sim_time) == (2.0, 3.0)
    for wrong, message in [
        ({"sim_time": 3.0}, r"no parameter 'sim_time'; it is now navigator.controller.sim_time"),
        ({"controller": {"gain": 2.0}}, r"no parameter 'controller.gain'"),
        ({"controller": {"sim_tim": 2.0}}, r"no parameter 'controller.sim_tim' \(did you mean 'controller.sim_time'\?\)"),
    ]:
        with pytest.raises(ParameterError, match=message) as error:
            build("navigator", "by_part:build", replace(context, parameters=wrong))
        assert "it is now navigator.gain" not in str(error.value)


@pytest.mark.parametrize(
    "wrong",
    [
        "{'': (3,)}", "{'': (object,)}", "{'': (WithoutDefault,)}", "{'': (NotGiven,)}", "{'': Good}", "{'': ()}",
        "{'a.b': (Good,)}",
        "{5: (Good,)}", "[Good]", "{'': (Good,), 'gain': (Good,)}",
    ],
)  # fmt: skip
def test_declared_parameters_are_dataclasses_with_defaults(wrong: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """What could not be set, or would be ignored, is refused when it is declared."""
    module = f"badly_declared_{abs(hash(wrong))}"
    (tmp_path / f"{module}.py").write_text(
        "from dataclasses import dataclass, field\nfrom robocar.core import declares\n"
        "@dataclass\nclass Good:\n    gain: float = 1.0\n"
        "@dataclass\nclass WithoutDefault:\n    gain: float\n"
        "@dataclass\nclass NotGiven:\n    gain: float = field(default=1.0, init=False)\n"
        f"@declares(parameters={wrong})\ndef build(context): ...\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UnknownNameError, match=r"cannot be imported: TypeError: .*parameter"):
        find("navigator", f"{module}:build")


def test_a_third_party_without_one_looks_at_its_parameters_itself(
    context: Context, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "class Free:\n    def command(self, state, observation, goal): ...\n"
    text += "def build(context):\n    free = Free()\n    free.seen = context.parameters\n    return free\n"
    (tmp_path / "free_form.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    assert build("navigator", "free_form:build", replace(context, parameters={"anything": 3})).seen == {"anything": 3}


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
    world = simulate(WORLD, settings={"robot.sonars": "ring"})
    world.close()
    assert len(world.robot.robot.sonars) == 16
    again = RobotModel.load().describe(FitOut(sonars="ring"))
    assert [s.robot_from_sensor for s in again.sonars] == [s.robot_from_sensor for s in world.robot.robot.sonars]
