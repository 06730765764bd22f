"""How the physics is computed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco

from robocar.core import ScenarioError


@dataclass(frozen=True, slots=True)
class PhysicsParameters:
    """Time steps, and how much one robot differs from the next.

    Args:
        timestep: of the physics [s].
        control_period: between two commands [s], an integer multiple of the firmware's period.
        friction_std: each run draws its own robots: spread of the tyres' friction, relative to the nominal value.
        wheel_radius_std: the same of the radius of each wheel.
    """

    timestep: float = 0.005
    control_period: float = 0.05
    friction_std: float = 0.05
    wheel_radius_std: float = 0.001


def set_physics(spec: mujoco.MjSpec, timestep: float = 0.005) -> None:
    """Time step [s], integrator and friction cone of a world.

    Raises:
        ScenarioError: a time step that is not positive.
    """
    if not (math.isfinite(timestep) and timestep > 0):
        raise ScenarioError(f"timestep {timestep} must be a positive number of seconds")
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # Not for sleeping: see `world_spec`.
    option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    option.sleep_tolerance = 0.0
