"""Commands of an environment, away from the checkout."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path


def outside(bin_folder: Path, folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Runs a command of the fresh environment in a folder that is not the checkout."""
    # What the fresh environment has to compile need not be fast; the results are the same.
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"NUMBA_OPT": "1"}
    program = str(bin_folder / command[0])
    return subprocess.run([program, *command[1:]], cwd=folder, env=env, capture_output=True, text=True, check=False)
