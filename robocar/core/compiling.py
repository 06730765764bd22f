"""The one way to have Numba's kernels compiled, or loaded, before the control loop begins."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ParamSpec

import numpy as np

from robocar.core.footprint import Footprint
from robocar.core.geometry import SE2
from robocar.core.robot import Calibration, Limits, RangeSensor, Robot

P = ParamSpec("P")


def warm_up(exercise: Callable[P, object]) -> Callable[P, None]:
    """A decorator: the function runs when it is first called in a process with these arguments, and never again.

    It builds a throwaway of its class and drives it with the types that the control loop has, so that nothing of it is left in a
    run. The class calls it in its constructor; the call from within the exercise does nothing.
    """
    done: set[object] = set()

    def once(*args: P.args, **kwargs: P.kwargs) -> None:
        key = args, tuple(sorted(kwargs.items()))
        if key not in done:
            done.add(key)
            exercise(*args, **kwargs)

    return once


def trial_robot(laser: bool = True) -> Robot:
    """The robot that throwaways drive: round, with a laser all round, or with a ring of sonars instead."""
    around = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    sensors: dict[str, Any] = {"lidar": RangeSensor("lidar", SE2(), around, 0.0, 0.05, 5.0, 0.1)}
    if not laser:
        here = np.zeros(1)
        ring = (SE2(theta=float(angle)) for angle in around[::4])
        sensors = {"sonars": tuple(RangeSensor(f"{k}", at, here, 0.3, 0.05, 5.0, 0.1) for k, at in enumerate(ring))}
    limits = Limits(min_vel_x=-0.2, max_vel_x=0.4, max_vel_theta=1.5, acc_lim_x=0.8, acc_lim_theta=4.0)
    return Robot(Footprint.circle(0.1), limits, Calibration(0.04, np.ones(1), np.ones(1)), 200, **sensors)
