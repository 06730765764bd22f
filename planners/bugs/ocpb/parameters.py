"""Parameters of the Operative Critical Point Bug."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OcpbParameters:
    """
    Args:
        max_obstacle_width: wider obstacles are taken for walls and not followed [m].
        tracking_distance: farther obstacles are not followed [m].
        collision_margin: kept free between the robot's body and a moving obstacle, for errors of the prediction [m].
        prediction_horizon: collisions later than this are not looked for yet [s].
        max_iterations: decisions after which it gives up.
    """

    max_obstacle_width: float = 1.0
    tracking_distance: float = 5.5
    collision_margin: float = 0.12
    prediction_horizon: float = 6.0
    max_iterations: int = 1000

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0 or (name == "collision_margin" and value == 0))):
                raise ValueError(f"{name} must be positive, not {value}")
