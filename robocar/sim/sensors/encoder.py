"""The wheel encoders."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EncoderParameters:
    """Pulse counters: read at every control tick where `period` is 0."""

    period: float = 0.0
    delay: float = 0.0
