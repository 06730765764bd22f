"""What a large map costs: boxes, time until the world is compiled, a physics step, a laser scan and a camera picture.

Every row compares with an empty world that the same car stands in, measured in turns with it, so that a busy machine slows both.
`python -m robocar.benchmarks.bench_worlds` (part of `make bench`).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from time import perf_counter

import robocar.sim  # noqa: F401 (says how MuJoCo renders, which must be known when it is imported)

# isort: split
import cv2
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from robocar.core import SE2, OccupancyGrid
from robocar.formats.generated import cave, maze, rooms
from robocar.sim.cover import cover
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_model import RobotModel
from robocar.sim.world_spec import FLOOR_BIT, SENSED_GROUP, SOLID_BIT, build_world

PREFIX = "robocar/"
ROUNDS, STEPS = 60, 100
LASER = 360, 6.0  # beams, range [m]


def roomiest(grid: OccupancyGrid) -> SE2:
    """A pose at the centre of the free cell farthest from all walls."""
    distance = cv2.distanceTransform(np.pad(~grid.occupied, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    cell = np.unravel_index(np.argmax(distance[1:-1, 1:-1]), grid.shape)
    return SE2(*grid.world_from_cell(np.array(cell)))


def with_car(world: mujoco.MjSpec, pose: SE2) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The world with a car that turns on the spot, so that it touches nothing but the floor."""
    frame = world.worldbody.add_frame(pos=[pose.x, pose.y, 0.0])
    world.attach(RobotModel.load().spec(FitOut(camera=True)), prefix=PREFIX, frame=frame)
    model = world.compile()
    data = mujoco.MjData(model)
    for side, volts in (("left", -4.0), ("right", 4.0)):
        for end in ("front", "rear"):
            data.actuator(f"{PREFIX}{end}_{side}_motor").ctrl = volts
    mujoco.mj_step(model, data, 300)
    return model, data


def plain_world(grid: OccupancyGrid, *, body: bool, sleep: bool, ground: bool = False) -> mujoco.MjSpec:
    """The same boxes without the measures that `build_world` takes, to see what each is worth."""
    world = build_world(OccupancyGrid(np.zeros((1, 1)), grid.resolution), border="open")
    if not sleep:
        world.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    if not ground:
        world.delete(world.body("floor"))
        world.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=FLOOR_BIT, conaffinity=FLOOR_BIT)
    parent = world.worldbody.add_body(name="walls") if body else world.worldbody
    for r0, c0, r1, c1 in cover(grid.occupied) * grid.resolution:
        parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[(c0 + c1) / 2, (r0 + r1) / 2, 0.15],
            size=[(c1 - c0) / 2, (r1 - r0) / 2, 0.15],
            group=SENSED_GROUP,
            contype=SOLID_BIT,
            conaffinity=SOLID_BIT,
        )
    return world


def fastest(call: Callable[[], object], repeats: int) -> float:
    """Shortest of several runs [s]: everything longer is the machine's other work."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return min(times)


def step_times(worlds: dict[str, tuple[mujoco.MjModel, mujoco.MjData]]) -> dict[str, float]:
    """Time of one step in each world [s], measured in turns."""
    best = dict.fromkeys(worlds, math.inf)
    for _ in range(ROUNDS):
        for name, (model, data) in worlds.items():
            best[name] = min(best[name], fastest(lambda m=model, d=data: mujoco.mj_step(m, d, STEPS), 1) / STEPS)
    return best


def scan_time(model: mujoco.MjModel, data: mujoco.MjData, pose: SE2) -> float:
    """Time of one laser scan [s]."""
    beams, reach = LASER
    angles = np.arange(beams) * (math.tau / beams)
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(beams)], axis=1).ravel()
    geoms, distances, groups = np.zeros(beams, np.int32), np.zeros(beams), np.array([1, 0, 0, 0, 0, 0], np.uint8)
    origin = np.array([pose.x, pose.y, 0.15])
    return fastest(
        lambda: mujoco.mj_multiRay(model, data, origin, directions, groups, True, -1, geoms, distances, None, beams, reach),
        5,
    )


def picture_time(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Time of one picture of the car's camera, 160 x 120 [s]."""
    model.vis.global_.offwidth, model.vis.global_.offheight = 160, 120
    renderer = mujoco.Renderer(model, 120, 160, max_geom=100_000)

    def take() -> None:
        renderer.update_scene(data, PREFIX + "camera")
        renderer.render()

    time = fastest(take, 5)
    renderer.close()
    return time


def main() -> None:
    """Prints both tables."""
    parser = argparse.ArgumentParser(description="What a large map costs.")
    parser.add_argument("--cells", type=int, default=512, help="rows and columns of the maps (default 512)")
    size = parser.parse_args().cells
    console = Console()

    maps = {
        "cave": cave(size, size, np.random.default_rng(0)),
        "cave, turned 0.4 rad": cave(size, size, np.random.default_rng(0), origin=SE2(3.0, -2.0, 0.4)),
        "maze, corridor 9": maze(size, size, 9, np.random.default_rng(0)),
        "maze, corridor 3": maze(size, size, 3, np.random.default_rng(0)),
        "rooms": rooms(size, size, np.random.default_rng(0)),
    }
    cover(np.eye(3, dtype=bool))  # compiles
    table = Table(title=f"Worlds of {size} x {size} cells")
    for column in ("map", "boxes", "cover [ms]", "world [s]", "step [us]", "step / empty", "scan [ms]", "picture [ms]"):
        table.add_column(column, justify="left" if column == "map" else "right")
    for name, grid in maps.items():
        pose = roomiest(grid)
        start = perf_counter()
        world = with_car(build_world(grid), pose)
        built = perf_counter() - start
        blank = OccupancyGrid(np.zeros(grid.shape), grid.resolution, grid.origin)
        times = step_times({"this": world, "empty": with_car(build_world(blank), pose)})
        table.add_row(
            name,
            str(len(cover(grid.occupied))),
            f"{1e3 * fastest(lambda g=grid: cover(g.occupied), 5):.0f}",
            f"{built:.2f}",
            f"{1e6 * times['this']:.1f}",
            f"{times['this'] / times['empty']:.2f}",
            f"{1e3 * scan_time(*world, pose):.2f}",
            f"{1e3 * picture_time(*world):.1f}",
        )
    console.print(table)

    grid = maps["cave"]
    pose = roomiest(grid)
    ways = {
        "empty world": with_car(plain_world(OccupancyGrid(np.zeros((1, 1)), 0.05), body=False, sleep=False), pose),
        "static child body": with_car(plain_world(grid, body=True, sleep=False), pose),
        "static child body, sleep": with_car(plain_world(grid, body=True, sleep=True), pose),
        "world body": with_car(plain_world(grid, body=False, sleep=False), pose),
        "world body, sleep": with_car(plain_world(grid, body=False, sleep=True), pose),
        "world body, sleep, floor apart": with_car(plain_world(grid, body=False, sleep=True, ground=True), pose),
        "build_world": with_car(build_world(grid), pose),
    }
    times = step_times(ways)
    table = Table(title="The cave's walls put in different ways")
    for column in ("boxes in the", "step [us]", "step / empty", "picture [ms]"):
        table.add_column(column, justify="left" if column == "boxes in the" else "right")
    for name, time in times.items():
        picture = picture_time(*ways[name])
        table.add_row(name, f"{1e6 * time:.1f}", f"{time / times['empty world']:.2f}", f"{1e3 * picture:.1f}")
    console.print(table)


if __name__ == "__main__":
    main()
