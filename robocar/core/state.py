"""What the estimation side says: pose and map come from one place."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from robocar.core.geometry import SE2
from robocar.core.grid import OccupancyGrid
from robocar.core.plan import Belief
from robocar.core.work import Work


class MapView(Protocol):
    """A map that is being drawn, as a navigator sees it."""

    @property
    def revision(self) -> int:
        """Rises when cells that were decided have moved: a loop was closed."""
        ...

    @property
    def complete(self) -> bool:
        """Whether it shows every obstacle as it is now: what it does not show is not there."""
        ...

    def grid(self) -> OccupancyGrid | None:
        """A snapshot, made when asked for; None before the first reading. While nothing has changed it is the same object."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What an `Estimator` says at a tick.

    Args:
        belief: where the robot is in the map frame.
        map_from_odom: where the odometry's frame lies. It jumps when an estimator corrects itself, and is exactly `SE2()`, not
            computed, where the estimate itself is smooth.
        odom_from_robot: the pose by odometry alone: smooth, it drifts (REP-105).
        map: None where the estimator draws none; navigators then have the prior map of their context.
        work: what was computed for it (`robocar.core.work`).
    """

    belief: Belief
    map_from_odom: SE2
    odom_from_robot: SE2
    map: MapView | None = None
    work: Work = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (
            isinstance(self.belief, Belief) and isinstance(self.map_from_odom, SE2) and isinstance(self.odom_from_robot, SE2)
        ):
            given = ", ".join(type(value).__name__ for value in (self.belief, self.map_from_odom, self.odom_from_robot))
            raise TypeError(f"a state needs a belief, map_from_odom and odom_from_robot, not {given}")

    @classmethod
    def of(cls, belief: Belief, map_view: MapView | None = None) -> State:
        """The state of a belief and of a map that is drawn beside it."""
        odom = belief.odom_from_robot
        if odom is None:
            return cls(belief, _HERE, belief.pose, map_view)
        return cls(belief, belief.pose @ odom.inverse(), odom, map_view)


_HERE = SE2()
