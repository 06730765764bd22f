"""Where the car's base is at an instant."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import SE2, Array


@dataclass(frozen=True, slots=True)
class BasePose:
    """world_from_base of this instant: position (3,), rotation (3, 3)."""

    position: Array
    rotation: Array

    @property
    def heading(self) -> float:
        """[rad]"""
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])


def base_pose(qpos: Array) -> BasePose:
    """world_from_base from the seven numbers of a free joint."""
    w, x, y, z = qpos[3:7]
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return BasePose(qpos[:3].copy(), rotation)


def planar(pose: BasePose) -> SE2:
    """The pose's shadow on the floor."""
    return SE2(float(pose.position[0]), float(pose.position[1]), pose.heading)
