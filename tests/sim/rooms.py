"""What the tests of the car share: an empty room around it, and a way to let it drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robocar.core import SE2, Command, Hold, Landmark, Observation, OccupancyGrid, Serial
from robocar.core.solids import Solid
from robocar.sim.firmware import FirmwareParameters
from robocar.sim.fit_out import FitOut
from robocar.sim.physics import PhysicsParameters
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.sensors.types import Overrides
from robocar.sim.world import World
from robocar.sim.world_spec import add_top_camera, build_world

IDENTICAL_CARS = PhysicsParameters(friction_std=0.0, wheel_radius_std=0.0)


def room(
    width: float = 8.0,
    depth: float = 8.0,
    *,
    start: SE2 | None = None,
    seed: int = 0,
    fit_out: FitOut | None = None,
    sensors: Overrides | None = None,
    firmware: FirmwareParameters | None = None,
    solids: Sequence[Solid] = (),
    landmarks: Sequence[Landmark] = (),
    **kwargs: Any,
) -> World:
    """The car in the middle of an empty room between (0, 0) and (width, depth) [m], four walls around it."""
    grid = OccupancyGrid(np.zeros((round(depth / 0.1), round(width / 0.1)), dtype=np.int8), 0.1)
    world = build_world(grid, solids=solids, landmarks=landmarks)
    if fit_out is not None and fit_out.top_camera:
        add_top_camera(world, grid)
    start = start or SE2(width / 2, depth / 2)
    setup = RobotSetup(start, fit_out=fit_out or FitOut(), sensors=sensors or {}, firmware=firmware or FirmwareParameters())
    return World(world, [setup], seed=seed, **kwargs)


def drive(simulation: World, command: Command | Callable[[float], Command], duration: float) -> list[Observation]:
    """What the car senses while it keeps to a command, or to one chosen by the time [s], for `duration` [s]."""
    observations = []
    for _ in range(round(duration / simulation.control_period)):
        observations.append(simulation.robot.sense())
        simulation.robot.act(command(simulation.time) if callable(command) else command)
        simulation.step()
    return observations


def execute(simulation: World, line: str, limit: float = 30.0) -> tuple[list[str], SE2]:
    """Sends a serial command and waits for its end: the answers, and start_from_robot afterwards."""
    before = simulation.ground_truth().pose
    answers = list(simulation.robot.sense().serial)
    simulation.robot.act(Serial(line))
    simulation.step()
    end = simulation.time + limit
    while simulation.time < end:
        answers += simulation.robot.sense().serial
        if not simulation.robot.busy:
            break
        simulation.robot.act(Hold())
        simulation.step()
    return answers, before.inverse() @ simulation.ground_truth().pose
