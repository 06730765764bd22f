"""Replaying logs. Oracles: the run that a recording was made of, bit by bit; ground truth of the MRCLAM fixture."""

from __future__ import annotations

import json
import math
import shutil
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import yaml

import robocar
from robocar.core import LogFormatError, ParameterError, RobocarError, ScenarioError, UnknownNameError
from robocar.episode.replay import replay
from robocar.formats import check_file, read_tum
from robocar.formats.mrclam import load_mrclam
from robocar.regression.divergence import find_divergence
from robocar.regression.report import write_report
from robocar.regression.results import read_results
from robocar.regression.suite import load_suite
from robocar.scenario.load import load_scenario

SETTINGS = {
    "robot.camera": True,
    "robot.camera_pan": "sweep",
    "robot.compass": True,
    "time_limit": 6.0,
    "estimator.max_particles": 300,
    "estimator.min_particles": 300,
}


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run with particles, images and a seed of its own."""
    result = robocar.run(
        "thesis-field",
        navigator="a-star",
        estimator="particle-filter",
        seed=5,
        settings=SETTINGS,
        out=tmp_path_factory.mktemp("runs"),
    )
    assert result.status == "timeout"
    assert result.directory is not None
    return result.directory


def test_the_same_estimator_gives_the_run_s_estimate_bit_by_bit(run_folder: Path, tmp_path: Path) -> None:
    result = replay(run_folder, out=tmp_path)
    assert result.status == "success"
    assert (result.estimator, result.seed, result.navigator) == ("particle-filter", 5, "replay")
    assert result.directory is not None
    assert (result.directory / "estimate.tum").read_bytes() == (run_folder / "estimate.tum").read_bytes()
    assert (result.directory / "odometry.tum").read_bytes() == (run_folder / "odometry.tum").read_bytes()
    before = json.loads((run_folder / "metrics.json").read_text())["metrics"]
    for name in ("position_rmse", "heading_rmse", "odometry_position_rmse", "localization/nees", "final_position_error"):
        assert result.value(name) == pytest.approx(before[name]["value"], rel=1e-4), name


def test_a_replay_can_be_replayed(run_folder: Path, tmp_path: Path) -> None:
    first = replay(run_folder, out=tmp_path / "a")
    assert first.directory is not None
    second = replay(first.directory, out=tmp_path / "b")
    assert second.hash == first.hash


@pytest.mark.parametrize("estimator", ["odometry", "odometry-compass", "ekf"])
def test_another_estimator_over_the_same_sensor_data(run_folder: Path, estimator: str) -> None:
    result = replay(run_folder, estimator=estimator)
    error = result.value("position_rmse")
    assert error is not None
    assert error < 0.10
    if estimator == "odometry":
        np.testing.assert_array_equal(result.estimate.poses, result.odometry.poses)


def test_the_replay_of_a_log_sends_the_user_to_the_log(data_dir: Path, tmp_path: Path) -> None:
    result = replay(data_dir / "mrclam", estimator="odometry", out=tmp_path)
    assert result.directory is not None
    with pytest.raises(LogFormatError, match="replay the log itself"):
        replay(result.directory, estimator="ekf")


def test_seed_and_parameters_matter(run_folder: Path) -> None:
    base = replay(run_folder)
    assert replay(run_folder, seed=6).hash != base.hash
    assert replay(run_folder, settings={"estimator.max_particles": 400}).hash != base.hash
    assert replay(run_folder / "run.rrd").hash == base.hash


def mrclam_rmse(result: robocar.RunResult, folder: Path) -> float:
    """Position RMSE of the estimate against the linearly interpolated ground truth, over the odometry's times."""
    log = load_mrclam(folder)
    assert log.truth is not None
    times = np.unique([o.time for o in log.observations if o.twist is not None])
    np.testing.assert_array_equal(result.estimate.times, times)
    inside = (times >= log.truth.times[0]) & (times <= log.truth.times[-1])
    off = [np.interp(times[inside], log.truth.times, log.truth.poses[:, k]) - result.estimate.poses[inside, k] for k in (0, 1)]
    return math.sqrt(np.mean(off[0] ** 2 + off[1] ** 2))


@pytest.mark.parametrize("estimator", ["ekf", "particle-filter"])
def test_the_mrclam_fixture_to_20_cm_with_default_parameters(data_dir: Path, estimator: str, tmp_path: Path) -> None:
    folder = data_dir / "mrclam"
    result = replay(folder, estimator=estimator, out=tmp_path)
    error = mrclam_rmse(result, folder)
    assert error <= 0.20
    assert result.value("position_rmse") == pytest.approx(error, rel=1e-6)
    assert result.value("odometry_position_rmse") > 1.0
    assert result.value("min_clearance") is None
    assert result.value("contacts") is None
    assert result.directory is not None
    written = read_tum(result.directory / "estimate.tum")
    np.testing.assert_allclose(written.poses, result.estimate.poses, atol=1e-12)
    assert result.recording is not None
    assert json.loads((result.directory / "metrics.json").read_text())["navigator"] == "replay"


@pytest.mark.parametrize("estimator", ["ekf", "particle-filter"])
def test_the_robot_with_false_recoveries_to_20_cm(data_dir: Path, estimator: str) -> None:
    """Robot 4: at 134 s the particle filter's error rose from 0.11 m to more than 1 m within a tick or two."""
    folder = data_dir / "mrclam_r4"
    settings = {"estimator.min_particles": 500, "estimator.max_particles": 500} if estimator == "particle-filter" else {}
    result = replay(folder, estimator=estimator, subject=4, settings=settings)
    assert mrclam_rmse(result, folder) <= 0.20
    with pytest.raises(LogFormatError, match="there is no robot 1; its robots are 4"):
        replay(folder, estimator=estimator, subject=1)


def test_dead_reckoning_of_the_fixture_drifts_by_metres(data_dir: Path) -> None:
    result = replay(data_dir / "mrclam", estimator="odometry")
    assert mrclam_rmse(result, data_dir / "mrclam") > 1.0


def test_bad_input_is_named(run_folder: Path, tmp_path: Path, data_dir: Path) -> None:
    with pytest.raises(LogFormatError, match="no such file"):
        replay(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogFormatError, match=r"run\.rrd"):
        replay(tmp_path / "empty")
    (tmp_path / "log.txt").write_text("hello")
    with pytest.raises(LogFormatError, match="a log is"):
        replay(tmp_path / "log.txt")
    with pytest.raises(UnknownNameError, match="particle-filter"):
        replay(run_folder, estimator="particle-filtr")
    with pytest.raises(ScenarioError, match="truth"):
        replay(run_folder, estimator="truth")
    with pytest.raises(ScenarioError, match="--estimator"):
        replay(data_dir / "mrclam")
    with pytest.raises(ScenarioError, match=r"robot\.lidar"):
        replay(run_folder, settings={"robot.lidar": "hokuyo"})
    with pytest.raises(ScenarioError, match=r"navigator\.speed"):
        replay(run_folder, settings={"navigator.speed": 0.2})
    with pytest.raises(ParameterError, match="max_particle"):
        replay(run_folder, settings={"estimator.max_particle": 3})
    with pytest.raises(ScenarioError, match="seed"):
        replay(run_folder, seed=-1)


@pytest.mark.parametrize("damage", ["nothing", "text", "half"])
def test_a_run_whose_configuration_is_damaged(run_folder: Path, tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run_folder, folder)
    text = (folder / "config.yaml").read_text()
    (folder / "config.yaml").write_text({"nothing": "", "text": "a: [", "half": text[: len(text) // 2]}[damage])
    with pytest.raises(LogFormatError, match=r"config\.yaml"):
        replay(folder)


def test_a_recorded_configuration_runs_no_code(run_folder: Path, tmp_path: Path) -> None:
    """An estimator by path is named where the replay is started."""
    folder = tmp_path / "run"
    shutil.copytree(run_folder, folder)
    text = (folder / "config.yaml").read_text().replace("estimator: particle-filter", "estimator: broken_parts:at_goal")
    (folder / "config.yaml").write_text(
        text.replace("estimator.max_particles", "time").replace("estimator.min_particles", "limit")
    )
    with pytest.raises(ScenarioError, match="estimator is broken_parts:at_goal, and a recorded configuration runs no code"):
        replay(folder)
    assert replay(folder, estimator="broken_parts:at_goal").status == "success"


@pytest.mark.parametrize(
    "key", ["navigator", "estimator", "mapper", "defaults.navigator", "defaults.estimator", "defaults.mapper"]
)
def test_nothing_that_reads_a_run_imports_what_its_configuration_names(
    key: str, run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a module that would leave a file."""
    (tmp_path / "canary.py").write_text(f"open({str(tmp_path / 'sang')!r}, 'w').close()\nraise SystemExit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    folder = tmp_path / "runs" / run_folder.name
    shutil.copytree(run_folder, folder)
    config = yaml.safe_load((folder / "config.yaml").read_text())
    place = config["scenario"].setdefault("defaults", {}) if "." in key else config
    place[key.rpartition(".")[2]] = "canary:build"
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    for action in (
        lambda: replay(folder),
        lambda: replay(folder, estimator="odometry"),
        lambda: find_divergence(folder, run_folder, tmp_path / "both.rrd"),
        lambda: write_report(folder.parent),
        lambda: read_results(folder.parent),
        lambda: check_file(folder / "config.yaml"),
        lambda: load_scenario(folder / "config.yaml"),
        lambda: load_suite(folder / "config.yaml"),
    ):
        with suppress(RobocarError):
            action()
    assert not (tmp_path / "sang").exists()
    assert "canary" not in sys.modules


def test_a_run_without_a_camera_cannot_feed_the_particle_filter(tmp_path: Path) -> None:
    result = robocar.run("thesis-field", navigator="a-star", settings={"time_limit": 1.0}, out=tmp_path)
    assert result.directory is not None
    with pytest.raises(ScenarioError, match=r"robot\.camera=true"):
        replay(result.directory, estimator="particle-filter")
