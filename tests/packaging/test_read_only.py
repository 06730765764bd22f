"""An installation that cannot be written, for a user without a home: as in many containers. Oracle: real processes."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from robocar.kernel_cache import VARIABLE
from tests.cli.command_line import ROOT

pytestmark = pytest.mark.skipif(
    not hasattr(os, "getuid") or (os.getuid() == 0 and shutil.which("setpriv") is None), reason="no users, or no setpriv, here"
)
NOTE = "robocar: neither the installation nor a home folder can be written: "
KERNEL = (
    "import numpy as np; from robocar.core.distance import polygon_distance as far; "
    "corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]); print(far(corners, corners + [3.0, 0.0]))"
)
NESTED = f"import subprocess, sys, robocar; sys.exit(subprocess.call([sys.executable, '-c', {KERNEL!r}]))"


@pytest.fixture(scope="module")
def installation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package and its data, without a right to write."""
    folder = tmp_path_factory.mktemp("read-only")
    shutil.copytree(ROOT / "robocar", folder / "robocar", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "models", folder / "models")
    for path in (folder, *folder.rglob("*")):
        path.chmod(path.stat().st_mode & ~(stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH))
    return folder


def python(installation: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A process that may not write there. Root may write everywhere, unless it gives that right up."""
    powers = "-dac_override,-dac_read_search"
    drop = [] if os.getuid() else ["setpriv", f"--bounding-set={powers}", f"--inh-caps={powers}"]
    env = {key: os.environ[key] for key in ("PATH", "MUJOCO_GL") if key in os.environ}
    env |= {"HOME": "/dev/null/home", "PYTHONPATH": str(installation), "NUMBA_OPT": "1"} | environment
    done = subprocess.run(
        [*drop, sys.executable, "-P", *words], env=env, cwd=environment["TMPDIR"], capture_output=True, text=True, check=False
    )
    if drop and ("setpriv" in done.stderr or not (installation / "robocar").exists()):
        pytest.skip(f"root cannot give up its rights here: {done.stderr[:100]}")
    return done


def test_kernels_are_kept_in_a_temporary_folder_and_that_is_said_once(installation: Path, tmp_path: Path) -> None:
    words = ("-m", "robocar", "list", "navigators")
    for _ in range(2):
        done = python(installation, *words, TMPDIR=str(tmp_path))
        assert done.returncode == 0, done.stderr
        assert done.stderr.startswith(f"{NOTE}compiled kernels are kept in {tmp_path}/robocar-kernels-")
        assert len(done.stderr.splitlines()) == 1
    done = python(installation, "-c", KERNEL, TMPDIR=str(tmp_path))
    assert (done.stdout, done.stderr.count("\n")) == ("2.0\n", 1), done.stderr
    (kept,) = tmp_path.glob("robocar-kernels-*")
    assert stat.S_IMODE(kept.stat().st_mode) == 0o700
    assert list(kept.rglob("*.nbi"))
    again = python(installation, "-c", NESTED, TMPDIR=str(tmp_path))
    assert (again.stdout, again.stderr.count(NOTE)) == ("2.0\n", 1)  # a process of a process says nothing
    quiet = python(installation, "-c", KERNEL, TMPDIR=str(tmp_path), **{VARIABLE: str(kept)})
    assert (quiet.stdout, quiet.stderr) == ("2.0\n", "")


def test_a_folder_that_somebody_else_could_have_written_is_not_used(installation: Path, tmp_path: Path) -> None:
    """What is kept is code. Oracle: the planted folder stays empty."""
    planted = tmp_path / f"robocar-kernels-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)
    done = python(installation, "-c", KERNEL, TMPDIR=str(tmp_path))
    assert done.stdout == "2.0\n", done.stderr
    assert list(planted.iterdir()) == []
    assert len(list(tmp_path.glob("robocar-kernels-*"))) == 2


def test_without_any_folder_kernels_are_not_kept(installation: Path, tmp_path: Path) -> None:
    code = f"import tempfile; tempfile.gettempdir = lambda: '/dev/null'\n{KERNEL}"
    done = python(installation, "-c", code, TMPDIR=str(tmp_path))
    assert (done.stdout, done.stderr) == ("2.0\n", f"{NOTE}compiled kernels are not kept; {VARIABLE} names a place\n")
