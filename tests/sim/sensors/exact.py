"""What the tests of the sensors share: sensors without noise, a hall, and a car that is put somewhere."""

from __future__ import annotations

from typing import Any

from robocar.core import SE2, Hold, Observation
from robocar.sim.world import World

EXACT: dict[str, dict[str, Any]] = {
    "sonar": {"range_std": 0.0, "relative_std": 0.0, "dropout": 0.0},
    "lidar": {"range_std": 0.0, "dropout": 0.0},
    "psd": {"relative_std": 0.0},
    "compass": {"std": 0.0, "resolution": 0.0},
    "accelerometer": {"std": 0.0},
}
TILT = 0.002  # [m] the car sinks and nods a little on its tyres
HALL = (24.0, 24.0)  # larger than any range in its middle


def observe(world: World, pose: SE2) -> tuple[Observation, SE2]:
    """What the car senses a tick after it was put somewhere, and where it is then."""
    world.robot.kidnap(pose)
    world.robot.act(Hold())
    world.step()
    return world.robot.sense(), world.ground_truth().pose
