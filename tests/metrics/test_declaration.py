"""Metrics that say what they are. Oracles: values by hand, the trajectory of a real run, and the page in the repository."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import robocar
from robocar.metrics import Declaration, RunLog, Tolerance, declaration, declared, metric, metrics, summarize
from robocar.metrics.page import page
from robocar.regression.compare import compare
from robocar.regression.results import Results, Row
from tests.metrics.test_run import run_log

ROOT = Path(__file__).parents[2]
SHORT = {"name": "short", "map": "maps/thesis_field.yaml", "start": [0.3, 0.3, 0], "goal": [1.2, 0.4], "time_limit": 20}
OUTSIDE = """
import numpy as np
from robocar.metrics import Tolerance, metric

@metric("theirs/ticks_east", unit="1", tolerance=Tolerance("higher", absolute=2), needs=("truth_poses",))
def ticks_east(poses):
    '''Ticks at which the robot is east of x = 0.5 m. Of no use.'''
    return np.count_nonzero(poses[:, 0] > 0.5)
"""


@pytest.fixture(autouse=True)
def own_declarations(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test declares is gone after it."""
    monkeypatch.setattr(declaration, "_COMPUTATIONS", dict(declaration._COMPUTATIONS))


def value(log: RunLog, name: str) -> Any:
    return summarize(log)[name]["value"]


def test_a_metric_from_outside_is_computed_listed_and_judged() -> None:
    """Oracle: the trajectory of the run; a made-up second run that is worse by more, and by less, than the tolerance."""
    exec(OUTSIDE, {"__name__": "theirs"})
    about = declared()["theirs/ticks_east"]
    assert about.summary == "Ticks at which the robot is east of x = 0.5 m."
    assert (about.unit, about.tolerance, about.module) == ("1", Tolerance("higher", 2), "theirs")
    run = robocar.run(SHORT, navigator="a-star", estimator="truth")
    assert run.success
    east = int(np.count_nonzero(run.truth.poses[:, 0] > 0.5))
    assert east > 10
    assert run.metrics["theirs/ticks_east"] == {"value": east, "unit": "1"}
    assert list(run.metrics)[-1] == "theirs/ticks_east"
    json.dumps(run.metrics)
    values = {name: found["value"] for name, found in run.metrics.items()}
    facts: dict = {"settings": "{}", "fingerprint": "", "versions": {}, "reason": "", "mapper": "none"}
    row = Row("a", "short", "a-star", "truth", seed=0, status="success", hash="1", metrics=values, **facts)
    verdicts = {}
    for lost in (1, 3):
        other = replace(row, hash="2", metrics=values | {"theirs/ticks_east": east - lost})
        found = compare(Results(Path("base"), (row,), {}), Results(Path("new"), (other,), {}))
        verdicts[lost] = {change.metric: change.verdict for change in found.metrics}
    assert verdicts[1]["theirs/ticks_east"] == "unchanged"
    assert verdicts[3] == verdicts[1] | {"theirs/ticks_east": "worse"}


def test_a_metric_of_an_installed_package_is_computed_in_worker_processes(tmp_path: Path) -> None:
    """A package with metadata on the path, as pip would install it. Oracle: the sum over the trajectory file."""
    site = tmp_path / "site"
    (site / "theirs-1.0.dist-info").mkdir(parents=True)
    (site / "theirs.py").write_text(OUTSIDE)
    (site / "theirs-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (site / "theirs-1.0.dist-info" / "entry_points.txt").write_text("[robocar.metrics]\ntheirs = theirs\n")
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(SHORT | {"time_limit": 3}))
    suite = {"runs": [{"scenarios": ["short.yaml"], "navigators": ["a-star"], "estimators": ["truth"], "seeds": [0]}]}
    suite |= {"tolerances": {"theirs/ticks_east": {"absolute": 5}}}
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump(suite))
    path = os.pathsep.join([str(site), str(ROOT), os.environ.get("PYTHONPATH", "")])
    words = [sys.executable, "-m", "robocar", "sweep", "suite.yaml", "--out", "out"]
    done = subprocess.run(words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False)
    (file,) = (tmp_path / "out").glob("*/metrics.json")
    times_and_x = np.loadtxt(file.parent / "truth.tum")[:, :2]
    expected = {"value": int(np.count_nonzero(times_and_x[:, 1] > 0.5)), "unit": "1"}
    assert json.loads(file.read_text())["metrics"]["theirs/ticks_east"] == expected, done.stderr


def test_our_metrics_in_the_order_of_metrics_json() -> None:
    """Oracle: the names of a run with an estimator and a mapper, which has all but those of explorations and movers."""
    settings = {"robot.lidar": "scan360", "time_limit": 0.5}
    run = robocar.run(SHORT, navigator="a-star", estimator="odometry", mapper="laser", settings=settings)
    expected = [name for name in declared() if not name.startswith(("map/reachable_", "movers/"))]
    assert list(run.metrics) == expected
    assert len(expected) == 40
    assert all(one.summary.endswith(".") for one in declared().values())
    clock = {"plan_time_mean", "plan_time_max", "wall_time", "real_time_factor"}
    assert {name for name, one in declared().items() if one.wall_clock} == clock


def test_what_a_log_does_not_have_is_none() -> None:
    """Oracle: the list that stood in the code of the replay before metrics said what they need."""
    everything = summarize(run_log(41))
    fields = ("clearance", "contact", "standing", "work", "goal", "truth_twists")
    replayed = summarize(run_log(41, **dict.fromkeys(fields)))
    missing = {"min_clearance", "mean_clearance", "contacts", "contacts_standing", "replans", "spl", "jerk_rms"}
    assert replayed == everything | {
        name: {"value": None, "unit": everything[name]["unit"]} for name in missing | {"shortest_path_length"}
    }


def test_needs_are_arguments_in_their_order_and_other_metrics_may_be_needed() -> None:
    @metric("half", unit="m", needs=("path_length", "wall_time"), optional=("discs", "localized"))
    def half(length: float, seconds: float, discs: None, localized: bool) -> float:
        assert (seconds, discs, localized) == (2.0, None, False)
        return length / 2

    assert value(run_log(41), "half") == pytest.approx(1.0)
    assert half(3.0, 2.0, None, False) == 1.5
    assert value(run_log(41, wall_time=None), "half") is None


def test_values_are_plain_finite_numbers_or_none() -> None:
    numbers = {"a": np.int64(3), "b": np.float32(0.5), "c": np.inf, "d": np.nan, "e": None}

    @metrics([Declaration(name, "1") for name in [*numbers, "left out"]], needs=("time",))
    def several(time: np.ndarray) -> dict[str, Any]:
        return numbers

    found = summarize(run_log(3))
    assert {name: found[name]["value"] for name in numbers} == {"a": 3, "b": 0.5, "c": None, "d": None, "e": None}
    assert {type(found[name]["value"]) for name in "ab"} == {int, float}
    assert "left out" not in found


def test_a_group_is_listed_where_the_run_has_it() -> None:
    log = run_log(41)
    for n, where in enumerate(("localized", "movers", "clearance")):
        metric(f"group/{n}", unit="1", where=where)(lambda: 1)
    assert [name for name in summarize(log) if "/" in name] == ["group/2"]
    assert [name for name in summarize(replace(log, movers={}, clearance=None)) if "group" in name] == ["group/1"]


@pytest.mark.parametrize(
    ("name", "needs", "message"),
    [
        ("duration", (), r"'duration' is declared by robocar\.metrics\.run\.duration already"),
        ("new", ("tine",), r"'new' needs 'tine': neither a metric declared before nor one of carried, clearance"),
        ("new", ("time",), r"gets \(time\): too many positional arguments"),
    ],
)
def test_bad_declarations(name: str, needs: tuple[str, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        metric(name, unit="1", needs=needs)(lambda: 1)
    with pytest.raises(ValueError, match="asks for 'tine'"):
        metric("new", unit="1", where="tine")(lambda: 1)
    assert "new" not in declared()


def test_a_metric_may_be_declared_once_more_by_the_same_function() -> None:
    """As a cell of a notebook does that is run again."""
    for _ in range(2):
        exec(OUTSIDE, {"__name__": "theirs"})
    assert [name for name in declared() if name.startswith("theirs")] == ["theirs/ticks_east"]


@pytest.mark.parametrize(
    ("value", "error"),
    [(lambda: 1 / 0, "ZeroDivisionError"), (lambda: "far", "TypeError"), (list, "TypeError"), (lambda: 1j, "TypeError")],
)
def test_a_metric_that_fails_is_none_and_says_whose_it_is(value: Callable[[], Any], error: str) -> None:
    """The other metrics of the run are not lost."""

    def broken() -> float:
        return value()

    metric("broken", unit="1")(broken)
    with pytest.warns(RuntimeWarning, match=re.escape(f"metric 'broken' of {__name__}.") + f".* fails, and is None: .*{error}"):
        found = summarize(run_log(3))
    assert found["broken"] == {"value": None, "unit": "1"}
    assert found["duration"]["value"] is not None


def test_the_page_is_what_the_declarations_say() -> None:
    """Otherwise: `python -m robocar.metrics.page docs/metrics.md`."""
    exec(OUTSIDE, {"__name__": "theirs"})  # those of others are not on it
    assert (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8") == page()
    assert page().count("\n| `") == len(declared()) - 1


@pytest.mark.parametrize("name", ["", "a\udcff", "a\nb", 5])
def test_a_metric_has_a_name_that_can_be_written(name: Any) -> None:
    with pytest.raises(ValueError, match="a metric needs a name"):
        metric(name, unit="1")(lambda: 1.0)


def test_a_metric_that_leaves_the_process_is_none() -> None:
    @metric("leaves", unit="1")
    def leaves() -> float:
        sys.exit(3)

    with pytest.warns(RuntimeWarning, match="metric 'leaves' of .* fails, and is None: SystemExit: 3"):
        assert value(run_log(41), "leaves") is None


def test_needs_are_a_tuple() -> None:
    with pytest.raises(ValueError, match="needs and optional are tuples of names"):
        metric("one", unit="1", needs="time")(lambda time: 1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="a metric needs a name"):
        metrics([])(lambda: {})
