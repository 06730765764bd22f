"""The run directory holds what it says, and is there whole or not at all.

Oracles: the design's list of files and fields; the metrics' formulas on the trajectory files; the recording, read back; a disk
that is full.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from robocar.core import OutputError
from robocar.episode.result import RunResult
from robocar.episode.run import run
from robocar.episode.spec import RunSpec
from robocar.formats import read_tum
from robocar.recording import read_observations, read_signal, read_trajectory
from tests.episode.runs import PARTS, SHORT, short, strict

ALWAYS = """
    duration path_length shortest_path_length spl min_clearance mean_clearance contacts replans plan_time_mean plan_time_max
    position_rmse heading_rmse final_position_error odometry_position_rmse angle_over_length jerk_rms wall_time real_time_factor
"""


class TestRunDirectory:
    def test_holds_what_the_design_says(self, recorded: RunResult, out: Path) -> None:
        assert recorded.directory == out / recorded.name
        assert re.fullmatch("short--a-star--odometry--none--s3--[0-9a-f]{8}", recorded.name)
        names = {file.name for file in recorded.directory.iterdir()}
        assert names == {"run.rrd", "metrics.json", "config.yaml", "truth.tum", "odometry.tum", "estimate.tum"}
        assert recorded.recording == recorded.directory / "run.rrd"
        assert [file.name for file in out.iterdir() if file.name.startswith(".")] == []

    def test_metrics_json(self, recorded: RunResult) -> None:
        assert recorded.directory is not None
        content = strict((recorded.directory / "metrics.json").read_text())
        assert content == strict(json.dumps(recorded.summary()))
        keys = "schema scenario navigator estimator mapper seed status reason hash fingerprint versions metrics"
        assert list(content) == keys.split()
        facts = [content[key] for key in ("schema", "scenario", "navigator", "estimator", "mapper", "seed", "status")]
        assert facts == [1, "short", "a-star", "odometry", "none", 3, "success"]
        assert re.fullmatch("[0-9a-f]{64}", content["hash"])
        assert {"python", "robocar", "mujoco", "numpy"} <= set(content["versions"])
        assert set(content["metrics"]) >= set(ALWAYS.split())
        assert all(set(metric) == {"value", "unit"} for metric in content["metrics"].values())
        assert content["metrics"]["duration"]["unit"] == "s"
        assert content["metrics"]["heading_rmse"]["unit"] == "rad"

    def test_a_missing_value_is_null(self, tmp_path: Path) -> None:
        floor = tmp_path / "floor.txt"
        floor.write_text("........\n" * 8)
        result = run(short(goal=None, border="open", map=str(floor)), navigator="broken_parts:done", estimator="truth")
        content = strict(json.dumps(result.summary()))["metrics"]
        for name, unit in (("shortest_path_length", "m"), ("spl", "1"), ("min_clearance", "m"), ("mean_clearance", "m")):
            assert content[name] == {"value": None, "unit": unit}

    def test_metrics_are_those_of_the_trajectories(self, recorded: RunResult) -> None:
        """Their formulas on the files."""
        assert recorded.directory is not None
        truth, estimate, odometry = (read_tum(recorded.directory / f"{n}.tum") for n in ("truth", "estimate", "odometry"))
        assert recorded.value("duration") == pytest.approx(truth.times[-1] - truth.times[0])
        assert recorded.value("path_length") == pytest.approx(np.hypot(*np.diff(truth.poses[:, :2], axis=0).T).sum())
        errors = np.hypot(*(truth.poses - estimate.poses)[:, :2].T)
        assert recorded.value("position_rmse") == pytest.approx(math.sqrt(np.mean(errors**2)))
        assert recorded.value("final_position_error") == pytest.approx(errors[-1])
        assert np.array_equal(odometry.poses, estimate.poses)  # the estimator is odometry
        straight = math.hypot(0.9, 0.1)
        assert recorded.value("shortest_path_length") == pytest.approx(straight, rel=1e-9)  # nothing stands in between
        assert math.dist(estimate.poses[-1, :2], SHORT["goal"]) <= 0.10
        assert recorded.value("contacts") == 0

    def test_the_recording_holds_the_trajectories(self, recorded: RunResult) -> None:
        assert recorded.directory is not None
        for name in ("truth", "estimate", "odometry"):
            times, poses = read_trajectory(recorded.directory / "run.rrd", f"world/{name}")
            written = read_tum(recorded.directory / f"{name}.tum")
            assert np.abs(times - written.times).max() < 1e-8  # nanoseconds in the recording
            assert np.abs(poses - written.poses).max() < 1e-12  # quaternions in the file
        _, clearance = read_signal(recorded.directory / "run.rrd", "signals/clearance")
        assert clearance.min() == recorded.value("min_clearance")
        assert sum(1 for _ in read_observations(recorded.directory / "run.rrd")) == len(recorded.truth.times)

    def test_overrides_have_directories_of_their_own(self, tmp_path: Path) -> None:
        brief = {"time_limit": 0.5}
        names = []
        for settings in (
            brief,
            brief | {"robot.compass": True},
            {"robot.compass": True} | brief,
            brief | {"robot.compass": False},
        ):
            result = run(SHORT, **PARTS, settings=settings, out=tmp_path, record=False, force=True)
            assert result.directory is not None
            names.append(result.directory.name)
        assert all(re.fullmatch("short--a-star--odometry--none--s0--[0-9a-f]{8}", name) for name in names)
        assert names[1] == names[2]  # whatever their order
        assert len(set(names)) == 3

    def test_settings_from_python_may_hold_arrays(self, tmp_path: Path) -> None:
        settings = {"start": np.array([0.4, 0.4, 0.0]).tolist(), "time_limit": np.float64(0.5)}
        result = run(SHORT, **PARTS, settings=settings, out=tmp_path, record=False)
        assert result.directory is not None
        assert yaml.safe_load((result.directory / "config.yaml").read_text())["scenario"]["start"] == [0.4, 0.4, 0.0]

    def test_an_existing_run_is_refused_and_replaced_only_by_force(self, tmp_path: Path) -> None:
        first = run(SHORT, **PARTS, out=tmp_path, record=False, settings={"time_limit": 0.5})
        assert first.directory is not None
        stray = first.directory / "notes.txt"
        stray.write_text("mine")
        with pytest.raises(OutputError, match=r"exists already; --force replaces it"):
            run(SHORT, **PARTS, out=tmp_path, record=False, settings={"time_limit": 0.5})
        assert stray.read_text() == "mine"
        second = run(SHORT, **PARTS, out=tmp_path, record=False, settings={"time_limit": 0.5}, force=True)
        assert second.directory == first.directory
        assert not stray.exists()
        assert [entry.name for entry in tmp_path.iterdir()] == [first.directory.name]

    def test_by_force_the_old_run_stays_until_the_new_one_is_complete(self, tmp_path: Path) -> None:
        settings = {"time_limit": 0.5}
        first = run(SHORT, **PARTS, out=tmp_path, record=False, settings=settings)
        assert first.directory is not None
        before = (first.directory / "metrics.json").read_text()
        seen = []
        run(
            SHORT, **PARTS, out=tmp_path, record=False, settings=settings, force=True,
            progress=lambda time, limit: seen.append((first.directory / "metrics.json").read_text()),
        )  # fmt: skip
        assert set(seen) == {before}

    def test_what_a_killed_process_of_the_same_number_left_is_not_taken_over(self, tmp_path: Path) -> None:
        name = RunSpec.of(SHORT | {"time_limit": 0.5}, **PARTS).name
        old = tmp_path / f".{name}.{os.getpid()}.partial"
        old.mkdir()
        (old / "error.txt").write_text("of another run")
        result = run(SHORT | {"time_limit": 0.5}, **PARTS, out=tmp_path, record=False)
        assert result.directory is not None
        assert not (result.directory / "error.txt").exists()

    @pytest.mark.parametrize("folder", ["file/below", "file"])
    def test_a_folder_that_cannot_be_written(self, folder: str, tmp_path: Path) -> None:
        """Below a file: that fails for root, too."""
        (tmp_path / "file").write_text("")
        with pytest.raises(OutputError, match=r"cannot write a run here: (Not a directory|File exists)"):
            run(SHORT, **PARTS, out=tmp_path / folder)

    def test_a_name_too_long_for_the_disk(self, tmp_path: Path) -> None:
        with pytest.raises(OutputError, match="name too long"):
            run(short(name="x" * 300), **PARTS, out=tmp_path)

    @pytest.mark.parametrize(("record", "size"), [(True, "1200k"), (False, "16k")])
    def test_a_full_disk_leaves_nothing_that_looks_whole(self, record: bool, size: str, tmp_path: Path) -> None:
        disk = tmp_path / "disk"
        disk.mkdir()
        if os.geteuid() != 0 or shutil.which("mount") is None:
            pytest.skip("needs root to make a disk that can be full")
        if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)], capture_output=True).returncode:
            pytest.skip("this machine does not let root mount a tmpfs")
        try:
            scenario = short(robot={"lidar": "scan360"}, time_limit=90, goal=None)
            with pytest.raises(OutputError, match=r"disk is full|No space left"):
                run(scenario, navigator="broken_parts:spin", estimator="truth", out=disk, record=record)
            assert [entry.name for entry in disk.iterdir() if not entry.name.startswith(".")] == []
        finally:
            subprocess.run(["umount", "-l", str(disk)], check=True)

    def test_files_that_may_not_grow_are_an_output_error(self, tmp_path: Path) -> None:
        """A limit of the process instead of a small disk, so that it needs no rights."""
        code = (
            "import resource, sys, tests.episode.test_run_directory as t\n"
            "t.run(t.SHORT, **t.PARTS)\n"  # what numba compiles it may keep
            "resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))\n"
            "try: t.run(t.SHORT, **t.PARTS, out=sys.argv[1], record=False)\n"
            "except t.OutputError as error: sys.stdout.write(f'refused: {error}')"
        )
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
        command = [sys.executable, "-c", code, str(tmp_path)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert "refused: " in done.stdout, done.stderr
        assert "File too large" in done.stdout
        assert [entry.name for entry in tmp_path.iterdir() if not entry.name.startswith(".")] == []
