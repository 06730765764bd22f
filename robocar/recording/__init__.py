"""Recordings for the Rerun viewer: written while a run is going on, read back by metrics, tests and replays.

Rerun takes most of a second to import, so the names that need it are imported when they are first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from robocar.recording.recorder import NullRecorder, Recorder
from robocar.recording.scenery import Box, Cylinder, Scenery

if TYPE_CHECKING:
    from robocar.recording.reader import read_observations, read_signal, read_trajectory
    from robocar.recording.writer import RerunRecorder

_LAZY = {
    "RerunRecorder": "writer",
    "read_observations": "reader",
    "read_signal": "reader",
    "read_trajectory": "reader",
}

__all__ = [
    "Box",
    "Cylinder",
    "NullRecorder",
    "Recorder",
    "RerunRecorder",
    "Scenery",
    "read_observations",
    "read_signal",
    "read_trajectory",
]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
