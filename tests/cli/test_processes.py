"""The command line as people and scripts meet it, in a process of its own: Ctrl-C and kill, pipes, planners of somebody else.

Oracles: the design's section 9; the files that a real process leaves behind.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from robocar.formats import read_tum
from robocar.recording import read_trajectory
from tests.cli.command_line import ROOT, SHORT


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "robocar", *map(str, words)]


def environment(*folders: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join([*map(str, folders), str(ROOT)])}


def test_help_and_version_import_nothing_heavy() -> None:
    code = (
        "import sys\nfrom robocar.cli import main\n"
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
        words, env=environment(ROOT / "tests" / "parts"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
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
        assert done.returncode == 1, done.stderr
        assert [json.loads(done.stdout)[key] for key in ("navigator", "status")] == [
            name,
            "missed",
        ]  # far from it
    assert robocar("run", "short.yaml", "--estimator", "their_planners:at_goal", "--out", "recorded").returncode == 1  # missed
    (recorded,) = (here / "recorded").iterdir()
    (here / "mine.py").write_text("from their_planners import at_goal as build\n")
    replayed = robocar("replay", str(recorded), "--estimator", "mine:build", "--out", "replayed", "--no-recording")
    assert replayed.returncode == 0, replayed.stderr
    directories = {path.name.rpartition("--")[0] for path in (here / "runs").iterdir()}
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
