"""MuJoCo, and only here: world, car, sensors, movers, firmware, simulation."""

import os

# Without a screen MuJoCo renders through EGL; who wants OSMesa or a window sets the variable before.
os.environ.setdefault("MUJOCO_GL", "egl")
