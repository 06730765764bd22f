"""Rays cast into the world."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numba import njit

from robocar.core import Array
from robocar.sim.sensors.sensor import Fitting


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
    """Rays from a sensor's mount, cast into the world's surfaces.

    Args:
        fitting: of the sensor.
        directions: unit vectors (n, 3) in the frame of the robot's base.
        reach: [m].
    """

    def __init__(self, fitting: Fitting, directions: Array, reach: float) -> None:
        self._model, self._data, self._met = fitting.model, fitting.data, fitting.met_by_rays
        self._base_pose = fitting.base_pose
        self._origin = np.asarray(fitting.mount.position, dtype=float)
        self._directions = np.ascontiguousarray(directions, dtype=float)
        self._reach = reach
        count = len(directions)
        self._turned = np.empty((count, 3))
        self._distances = np.empty(count)
        self._geoms = np.empty(count, dtype=np.int32)
        self._normals = np.empty((count, 3))
        self._flat = self._turned.ravel(), self._normals.ravel()  # views
        _first_echo(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), 1.0, 0.0)  # compiled here, not in the control loop

    def _cast(self) -> None:
        base = self._base_pose()
        np.dot(self._directions, base.rotation.T, out=self._turned)
        directions, normals = self._flat
        mujoco.mj_multiRay(
            self._model,
            self._data,
            base.position + base.rotation @ self._origin,
            directions,
            self._met,
            True,
            -1,
            self._geoms,
            self._distances,
            normals,
            len(self._distances),
            self._reach,
        )

    def cast(self) -> Array:
        """Distances at this instant (n,) [m], inf where nothing is in reach."""
        self._cast()
        return np.where((self._distances < 0) | (self._distances > self._reach), np.inf, self._distances)

    def first_echo(self, min_cosine: float) -> float:
        """The nearest surface that is not seen at too grazing an angle [m], inf if there is none.

        Args:
            min_cosine: of the angle of incidence, measured from the surface's normal.
        """
        self._cast()
        return float(_first_echo(self._distances, self._turned, self._normals, self._reach, min_cosine))
