"""`robocar.sim` says how mujoco renders without a screen, before a test imports it. Compiling in an example is no timeout."""

from hypothesis import settings

import robocar.sim  # noqa: F401

settings.register_profile("estimation", deadline=None)
settings.load_profile("estimation")
