"""Ordinary mistakes, and what is answered. Oracles: registry, schema, brute force over cells, real processes."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

import robocar
from robocar.cli import main
from robocar.cli.listing import KINDS, listing
from robocar.core import SE2, GoalOccupied, OutsideMap, ParameterError, RobocarError, ScenarioError, StartOccupied
from robocar.episode.registry import find, parameters
from robocar.episode.spec import RunSpec
from robocar.formats.generated import cave
from robocar.formats.ros_map import save_ros_map
from robocar.regression.pool import DaskWorkers
from robocar.scenario.load import load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.scene import Scene
from tests.cli.command_line import ROOT, SHORT, Call


@pytest.mark.parametrize(
    ("setting", "meant"),
    [
        ("lidar", "robot.lidar"),
        ("control_period", "robot.physics.control_period"),
        ("movement_time_allowance", "progress.movement_time_allowance"),
        ("movment_time_allowance", "progress.movement_time_allowance"),
        ("robot.timestep", "robot.physics.timestep"),
        ("goall", "goal"),
        ("lookahead_dist", "navigator.controller.lookahead_dist"),
        ("navigtor.controller.lookahead_dist", "navigator.controller.lookahead_dist"),
    ],
)
def test_a_setting_in_the_wrong_place_is_answered_with_the_right_one(setting: str, meant: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(repr(meant))):
        RunSpec.of("tilted", navigator="a-star", settings={setting: 1})


def test_every_key_of_a_scenario_is_found_by_its_last_name() -> None:
    """Property: whatever stands inside, set at the top, is answered with a place that holds it."""
    inner = {"model", "sonars", "compass", "camera", "physics", "required_movement_radius", "navigator", "estimator", "mapper"}
    for key in sorted(inner - set(Scenario.model_fields) - {"navigator", "estimator", "mapper"}):
        with pytest.raises(ScenarioError, match=rf"did you mean '[a-z.]*{key}'"):
            load_scenario("tilted", {key: "x"})


@pytest.mark.parametrize("command", ["run", "replay"])
def test_the_examples_of_the_help_are_accepted(command: str, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the part that they name, or of every scenario."""
    monkeypatch.setenv("COLUMNS", "1000")
    text = call(command, "--help")[1]
    examples = re.findall(r"\b([a-z_]+(?:\.[a-z_]+)+)=([\w.]+)", text)
    assert examples
    for path, value in examples:
        kind, _, name = path.partition(".")
        if kind in ("navigator", "estimator"):
            (part,) = re.findall(rf"--{kind} ([a-z-]+): {re.escape(path)}", text)
            assert name in parameters(find(kind, part))  # type: ignore[arg-type]
        else:
            for scenario in ("thesis-field", "tilted"):
                load_scenario(scenario, {path: value})


class WithoutContext:
    def command(self, state: object, observation: object, goal: object) -> None: ...


def test_a_part_that_cannot_be_built_from_the_context_is_answered_with_the_contract() -> None:
    for part in (WithoutContext, lambda state, observation, goal: None):
        with pytest.raises(ParameterError, match=r"is called with one argument, the context \(robocar.core.Context\)"):
            robocar.run(SHORT, navigator=part)
    with pytest.raises(ParameterError, match=r"expected a class, a factory .*, not an object of type WithoutContext"):
        robocar.run(SHORT, navigator=WithoutContext())  # type: ignore[arg-type]


def test_an_error_of_somebodys_part_is_told_with_its_line(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(SHORT))
    (tmp_path / "their_part.py").write_text(
        "import numpy as np\n"
        "class Fails:\n"
        "    def __init__(self, context): pass\n"
        "    def command(self, state, observation, goal):\n"
        "        return np.linalg.inv(np.ones((2, 3)))\n"
        "def unready(context):\n"
        "    return context.nothing\n"
    )
    (tmp_path / "their_typo.py").write_text("x = 1\nif x\n    pass\n")
    for part, status, words in (
        ("their_part:Fails", 1, " (their_part.py, line 5, in command)"),
        ("their_part:unready", 2, " (their_part.py, line 7, in unready)"),
        ("their_typo:build", 2, " (their_typo.py, line 2)"),
    ):
        found, _, err = call("run", "short.yaml", "--navigator", part, "--no-recording")
        assert (found, words in " ".join(err.split())) == (status, True), err
        assert "Traceback" not in err


@pytest.mark.parametrize("seed", range(3))
def test_a_pose_in_a_wall_is_answered_with_the_nearest_free_one(seed: int, tmp_path: Path) -> None:
    """Oracle: every cell of a cave that nobody drew, tried as a start or as a goal."""
    rng = np.random.default_rng(seed)
    grid = cave(40, 50, rng, resolution=0.08, origin=SE2(-1.0, 0.5, 0.3))
    save_ros_map(grid, tmp_path / "cave")
    centres = grid.world_from_cell(np.argwhere(np.ones(grid.shape, bool)))

    def scene(start: list[float], goal: list[float] | None) -> Scene:
        scenario = load_scenario({"map": str(tmp_path / "cave.yaml"), "start": start, "goal": goal})
        return Scene.load(scenario, scenario.robot_model().footprint)

    def accepted(start: list[float], goal: list[float] | None) -> bool:
        try:
            scene(start, goal)
        except (StartOccupied, GoalOccupied, OutsideMap):
            return False
        return True

    walls = grid.world_from_cell(np.argwhere(grid.occupied)[:: 1 + grid.occupied.sum() // 3])
    for x, y in [*walls.tolist(), [30.0, -20.0]]:
        start = [x, y, float(rng.uniform(-3, 3))]
        with pytest.raises((StartOccupied, OutsideMap)) as refused:
            scene(start, None)
        (words,) = re.findall(r"the nearest free pose is \(([^)]+)\)", str(refused.value))
        answer = [float(word) for word in words.split(",")]
        assert accepted(answer, None)
        assert answer[2] == pytest.approx(start[2], rel=1e-4)
        nearer = centres[np.hypot(*(centres - (x, y)).T) < np.hypot(answer[0] - x, answer[1] - y) - 1e-4]
        checker = scene(answer, None)
        footprint = checker.scenario.robot_model().footprint
        assert not [p for p in nearer.tolist() if checker.clearance(footprint.at(SE2(*p, start[2]))) > 0.0]
        with pytest.raises((GoalOccupied, OutsideMap)) as refused_goal:
            scene(answer, [x, y])
        (words,) = re.findall(r"the nearest free pose is \(([^)]+)\)", str(refused_goal.value))
        assert accepted(answer, [float(word) for word in words.split(",")])


def test_no_pose_fits_is_said(tmp_path: Path) -> None:
    (tmp_path / "tight.txt").write_text("#####\n#...#\n#####\n")
    scenario = load_scenario({"map": str(tmp_path / "tight.txt"), "resolution": 0.1, "start": [0.2, 0.15, 0]})
    with pytest.raises(StartOccupied, match="there is no free pose on this map"):
        Scene.load(scenario, scenario.robot_model().footprint)


@pytest.mark.parametrize(
    "address", ["nonsense", "tcp://", "tcp://host", "http://host:1", "tcp://a b:1", "host:8786", "", "tcp://host:x"]
)
def test_a_scheduler_that_is_no_address_is_one_line(address: str) -> None:
    with pytest.raises(RobocarError, match=r"--scheduler: expected the address of a Dask scheduler, tcp://HOST:PORT, not"):
        DaskWorkers(address)


def test_list_alone_lists_everything(call: Call) -> None:
    status, out, err = call("list")
    assert (status, err) == (0, "")
    assert [line.rstrip(":") for line in out.splitlines() if line.endswith(":") and not line.startswith(" ")] == list(KINDS)
    assert set(listing("navigators")) <= {line.split()[0] for line in out.splitlines() if line.startswith("  ")}
    assert set(yaml.safe_load(call("list", "--json")[1])) == set(KINDS)


def test_view_without_a_display_names_the_browser(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = tmp_path / "my run.rrd"
    recording.write_bytes(b"")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    status, _, err = call("view", recording)
    assert (status, len(err.splitlines())) == (2, 1)
    assert f"robocar view {shlex.quote(str(recording))} --web" in err
    monkeypatch.setenv("DISPLAY", ":4711")  # where nobody listens: the viewer itself complains
    status, _, err = call("view", recording)
    assert (status, len(err.splitlines())) == (2, 1), err
    assert "--web" in err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_of_the_shells(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--tyro-print-completion", shell])
    assert not ended.value.code
    assert {"sweep", "--navigator"} <= set(re.findall(r"[\w-]+", capsys.readouterr().out))


SLOW_IMPORT = "import time, sys\nsys.stderr.write('ready\\n'); sys.stderr.flush()\ntime.sleep(60)\n"


@pytest.mark.parametrize("module", ["tyro", "numpy", "mujoco"])
def test_ctrl_c_while_libraries_are_imported_is_one_line(module: str, tmp_path: Path) -> None:
    """A library that takes its time stands in for a cold disk."""
    (tmp_path / f"{module}.py").write_text(SLOW_IMPORT)
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # children of a shell in the background ignore Ctrl-C
    words = [sys.executable, "-m", "robocar", "run", "tilted", "--out", str(tmp_path / "runs")]
    process = subprocess.Popen(words, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    signal.signal(signal.SIGINT, before)
    assert process.stderr is not None
    assert process.stderr.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "interrupted\n")


def test_ctrl_c_while_workers_start_is_one_line(tmp_path: Path) -> None:
    """As a terminal sends it: to the whole group of processes, as soon as the first worker is there."""
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    words = [sys.executable, "-m", "robocar", "sweep", "quick", "--jobs", "2", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(words, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    signal.signal(signal.SIGINT, before)
    children = Path(f"/proc/{process.pid}/task")
    if not children.is_dir():
        process.kill()
        pytest.skip("no /proc here")
    for _ in range(1200):
        if any((task / "children").read_text().split() for task in children.glob("*")) or process.poll() is not None:
            break
        time.sleep(0.1)
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (130, "")
    assert len(err.splitlines()) == 1
    assert "--resume goes on" in err
    for _ in range(300):  # the tracker of shared resources ends when it notices that we have
        left = [p for p in Path("/proc").glob("[0-9]*") if _group_of(p) == process.pid]
        if not left:
            break
        time.sleep(0.1)
    assert left == []


def _group_of(process: Path) -> int | None:
    try:
        fields = (process / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return int(fields[2]) if fields[0] != "Z" else None
