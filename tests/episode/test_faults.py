"""What goes wrong is told: parts that fail end the run with a complete directory, bad arguments leave no trace.

Oracles: parts that are broken in known ways, the files of the run, read back.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from robocar.core import ParameterError, RobocarError, ScenarioError, UnknownNameError
from robocar.episode.replay import replay
from robocar.episode.result import RunResult
from robocar.episode.run import run, simulate
from robocar.formats import read_tum
from robocar.recording import read_trajectory
from tests.episode.runs import PARTS, SHORT, short, strict

FAULTS = {
    "nan": "ValueError: the navigator commanded a number that is not finite",
    "nan_pan": "ValueError: the navigator commanded a number that is not finite",
    "raises": "ZeroDivisionError: no way to divide",
    "exits": "SystemExit: 0",
    "odd_error": "Odd: nobody catches me",
    "generator_exit": "GeneratorExit: x",
    "cancels": "CancelledError:",
    "no_message_either": "Mute: (its message cannot be made)",
    "half_line": "ValueError: the navigator gave a text that UTF-8 cannot hold: '\\udcff'",
    "none": "TypeError: the navigator must return a command, not NoneType",
    "tuple_of_speeds": "TypeError: the navigator must return a command, not tuple",
    "serial_number": "TypeError: the navigator must give a text, not int",
    "no_trace": "TypeError: the navigator's trace must be a mapping",
    "odd_trace": "TypeError: the navigator's trace must be a mapping of names to drawables; 'what' is int",
    "word_scalar": "TypeError: the navigator's trace must hold numbers as scalars; 'what' is 'much'",
    "undrawable": "ValueError: cannot reshape",
    "drawn_late": "ValueError: cannot reshape",
    "huge_scalar": "TypeError: the navigator's trace must hold numbers as scalars; 'what' is 1000",
    "huge_work": "TypeError: the navigator's work must map units to counts from 0 to 2^53",
    "half_unit": "TypeError: the navigator's work must map units to counts from 0 to 2^53",
    "half_text": "ValueError: the navigator gave a text that UTF-8 cannot hold: '\\udcff'",
    "no_twist": "TypeError: the navigator must drive with a twist, not NoneType",
    "word_twist": "TypeError: a twist's v is a number, not 'fast'",
    "half_message": "ValueError: \\udcff",
    "two_lines": "ValueError: first second\\x1b[31m",
    "no_message": "Speechless: (its message cannot be made)",
}


def check_error(result: RunResult, reason: str) -> None:
    """The run is an error for this reason, and its directory is complete."""
    assert result.status == "error"
    assert re.match(reason, result.reason)
    assert result.directory is not None
    assert strict((result.directory / "metrics.json").read_text())["status"] == "error"
    assert result.reason.partition(":")[0] in (result.directory / "error.txt").read_text()


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
            (
                "estimator_covariance",
                r"ValueError: a belief's covariance are finite numbers of shape \(3, 3\), not shape \(2, 2\)",
            ),
            ("estimator_covariance_nan", "ValueError: a belief's covariance are finite numbers"),
            ("estimator_particles", r"ValueError: a belief's particles are finite numbers of shape \(5, 4\), not shape \(5, 3\)"),
            ("estimator_twist", "TypeError: a belief needs a pose, a twist and"),
            ("estimator_column_twist", r"TypeError: a twist's v is a number, not array\(\[0.1\]\)"),
            ("estimator_huge", "ValueError: a twist's v is too large"),
            ("estimator_odom", "TypeError: a belief needs a pose, a twist and"),
            ("estimator_state", r"TypeError: the estimator must return a belief, not State; .* @declares\(maps=True\)"),
            ("slam_frames", "TypeError: a state needs a belief, map_from_odom and odom_from_robot, not Belief, NoneType, SE2"),
            ("slam_belief", "TypeError: a state needs a belief, map_from_odom and odom_from_robot, not NoneType, SE2, SE2"),
            ("slam_no_map", r"TypeError: the state's map must have grid\(\), revision and complete; int has not"),
            ("slam_raises", "RuntimeError: no paper"),
            ("slam_text", "TypeError: a map's grid must be an occupancy grid or None, not str"),
        ],
    )
    def test_of_an_estimator(self, estimator: str, reason: str, tmp_path: Path) -> None:
        result = run(SHORT, navigator="broken_parts:still", estimator=f"broken_parts:{estimator}", out=tmp_path, record=False)
        check_error(result, reason)
        assert result.value("contacts") == 0

    @pytest.mark.parametrize("record", [True, False])
    @pytest.mark.parametrize(("mapper", "reason"), [("mapper_raises", "RuntimeError: no paper"), ("mapper_array", "")])
    def test_of_a_map(self, mapper: str, reason: str, record: bool, tmp_path: Path) -> None:
        parts = {"navigator": "broken_parts:still", "estimator": "odometry", "mapper": f"broken_parts:{mapper}"}
        check_error(run(SHORT, **parts, out=tmp_path, record=record, settings={"time_limit": 0.5}), reason)

    @pytest.mark.parametrize("estimator", ["estimator_raises", "estimator_covariance", "slam_raises", "slam_text"])
    @pytest.mark.parametrize("record", [True, False])
    def test_of_an_estimator_over_a_recording(self, estimator: str, record: bool, tmp_path: Path) -> None:
        made = run(SHORT, **PARTS, out=tmp_path, settings={"time_limit": 0.5})
        assert made.directory is not None
        check_error(replay(made.directory, estimator=f"broken_parts:{estimator}", out=tmp_path, record=record), "")

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
            ({"seed": -1}, ScenarioError, "non-negative integer, not -1"),
            ({"seed": True}, ScenarioError, "non-negative integer, not True"),
            ({"seed": 1.5}, ScenarioError, "non-negative integer, not 1.5"),
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
