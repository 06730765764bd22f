"""`robocar run` with a scenario: exit status, what goes to stdout and what to stderr, the files of the run.

Oracles: the design's section 9; the JSON and YAML parsers.
"""

from __future__ import annotations

import json
from pathlib import Path

import yaml

from tests.cli.command_line import Call


class TestRun:
    def test_success_is_0_and_says_where_everything_is(self, call: Call, files: Path) -> None:
        status, out, err = call("run", "short.yaml", "--navigator", "a-star", "--seed", 2, "--out", "o")
        assert status == 0
        assert out == ""
        assert "success: reached the goal" in err
        (recording,) = (files / "o").glob("short--a-star--odometry--none--s2--????????/run.rrd")
        assert str(recording.relative_to(files)) in err.replace("\n", "")

    def test_json_is_one_object_on_stdout_and_the_content_of_metrics_json(self, call: Call, files: Path) -> None:
        status, out, err = call("run", "short.yaml", "--json", "--no-recording", "--out", "o")
        assert status == 0
        (directory,) = (files / "o").iterdir()
        assert json.loads(out) == json.loads((directory / "metrics.json").read_text())
        assert "duration" in err
        assert not (directory / "run.rrd").exists()

    def test_not_reached_is_1_with_status_and_reason(self, call: Call, files: Path) -> None:
        status, out, err = call("run", "short.yaml", "--set", "time_limit=0.5", "--no-recording", "--json")
        assert status == 1
        assert "timeout: not there after 0.5 s" in err
        assert json.loads(out)["status"] == "timeout"

    def test_an_existing_run_needs_force(self, call: Call, files: Path) -> None:
        words = ("run", "short.yaml", "--set", "time_limit=0.5", "--no-recording", "--out", "o")
        assert call(*words)[0] == 1
        status, out, err = call(*words)
        assert (status, out) == (2, "")
        assert err.startswith("error: o/short--a-star--odometry--none--s0--")
        assert err.endswith("this run exists already; --force replaces it\n")
        assert call(*words, "--force")[0] == 1

    def test_settings_reach_scenario_and_parts(self, call: Call, files: Path) -> None:
        call("run", "short.yaml", "--set", "robot.compass=true", "--set", "navigator.speed=0.1", "--navigator", "dynamic-a-star",
             "--set", "time_limit=0.5", "--out", "o", "--no-recording")  # fmt: skip
        (directory,) = (files / "o").iterdir()
        config = yaml.safe_load((directory / "config.yaml").read_text())
        assert config["settings"] == {"robot.compass": True, "navigator.speed": 0.1, "time_limit": 0.5}
        assert config["scenario"]["robot"]["compass"] is True

    def test_the_default_scenario_by_name(self, call: Call) -> None:
        status, out, _ = call("run", "thesis-field", "--set", "time_limit=0.5", "--no-recording", "--json")
        assert status == 1
        assert [json.loads(out)[key] for key in ("scenario", "navigator", "estimator")] == [
            "thesis-field",
            "dynamic-a-star",
            "truth",
        ]
