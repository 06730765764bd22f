"""The plugin in sessions of its own, as its users meet it. Oracle: pytest's own outcome and words; the files that it leaves.

That it works from an installed wheel alone, with the example of a planner in its own repository, `tests/packaging` shows.
"""

from __future__ import annotations

import json
from importlib import import_module

import pytest

from robocar.episode.run import run

pytest_plugins = ["pytester"]
SHORT = {"name": "short", "map": "maps/thesis_field.yaml", "start": [0.3, 0.3, 0], "goal": [1.2, 0.4], "time_limit": 1.0}
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
    assert "no baseline robocar-baselines/short--a-star--truth--none--s3.json; pytest --robocar-update writes it" in out
    result, out = session(project, "--robocar-update")
    result.assert_outcomes(passed=2)
    assert "baseline new: robocar-baselines/short--a-star--truth--none--s3.json" in out
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
        ("{", "not a baseline that can be read"),
        ("[]", "no baseline"),
        ('{"kind": "robocar-baseline", "schema": 99}', "a baseline of schema 99, this robocar knows 1"),
        ('{"kind": "robocar-baseline", "schema": 1, "runs": {"a": {}}}', "a damaged baseline"),
    ],
)
def test_a_bad_baseline_fails_with_its_reason(project: pytest.Pytester, text: str, words: str) -> None:
    folder = project.path / "robocar-baselines"
    folder.mkdir()
    (folder / "short--a-star--truth--none--s3.json").write_text(text)
    result, out = session(project, "-k", "first", "--robocar-recordings=none")
    result.assert_outcomes(failed=1, deselected=1)
    assert words in out


def test_a_factory_may_be_given_itself_and_a_lambda_may_not(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        own="from robocar.planners.search.dynamic_a_star import build as make\ndef build(context):\n    return make(context)\n",
        test_it=f"""
import own, pytest
SHORT = {SHORT!r}

def test_factory(physics_run):
    assert physics_run(SHORT, navigator=own.build).navigator == "own:build"

def test_lambda(physics_run):
    with pytest.raises(TypeError, match="at the top of a module"):
        physics_run(SHORT, navigator=lambda context: None)
""",
    )
    session(pytester, "--robocar-recordings=none")[0].assert_outcomes(passed=2)
