"""`robocar run` with a map file, and with bad input of every kind: one line on stderr, status 2.

Oracles: the trajectory files; the design's section 9.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from robocar.formats import read_tum
from robocar.scenario.map_scenario import map_scenario
from tests.cli.command_line import Call
from tests.cli.conftest import MAP_YAML


class TestMaps:
    def test_a_text_grid_brings_start_and_goal(self, call: Call, files: Path) -> None:
        """S is the cell in column 1, row 1 from the top of 7; its centre, 0.3 m a cell, is (0.45, 1.65)."""
        status, out, _ = call("run", "grid.txt", "--resolution", 0.3, "--no-recording", "--json", "--out", "o")
        assert status == 0
        assert json.loads(out)["estimator"] == "truth"
        (directory,) = (files / "o").iterdir()
        truth = read_tum(directory / "truth.tum").poses
        assert truth[0, :2] == pytest.approx([0.45, 1.65], abs=0.01)
        assert truth[-1, :2] == pytest.approx([10.5 * 0.3, 1.5 * 0.3], abs=0.12)

    @pytest.mark.parametrize("style", ["apart", "joined"])
    def test_negative_coordinates(self, style: str, call: Call, files: Path) -> None:
        points = {"--start": "-0.7,-0.7,1.5708", "--goal": "-0.6,0.5"}
        words = [f"{k}={v}" for k, v in points.items()] if style == "joined" else [w for pair in points.items() for w in pair]
        status, _, err = call("run", "map.yaml", *words, "--no-recording", "--out", "o")
        assert status == 0, err
        (directory,) = (files / "o").iterdir()
        truth = read_tum(directory / "truth.tum").poses
        assert truth[0] == pytest.approx([-0.7, -0.7, 1.5708], abs=0.02)
        assert truth[-1, :2] == pytest.approx([-0.6, 0.5], abs=0.11)

    def test_the_time_limit_is_that_of_the_way_and_a_map_without_one_says_so(self, files: Path) -> None:
        """Two walls with doors at alternating ends: the way is 3 crossings, 3 * 7 m at least, where the straight line has 2 m."""
        rows = ["." * 24, "." * 24, "#" * 21 + "...", "." * 24, "." * 24, "..." + "#" * 21, "." * 24, "." * 24]
        name = files / "serpentine.txt"
        name.write_text("\n".join(rows))
        content = map_scenario(str(name), 0.3, "6.6,0.3", "0.45,2.1")
        straight = 120.0 + 30.0 * math.hypot(6.15, 1.8)
        assert 120.0 + 30.0 * (3 * 5.5) < content["time_limit"] < 120.0 + 30.0 * 25.0
        assert content["time_limit"] > 1.5 * straight
        name.write_text("\n".join([*rows[:2], "#" * 24, *rows[3:]]))
        with pytest.warns(UserWarning, match=r"serpentine.txt: no way from start to goal .* straight line, 6\.4 m"):
            closed = map_scenario(str(name), 0.3, "6.6,0.3", "0.45,2.1")
        assert closed["time_limit"] == round(straight)

    def test_a_path_through_unknown_is_said(self, call: Call, files: Path) -> None:
        """The map's middle third has never been seen: a way of 1.4 m, 0.67 m of it unknown."""
        cells = np.full((40, 40), 254, dtype=np.uint8)
        cells[:, 13:27] = 205
        (files / "seen.pgm").write_bytes(b"P5 40 40 255\n" + cells.tobytes())
        (files / "seen.yaml").write_text(yaml.safe_dump(MAP_YAML | {"image": "seen.pgm"}))
        status, out, err = call("run", "seen.yaml", "--start=-0.7,0", "--goal", "0.7,0", "--no-recording", "--json", "--out", "o")
        assert status == 0, err
        assert json.loads(out)["metrics"]["unknown_length"]["value"] == pytest.approx(0.7, abs=0.03)
        assert "path through unknown: 0.7 m of 1.3 m" in err
        (files / "seen_scenario.yaml").write_text(yaml.safe_dump({"map": "seen.yaml", "start": [-0.7, 0, 0], "goal": [0.7, 0]}))
        status, out, _ = call("check", "seen_scenario.yaml", "seen.yaml")
        assert status == 0
        assert "35.0% of the map are unknown, and free floor to the robot" in out
        assert "shortest path through unknown: 0.7 m of 1.4 m; no way is known all along" in out
        assert "35.0% of the cells are unknown" in out

    def test_another_goal_is_another_run(self, call: Call, files: Path) -> None:
        for goal in ("0,0", "0,0.5"):
            status, _, err = call("run", "map.yaml", "--start=-0.5,-0.5", "--goal", goal, "--no-recording", "--out", "o",
                                  "--set", "time_limit=0.5")  # fmt: skip
            assert status == 1, err
        assert len(list((files / "o").iterdir())) == 2

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            ("map.yaml --start 0,0", "a map needs --goal X,Y"),
            ("map.yaml --goal 0,0", "a map needs --start X,Y"),
            ("map.yaml --start 0,0 --goal a,b", "--goal takes X,Y or X,Y,THETA in metres and radians, not 'a,b'"),
            ("map.yaml --start 0,0,0,0 --goal 1,1", "--start takes X,Y or X,Y,THETA"),
            ("map.yaml --start nan,0 --goal 0,0", "--start takes X,Y"),
            ("map.yaml --start 3,0 --goal 0,0", "start (3.000, 0.000) lies outside the map, which spans x -1.000 to 1.000"),
            ("map.yaml --start 0,0 --goal 0,-1.5", "goal (0.000, -1.500) lies outside the map"),
            ("map.yaml --start 0.8,0.8 --goal 0,0", "start (0.8, 0.8, 0) lies in a wall"),
            ("map.yaml --start 0,0 --goal 0.8,0.8", "goal (0.8, 0.8) lies in a wall of the prior map"),
            ("map.yaml --start -0.95,0 --goal 0,0", "start (-0.95, 0, 0) is too tight"),
            ("map.yaml --start 0,0 --goal 0.55,0.9", "is too tight"),
            ("map.yaml --start 0,0 --goal 0.5,0.5 --resolution 0", "resolution: Input should be greater than 0, not 0.0"),
            ("map.yaml --start 0,0 --goal 0.5,0.5 --resolution -1", "resolution: Input should be greater than 0, not -1.0"),
            ("map.yaml --start 0,0 --goal 0.5,0.5 --resolution nan", "resolution: Input should be greater than 0, not nan"),
            ("grid.txt --resolution 0", "resolution must be a positive number of metres per cell, not 0"),
            ("missing.yaml --start 0,0 --goal 1,1", "nowhere.pgm: no such file"),
            ("not_image.yaml --start 0,0 --goal 1,1", "hello.pgm: begins with b'hello\\n'; not an image"),
            ("zero.yaml --start 0,0 --goal 1,1", "resolution must be a positive number of metres per cell, not 0.0"),
            ("negative.yaml --start 0,0 --goal 1,1", "resolution must be a positive number of metres per cell, not -0.05"),
            ("nan.yaml --start 0,0 --goal 1,1", "resolution must be a finite number, not nan"),
            ("crossed.yaml --start 0,0 --goal 1,1", "thresh"),
            ("ragged.map --start 0,0 --goal 1,1", "line 6"),
            ("count.map --start 0,0 --goal 1,1", "height"),
            ("short.yaml --goal 1,1", "--goal goes with a map file; in a scenario use --set goal="),
            ("nowhere.map --start 0,0 --goal 1,1", "nowhere.map: no such file"),
            ("typo.yaml", "unknown key 'goall' (did you mean 'goal'?)"),
            ("code.yaml", "a scenario runs no code"),
            ("walled.yaml", "start (1.8, 1.8, 0) lies in a wall"),
            ("mover.yaml", "mover 'cart' hits a wall or an obstacle between (1, 1.8) and (3, 1.8)"),
            ("thesis-fild", "unknown scenario 'thesis-fild' (did you mean 'thesis-field'?); known: "),
            ("short.yaml --navigator a-sta", "unknown navigator 'a-sta' (did you mean 'a-star'?); known: "),
            ("short.yaml --set navigator.sped=1", "has no parameter 'sped'"),
            ("short.yaml --navigator dynamic-a-star --set navigator.speed=fast", "takes a float (default 0.25), not 'fast'"),
            ("short.yaml --navigator dynamic-a-star --set navigator.speed=-1", "speed must be positive, not -1"),
            ("short.yaml --set time_limit", "expected path.to.parameter=value"),
            ("short.yaml --set time_limit=[", "--set time_limit, line 2: not YAML"),
            ("short.yaml --set time_limit=.nan", "time_limit: "),
            ("short.yaml --set robot.physics.control_period=0.033", "must be an integer multiple of the firmware's period"),
            ("short.yaml --seed -3", "the seed must be a non-negative integer, not -3"),
            ("short.yaml --out grid.txt/below", "grid.txt/below: cannot write a run here: Not a directory"),
            ("short.yaml --navigator nowhere.to:build", "there is no module 'nowhere'"),
        ],
    )  # fmt: skip
    def test_bad_input_is_one_line_on_stderr_and_status_2(self, words: str, message: str, call: Call, files: Path) -> None:
        out = () if "--out" in words else ("--out", "o")
        status, stdout, stderr = call("run", *words.split(), *out, "--json")
        assert status == 2
        assert stdout == ""
        assert stderr.startswith("error: ")
        assert message in stderr
        assert stderr.count("\n") == 1
        assert list(files.rglob("metrics.json")) == []
        assert [path for path in files.glob("o/*") if not path.name.startswith(".")] == []
        assert list(files.glob("o/.*")) == []
