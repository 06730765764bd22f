"""Offscreen pictures from the cameras of the model."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from robocar.core import Array, Image

# MuJoCo's camera frame looks along -z with y up; OpenCV's along +z with y down.
_MUJOCO_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])


class OffscreenCamera:
    """Renders one camera: no shadows, no reflections, no multisampling (the world asks for none).

    Args:
        model: of the world.
        data: of the world.
        camera: its name in the model.
        size: width and height of the picture [px].
        shown: geom groups that it shows, (6,); by default MuJoCo's.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        camera: str,
        size: tuple[int, int],
        shown: NDArray[np.uint8] | None = None,
    ) -> None:
        width, height = size
        self._model, self._data = model, data
        self._option = mujoco.MjvOption()
        if shown is not None:
            self._option.geomgroup[:] = shown
        self._camera = model.camera(camera).id
        self._renderer = mujoco.Renderer(model, height, width)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._renderer.scene.flags[flag] = False
        focal = 0.5 * height / math.tan(0.5 * math.radians(float(model.cam_fovy[self._camera])))
        self.intrinsics = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])

    def read(self, time: float, base_position: Array | None, base_rotation: Array | None) -> Image:
        """A picture of this instant; its pose relative to the base, or in the world where no base is given."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera, self._option)
        pixels = self._renderer.render()
        transform = np.eye(4)
        rotation = self._data.cam_xmat[self._camera].reshape(3, 3) @ _MUJOCO_FROM_OPENCV
        position = self._data.cam_xpos[self._camera]
        if base_position is not None and base_rotation is not None:
            rotation = base_rotation.T @ rotation
            position = base_rotation.T @ (position - base_position)
        transform[:3, :3], transform[:3, 3] = rotation, position
        return Image(time, pixels, self.intrinsics, transform)

    def close(self) -> None:
        self._renderer.close()
