"""`scripts/setup.sh` where it may not install. Oracle: a PATH made for it."""

from __future__ import annotations

import stat
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def stub(folder: Path, name: str, script: str) -> None:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


@pytest.mark.parametrize(
    ("python", "told"),
    [
        # Python without ensurepip, as Debian's is before python3-venv is installed.
        (
            f'case "$2" in *ensurepip*) exit 1;; *) exec {sys.executable} "$@";; esac',
            "install -y --no-install-recommends python3.",
        ),
        # Python too old or too new: `suits` asks for its version.
        ("exit 1", "install -y --no-install-recommends python3 python3-venv"),
    ],
    ids=["without venv", "wrong version"],
)
def test_setup_without_rights_says_the_line_to_type(tmp_path: Path, python: str, told: str) -> None:
    """Oracle: a PATH on which nobody is root, sudo asks for a password, and Python is not what it should be."""
    (tmp_path / "scripts").mkdir()
    script = tmp_path / "scripts" / "setup.sh"
    script.write_bytes((ROOT / "scripts" / "setup.sh").read_bytes())
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "dirname").symlink_to("/usr/bin/dirname")
    for name, text in {"id": "echo 1000", "sudo": "exit 1", "apt-get": "echo called >> apt.log", "sleep": ""}.items():
        stub(programs, name, text)
    for name in ("python3", "python3.11", "python3.12"):
        stub(programs, name, python)
    done = subprocess.run(
        ["/bin/bash", str(script), "demo"], env={"PATH": str(programs)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("sudo apt-get")]
    assert told in line
    assert not (tmp_path / ".venv").exists()
    assert not (tmp_path / "apt.log").exists()
