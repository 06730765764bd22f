"""What a result depends on beside its seed: versions, processor and renderer."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
from functools import cache
from pathlib import Path

_PACKAGES = ("robocar", "mujoco", "numpy", "numba", "scipy", "opencv-python-headless", "rerun-sdk")


@cache
def versions() -> dict[str, str]:
    """Of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "unknown"
    return found


@cache
def fingerprint() -> str:
    """Short hash: equal fingerprints promise equal run hashes, others do not.

    Over the versions, the machine's architecture, the processor features that numeric libraries choose their code by, and
    the renderer.
    """
    features = ""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = [line for line in cpuinfo.read_text(errors="replace").splitlines() if line.startswith(("flags", "Features"))]
        features = " ".join(sorted(set(lines[0].partition(":")[2].split()))) if lines else ""
    renderer = os.environ.get("MUJOCO_GL", "")
    parts = [repr(sorted(versions().items())), platform.machine(), features, renderer]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
