"""The other commands, list, schema, check, experiment and view, and wrong usage.

Oracles: the design's section 9; the JSON parser; the registry and the shipped files; logs and rooms written here.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from robocar import __version__
from robocar.episode.registry import names
from robocar.scenario.load import scenario_names
from tests.cli.command_line import ROOT, Call


class TestOthers:
    @pytest.mark.parametrize("what", ["scenarios", "navigators", "estimators", "mappers", "experiments"])
    def test_list(self, what: str, call: Call) -> None:
        status, out, _ = call("list", what, "--json")
        assert status == 0
        listed = json.loads(out)
        expected = {
            "scenarios": set(scenario_names()),
            "experiments": {"thesis_motion", "thesis_navigation", "odometry_calibration"},
        }.get(what) or set(names(what[:-1]))  # type: ignore[arg-type]
        assert set(listed) >= expected
        assert all(isinstance(text, str) and text and "\n" not in text for text in listed.values())
        plain = call("list", what)[1].splitlines()
        assert [line.split()[0] for line in plain] == list(listed)

    def test_schema(self, call: Call) -> None:
        """A JSON schema that lists the keys of the design's example and refuses others; every reference in it leads somewhere."""
        status, out, _ = call("schema", "scenario")
        schema = json.loads(out)
        assert status == 0
        keys = "map prior unknown_obstacles start goal landmarks movers events robot on_contact lighting time_limit defaults"
        assert set(schema["properties"]) >= set(keys.split())
        assert "folder" not in schema["properties"]
        assert schema["additionalProperties"] is False
        assert set(schema["required"]) == {"map", "start"}
        references = references_of(schema)
        assert len(references) >= 8
        assert {r.removeprefix("#/$defs/") for r in references} <= set(schema["$defs"])

    def test_check_says_what_is_wrong_with_each_bad_file_and_what_the_good_ones_hold(self, call: Call, files: Path) -> None:
        good = ["short.yaml", "grid.txt", "map.yaml"]
        bad = [f"{name}.yaml" for name in ("missing", "not_image", "zero", "negative", "nan", "crossed", "typo", "code", "walled",
                                           "mover", "broken")]  # fmt: skip
        bad += ["hello.pgm", "ragged.map", "count.map", "nowhere.yaml", "."]
        status, out, err = call("check", *good, *bad)
        assert status == 2
        assert [line.partition(":")[0] for line in out.splitlines() if not line.startswith("  ")] == good
        assert len(err.splitlines()) == len(bad)
        assert all(line.startswith("error: ") for line in err.splitlines())
        assert call("check", *good)[0] == 0
        assert call("check")[0] == 2

    def test_check_passes_all_that_comes_with_robocar(self, call: Call) -> None:
        folder = ROOT / "models"
        shipped = sorted(folder.glob("maps/*.yaml")) + sorted(folder.glob("scenarios/*.yaml"))
        assert len(shipped) >= 20
        status, out, err = call("check", *shipped)
        assert (status, err) == (0, "")
        assert out.count("scenario, ") == len(scenario_names())

    def test_check_reads_logs_and_names_the_lines_that_it_cannot_use(self, call: Call, tmp_path: Path) -> None:
        """Oracle: a log written here, one of whose lines is cut short."""
        scan = "FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 {time} host {time}"
        log = tmp_path / "two.log"
        log.write_text("\n".join([scan.format(time=1.0), "FLASER 3 1.0", scan.format(time=3.5)]) + "\n")
        status, out, _ = call("check", log)
        first, second = out.splitlines()
        assert (status, first) == (0, f"{log}: carmen log, 2 observations in 2.5 s, 2 scans, 0 landmarks seen")
        assert second.startswith("  warning: skipped line 2: ")
        status, _, err = call("check", tmp_path / "none.log")
        assert (status, err) == (2, f"error: {tmp_path / 'none.log'}: no such file or folder\n")

    def test_a_map_is_explored_without_a_goal(self, call: Call, tmp_path: Path) -> None:
        """Oracle: the room drawn here is known when it is over; other navigators ask for the goal."""
        room = tmp_path / "room.txt"
        room.write_text("\n".join(["#" * 12, *["#..........#"] * 8, "#" * 12]) + "\n")
        words = ("run", room, "--resolution", 0.25, "--start", "0.8,0.8", "--no-recording", "--out", tmp_path / "runs", "--json")
        status, out, _ = call(*words, "--navigator", "explore", "--mapper", "laser", "--set", "robot.lidar=scan360")
        metrics = json.loads(out)["metrics"]
        assert (status, metrics["map/explored"]["value"]) == (0, pytest.approx(1.0, abs=0.01))
        status, _, err = call(*words)
        assert (status, err) == (2, f"error: {room}: a map needs --goal X,Y\n")

    def test_version(self, call: Call) -> None:
        assert call("--version") == (0, f"robocar {__version__}\n", "")

    @pytest.mark.parametrize("words", [[], ["fly"], ["run"], ["list", "planets"], ["run", "thesis-field", "--seed", "x"]])
    def test_wrong_usage_is_status_2(self, words: list[str], call: Call) -> None:
        status, out, err = call(*words)
        assert (status, out) == (2, "")
        assert err

    def test_unknown_experiment(self, call: Call) -> None:
        status, _, err = call("experiment", "thesis_moton")
        assert status == 2
        assert "did you mean 'thesis_motion'?" in err

    def test_view_of_nothing(self, call: Call, tmp_path: Path) -> None:
        status, _, err = call("view", tmp_path)
        assert status == 2
        assert "there is no recording here" in err


def references_of(node: Any) -> set[str]:
    """All values of `$ref` in nested JSON."""
    if isinstance(node, dict):
        own = {node["$ref"]} if "$ref" in node else set()
        return own.union(*(references_of(value) for value in node.values()))
    return set().union(*(references_of(value) for value in node)) if isinstance(node, list) else set()
