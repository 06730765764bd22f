"""Before any test imports mujoco, `robocar.sim` says how it renders without a screen."""

import robocar.sim  # noqa: F401
