"""The command `view`."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import tyro

from robocar.cli.output import Flag


def view(run: tyro.conf.Positional[Path], /, web: Flag = False) -> int:
    """Open a recording in the Rerun viewer.

    Args:
        run: a run directory or an .rrd file.
        web: in a browser instead of a window.
    """
    from robocar.core import OutputError, RobocarError

    recording = run / "run.rrd" if run.is_dir() else run
    if not recording.is_file():
        raise OutputError(f"{run}: there is no recording here")
    if not web and not _has_display():
        raise RobocarError(
            f"there is no display here (DISPLAY and WAYLAND_DISPLAY are empty); in a browser: {_in_a_browser(run)}"
        )
    command = [sys.executable, "-m", "rerun", str(recording.absolute())] + (["--web-viewer"] if web else [])
    try:
        # A window that cannot be opened ends in several lines of a library.
        done = subprocess.run(command, check=False, stderr=None if web else subprocess.PIPE, text=True, errors="replace")
    except OSError as error:
        raise RobocarError(f"cannot start the Rerun viewer: {error}") from error
    if done.returncode > 0 and not web:
        last = done.stderr.strip().rpartition("\n")[2]
        raise RobocarError(f"the Rerun viewer could not open a window ({last[:200]}); in a browser: {_in_a_browser(run)}")
    return done.returncode


def _has_display() -> bool:
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def _in_a_browser(run: Path) -> str:
    return f"robocar view {shlex.quote(str(run))} --web"


COMMANDS: dict[str, Callable[..., int]] = {"view": view}
