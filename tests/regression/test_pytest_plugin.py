"""The plugin in sessions of its own, as its users meet it. Oracle: pytest's own outcome and words; the files that it leaves.

That it works from an installed wheel alone, with the example of a planner in its own repository, `tests/packaging` shows.
"""

from __future__ import annotations

import json
from importlib import import_module

import pytest

from robocar.episode.run import run
from robocar.episode.spec import RunSpec

pytest_plugins = ["pytester"]
SHORT = {"name": "short", "map": "maps/thesis_field.yaml", "start": [0.3, 0.3, 0], "goal": [1.2, 0.4], "time_limit": 1.0}
NAME = RunSpec.of(SHORT, navigator="a-star", estimator="truth", seed=3).name
TEST = f"""
SHORT = {SHORT!r}

def test_first(physics_run, assert_no_regression):
    assert_no_regression(physics_run(SHORT, navigator="a-star", estimator="truth", seed=3))

def test_second(physics_run):
    run = physics_run(SHORT, navigator="a-star", estimator="truth", seed=3)
    print("wall", run.value("wall_time"), run.hash)
    assert run.status == "timeout"
"""


@pytest.fixture(scope="module", autouse=True)
def imported(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Sessions inside this process forget the modules that they import, which compiled ones do not survive."""
    run(SHORT, navigator="a-star", estimator="truth", seed=0, out=tmp_path_factory.mktemp("warm"))
    for module in (
        "robocar.planners.search.dynamic_a_star",
        "robocar.regression.compare",
        "robocar.regression.tables",
        "rich.table",
    ):
        import_module(module)


@pytest.fixture
def project(pytester: pytest.Pytester) -> pytest.Pytester:
    pytester.makepyfile(test_it=TEST)
    return pytester


def session(project: pytest.Pytester, *words: str) -> tuple[pytest.RunResult, str]:
    result = project.runpytest_inprocess("-p", "no:cacheprovider", "-s", *words)
    return result, result.stdout.str()


def test_baselines_are_written_kept_and_compared(project: pytest.Pytester) -> None:
    result, out = session(project)
    result.assert_outcomes(failed=1, passed=1)
    assert f"no baseline robocar-baselines/{NAME}.json; pytest --robocar-update writes it" in out
    result, out = session(project, "--robocar-update")
    result.assert_outcomes(passed=2)
    assert f"baseline new: robocar-baselines/{NAME}.json" in out
    (path,) = (project.path / "robocar-baselines").iterdir()
    (baseline,) = json.loads(path.read_text())["runs"].values()
    alone = run(SHORT, navigator="a-star", estimator="truth", seed=3)
    assert (baseline["hash"], baseline["status"]) == (alone.hash, "timeout")
    assert f"{alone.hash}" in out
    result, out = session(project)
    result.assert_outcomes(passed=2)
    result, out = session(project, "--robocar-update")
    assert "baseline unchanged" in out


def test_a_changed_behaviour_is_found_and_its_recording_kept(project: pytest.Pytester) -> None:
    session(project, "--robocar-update", "--robocar-recordings=none")
    assert not (project.path / "robocar-recordings").exists()
    path = project.path / "test_it.py"
    path.write_text(path.read_text().replace("seed=3))", 'seed=3, settings={"navigator.controller.desired_linear_vel": 0.1}))'))
    (base,) = (project.path / "robocar-baselines").iterdir()
    # With settings the run has another name; its baseline is the old one's.
    result, out = session(project)
    result.assert_outcomes(failed=1, passed=1)
    (name,) = [
        line.split("/")[1].split(".json")[0] for line in out.splitlines() if "no baseline" in line and "robocar-base" in line
    ][:1]
    text = (
        base.read_text()
        .replace('"settings": {}', '"settings": {"navigator.controller.desired_linear_vel": 0.1}')
        .replace(base.stem, name)
    )
    base.with_name(f"{name}.json").write_text(text)
    result, out = session(project)
    result.assert_outcomes(failed=1, passed=1)
    assert "1 runs behave differently (another hash)" in out
    assert "if this is meant: pytest --robocar-update, and commit robocar-baselines/" in out
    assert "recordings of this test" in out
    assert f"robocar-recordings/{name}.rrd" in out
    assert sorted(kept.name for kept in (project.path / "robocar-recordings").iterdir()) == [f"{name}.rrd"]


def test_another_machine_compares_metrics_and_says_so(project: pytest.Pytester) -> None:
    """The baseline of another fingerprint and hash: the same metrics pass, a much shorter clearance does not."""
    session(project, "--robocar-update")
    (path,) = (project.path / "robocar-baselines").iterdir()
    content = json.loads(path.read_text())
    (entry,) = content["runs"].values()
    entry |= {"fingerprint": "elsewhere", "hash": "0" * 64}
    content["versions"][0]["numpy"] = "1.0"
    path.write_text(json.dumps(content))
    session(project)[0].assert_outcomes(passed=2)
    entry["status"] = "success"
    path.write_text(json.dumps(content))
    result, out = session(project)
    result.assert_outcomes(failed=1, passed=1)
    assert "success became timeout: worse" in out
    assert "hashes not compared, 1 of 1: other versions: numpy 1.0 is now" in out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "not JSON that can be read"),
        ("[]", "no baseline"),
        ('{"kind": "robocar-baseline", "schema": 99}', "a baseline of schema 99, this robocar knows 1"),
        ('{"kind": "robocar-baseline", "schema": 1, "runs": {"a": {}}}', "a damaged baseline"),
    ],
)
def test_a_bad_baseline_fails_with_its_reason(project: pytest.Pytester, text: str, words: str) -> None:
    folder = project.path / "robocar-baselines"
    folder.mkdir()
    (folder / f"{NAME}.json").write_text(text)
    result, out = session(project, "-k", "first", "--robocar-recordings=none")
    result.assert_outcomes(failed=1, deselected=1)
    assert words in out


def test_classes_and_factories_may_be_given_themselves(pytester: pytest.Pytester) -> None:
    """One at the top of a module has its place for a name; what is made on the way is told from others by what it holds."""
    pytester.makepyfile(
        own="from robocar.planners.search.dynamic_a_star import build as make\ndef build(context):\n    return make(context)\n",
        test_it=f"""
import own, pytest
from robocar.core import STOP, ParameterError
SHORT = {SHORT!r}

class Stands:
    def __init__(self, context, why=""):
        self.why = why
    def command(self, state, observation, goal):
        return STOP

def standing(why):
    return lambda context: Stands(context, why)

def test_factory(physics_run):
    assert physics_run(SHORT, navigator=own.build).navigator == "own:build"
    assert physics_run(SHORT, navigator=own.build) is physics_run(SHORT, navigator="own:build")

def test_class(physics_run):
    assert physics_run(SHORT, navigator=Stands).navigator == "test_it:Stands"

def test_closures(physics_run):
    names = [physics_run(SHORT, navigator=standing(why)).name for why in "aba"]
    assert names[0] == names[2] != names[1]
    with pytest.raises(ParameterError, match="holds an object of type object, by which two runs cannot be told apart"):
        physics_run(SHORT, navigator=standing(object()))
""",
    )
    session(pytester, "--robocar-recordings=none")[0].assert_outcomes(passed=3)


FOUR = f"""
import pytest
SHORT = {SHORT!r}

@pytest.mark.parametrize("y", [0.4, 0.5, 0.6, 0.7])
def test_it(physics_run, assert_no_regression, y):
    assert_no_regression(physics_run(SHORT | {{"goal": [1.2, y]}}, navigator="a-star", estimator="truth"))
"""


@pytest.mark.parametrize("words", [("-n", "2")])
def test_every_run_has_its_own_baseline_and_recording_and_every_message_arrives(
    pytester: pytest.Pytester, words: tuple[str, ...]
) -> None:
    """Four runs of one name, in this process and in workers of xdist. Oracle: their number."""
    pytester.makepyfile(test_it=FOUR)
    names = [f"short--a-star--truth--none--s0--*.{kind}" for kind in ("json", "rrd")]
    run = pytester.runpytest_subprocess("-p", "no:cacheprovider", *words, "--robocar-update", "--robocar-recordings=all")
    run.assert_outcomes(passed=4)
    assert [len(list(pytester.path.glob(f"robocar-*/{name}"))) for name in names] == [4, 4]
    assert [sum(word in line for line in run.outlines) for word in ("baseline new: ", "recording: ")] == [4, 4]
    again = pytester.runpytest_subprocess("-p", "no:cacheprovider", *words, "--robocar-recordings=none")
    again.assert_outcomes(passed=4)
