"""What a control tick of the controllers costs, and random trees against OMPL's in the same run.

`python -m robocar.benchmarks.bench_controllers` (part of `make bench`). Times are medians of many calls, and the shortest,
which a busy machine disturbs least. OMPL's world of circles and its queries are read from `$ROBOCAR_DATA/references`; without
them, or without OMPL, that table is left out and says so.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path as FilePath
from time import perf_counter

import numpy as np
from rich.console import Console

from robocar.benchmarks.bench_planners import CAR, PERIOD, table
from robocar.core import SE2, Belief, Drive, Goal, Observation, OccupancyGrid, Path, Scan, State
from robocar.core.rays import cast_rays
from robocar.planners.controllers.dwa import DynamicWindow
from robocar.planners.controllers.mppi import MPPI
from robocar.planners.costmap.layered import CostmapParameters, inflate
from robocar.planners.costmap.rolling import RollingCostmap
from robocar.planners.sampling.random_trees import TreeObstacles
from robocar.planners.sampling.rrt import RrtParameters, circle_world, path_cost, search

STEP = 10.0  # of both planners; it has no unit there


def world(rng: np.random.Generator) -> OccupancyGrid:
    """6 x 6 m on 5 cm cells with 24 posts, none on the way along the middle."""
    data = np.zeros((120, 120), dtype=np.int8)
    for _ in range(24):
        row, col = rng.integers(5, 115, 2)
        if abs(row - 60) > 8:
            data[row - 2 : row + 3, col - 2 : col + 3] = 100
    return OccupancyGrid(data, 0.05, SE2(-3.0, -3.0))


def timed(call: Callable[[int], object], count: int) -> tuple[float, float]:
    """Median and shortest time of a call [s]."""
    times = []
    for k in range(count):
        begin = perf_counter()
        call(k)
        times.append(perf_counter() - begin)
    return float(np.median(times)), float(np.min(times))


def controllers(console: Console, count: int) -> None:
    """Cycles on a 6 x 6 m costmap, driving along its middle between posts."""
    grid = world(np.random.default_rng(0))
    costmap = inflate(grid, CAR.footprint.inscribed_radius, CostmapParameters(walled=False))
    path, goal = Path(np.column_stack([np.arange(-2.5, 2.51, 0.05), np.zeros(101)])), Goal(np.array([2.5, 0.0]))
    planners = {
        "DWA, 20 x 40 samples, 2 s": (DynamicWindow(CAR, PERIOD, inflation=CostmapParameters()), "1.0"),
        "MPPI, 1000 x 30": (MPPI(CAR, PERIOD, np.random.default_rng(0), inflation=CostmapParameters()), "10"),
    }
    rows = []
    for name, (planner, target) in planners.items():
        state = [SE2(-2.5, 0.0, 0.0)]

        def tick(k: int, planner: DynamicWindow | MPPI = planner, state: list[SE2] = state) -> None:
            command = planner.command(State.of(Belief(state[0])), path, costmap, Observation(k * PERIOD), goal)
            if isinstance(command, Drive):
                state[0] = state[0] @ command.twist.step(PERIOD)
            if state[0].x > 1.5:
                state[0] = SE2(-2.5, 0.0, 0.0)

        median, least = timed(tick, count)
        rows.append([name, f"{median * 1e3:.2f}", f"{least * 1e3:.2f}", target])
    local, fan = RollingCostmap(None, CAR), np.radians(np.linspace(-102.5, 102.5, 570))
    rng, scans = np.random.default_rng(1), []
    for k in range(count):
        pose = SE2(-1.0 + 2.0 * k / count, 0.0, 0.3 * math.sin(k / 10))
        ranges = cast_rays(grid, grid.occupied, pose.position, pose.theta + fan, 5.6) + 0.01 * rng.standard_normal(570)
        scans.append((pose, Observation(0.0, lidar=Scan(0.0, ranges, fan, 5.6))))
    median, least = timed(lambda k: local.update(*scans[k]), count)
    rows.append(["local costmap update, 570 beams, 6 x 6 m", f"{median * 1e3:.2f}", f"{least * 1e3:.2f}", "1.0"])
    table(console, "A tick of the controllers [ms]", ["what", "median", "shortest", "target"], rows)


def references() -> tuple[TreeObstacles, list[tuple[np.ndarray, np.ndarray]]] | None:
    """OMPL's circles and queries, None where they are not."""
    default = FilePath(__file__).resolve().parents[2] / "shared" / "data"
    folder = FilePath(os.environ.get("ROBOCAR_DATA") or default) / "references"
    if not folder.is_dir():
        return None
    lines = (folder / "circle_obstacles.txt").read_text().splitlines()[2:]
    circles = [[float(word) for word in line.split()[1:4]] for line in lines if line.strip()]
    words = [line.split() for line in (folder / "circle_queries.txt").read_text().splitlines() if line.strip()]
    ends = [np.array([float(word[2]), float(word[3])]) for word in words]
    return circle_world(circles, (2.0, -4.6), (66.0, 62.0)), list(zip(ends[::2], ends[1::2], strict=True))


def against_ompl(console: Console) -> None:
    """The same queries in turns; OMPL's states are checked by a Python function, as its bindings have it."""
    found = references()
    if found is None:
        console.print("OMPL's circle world is not there: set ROBOCAR_DATA")
        return
    try:
        from ompl import base, geometric, util  # pyright: ignore[reportMissingImports]
    except ImportError:
        console.print("OMPL is not installed: pip install ompl")
        return
    util.setLogLevel(util.LOG_ERROR)
    util.RNG.setSeed(1)
    obstacles, queries = found
    circles = obstacles.circles
    space = base.RealVectorStateSpace(2)
    bounds = base.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(obstacles.bounds[axis]))
        bounds.setHigh(axis, float(obstacles.bounds[2 + axis]))
    space.setBounds(bounds)
    xs, ys, squared = circles[:, 0], circles[:, 1], circles[:, 2] ** 2

    def valid(state) -> bool:
        return bool(np.all((xs - state[0]) ** 2 + (ys - state[1]) ** 2 >= squared))

    rows = []
    for name, variant, theirs in (("RRT", "rrt", geometric.RRT), ("RRT-Connect", "rrt-connect", geometric.RRTConnect)):
        p = RrtParameters(variant=variant, step=STEP, goal_tolerance=1.0, max_samples=100_000, shortcuts=0, adaptive_step=False)
        search(obstacles, *queries[0], p, np.random.default_rng(0))  # compiled
        times, lengths = [], []
        for k, (start, goal) in enumerate(queries):
            setup = geometric.SimpleSetup(space)
            setup.setStateValidityChecker(valid)
            planner = theirs(setup.getSpaceInformation())
            planner.setRange(STEP)
            setup.setPlanner(planner)
            a, b = space.allocState(), space.allocState()
            for axis in range(2):
                a[axis], b[axis] = float(start[axis]), float(goal[axis])  # pyright: ignore[reportIndexIssue]
            setup.setStartAndGoalStates(a, b, 1.0 if variant == "rrt" else 1e-6)
            begin = perf_counter()
            solved = setup.solve(20.0)
            middle = perf_counter()
            path = search(obstacles, start, goal, p, np.random.default_rng(k)).path
            end = perf_counter()
            if solved and len(path):
                times.append((end - middle, middle - begin))
                lengths.append((path_cost(obstacles, path), setup.getSolutionPath().length()))
        ours, other = np.median(times, axis=0) * 1e3
        ratio = float(np.sum(np.array(times)[:, 0]) / np.sum(np.array(times)[:, 1]))
        mine, their = np.mean(lengths, axis=0)
        rows.append(
            [name, f"{len(times)}/{len(queries)}", f"{ours:.2f}", f"{other:.2f}", f"{ratio:.3f}", f"{mine:.1f}", f"{their:.1f}"]
        )
    columns = ["planner", "solved by both", "ours [ms]", "OMPL [ms]", "sum of ours / OMPL's", "length", "OMPL's"]
    table(console, "Random trees on OMPL's circle world (target: at most 3 times OMPL's time)", columns, rows)


def rrt_star(console: Console) -> None:
    """How long 20 000 samples of RRT* take."""
    found = references()
    if found is None:
        return
    obstacles, queries = found
    p = RrtParameters(variant="rrt-star", step=5.0, max_samples=20_000, shortcuts=0)
    times = []
    for start, goal in queries[:5]:
        begin = perf_counter()
        search(obstacles, start, goal, p, np.random.default_rng(0))
        times.append(perf_counter() - begin)
    console.print(f"RRT*, 20 000 samples on OMPL's circle world: {np.median(times):.2f} s")


def main(count: int = 300) -> None:
    """Prints the tables; `count` ticks each."""
    console = Console(width=140)
    controllers(console, count)
    against_ompl(console)
    rrt_star(console)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
