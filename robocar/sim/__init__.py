"""MuJoCo, and only here: worlds, robots, sensors, movers, firmware."""

import os

# Without a screen MuJoCo renders through EGL; who wants OSMesa or a window sets the variable before.
os.environ.setdefault("MUJOCO_GL", "egl")
