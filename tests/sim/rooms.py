"""What the tests of the car share: an empty room around it, and a way to let it drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robocar.core import SE2, Command, Hold, Landmark, Observation, OccupancyGrid, Serial
from robocar.core.solids import Solid
from robocar.sim.car import FitOut
from robocar.sim.simulation import PhysicsParameters, Simulation
from robocar.sim.world import build_world

IDENTICAL_CARS = PhysicsParameters(friction_std=0.0, wheel_radius_std=0.0)


def room(
    width: float = 8.0,
    depth: float = 8.0,
    *,
    start: SE2 | None = None,
    seed: int = 0,
    fit_out: FitOut | None = None,
    solids: Sequence[Solid] = (),
    landmarks: Sequence[Landmark] = (),
    **kwargs: Any,
) -> Simulation:
    """The car in the middle of an empty room between (0, 0) and (width, depth) [m], four walls around it."""
    grid = OccupancyGrid(np.zeros((round(depth / 0.1), round(width / 0.1)), dtype=np.int8), 0.1)
    world = build_world(grid, solids=solids, landmarks=landmarks, top_camera=fit_out is not None and fit_out.top_camera)
    start = start or SE2(width / 2, depth / 2)
    return Simulation(world, start=start, seed=seed, fit_out=fit_out, **kwargs)


def drive(simulation: Simulation, command: Command | Callable[[float], Command], duration: float) -> list[Observation]:
    """What the car senses while it keeps to a command, or to one chosen by the time [s], for `duration` [s]."""
    observations = []
    for _ in range(round(duration / simulation.control_period)):
        observations.append(simulation.sense())
        simulation.act(command(simulation.time) if callable(command) else command)
    return observations


def execute(simulation: Simulation, line: str, limit: float = 30.0) -> tuple[list[str], SE2]:
    """Sends a serial command and waits for its end: the answers, and start_from_robot afterwards."""
    before = simulation.ground_truth().pose
    answers = list(simulation.sense().serial)
    simulation.act(Serial(line))
    end = simulation.time + limit
    while simulation.time < end:
        answers += simulation.sense().serial
        if not simulation.busy:
            break
        simulation.act(Hold())
    return answers, before.inverse() @ simulation.ground_truth().pose
