"""Runs as a whole: equal seeds give equal runs, the run directory holds what it says, and what goes wrong is told.

Oracles: hashes and trajectories of repeated runs; the metrics' formulas on the trajectory files; the recording, read back; the
design's list of files and fields; a disk that is full.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robocar.core import (
    STOP,
    Drive,
    Observation,
    OutputError,
    ParameterError,
    RobocarError,
    ScenarioError,
    Twist,
    UnknownNameError,
)
from robocar.episode.judge import Episode, Rules
from robocar.episode.result import RunResult
from robocar.episode.run import run, simulate
from robocar.formats import load_map, read_tum
from robocar.recording import read_observations, read_signal, read_trajectory
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario

SHORT: dict[str, Any] = {
    "name": "short",
    "map": "maps/thesis_field.yaml",
    "start": [0.3, 0.3, 0],
    "goal": [1.2, 0.4],
    "time_limit": 30,
}
"""A few seconds of driving."""
PARTS = {"navigator": "a-star", "estimator": "odometry"}
ALWAYS = """
    duration path_length shortest_path_length spl min_clearance mean_clearance contacts replans plan_time_mean plan_time_max
    position_rmse heading_rmse final_position_error odometry_position_rmse angle_over_length jerk_rms wall_time real_time_factor
"""


def short(**changes: Any) -> dict[str, Any]:
    return SHORT | changes


def strict(text: str) -> Any:
    """JSON without Python's NaN and Infinity."""

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def recorded(out: Path) -> RunResult:
    return run(SHORT, **PARTS, seed=3, out=out)


class TestDeterminism:
    def test_the_same_with_and_without_recording(self, recorded: RunResult) -> None:
        again = run(SHORT, **PARTS, seed=3)
        assert again.hash == recorded.hash
        for name in ("truth", "estimate", "odometry"):
            assert np.array_equal(getattr(again, name).poses, getattr(recorded, name).poses)

    def test_the_same_in_worker_processes(self, recorded: RunResult) -> None:
        job = {"scenario": SHORT, **PARTS, "seed": 3}
        first, second = run_many([job, job | {"seed": 4}])
        assert first.hash == recorded.hash != second.hash

    def test_another_seed_is_another_run(self, recorded: RunResult) -> None:
        hashes = {run(SHORT, **PARTS, seed=seed).hash for seed in (0, 1, 2)} | {recorded.hash}
        assert len(hashes) == 4

    def test_the_hash_is_sha256_over_time_qpos_qvel_and_ctrl_at_each_tick(self) -> None:
        simulation = simulate(SHORT, seed=5)
        digest = hashlib.sha256()
        for tick in range(60):
            simulation.sense()
            simulation.act(Drive(Twist(0.2, 0.3 * math.sin(tick))))
            data = simulation.data
            for part in (np.float64(data.time), data.qpos, data.qvel, data.ctrl):
                digest.update(np.asarray(part, dtype=np.float64).tobytes())
        assert simulation.hash == digest.hexdigest()
        simulation.close()

    def test_a_run_does_not_touch_the_global_random_state(self) -> None:
        np.random.seed(1)  # noqa: NPY002
        expected = np.random.random()  # noqa: NPY002
        np.random.seed(1)  # noqa: NPY002
        run(SHORT, **PARTS, seed=1, settings={"time_limit": 1})
        assert np.random.random() == expected  # noqa: NPY002

    @pytest.mark.parametrize("more", [{"robot.compass": True}, {"robot.lidar": "scan360"}])
    def test_one_more_sensor_changes_no_other_stream(self, more: dict[str, Any]) -> None:
        """A parked car: what the sonars, the PSD and the accelerometer say is the same, noise and drop-outs included."""

        def readings(settings: dict[str, Any], seed: int = 7) -> np.ndarray:
            simulation = simulate(SHORT, seed=seed, settings=settings)
            rows = []
            for _ in range(60):
                seen: Observation = simulation.sense()
                simulation.act(STOP)
                rows += [[scan.time, *scan.ranges] for scan in seen.sonars]
                rows += [[r.time, r.value] for r in (seen.psd,) if r is not None]
                rows += [[r.time, v] for r in (seen.acceleration,) if r is not None for v in r.value]
            simulation.close()
            return np.array(rows)

        plain = readings({})
        assert len(plain) > 100
        assert np.array_equal(readings(more), plain, equal_nan=True)
        assert not np.array_equal(readings({}, seed=8), plain, equal_nan=True)

    def test_the_effective_configuration_gives_the_run_again(self, recorded: RunResult) -> None:
        assert recorded.directory is not None
        config = yaml.safe_load((recorded.directory / "config.yaml").read_text())
        parts = {kind: config[kind] for kind in ("navigator", "estimator", "mapper")}
        again = run(config["scenario"], **parts, seed=config["seed"])
        assert again.hash == recorded.hash

    def test_a_scenario_object_a_mapping_and_overrides_mean_the_same(self, recorded: RunResult) -> None:
        other = {key: value for key, value in SHORT.items() if key != "goal"}
        assert run(other, **PARTS, seed=3, settings={"goal": [1.2, 0.4]}).hash == recorded.hash
        assert run(load_scenario(SHORT), **PARTS, seed=3).hash == recorded.hash


class TestRunDirectory:
    def test_holds_what_the_design_says(self, recorded: RunResult, out: Path) -> None:
        assert recorded.directory == out / "short--a-star--odometry--none--s3"
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
        old = tmp_path / f".short--a-star--odometry--none--s0.{os.getpid()}.partial"
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
            "import resource, sys, tests.episode.test_run as t\n"
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


class TestEndings:
    """Each way in which a run may end, in physics."""

    def test_goal_reached(self, recorded: RunResult) -> None:
        assert recorded.success
        assert recorded.status == "success"
        assert "reached the goal" in recorded.reason

    def test_time_limit(self) -> None:
        result = run(short(time_limit=2), navigator="broken_parts:spin", estimator="truth")
        assert (result.status, result.reason) == ("timeout", "not there after 2 s")
        assert result.value("duration") == pytest.approx(2.0)
        assert result.value("spl") == 0.0

    def test_a_navigator_that_stands_still_is_stuck_and_one_that_turns_is_not(self) -> None:
        progress = {"movement_time_allowance": 3.0}
        still = run(short(progress=progress, time_limit=8), navigator="broken_parts:still", estimator="truth")
        assert still.status == "stuck"
        assert 3.0 <= (still.value("duration") or 0) <= 3.2
        spin = run(short(progress=progress, time_limit=8), navigator="broken_parts:spin", estimator="truth")
        assert spin.status == "timeout"

    @pytest.mark.parametrize("speed", [0.01, 0.3])
    def test_contact_ends_the_run(self, speed: float) -> None:
        """Analytic: nose at the wall x = 3.5 after the way in between, however slowly."""
        result = run(
            short(start=[3.36, 0.4, 0], time_limit=20),
            navigator="broken_parts:straight", estimator="truth", settings={"navigator.speed": speed},
        )  # fmt: skip
        assert result.status == "collision"
        assert re.fullmatch(r"contact at \(3\.4\d, 0\.40\), [\d.]+ s", result.reason)
        assert result.value("contacts") == 1
        assert result.value("contacts_standing") == 0
        assert result.value("min_clearance") == pytest.approx(0.0, abs=1e-3)

    def test_contacts_are_counted_where_the_scenario_says_continue(self) -> None:
        result = run(
            short(start=[3.3, 0.4, 0], time_limit=4, on_contact="continue"), navigator="broken_parts:straight", estimator="truth"
        )
        assert result.status == "timeout"
        assert result.value("contacts") >= 1  # type: ignore[operator]

    def test_a_mover_that_runs_into_the_parked_car_is_no_fault_of_the_car(self) -> None:
        cart = {"name": "cart", "box": [0.3, 0.3, 0.3], "waypoints": [[0.6, 1.25], [2.5, 1.25]], "speed": 0.3, "mass": 20.0}
        parked = short(start=[1.2, 1.25, 1.57], movers=[cart], time_limit=4)
        result = run(parked, navigator="broken_parts:still", estimator="truth")
        assert result.status == "timeout"
        assert result.value("contacts") == 0
        assert result.value("contacts_standing") >= 1  # type: ignore[operator]
        assert result.value("min_clearance") == 0.0
        moved = np.hypot(*(result.truth.poses[-1] - result.truth.poses[0])[:2])
        assert moved > 0.05  # it was pushed

    def test_done_and_give_up(self) -> None:
        done = run(short(goal=None), navigator="broken_parts:done", estimator="truth")
        assert (done.status, done.reason, done.success) == ("success", "seen all", True)
        stuck = run(SHORT, navigator="broken_parts:give_up", estimator="truth")
        assert (stuck.status, stuck.reason, stuck.success) == ("stuck", "walled in", False)

    def test_who_only_believes_to_be_there_has_missed(self) -> None:
        result = run(SHORT, navigator="broken_parts:still", estimator="broken_parts:at_goal")
        assert result.status == "missed"
        assert result.reason == f"believes to be at the goal but is {math.hypot(0.9, 0.1):.2f} m from it"

    def test_a_goal_with_a_heading_asks_for_it(self) -> None:
        """The pose at the end, by the tolerances' definition; without a heading the car arrives facing along its way."""
        free = run(SHORT, navigator="a-star", estimator="truth")
        turned = run(short(goal=[1.2, 0.4, 1.5708], yaw_goal_tolerance=0.2), navigator="a-star", estimator="truth")
        assert free.success
        assert turned.success
        assert abs(free.truth.poses[-1, 2] - math.pi / 2) > 0.5
        assert abs(turned.truth.poses[-1, 2] - math.pi / 2) <= 0.2
        assert math.dist(turned.truth.poses[-1, :2], (1.2, 0.4)) <= 0.10

    def test_kidnapping(self) -> None:
        """Where, when, unseen by odometry, and not part of the way."""
        spot = [2.8, 2.0, 1.0]
        kidnapped = short(time_limit=3, events=[{"time": 1.0, "kidnap": spot}])
        result = run(kidnapped, navigator="broken_parts:spin", estimator="odometry")
        steps = np.hypot(*np.diff(result.truth.poses[:, :2], axis=0).T)
        jump = int(np.argmax(steps))
        assert result.truth.times[jump + 1] == pytest.approx(1.05)
        assert result.truth.poses[jump + 1] == pytest.approx(spot, abs=0.05)
        assert np.sort(steps)[-2] < 0.02
        assert np.hypot(*np.diff(result.estimate.poses[:, :2], axis=0).T).max() < 0.02
        assert result.value("path_length") == pytest.approx(steps.sum() - steps[jump])
        assert result.value("position_rmse") > 1.0  # type: ignore[operator]

    def test_kidnapping_into_a_wall_is_refused(self) -> None:
        with pytest.raises(ScenarioError, match=r"kidnap at 1 s \(1\.8, 1\.8, 0\) lies in a wall"):
            run(short(events=[{"time": 1.0, "kidnap": [1.8, 1.8, 0]}]), **PARTS)


FAULTS = {
    "nan": "ValueError: the navigator commanded a number that is not finite",
    "nan_pan": "ValueError: the navigator commanded a number that is not finite",
    "raises": "ZeroDivisionError: no way to divide",
    "exits": "SystemExit: 0",
    "none": "TypeError: the navigator must return a command, not NoneType",
    "tuple_of_speeds": "TypeError: the navigator must return a command, not tuple",
    "serial_number": "TypeError: the navigator must give a text, not int",
    "no_trace": "TypeError: the navigator's trace must be a mapping",
    "odd_trace": "TypeError: the navigator's trace must be a mapping of names to drawables; 'what' is int",
    "word_scalar": "TypeError: the navigator's trace must hold numbers as scalars; 'what' is 'much'",
    "undrawable": "ValueError: cannot reshape",
}


class TestFaults:
    @pytest.mark.parametrize("navigator", FAULTS)
    def test_of_a_planner_end_the_run_and_its_directory_is_complete(self, navigator: str, tmp_path: Path) -> None:
        result = run(SHORT, navigator=f"broken_parts:{navigator}", estimator="truth", out=tmp_path)
        assert result.status == "error"
        assert result.reason.startswith(FAULTS[navigator])
        assert not result.success
        assert result.directory is not None
        assert result.reason.partition(":")[0] in (result.directory / "error.txt").read_text()
        assert "Traceback" in (result.directory / "error.txt").read_text()
        assert strict((result.directory / "metrics.json").read_text())["reason"] == result.reason
        times, _ = read_trajectory(result.directory / "run.rrd")
        assert len(times) >= 5  # the ticks before are kept
        assert len(read_tum(result.directory / "truth.tum").times) == 5

    @pytest.mark.parametrize(
        ("estimator", "reason"),
        [
            ("estimator_raises", "RuntimeError: lost"),
            ("estimator_nan", r"ValueError: a pose needs finite numbers, not \(nan, 0.0, 0.0\)"),
            ("estimator_none", "TypeError: the estimator must return a belief, not NoneType"),
        ],
    )
    def test_of_an_estimator(self, estimator: str, reason: str, tmp_path: Path) -> None:
        result = run(SHORT, navigator="broken_parts:still", estimator=f"broken_parts:{estimator}", out=tmp_path, record=False)
        assert result.status == "error"
        assert re.match(reason, result.reason)
        assert result.directory is not None
        assert result.value("contacts") == 0

    def test_of_a_factory_is_bad_input(self) -> None:
        with pytest.raises(ParameterError, match="broken_parts:factory_raises' cannot be built: OSError: no licence"):
            run(SHORT, navigator="broken_parts:factory_raises")

    @pytest.mark.parametrize(
        ("keywords", "error", "message"),
        [
            ({"navigator": "dynamic-astar"}, UnknownNameError, r"did you mean 'dynamic-a-star'\?\); known: a-star, "),
            ({"estimator": "odometer"}, UnknownNameError, r"known: .*odometry, odometry-compass, "),
            ({"mapper": "x"}, UnknownNameError, r"unknown mapper 'x'; known: .*none"),
            ({"navigator": "broken_parts:no_factory"}, UnknownNameError, "no function or class 'no_factory'"),
            ({"navigator": "no_such_module:build"}, UnknownNameError, "there is no module 'no_such_module'"),
            ({"settings": {"navigator.sped": 1}}, ParameterError, "has no parameter 'sped'"),
            ({"settings": {"navigator": "x"}}, ScenarioError, "choose it with --navigator"),
            ({"settings": {"robot.lidr": "none"}}, ScenarioError, r"unknown key 'robot\.lidr' \(did you mean 'lidar'\?\)"),
            ({"settings": {"folder": "/"}}, ScenarioError, "unknown key 'folder'"),
            ({"seed": -1}, ScenarioError, "whole number from 0 on, not -1"),
            ({"seed": True}, ScenarioError, "whole number from 0 on, not True"),
            ({"seed": 1.5}, ScenarioError, "whole number from 0 on, not 1.5"),
        ],
    )
    def test_bad_arguments_leave_no_trace(self, keywords: Any, error: type[RobocarError], message: str, tmp_path: Path) -> None:
        with pytest.raises(error, match=message):
            run(SHORT, **(PARTS | keywords), out=tmp_path / "runs")
        assert list(tmp_path.rglob("*s0*")) == []

    @pytest.mark.parametrize("kind", ["navigator", "estimator", "mapper"])
    def test_a_scenario_names_no_code(self, kind: str, tmp_path: Path) -> None:
        """Data files run no code: the module would leave a mark when imported."""
        file = tmp_path / "evil.yaml"
        file.write_text(yaml.safe_dump(short(defaults={kind: "broken_parts:straight"})))
        with pytest.raises(ScenarioError, match=rf"evil\.yaml: defaults\.{kind}: a scenario runs no code"):
            run(file)
        with pytest.raises(ScenarioError, match="a scenario runs no code"):
            run(SHORT, settings={f"defaults.{kind}": "broken_parts:straight"})


def test_simulate_has_no_parts() -> None:
    with pytest.raises(ScenarioError, match="there is no navigator here"):
        simulate(SHORT, settings={"navigator.speed": 1.0})


def test_the_function_run_stays_the_function() -> None:
    """`robocar.run` is the API's function, whatever else is imported before or after it."""
    call = "\ntry: robocar.run('none')\nexcept robocar.core.ScenarioError: pass\nelse: raise AssertionError"
    for order in (
        "import robocar.episode.run, robocar",
        "import robocar; robocar.run; robocar.RunResult; import robocar.episode.run",
    ):
        subprocess.run([sys.executable, "-c", f"{order}; import robocar.core{call}"], check=True)


class TestOtherMaps:
    """Maps that nobody here drew, driven with the pose oracle."""

    @pytest.mark.parametrize(
        ("file", "resolution", "start", "goal"),
        [
            ("ros_maps/turtlebot3/map.yaml", 0.05, None, None),
            ("ros_maps/nav2/tb3_sandbox.yaml", 0.05, None, None),
            ("ros_maps/nav2/testmap.yaml", 0.5, None, None),
            ("movingai/room-32-32-4.map", 0.5, None, None),
            ("movingai/random-32-32-10.map", 0.6, None, None),
        ],
    )
    def test_is_driven(self, file: str, resolution: float, start: Any, goal: Any, data_dir: Path) -> None:
        """Start and goal: two of the roomiest free cells, some cells apart, connected by scipy's labels."""
        grid = load_map(data_dir / file, resolution)
        a, b = far_apart(grid, reach=2.5)
        content = {"name": "map", "map": str(data_dir / file), "resolution": resolution, "start": [*a, 0.0], "goal": list(b)}
        result = run(content | {"time_limit": 60}, navigator="a-star", estimator="truth")
        assert result.status == "success", result.reason
        assert result.value("contacts") == 0
        assert math.dist(result.truth.poses[-1, :2], b) <= 0.10
        shortest, length = result.value("shortest_path_length"), result.value("path_length")
        assert shortest is not None
        assert length is not None
        assert shortest - 0.11 <= length <= 1.5 * shortest + 0.3


def far_apart(grid: Any, reach: float) -> tuple[list[float], list[float]]:
    """Two centres of cells at most `reach` apart along x or y, each 0.25 m from all that is not free, with a way in between."""
    from scipy import ndimage

    closed = np.pad(~grid.free, 1, constant_values=True)
    room = ndimage.distance_transform_edt(~closed)[1:-1, 1:-1] * grid.resolution - 0.71 * grid.resolution
    labels, _ = ndimage.label(room > 0.22)
    cells = np.argwhere(room > 0.25)
    start = cells[len(cells) // 2]
    near = cells[labels[tuple(cells.T)] == labels[tuple(start)]]
    distances = np.hypot(*(near - start).T) * grid.resolution
    goal = near[np.argmax(np.where(distances <= reach, distances, -1.0))]
    assert 0.5 < np.hypot(*(goal - start)) * grid.resolution <= reach
    return grid.world_from_cell(start).tolist(), grid.world_from_cell(goal).tolist()


def test_rules_and_episode_are_plain_values() -> None:
    episode = Episode(Rules(), None)
    assert not episode.done
    episode.end("timeout", "first")
    episode.end("stuck", "second")
    assert (episode.done, episode.status, episode.reason) == (True, "timeout", "first")  # the first end counts
