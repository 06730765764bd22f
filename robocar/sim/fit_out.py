"""The fit-outs that a scenario chooses from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Sonars = Literal["none", "front", "front+sides", "ring"]
Lidar = Literal["none", "hokuyo", "scan360"]


@dataclass(frozen=True, slots=True)
class FitOut:
    """Which sensors a robot carries. The camera looks ahead (`fixed`) or, where no command turns it, around (`sweep`)."""

    sonars: Sonars = "front"
    lidar: Lidar = "none"
    compass: bool = False
    camera: bool = False
    top_camera: bool = False
    camera_pan: Literal["fixed", "sweep"] = "fixed"

    def choice(self, key: str) -> bool | str:
        """What is chosen for `sonars`, `lidar` and so on."""
        return getattr(self, key)
