"""The accelerometer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AccelerometerParameters:
    """Two axes; noise in m/s^2."""

    period: float = 0.05
    delay: float = 0.0
    std: float = 0.05
