"""Rays cast into the world."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numba import njit

from robocar.core import Array

SEEN_BY_RAYS = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
"""Geom groups that range sensors see: the world (0), not the car (1) nor what is only to be looked at (2)."""


@njit(cache=True)
def _first_echo(distances: Array, directions: Array, normals: Array, reach: float, min_cosine: float) -> float:
    """Smallest distance in reach among the rays whose angle of incidence has at least this cosine; inf if there is none."""
    first = math.inf
    for i in range(len(distances)):
        distance = distances[i]
        if 0.0 <= distance <= reach and distance < first:
            cosine = abs(directions[i, 0] * normals[i, 0] + directions[i, 1] * normals[i, 1] + directions[i, 2] * normals[i, 2])
            if cosine >= min_cosine:
                first = distance
    return first


class RayFan:
    """Rays from a point fixed to the car, cast into the world's surfaces."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, origin: Array, directions: Array, reach: float) -> None:
        """`origin` (3,) and unit `directions` (n, 3) in the frame of the car's base."""
        self._model, self._data = model, data
        self._origin = np.asarray(origin, dtype=float)
        self._directions = np.ascontiguousarray(directions, dtype=float)
        self._reach = reach
        count = len(directions)
        self._turned = np.empty((count, 3))
        self._distances = np.empty(count)
        self._geoms = np.empty(count, dtype=np.int32)
        self._normals = np.empty((count, 3))
        self._flat = self._turned.ravel(), self._normals.ravel()  # views
        _first_echo(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), 1.0, 0.0)  # compiled here, not in the control loop

    def _cast(self, position: Array, rotation: Array) -> None:
        np.dot(self._directions, rotation.T, out=self._turned)
        directions, normals = self._flat
        mujoco.mj_multiRay(
            self._model,
            self._data,
            position + rotation @ self._origin,
            directions,
            SEEN_BY_RAYS,
            True,
            -1,
            self._geoms,
            self._distances,
            normals,
            len(self._distances),
            self._reach,
        )

    def cast(self, position: Array, rotation: Array) -> Array:
        """Distances (n,) [m], inf where nothing is in reach.

        Args:
            position, rotation: world_from_base, (3,) [m] and (3, 3).
        """
        self._cast(position, rotation)
        return np.where((self._distances < 0) | (self._distances > self._reach), np.inf, self._distances)

    def first_echo(self, position: Array, rotation: Array, min_cosine: float) -> float:
        """The nearest surface that is not seen at too grazing an angle [m], inf if there is none.

        Args:
            min_cosine: of the angle of incidence, measured from the surface's normal.
        """
        self._cast(position, rotation)
        return float(_first_echo(self._distances, self._turned, self._normals, self._reach, min_cosine))
