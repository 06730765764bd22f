"""Grid planners against what people use from Python today, and what replanning and following cost.

Every comparison runs in turns within one process, so that a busy machine slows both sides; times are the shortest of several runs
of a query, then the median over queries. `python -m robocar.benchmarks.bench_planners` (part of `make bench`).
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
from rich.console import Console
from rich.table import Table

from robocar.core import (
    SE2,
    Belief,
    Calibration,
    Costmap,
    Footprint,
    Goal,
    Limits,
    NoPathFound,
    Observation,
    OccupancyGrid,
    Robot,
    Scan,
    State,
)
from robocar.core.rays import cast_rays
from robocar.formats.generated import cave, maze, rooms
from robocar.formats.load import load_map
from robocar.planners.controllers.pure_pursuit import PurePursuit
from robocar.planners.costmap.layered import CostmapParameters, LayeredCostmap, inflate
from robocar.planners.navigators.plan_and_follow import PlanAndFollow
from robocar.planners.search.a_star import AStar
from robocar.planners.search.d_star_lite import DStarLite
from robocar.planners.search.theta_star import ThetaStar

CAR = Robot(
    Footprint.rectangle(front=0.11, rear=0.10, half_width=0.09),
    Limits(min_vel_x=-0.2, max_vel_x=0.4, max_vel_theta=1.5, acc_lim_x=1.0, acc_lim_theta=6.0),
    Calibration(0.042, np.array([0.0]), np.array([0.4])),
    200,
)
PERIOD = 0.05
INFLATION = CostmapParameters(walled=False)


def maps(size: int) -> dict[str, OccupancyGrid]:
    """Generated maps, and those of `$ROBOCAR_DATA/movingai` where present."""
    rng = np.random.default_rng(0)
    chosen = {
        "cave": cave(size, size, rng),
        "maze, corridor 3": maze(size, size, 3, rng),
        "maze, corridor 9": maze(size, size, 9, rng),
        "rooms": rooms(size, size, rng),
    }
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    for path in sorted((Path(os.environ.get("ROBOCAR_DATA") or default) / "movingai").glob("*.map")):
        chosen[path.stem] = load_map(path, 0.05)
    return chosen


def queries(costmap: Costmap, count: int, rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs of random free cells (row, col) with a way between them."""
    cells = np.argwhere(~costmap.blocked)
    planner, found = AStar(), []
    while len(found) < count:
        a, b = cells[rng.integers(len(cells), size=2)]
        if planner.search(costmap, (a[0], a[1]), (b[0], b[1])).cells is not None:
            found.append((a, b))
    return found


def shortest(calls: dict[str, Callable[[], object]], repeats: int = 3) -> dict[str, float]:
    """Shortest time of each call [s], measured in turns."""
    times = dict.fromkeys(calls, np.inf)
    for _ in range(repeats):
        for name, call in calls.items():
            start = perf_counter()
            call()
            times[name] = min(times[name], perf_counter() - start)
    return times


def table(console: Console, title: str, columns: list[str], rows: list[list[str]]) -> None:
    shown = Table(title=title)
    for k, column in enumerate(columns):
        shown.add_column(column, justify="right" if k else "left")
    for row in rows:
        shown.add_row(*row)
    console.print(shown)


def against_tcod(console: Console, worlds: dict[str, OccupancyGrid], count: int) -> None:
    """Median times of the same queries; tcod's planners cut corners, which ours do not."""
    import tcod.path  # pyright: ignore[reportMissingImports]

    planner, theta, rows, ratios = AStar(), ThetaStar(), [], []
    for name, world in worlds.items():
        costmap = Costmap(np.where(world.occupied, 254, 0), world.resolution)
        weights = world.free.astype(np.int8)
        times = []
        for a, b in queries(costmap, count, np.random.default_rng(1)):
            start, goal = costmap.world_from_cell([a, b])

            def pathfinder(a: np.ndarray = a, b: np.ndarray = b, weights: np.ndarray = weights) -> object:
                search = tcod.path.Pathfinder(tcod.path.SimpleGraph(cost=weights, cardinal=70, diagonal=99))
                search.add_root(tuple(a))
                return search.path_to(tuple(b))

            def old(a: np.ndarray = a, b: np.ndarray = b, weights: np.ndarray = weights) -> object:
                return tcod.path.AStar(weights, 1.41).get_path(*a.tolist(), *b.tolist())

            def ours(start: np.ndarray = start, goal: np.ndarray = goal, costmap: Costmap = costmap) -> object:
                return planner.plan(costmap, start, goal)

            def any_angle(start: np.ndarray = start, goal: np.ndarray = goal, costmap: Costmap = costmap) -> object:
                return theta.plan(costmap, start, goal)

            found = shortest({"a": ours, "p": pathfinder, "o": old})
            times.append([found["a"], found["p"], found["o"], shortest({"t": any_angle}, 1)["t"]])
        medians = np.median(times, axis=0) * 1e3
        ratio = np.median(np.array(times)[:, :1] / np.array(times)[:, 1:3], axis=0)
        ratios.append(ratio)
        rows.append([f"{name} {world.shape[0]} x {world.shape[1]}", *(f"{v:.2f}" for v in (*medians, *ratio))])
    rows.append(["median of the maps", "", "", "", "", *(f"{v:.2f}" for v in np.median(ratios, axis=0))])
    columns = ["map", "A* [ms]", "tcod Pathfinder", "tcod AStar", "Theta*", "A* / Pathfinder", "A* / tcod AStar"]
    table(console, f"A* and tcod's C pathfinders, {count} queries a map (target: at most 0.40)", columns, rows)


def against_python(console: Console, count: int) -> None:
    """Pure-Python planners on small maps, where they finish."""
    import python_motion_planning as pmp  # pyright: ignore[reportMissingImports]
    from pathfinding.core.grid import Grid  # pyright: ignore[reportMissingImports]
    from pathfinding.finder.a_star import AStarFinder  # pyright: ignore[reportMissingImports]

    planner, rows = AStar(), []
    rng = np.random.default_rng(0)
    for name, world in {
        "cave": cave(200, 200, rng),
        "maze, corridor 3": maze(200, 200, 3, rng),
        "rooms": rooms(200, 200, rng),
    }.items():
        costmap = Costmap(np.where(world.occupied, 254, 0), world.resolution)
        times = []
        for a, b in queries(costmap, count, rng):
            start, goal = costmap.world_from_cell([a, b])
            grid = Grid(matrix=world.free.astype(int).tolist())
            cells = pmp.Grid(bounds=[[0, world.shape[0]], [0, world.shape[1]]], type_map=world.occupied.astype(np.int8))
            other = pmp.AStar(map_=cells, start=tuple(a.tolist()), goal=tuple(b.tolist()))

            def pathfinding(grid: Grid = grid, a: np.ndarray = a, b: np.ndarray = b) -> object:
                grid.cleanup()
                ends = grid.node(int(a[1]), int(a[0])), grid.node(int(b[1]), int(b[0]))
                return AStarFinder(diagonal_movement=4).find_path(*ends, grid)

            def ours(start: np.ndarray = start, goal: np.ndarray = goal, costmap: Costmap = costmap) -> object:
                return planner.plan(costmap, start, goal)

            found = shortest({"a": ours, "m": other.plan, "f": pathfinding}, 2)
            times.append([found[key] for key in "amf"])
        medians = np.median(times, axis=0) * 1e3
        ratio = np.median(np.array(times)[:, 1:] / np.array(times)[:, :1], axis=0)
        rows.append([f"{name} 200 x 200", *(f"{v:.3f}" for v in medians), *(f"{v:.0f}" for v in ratio)])
    columns = ["map", "A* [ms]", "python-motion-planning", "pathfinding", "p-m-p / A*", "pathfinding / A*"]
    table(console, f"A* and Python planners, {count} queries a map (target: at least 100 times faster)", columns, rows)


def replanning(console: Console, worlds: dict[str, OccupancyGrid], count: int) -> None:
    """An obstacle of 1 to 20 cells appears within 30 cells ahead on the path; raw maps, and maps inflated for the car."""
    rows, a_star = [], AStar()
    for name, world in worlds.items():
        for robot in (False, True):
            radius = CAR.footprint.inscribed_radius if robot else 0.0
            spread = INFLATION if robot else CostmapParameters(walled=False, inflation_radius=0.0, margin=0.0)
            before = inflate(world, radius, spread)
            if before.blocked.mean() > 0.999 or np.count_nonzero(~before.blocked) < 1000:
                continue
            d_star, rng = DStarLite(), np.random.default_rng(2)
            times, work, inflating = [], [], []
            for a, b in queries(before, count, rng):
                start, goal = before.world_from_cell([a, b])
                path = d_star.plan(before, start, goal)
                if len(path.path.points) < 40:
                    continue
                occupied = world.data.copy()
                row, col = before.cell_from_world(path.path.points[int(rng.integers(6, 30))])
                height, width = (int(v) for v in rng.integers(1, 5, 2))
                occupied[row : row + height, col : col + width] = 100
                begin = perf_counter()
                after = inflate(OccupancyGrid(occupied, world.resolution, world.origin), radius, spread)
                inflating.append(perf_counter() - begin)
                if after.blocked[tuple(a)] or after.blocked[tuple(b)]:
                    continue
                try:
                    repair, repaired = np.inf, path
                    for _ in range(3):  # seen, gone, seen again
                        d_star.plan(before, start, goal)
                        begin = perf_counter()
                        repaired = d_star.plan(after, start, goal)
                        repair = min(repair, perf_counter() - begin)
                except NoPathFound:
                    continue
                scratch = a_star.plan(after, start, goal)
                if repaired.cost != scratch.cost:
                    raise AssertionError(f"D* Lite found {repaired.cost}, A* {scratch.cost}")
                if repaired.cost <= 2.0 * path.cost:
                    searching = shortest({"a": lambda s=start, g=goal, m=after: a_star.plan(m, s, g)})["a"]
                    times.append([repair, searching, repair / searching])
                    mine, theirs = (plan.work["expansions"] for plan in (repaired, scratch))
                    work.append([mine, theirs, mine / theirs])
            if not times:
                continue
            t, w = np.median(times, axis=0), np.median(work, axis=0)
            rows.append([
                name, "car" if robot else "point", str(len(times)), f"{t[0] * 1e3:.2f}", f"{t[1] * 1e3:.2f}", f"{t[2]:.2f}",
                f"{w[0]:.0f}", f"{w[1]:.0f}", f"{w[2]:.3f}", f"{np.median(inflating) * 1e3:.1f}",
            ])  # fmt: skip
    columns = ["map", "robot", "n", "D* Lite [ms]", "A* [ms]", "ratio", "expanded D*", "A*", "ratio", "inflate all [ms]"]
    table(
        console,
        "Replanning around an obstacle ahead (targets: 2 ms, 1/20), medians where the detour is below twice the way",
        columns,
        rows,
    )


def footprints(console: Console) -> None:
    """Memory a cell and the first call after import."""
    n = 512
    costmap = Costmap(np.zeros((n, n)), 0.05)
    ends = np.array([0.1, 0.1]), np.array([25.0, 25.0])
    rows = []
    for module, planner in (
        ("a_star.AStar", AStar()),
        ("d_star_lite.DStarLite", DStarLite()),
        ("theta_star.ThetaStar", ThetaStar()),
    ):
        planner.plan(costmap, *ends)
        parts: list[object] = [planner, getattr(planner, "_a_star", None)]
        arrays = {id(v): v for part in parts if part is not None for v in vars(part).values() if isinstance(v, np.ndarray)}
        for v in getattr(planner, "_search", ()):
            arrays[id(v)] = v
        size = sum(v.nbytes for v in arrays.values()) / n**2
        name, cls = module.split(".")
        code = (
            f"from robocar.planners.search.{name} import {cls}; import numpy as np, time; from robocar.core import Costmap; "
            "t = time.perf_counter(); "
            f"{cls}().plan(Costmap(np.zeros((99, 99)), 1.0), np.array([1.0, 1.0]), np.array([90.0, 9.0])); "
            "print(time.perf_counter() - t)"
        )
        first = min(float(subprocess.check_output([sys.executable, "-c", code])) for _ in range(2))
        rows.append([cls, f"{size:.1f}", f"{first:.2f}"])
    title = "Memory kept between plans (512 x 512; target 64), first call after import (target 1 s)"
    table(console, title, ["planner", "bytes a cell", "first call [s]"], rows)


def following(console: Console) -> None:
    """What a control tick costs without physics."""
    world = rooms(200, 200, np.random.default_rng(0))
    costmap = LayeredCostmap(world, CAR)
    cells = np.argwhere(~inflate(world, CAR.footprint.circumscribed_radius).blocked)
    start, goal = world.world_from_cell(cells[[0, -1]])
    pursuit = PurePursuit(CAR, PERIOD)
    navigator = PlanAndFollow(AStar(), pursuit, costmap)
    pose, target = SE2(start[0], start[1]), Goal(goal)
    mounts = SE2(0.1, 0.05, 0.2), SE2(0.1, -0.05, -0.2)
    beam, fan = np.radians(15.0), np.radians(np.linspace(-102.5, 102.5, 570))
    ticks, marks, scans, commands = [], [], [], []
    for tick in range(600):
        sonars = []
        for mount in mounts:
            at = pose @ mount
            rays = cast_rays(world, world.occupied, at.position, at.theta + np.linspace(-beam / 2, beam / 2, 5), 4.0)
            sonars.append(Scan(tick * PERIOD, np.array([rays.min()]), np.zeros(1), 4.0, beam, mount))
        lidar = Scan(tick * PERIOD, cast_rays(world, world.occupied, pose.position, pose.theta + fan, 5.6), fan, 5.6)
        seen, view = Observation(tick * PERIOD, sonars=tuple(sonars)), Observation(tick * PERIOD, lidar=lidar)
        begin = perf_counter()
        command = navigator.command(State.of(Belief(pose)), seen, target)
        end = perf_counter()
        if tick > 0:  # the first tick plans
            ticks.append(end - begin)
        for observation, list_ in ((seen, marks), (view, scans)):
            begin = perf_counter()
            costmap.update(pose, observation)
            list_.append(perf_counter() - begin)
        current, path = costmap.costmap(), navigator._path
        other = PurePursuit.__new__(PurePursuit)
        other.__dict__.update(pursuit.__dict__)
        begin = perf_counter()
        other.command(State.of(Belief(pose)), path, current, seen, target)
        commands.append(perf_counter() - begin)
        pose = pose @ command.twist.step(PERIOD)  # type: ignore[union-attr]
    rows = [
        [name, f"{np.median(times) * 1e6:.0f}", f"{np.min(times) * 1e6:.0f}", target_]
        for name, times, target_ in (
            ("navigator tick, 2 sonars, no replanning", ticks, "150"),
            ("costmap update, 2 sonars", marks, "150"),
            ("costmap update, 570 beams", scans, "1000"),
            ("pure pursuit command", commands, "60"),
        )
    ]
    table(console, "A control tick [us]", ["what", "median", "shortest", "target"], rows)


def main() -> None:
    """Prints all tables."""
    parser = argparse.ArgumentParser(description="Grid planners against their peers.")
    parser.add_argument("--cells", type=int, default=512, help="rows and columns of the generated maps (default 512)")
    parser.add_argument("--queries", type=int, default=30, help="random queries a map (default 30)")
    arguments = parser.parse_args()
    console = Console(width=150)
    console.print(f"{platform.machine()}, {os.cpu_count()} CPUs, Python {platform.python_version()}")
    worlds = maps(arguments.cells)
    against_tcod(console, worlds, arguments.queries)
    against_python(console, max(3, arguments.queries // 6))
    replanning(console, worlds, arguments.queries)
    footprints(console)
    following(console)


if __name__ == "__main__":
    main()
