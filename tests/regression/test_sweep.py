"""Sweeps: nothing is lost, whatever happens to workers, disk, terminal and scheduler.

Oracles: the hash of the same run alone in this process; the files that real processes leave behind, counted; marks that a
navigator leaves each time it is run.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robocar.core import OutputError, RobocarError, ScenarioError
from robocar.episode.run import run
from robocar.regression.pool import workers
from robocar.regression.results import is_complete, read_results
from robocar.regression.suite import load_suite
from robocar.regression.sweep import sweep
from robocar.regression.worker import Job, JobOutcome
from tests.regression.conftest import suite_of

ROOT = Path(__file__).parents[2]


@pytest.fixture
def marks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "marks"
    folder.mkdir()
    monkeypatch.setenv("BAD_PARTS_MARKS", str(folder))
    return folder


def left_behind(folder: Path) -> list[str]:
    """What is half-written, and logs."""
    return sorted(path.name for path in folder.iterdir() if path.name.startswith(".") and path.name != ".sweep.lock")


def test_the_hash_of_every_run_is_the_one_obtained_alone(short: str, tmp_path: Path) -> None:
    suite = suite_of(short, ("a-star", "harmonic"), seeds=[0, 1])
    told: list[tuple[int, int, int]] = []
    swept = sweep(suite, tmp_path / "out", jobs=2, progress=lambda *numbers: told.append(numbers))
    assert (swept.total, swept.before, swept.done, swept.lost) == (4, 0, 4, ())
    assert told == [(n, 4, 0) for n in range(5)]
    found = {row.name: row.hash for row in read_results(tmp_path / "out").rows}
    assert found == {case.name: run(**case.arguments()).hash for case in suite.cases}
    assert len(set(found.values())) == 4
    assert left_behind(tmp_path / "out") == []


def test_what_goes_wrong_costs_one_run_and_is_tried_once_more(short: str, marks: Path, tmp_path: Path) -> None:
    """One worker dies always, one once, one hangs, one raises before the loop, one in it; the good runs are there."""
    bad = ("dies", "dies_once", "hangs", "raises_when_built", "raises_in_the_loop")
    suite = suite_of(short, ("a-star", *(f"bad_parts:{name}" for name in bad)), seeds=[0], limit=4)
    swept = sweep(suite, tmp_path / "out", jobs=2)
    rows = {row.navigator.removeprefix("bad_parts:"): row for row in read_results(tmp_path / "out").rows}
    tries = {name: len(list(marks.glob(f"{name}.*"))) for name in bad}
    assert tries == {"dies": 2, "dies_once": 2, "hangs": 2, "raises_when_built": 2, "raises_in_the_loop": 1}
    assert {name: row.status for name, row in rows.items()} == {
        "a-star": "timeout",
        "dies": "error",
        "dies_once": "timeout",
        "hangs": "error",
        "raises_when_built": "error",
        "raises_in_the_loop": "error",  # the run's own end: it is deterministic, and not tried again
    }
    assert set(swept.lost) == {rows[name].name for name in ("dies", "hangs", "raises_when_built")}
    lost = rows["raises_when_built"]
    assert (lost.hash, dict(lost.metrics)) == (None, {})
    assert "no licence for this planner" in lost.reason
    logs = {name: (tmp_path / "out" / row.name / "error.txt") for name, row in rows.items()}
    for name, words in {
        "dies": ["signal 9", "2 times", "about to die"],
        "hangs": ["stopped after 4 s", "bad_parts.py", "in command"],  # the stack says where
        "raises_when_built": ["no licence for this planner", "Traceback"],
        "raises_in_the_loop": ["no way to divide", "Traceback"],
    }.items():
        text = logs[name].read_text()
        assert [word for word in words if word not in text] == []
    assert left_behind(tmp_path / "out") == []


def test_whatever_a_part_raises_or_leaves_the_sweep_goes_on(short: str, marks: Path, tmp_path: Path) -> None:
    """A process that ends with status 0, and errors that are no `Exception`: none is waited for until its limit."""
    bad = ("leaves", "raises_an_odd_error", "cancels")
    suite = suite_of(short, ("a-star", *(f"bad_parts:{name}" for name in bad)), seeds=[0], limit=300)
    started = time.monotonic()
    swept = sweep(suite, tmp_path / "out", jobs=2)
    assert time.monotonic() - started < 200
    rows = {row.navigator.removeprefix("bad_parts:"): row for row in read_results(tmp_path / "out").rows}
    assert {name: row.status for name, row in rows.items()} == dict.fromkeys(bad, "error") | {"a-star": "timeout"}
    assert len(swept.lost) == len(bad)
    assert rows["leaves"].reason == "its process ended in the middle of the run (status 0), 2 times"
    assert "_Odd: nobody catches me" in rows["raises_an_odd_error"].reason
    assert "CancelledError" in rows["cancels"].reason
    assert left_behind(tmp_path / "out") == []


def test_a_worker_killed_every_few_runs_loses_nothing(short: str, tmp_path: Path) -> None:
    """All results present, none twice, none torn; the oracle is the list of cases."""
    suite = suite_of(short, seeds=list(range(24)))
    killed = []

    def kill(done: int, total: int, failed: int) -> None:
        if done % 8 == 4:
            victim = multiprocessing.active_children()[0]
            assert victim.pid is not None
            os.kill(victim.pid, signal.SIGKILL)
            killed.append(victim.pid)

    swept = sweep(suite, tmp_path / "out", jobs=2, progress=kill)
    assert len(killed) == 3
    assert swept.lost == ()
    found = read_results(tmp_path / "out")
    assert found.skipped == ()
    assert [row.name for row in found.rows] == sorted(case.name for case in suite.cases)
    assert all(is_complete(tmp_path / "out" / case.name) for case in suite.cases)
    assert left_behind(tmp_path / "out") == []


def command(suite: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "robocar", "sweep", str(suite), "--out", str(out), "--jobs", "2", *more]


@pytest.fixture
def slow_suite(short: str, marks: Path, tmp_path: Path) -> Path:
    path = tmp_path / "suite.yaml"
    path.write_text(json.dumps({"runs": [{"scenarios": [short], "seeds": "0-7"}]}))
    return path


def wait_for(folder: Path, count: int, process: subprocess.Popen) -> None:
    patience = time.monotonic() + 60
    while len(list(folder.glob("*/metrics.json"))) < count:
        assert process.poll() is None, "it ended too early"
        assert time.monotonic() < patience, "no runs"
        time.sleep(0.02)


@contextmanager
def heeding_sigint() -> Iterator[None]:
    """Processes that start here can be interrupted even where pytest runs in the background of a shell, which ignores SIGINT."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def children(pid: int) -> set[int]:
    found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return {int(child) for child in found}


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT], ids=["kill -9", "Ctrl-C"])
def test_a_sweep_that_is_stopped_goes_on_with_what_is_missing(slow_suite: Path, tmp_path: Path, how: int) -> None:
    out = tmp_path / "out"
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tests" / "parts")}
    words = command(slow_suite, out, "--navigator", "bad_parts:slow")
    with heeding_sigint():
        first = subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    wait_for(out, 2, first)
    with pytest.raises(OutputError, match="another sweep is at work here"):
        sweep(load_suite(slow_suite, navigators=["bad_parts:slow"]), out, resume=True)
    workers = children(first.pid)
    first.send_signal(how)
    _, told = first.communicate(timeout=30)
    assert first.returncode == (130 if how == signal.SIGINT else -9)
    assert "Traceback" not in told
    if how == signal.SIGINT:
        assert left_behind(out) == []
    patience = time.monotonic() + 20
    while [pid for pid in workers if Path(f"/proc/{pid}/cmdline").exists()] and time.monotonic() < patience:
        time.sleep(0.1)
    assert [pid for pid in workers if Path(f"/proc/{pid}/cmdline").exists()] == []  # nobody goes on alone
    done = sorted(path.parent.name for path in out.glob("*/metrics.json"))
    assert 2 <= len(done) < 8
    stamps = {name: (out / name / "metrics.json").stat().st_mtime_ns for name in done}
    with pytest.raises(OutputError, match=f"holds runs already, {len(done)} of these 8"):
        sweep(load_suite(slow_suite, navigators=["bad_parts:slow"]), out)
    swept = sweep(load_suite(slow_suite, navigators=["bad_parts:slow"]), out, jobs=1, resume=True)
    assert (swept.done, swept.before, swept.lost) == (8 - len(done), len(done), ())
    assert {name: (out / name / "metrics.json").stat().st_mtime_ns for name in done} == stamps
    assert len(read_results(out).rows) == 8
    assert left_behind(out) == []


def test_a_damaged_and_a_lost_run_are_made_anew_and_a_stale_one_is_refused(short: str, tmp_path: Path) -> None:
    suite, out = suite_of(short, seeds=[0, 1, 2]), tmp_path / "out"
    sweep(suite, out, jobs=1)
    before = {row.name: row.hash for row in read_results(out).rows}
    torn, lost, _ = (out / case.name for case in suite.cases)
    (torn / "metrics.json").write_text((torn / "metrics.json").read_text()[:200])
    (lost / "metrics.json").write_text(json.dumps(json.loads((lost / "metrics.json").read_text()) | {"hash": None}))
    swept = sweep(suite, out, jobs=1, resume=True)
    assert (swept.before, swept.done) == (1, 2)
    assert {row.name: row.hash for row in read_results(out).rows} == before
    assert sweep(suite, out, resume=True).done == 0
    Path(short).write_text(Path(short).read_text().replace("1.2, 0.4", "1.3, 0.4"))
    with pytest.raises(ScenarioError, match="was run when the scenario was another one"):
        sweep(suite, out, jobs=1, resume=True)


def test_a_full_disk_stops_with_a_message_and_leaves_what_is_complete(far: str, tmp_path: Path) -> None:
    """A disk of 2.5 MB, mounted in a namespace of its own."""
    script = f"""
mount -t tmpfs -o size=2500k none {tmp_path}/disk || exit 77
{sys.executable} -m robocar sweep {tmp_path}/suite.yaml --out {tmp_path}/disk/out --jobs 1
echo status $?
{sys.executable} -m robocar results {tmp_path}/disk/out --json
"""
    (tmp_path / "disk").mkdir()
    content = {"runs": [{"scenarios": [far], "navigators": ["a-star"], "seeds": "0-59"}], "record": True}
    (tmp_path / "suite.yaml").write_text(json.dumps(content))
    if shutil.which("unshare") is None:
        pytest.skip("no unshare (Debian: util-linux)")
    done = subprocess.run(["unshare", "-rm", "bash", "-c", script], capture_output=True, text=True, check=False)
    if done.returncode == 77 or "Operation not permitted" in done.stderr or "unshare failed" in done.stderr:
        pytest.skip("no mounts here: " + done.stderr.strip()[:100])
    status, _, table = done.stdout.partition("\n")
    assert status == "status 2", done.stderr
    assert "the disk is full" in done.stderr
    assert "of 60 runs are complete; --resume goes on" in done.stderr
    rows = json.loads(table)["runs"]
    assert 0 < len(rows) < 60
    assert {row["status"] for row in rows} == {"success"}


# -- on a cluster ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A real Dask scheduler and two workers, processes of their own that join by TCP: one under Dask's nanny, one alone."""
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    program = [sys.executable, "-m", "dask"]
    options = ["--host", "127.0.0.1", "--port", address.rpartition(":")[2], "--no-dashboard"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tests" / "parts")}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    started = [subprocess.Popen([*program, "scheduler", *options], **quiet)]
    for more in ([], ["--no-nanny"]):
        words = [*program, "worker", address, "--nthreads", "1", "--no-dashboard", *more]
        started.append(subprocess.Popen(words, **quiet))
    from distributed import Client

    with Client(address, timeout=60, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    yield address
    for process in reversed(started):
        process.terminate()
    for process in started:  # Dask's own end, which a busy machine draws out, is not what is tested
        try:
            process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def test_a_cluster_gives_the_same_runs(scheduler: str, short: str, tmp_path: Path) -> None:
    suite = suite_of(short, seeds=list(range(6)))
    swept = sweep(suite, tmp_path / "cluster", scheduler=scheduler)
    assert (swept.done, swept.lost) == (6, ())
    sweep(suite, tmp_path / "here", jobs=2)
    there, here = (read_results(tmp_path / name) for name in ("cluster", "here"))
    assert [(row.name, row.hash) for row in there.rows] == [(row.name, row.hash) for row in here.rows]
    files = {path.name for path in (tmp_path / "cluster" / there.rows[0].name).iterdir()}
    assert files == {path.name for path in (tmp_path / "here" / here.rows[0].name).iterdir()}


def test_on_a_cluster_too_what_dies_or_hangs_costs_itself_only(scheduler: str, short: str, tmp_path: Path, marks: Path) -> None:
    """The workers were started before: their environment has no place for marks, so what would leave one raises KeyError."""
    suite = suite_of(short, ("a-star", "bad_parts:raises_when_built"), seeds=[0, 1], limit=20)
    swept = sweep(suite, tmp_path / "out", scheduler=scheduler)
    assert len(swept.lost) == 2
    rows = read_results(tmp_path / "out").rows
    assert sorted((row.navigator, row.status) for row in rows) == [
        ("a-star", "timeout"),
        ("a-star", "timeout"),
        ("bad_parts:raises_when_built", "error"),
        ("bad_parts:raises_when_built", "error"),
    ]


def test_a_scheduler_that_is_not_there_is_told_within_five_seconds(short: str, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with pytest.raises(RobocarError, match=r"no Dask scheduler answers within 3 s"):
        sweep(suite_of(short), tmp_path / "out", scheduler="tcp://127.0.0.1:1")
    with pytest.raises(RobocarError, match="expected the address of a Dask scheduler"):
        sweep(suite_of(short), tmp_path / "out", scheduler="nonsense")


def test_a_folder_that_cannot_be_written(short: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write here"):
        sweep(suite_of(short), tmp_path / "file" / "out")


def test_a_process_killed_between_two_runs_is_replaced(short: str, tmp_path: Path) -> None:
    """Nobody is at work then, so nobody is to blame: the next run is done at its first try."""
    (case,) = suite_of(short).cases
    jobs = [Job(name, case.arguments(), tmp_path / name) for name in ("first", "second")]
    with workers(1) as one:
        assert one.submit(jobs[0]).result(timeout=60) == JobOutcome("done")
        (victim,) = multiprocessing.active_children()
        assert victim.pid is not None
        os.kill(victim.pid, signal.SIGKILL)
        victim.join()
        assert one.submit(jobs[1]).result(timeout=60) == JobOutcome("done")
    assert multiprocessing.active_children() == []
