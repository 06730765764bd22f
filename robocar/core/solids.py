"""Simple bodies that stand on the floor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from robocar.core.geometry import SE2, Array


@dataclass(frozen=True, slots=True)
class Box:
    """A box on the floor: size along its x, y and z [m], pose of its centre."""

    size: tuple[float, float, float]
    pose: SE2 = SE2()

    @property
    def height(self) -> float:
        """[m]"""
        return self.size[2]

    @property
    def radius(self) -> float:
        """Of the circle around it [m]."""
        return 0.5 * math.hypot(self.size[0], self.size[1])

    def outline(self) -> Array:
        """Corners in the world, counter-clockwise, (4, 2) [m]."""
        x, y = 0.5 * self.size[0], 0.5 * self.size[1]
        return self.pose.transform([[x, y], [-x, y], [-x, -y], [x, -y]])


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright cylinder on the floor: radius and height [m], pose of its axis."""

    radius: float
    height: float
    pose: SE2 = SE2()

    def outline(self, corners: int = 32) -> Array:
        """A polygon around it in the world, counter-clockwise, (corners, 2) [m]."""
        angles = np.arange(corners) * (math.tau / corners)
        outer = self.radius / math.cos(math.pi / corners)
        return self.pose.transform(outer * np.stack([np.cos(angles), np.sin(angles)], axis=1))


Solid: TypeAlias = Box | Cylinder
