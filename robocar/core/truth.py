"""What the simulator knows and no algorithm may: it reaches the recorder and the metrics only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from robocar.core.geometry import SE2, Twist

_AT_REST = Twist()


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """The true state of the world at a tick.

    Args:
        time: of the tick [s].
        pose: world_from_robot.
        twist: of the robot in its own frame.
        clearance: from the footprint to the nearest obstacle, movers too, 0 in contact, inf where there is none [m].
        movers: world_from_mover by name.
        mover_velocities: of their centres in the world, x and y [m/s], and their turning rates [rad/s], by name.
        voltages: at the motors, left and right [V].
        contact: whether the car touches anything but the floor.
    """

    time: float
    pose: SE2
    twist: Twist = _AT_REST
    clearance: float = float("inf")
    movers: Mapping[str, SE2] = field(default_factory=dict)
    voltages: tuple[float, float] = (0.0, 0.0)
    contact: bool = False
    mover_velocities: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
