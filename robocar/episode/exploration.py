"""When an exploration has succeeded: what its map knows decides, not what the navigator says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robocar.core import SE2, MapView, OccupancyGrid
from robocar.metrics.map import explored_share

EXPLORED = 0.95
"""The least `map/explored` of an exploration that has succeeded."""


@dataclass(frozen=True, slots=True)
class Exploration:
    """The measure of an exploration, for the judge.

    Args:
        truth: makes the true map with its border: it is costly, and needed once.
        radius: of the robot's inscribed circle [m].
    """

    truth: Callable[[], OccupancyGrid]
    radius: float

    def __call__(self, start: SE2, view: MapView | None) -> tuple[bool, str]:
        """Whether the map knows enough of the area that the robot can cover from its start, and how much that is."""
        drawn = None if view is None else view.grid()
        share = None if drawn is None else explored_share(drawn, self.truth(), start.position, self.radius)
        if share is None:
            return False, "the map says nothing of the area that the robot can cover"
        return (
            share >= EXPLORED,
            f"{share:.1%} of the area that the robot can cover are known (at least {EXPLORED:.0%} are asked)",
        )
