"""A project with folders named as ours: `planners`, `experiments`, `models`, and a `conftest.py` at its root.

Oracles: the hash of the same navigator run in this process, exit statuses, and the project's own words. In the environment of
the wheel, and in the one of this checkout.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import robocar

SHORT = "map: maps/thesis_field.yaml\nstart: [0.3, 0.3, 0]\ngoal: [1.2, 0.4]\ntime_limit: 1.0\n"
SUITE = (
    "runs:\n  - scenarios: [{project}/models/short.yaml]\n    navigators: [a-star]\n    estimators: [truth]\n    seeds: [0, 1]\n"
)
OWN_PLANNER = """
from robocar.planners.search.a_star import build as a_star
from robocar.planners.controllers.pure_pursuit import build as pure_pursuit
from robocar.planners.navigators.plan_and_follow import plan_and_follow

WHOSE = "the stranger's"

def build(context):
    return plan_and_follow(context, a_star, pure_pursuit)
"""
OWN_EXPERIMENT = """
import json, sys
from pathlib import Path
import robocar
import planners.mine
from robocar.reporting.run_many import run_many

if __name__ == "__main__":
    assert planners.mine.WHOSE == "the stranger's"
    job = {"scenario": str(Path("models/short.yaml").resolve()), "estimator": "truth"}
    here = [robocar.run(**job, navigator=navigator).hash for navigator in ("a-star", "planners.mine:build")]
    workers = [result.hash for result in run_many([job | {"navigator": "planners.mine:build"}, job | {"navigator": "a-star"}])]
    json.dump(here + workers, sys.stdout)
"""
OWN_TESTS = """
import experiments.study
import planners.mine

def test_both(physics_run, assert_no_regression, whose):
    assert whose == planners.mine.WHOSE
    runs = [
        physics_run("models/short.yaml", navigator=navigator, estimator="truth")
        for navigator in ("a-star", "planners.mine:build", planners.mine.build)
    ]
    assert len({run.hash for run in runs}) == 1
    assert physics_run("cluttered", navigator="a-star", settings={"time_limit": 0.5}).status == "timeout"
    assert_no_regression(runs[1])
"""


@pytest.fixture
def project(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The stranger's repository; its folders are packages or, as many write them, only folders."""
    files = {
        "conftest.py": "import pytest\nimport planners.mine\n\n@pytest.fixture\ndef whose():\n    return planners.mine.WHOSE\n",
        "planners/mine.py": OWN_PLANNER,
        "experiments/study.py": OWN_EXPERIMENT,
        "models/short.yaml": SHORT,
        "models/suite.yaml": SUITE.format(project=tmp_path / "project"),
        "tests/test_mine.py": OWN_TESTS,
    }
    if request.param == "packages":
        files |= {f"{folder}/__init__.py": "" for folder in ("planners", "experiments", "models")}
    for name, text in files.items():
        (tmp_path / "project" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "project" / name).write_text(text)
    return tmp_path / "project"


@pytest.fixture
def python(request: pytest.FixtureRequest) -> Path:
    """The interpreter of an environment with Robocar: from the wheel, or from this checkout."""
    if request.param == "checkout":
        return Path(sys.executable)
    return request.getfixturevalue("installed") / "python"


def words_of(python: Path, project: Path, *words: str) -> subprocess.CompletedProcess[str]:
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    if python != Path(sys.executable):  # what a fresh environment has to compile need not be fast; the results are the same
        env["NUMBA_OPT"] = "1"  # 0 keeps nothing for the next process
    return subprocess.run([str(python), *words], cwd=project, env=env, capture_output=True, text=True, check=False)


@contextmanager
def cluster(python: Path, project: Path) -> Iterator[str]:
    """A Dask scheduler and a worker, started in the project's folder."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    address = f"tcp://127.0.0.1:{port}"
    program = [str(python), "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": project}
    started = [
        subprocess.Popen([*program, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"], **quiet),
        subprocess.Popen([*program, "worker", address, "--nthreads", "1", "--no-dashboard"], **quiet),
    ]
    try:
        from distributed import Client

        with Client(address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=60)
        yield address
    finally:
        for process in reversed(started):
            process.terminate()
        for process in started:
            try:
                process.wait(timeout=30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.mark.parametrize(("python", "project"), [("wheel", "packages"), ("checkout", "folders")], indirect=True)
def test_a_project_with_folders_of_our_names(python: Path, project: Path) -> None:
    expected = robocar.run(project / "models" / "short.yaml", navigator="a-star", estimator="truth").hash
    suite = ["sweep", "models/suite.yaml", "--navigator", "a-star", "--navigator", "planners.mine:build"]

    # The command line.
    for navigator in ("a-star", "planners.mine:build"):
        words = ["run", "models/short.yaml", "--navigator", navigator, "--estimator", "truth", "--no-recording", "--json"]
        done = words_of(python, project, "-m", "robocar", *words)
        assert done.returncode == 1, done.stderr  # its time is over before it is there
        assert json.loads(done.stdout)["hash"] == expected
    done = words_of(python, project, "-m", "robocar", "list", "experiments", "--json")
    assert "barn" in json.loads(done.stdout), done.stderr

    # The Python API, here and in workers of `run_many`.
    done = words_of(python, project, "-m", "experiments.study")
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)) == {expected}

    # The pytest plugin.
    plain = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--robocar-recordings=none"]
    for words in ([*plain, "--robocar-update"], plain):
        done = words_of(python, project, *words)
        assert done.returncode == 0, done.stdout + done.stderr

    # Sweeps: worker processes, and a cluster.
    done = words_of(python, project, "-m", "robocar", *suite, "--jobs", "2", "--out", "swept", "--json")
    assert done.returncode == 0, done.stderr
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with cluster(python, project) as address:
        done = words_of(python, project, "-m", "robocar", *suite, "--scheduler", address, "--out", "clustered", "--json")
        assert done.returncode == 0, done.stderr
    for folder in ("swept", "clustered"):
        runs = [json.loads(path.read_text()) for path in sorted((project / folder).glob("*/metrics.json"))]
        assert sorted((run["navigator"], run["seed"]) for run in runs) == [
            ("a-star", 0),
            ("a-star", 1),
            ("planners.mine:build", 0),
            ("planners.mine:build", 1),
        ]
        assert [run["hash"] for run in runs if run["seed"] == 0] == [expected] * 2
