"""What can be set on `robocar.planners.search.dynamic_a_star`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class DynamicAStarParameters:
    """
    Args:
        metric: of the A* search, see `robocar.planners.search.a_star`: `octile`, or `thesis` for its Manhattan heuristic.
        look_around: turn 360 degrees in each new cell: `auto` does where no sonar looks sideways.
        cell_size: of the lattice [m].
        allow_unknown: whether unknown cells of the prior map count as free; else as obstacles.
        margin: room that the footprint keeps [m]; given up where no way is left with it.
        prior_tolerance: an echo this near to what the prior shows (its edge included) is that, seen from a drifted pose [m].
        hit_range: echoes from farther away are not marked [m]; free_range: nor is what lies before them taken back beyond
            this [m].
        speed: from cell to cell [m/s]; turn_rate: on the spot [rad/s].
    """

    metric: Literal["octile", "thesis"] = "octile"
    look_around: Literal["auto", "always", "never"] = "auto"
    cell_size: float = 0.30
    allow_unknown: bool = True
    margin: float = 0.015
    prior_tolerance: float = 0.08
    hit_range: float = 0.65
    free_range: float = 0.65
    speed: float = 0.25
    turn_rate: float = 1.2

    def __post_init__(self) -> None:
        if self.metric not in ("octile", "thesis"):
            raise ValueError(f"metric is octile or thesis, not {self.metric!r}")
        if self.look_around not in ("auto", "always", "never"):
            raise ValueError(f"look_around is auto, always or never, not {self.look_around!r}")
        for name in ("cell_size", "hit_range", "free_range", "speed", "turn_rate"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        for name in ("margin", "prior_tolerance"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, not {getattr(self, name)}")
