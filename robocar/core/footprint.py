"""The outline of the robot on the floor and the two circles that planners know it by."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from robocar.core.geometry import SE2, Array, frozen_array


@dataclass(frozen=True, slots=True)
class Footprint:
    """A convex polygon around the robot's origin.

    Args:
        vertices: corners in the robot's frame, counter-clockwise, (n, 2) [m].

    `inscribed_radius` [m]: an obstacle nearer to the origin always touches.
    `circumscribed_radius` [m]: an obstacle farther from the origin never touches, however the robot turns.
    """

    vertices: Array
    inscribed_radius: float = field(init=False)
    circumscribed_radius: float = field(init=False)

    def __post_init__(self) -> None:
        vertices = frozen_array(self.vertices)
        if vertices.ndim != 2 or vertices.shape[0] < 3 or vertices.shape[1] != 2:
            raise ValueError(f"a footprint needs at least three corners (n, 2), not shape {vertices.shape}")
        edges = np.roll(vertices, -1, axis=0) - vertices
        following = np.roll(edges, -1, axis=0)
        if not np.all(edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0] > 0):
            raise ValueError("a footprint must be strictly convex, its corners counter-clockwise")
        ahead = np.sum(edges * following, axis=1)
        if not np.sum(np.arctan2(edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0], ahead)) < 3 * np.pi:
            raise ValueError("a footprint must not wind around the origin more than once")
        normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
        offsets = np.sum(normals * vertices, axis=1)
        if not np.all(offsets > 0):
            raise ValueError("the robot's origin must lie inside its footprint")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "inscribed_radius", float(offsets.min()))
        object.__setattr__(self, "circumscribed_radius", float(np.linalg.norm(vertices, axis=1).max()))

    @classmethod
    def rectangle(cls, front: float, rear: float, half_width: float) -> Footprint:
        """From `rear` behind to `front` ahead of the origin [m], symmetric about the x axis."""
        return cls(np.array([[front, half_width], [-rear, half_width], [-rear, -half_width], [front, -half_width]]))

    @classmethod
    def circle(cls, radius: float, corners: int = 32) -> Footprint:
        """A regular polygon around the disc of `radius` [m]."""
        angles = np.arange(corners) * (2 * np.pi / corners)
        outer = radius / np.cos(np.pi / corners)
        return cls(outer * np.stack([np.cos(angles), np.sin(angles)], axis=1))

    def padded(self, margin: float) -> Footprint:
        """The outline with each edge moved outwards by `margin` >= 0 [m]: its distance from what is outside, not a scale."""
        edges = np.roll(self.vertices, -1, axis=0) - self.vertices
        normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
        before = np.roll(normals, 1, axis=0)  # of the edge that ends at the corner
        # The corner moves by what lies `margin` along both normals: margin (n + m) / (1 + n m).
        shift = (normals + before) / (1.0 + np.sum(normals * before, axis=1))[:, None]
        return Footprint(self.vertices + margin * shift)

    def at(self, world_from_robot: SE2) -> Array:
        """Corners in the world, (n, 2) [m]."""
        return world_from_robot.transform(self.vertices)
