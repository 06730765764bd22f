"""The bumper."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BumperParameters:
    """Pressed from this force on [N]."""

    period: float = 0.05
    delay: float = 0.0
    threshold: float = 0.5
