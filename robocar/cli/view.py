"""The command `view`."""

from __future__ import annotations

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
    command = [sys.executable, "-m", "rerun", str(recording)] + (["--web-viewer"] if web else [])
    try:
        return subprocess.run(command, check=False).returncode
    except OSError as error:
        raise RobocarError(f"cannot start the Rerun viewer: {error}") from error


COMMANDS: dict[str, Callable[..., int]] = {"view": view}
