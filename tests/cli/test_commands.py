"""The command line as people and scripts meet it: exit status, what goes to stdout and what to stderr, Ctrl-C and kill.

Oracles: the design's section 9; the JSON and YAML parsers; the files that a real process leaves behind.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from robocar import __version__
from robocar.cli.main import main
from robocar.episode.registry import names
from robocar.formats import read_tum
from robocar.recording import read_trajectory
from robocar.scenario.load import scenario_names

ROOT = Path(__file__).parents[2]
SHORT = {"map": "maps/thesis_field.yaml", "start": [0.3, 0.3, 0], "goal": [1.2, 0.4], "time_limit": 30}
GRID = "############\n#S.........#\n#..........#\n#......#...#\n#......#...#\n#......#..G#\n############\n"
MAP_YAML = {
    "image": "map.pgm",
    "resolution": 0.05,
    "origin": [-1, -1, 0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Call:
    """`robocar <words>` in this process, in an empty folder: exit status, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in words])
        captured = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, captured.out, captured.err

    return run


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Good and bad files of several kinds."""
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(SHORT))
    (tmp_path / "grid.txt").write_text(GRID)
    # 2 x 2 m from (-1, -1) on, free but for a block in the upper right corner.
    rows = [[0 if row < 8 and col >= 32 else 254 for col in range(40)] for row in range(40)]
    (tmp_path / "map.pgm").write_text("P2\n40 40\n255\n" + "\n".join(" ".join(map(str, row)) for row in rows) + "\n")
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP_YAML))
    (tmp_path / "hello.pgm").write_text("hello\n")
    for name, change in (
        ("missing", {"image": "nowhere.pgm"}),
        ("not_image", {"image": "hello.pgm"}),
        ("zero", {"resolution": 0}),
        ("negative", {"resolution": -0.05}),
        ("nan", {"resolution": float("nan")}),
        ("crossed", {"occupied_thresh": 0.1}),
    ):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(MAP_YAML | change))
    (tmp_path / "ragged.map").write_text("type octile\nheight 2\nwidth 3\nmap\n...\n..\n")
    (tmp_path / "count.map").write_text("type octile\nheight 3\nwidth 3\nmap\n...\n...\n")
    for name, change in (
        ("typo", {"goall": [1, 1]}),
        ("code", {"defaults": {"navigator": "os:getcwd"}}),
        ("walled", {"start": [1.8, 1.8, 0]}),
        ("mover", {"movers": [{"name": "cart", "cylinder": [0.1, 0.3], "waypoints": [[1.0, 1.8], [3.0, 1.8]]}]}),
    ):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(SHORT | change))
    (tmp_path / "broken.yaml").write_text("map: [\n")
    return tmp_path


class TestRun:
    def test_success_is_0_and_says_where_everything_is(self, call: Call, files: Path) -> None:
        status, out, err = call("run", "short.yaml", "--navigator", "a-star", "--seed", 2, "--out", "o")
        assert status == 0
        assert out == ""
        assert "success: reached the goal" in err
        assert "o/short--a-star--odometry--none--s2/run.rrd" in err.replace("\n", "")
        assert (files / "o/short--a-star--odometry--none--s2/run.rrd").is_file()

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
            ("zero.yaml --start 0,0 --goal 1,1", "resolution must be a positive number of metres per pixel, not 0"),
            ("negative.yaml --start 0,0 --goal 1,1", "resolution must be a positive number of metres per pixel, not -0.05"),
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
            ("short.yaml --set time_limit=[", "the value is not YAML"),
            ("short.yaml --set time_limit=.nan", "time_limit: "),
            ("short.yaml --set robot.physics.control_period=0.033", "must be an integer multiple of the firmware's period"),
            ("short.yaml --seed -3", "the seed must be a whole number from 0 on, not -3"),
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


# -- processes of their own ---------------------------------------------------------------------------------------------


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "robocar", *map(str, words)]


def environment(*folders: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join([*map(str, folders), str(ROOT)])}


def test_help_and_version_import_nothing_heavy() -> None:
    code = (
        "import sys\nfrom robocar.cli.main import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit as end: assert not end.code\n"
        "heavy = {'mujoco', 'rerun', 'numba', 'matplotlib', 'numpy', 'scipy', 'cv2', 'pydantic', 'yaml'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    for words in (["--help"], ["run", "--help"], ["--version"]):
        done = subprocess.run(
            [sys.executable, "-c", code, *words], capture_output=True, text=True, env=environment(), check=False
        )
        assert done.returncode == 0, done.stderr
        assert "robocar" in done.stdout


ENDLESS = ("run", "thesis-field", "--navigator", "broken_parts:spin", "--set", "time_limit=1000000")


@pytest.fixture
def endless(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A run that has begun to write its recording, and the folder in which it writes."""
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a shell in the background makes its children ignore Ctrl-C
    words = command(*ENDLESS, "--out", tmp_path, "--json")
    process = subprocess.Popen(
        words, env=environment(ROOT / "tests"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )  # fmt: skip
    signal.signal(signal.SIGINT, before)
    try:
        for _ in range(1200):
            sizes = [file.stat().st_size for file in tmp_path.glob(".*.partial/run.rrd")]
            if process.poll() is not None or (sizes and sizes[0] > 200_000):
                break
            time.sleep(0.1)
        assert process.poll() is None, process.communicate()
        (partial,) = tmp_path.glob(".*.partial")
        yield process, partial
    finally:
        process.kill()
        process.communicate()


def test_ctrl_c_finishes_the_files_and_exits_130(endless: tuple[subprocess.Popen[str], Path], tmp_path: Path) -> None:
    process, _ = endless
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    summary = json.loads(out)
    assert (summary["status"], summary["reason"]) == ("interrupted", "stopped by the user")
    assert "Traceback" not in err
    (directory,) = tmp_path.iterdir()
    assert not directory.name.startswith(".")
    assert json.loads((directory / "metrics.json").read_text()) == summary
    times, _ = read_trajectory(directory / "run.rrd")
    assert len(times) == len(read_tum(directory / "truth.tum").times)


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # so it is, for a run that was killed
def test_a_killed_run_does_not_look_whole_and_is_readable_up_to_the_last_flush(
    endless: tuple[subprocess.Popen[str], Path], tmp_path: Path
) -> None:
    process, partial = endless
    process.kill()
    process.communicate()
    assert [entry.name for entry in tmp_path.iterdir() if not entry.name.startswith(".")] == []
    assert not (partial / "metrics.json").exists()
    times, poses = read_trajectory(partial / "run.rrd")
    assert len(times) >= 200
    assert times[0] == 0.0
    assert poses[0, :2] == pytest.approx([0.25, 0.20], abs=0.01)


def test_a_planner_of_somebody_else_by_path_and_by_entry_point(tmp_path: Path) -> None:
    """A package with metadata on the path, as pip would install it; and a module in the working directory."""
    site = tmp_path / "site"
    (site / "their_planners").mkdir(parents=True)
    (site / "their_planners" / "__init__.py").write_text((ROOT / "tests" / "parts" / "broken_parts.py").read_text())
    (site / "their_planners-1.0.dist-info").mkdir()
    (site / "their_planners-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: their-planners\nVersion: 1.0\n")
    points = "[robocar.planners]\nfinisher = their_planners:done\na-star = their_planners:give_up\n"
    (site / "their_planners-1.0.dist-info" / "entry_points.txt").write_text(points)
    here = tmp_path / "here"
    here.mkdir()
    (here / "mine.py").write_text("from their_planners import done as build\n")
    (here / "short.yaml").write_text(yaml.safe_dump(SHORT))

    def robocar(*words: str) -> subprocess.CompletedProcess[str]:
        safe = environment(site) | {
            "PYTHONSAFEPATH": "1"
        }  # like a console script, which does not look into the working directory
        return subprocess.run(command(*words), env=safe, cwd=here, capture_output=True, text=True, check=False)

    listed = json.loads(robocar("list", "navigators", "--json").stdout)
    assert listed["finisher"] == "from their-planners"
    assert "followed by pure pursuit" in listed["a-star"]  # nobody replaces ours
    for name in ("finisher", "mine:build"):
        done = robocar("run", "short.yaml", "--navigator", name, "--no-recording", "--json")
        assert done.returncode == 0, done.stderr
        assert [json.loads(done.stdout)[key] for key in ("navigator", "reason")] == [name, "seen all"]
    directories = {path.name for path in (here / "runs").iterdir()}
    assert directories == {"short--finisher--odometry--none--s0", "short--mine_build--odometry--none--s0"}


def test_a_reader_that_leaves_is_no_traceback() -> None:
    """`robocar list scenarios | head -1`, with a reader that is gone at once."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        command("schema", "scenario"), stdout=writer, stderr=subprocess.PIPE, text=True, env=environment(), check=False
    )
    os.close(writer)
    assert "Traceback" not in done.stderr
    assert done.returncode != 0
