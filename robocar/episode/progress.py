"""Who is told how far a run has got."""

from __future__ import annotations

from typing import Protocol


class RunProgress(Protocol):
    """Told after every tick how far the run has got [s]."""

    def __call__(self, time: float, time_limit: float) -> None: ...
