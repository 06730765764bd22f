"""What stands in the world of a recording before anything happens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from robocar.core import Goal, Landmark, OccupancyGrid, Robot
from robocar.core.solids import Box, Cylinder, Solid

__all__ = ["Box", "Cylinder", "Scenery", "Solid"]


@dataclass(frozen=True, slots=True)
class Scenery:
    """The static part of a recording.

    Args:
        truth: the map that physics is built from, None where nobody knows it.
        prior: the map that the robot is given.
        robot: the machine: its footprint and wheels are drawn.
        goal: where it shall go.
        landmarks: coloured balls.
        solids: boxes and cylinders that stand in the world but not on the map.
        movers: shapes of the movers by name, in the mover's own frame.
        wall_height: of the map's occupied cells in the 3D view [m].
    """

    truth: OccupancyGrid | None = None
    prior: OccupancyGrid | None = None
    robot: Robot | None = None
    goal: Goal | None = None
    landmarks: tuple[Landmark, ...] = ()
    solids: tuple[Solid, ...] = ()
    movers: Mapping[str, Solid] = field(default_factory=dict)
    wall_height: float = 0.25
