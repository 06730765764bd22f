"""Parked 5 to 80 mm beside a wall, a corner or a box: does every navigator get away?

A pose counts where physics allows a way out: one of many random manoeuvres of up to four arcs and turns, tried blindly with the
exact outline, ends with room to turn and keeps 3 mm off everything. Which one that is, no navigator is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import distance_transform_edt, label

from robocar.core import LETHAL, SE2, Array, Costmap, OccupancyGrid
from robocar.episode.algorithms import NAVIGATORS
from robocar.episode.result import RunResult
from robocar.experiments._bug_worlds import grid, room
from robocar.planners.geometry.surfaces import clearance, surfaces
from robocar.planners.geometry.surfaces import room as room_at
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.sim.robot_model import RobotModel

POSES, FIRST_SEED = 28, 2000
GAPS = (0.005, 0.08)  # [m]
KEPT = 0.003  # [m] by the manoeuvre that shows that there is a way out
FOOTPRINT = RobotModel.load().footprint
OUTLINE = np.array(FOOTPRINT.vertices)
TURNING = FOOTPRINT.circumscribed_radius + 0.005  # [m] room to turn
WIDTH, HEIGHT = 4.5, 3.5  # [m]


@dataclass(frozen=True)
class Parked:
    """A world (occupied cells of 5 cm), where the car stands in it, its gap to the nearest surface [m], and a goal [m]."""

    world: OccupancyGrid
    start: SE2
    gap: float
    goal: tuple[float, float]


def main(out: Path, quick: bool = False) -> None:
    """How many of the poses every navigator leaves."""
    names = ("a-star", "a-star-dwa", "dynamic-a-star", "tangent-bug") if quick else tuple(NAVIGATORS)
    cases = [parked(FIRST_SEED + k) for k in range(2 if quick else POSES)]
    jobs = []
    for k, case in enumerate(cases):
        scenario = _scenario(out / "maps", k, case)
        jobs += [_job(scenario, name, FIRST_SEED + k) for name in names]
    results = run_many(jobs)
    report = Report(out, "Parked beside a wall")
    rows, notes = [], []
    for i, name in enumerate(names):
        runs = list(zip(cases, results[i :: len(names)], strict=True))
        away = [left(case, result) for case, result in runs]
        arrived = sum(result.success for _, result in runs)
        contacts = sum(result.status == "collision" for _, result in runs)
        least = min(float(result.value("min_clearance") or 0.0) for _, result in runs)
        for what, value in (("left", sum(away)), ("arrived", arrived), ("contacts", contacts), ("runs", len(runs))):
            report.number(f"{name}/{what}", value, "1")
        rows.append((name, f"{sum(away)}/{len(runs)}", f"{arrived}/{len(runs)}", contacts, f"{1000 * least:.1f}"))
        notes += [
            f"* {name}, pose {k} ({1000 * case.gap:.0f} mm, {case.start}): {result.status}: {result.reason}"
            for k, ((case, result), gone) in enumerate(zip(runs, away, strict=True))
            if not gone or result.status in ("collision", "error")
        ]
    report.table(
        ("navigator", "left", "arrived", "contacts", "least clearance [mm]"),
        rows,
        f"{len(cases)} random poses, {1000 * GAPS[0]:.0f} to {1000 * GAPS[1]:.0f} mm from a wall, a corner or a box. Left: "
        "without a contact it got to its goal, or to where it has room to turn, 0.3 m from where it stood. Arrived: at a goal "
        "at least 1.5 m away; bugs whose method does not find it, and explore, which has none, need not.",
    )
    for note in notes:
        report.say(note)
    report.write()
    figure, axis = plt.subplots(figsize=(5, 3), layout="constrained")
    gaps = [1000 * case.gap for case in cases for _ in names]
    axis.plot(gaps, [1000 * float(result.value("min_clearance") or 0.0) for result in results], ".", ms=4)
    axis.plot([0.0, 80.0], [0.0, 80.0], color="gray", ls=":")
    axis.set(xlabel="gap where it is parked [mm]", ylabel="least clearance of the run [mm]")
    figure.savefig(out / "parked.png", dpi=110)
    plt.close(figure)


def left(case: Parked, result: RunResult) -> bool:
    """Whether the car has got away from where it was parked, without a contact."""
    if result.status in ("collision", "error"):
        return False
    segments = _walls(case.world, case.start, 20.0)
    poses = result.truth.poses
    gone = np.hypot(poses[:, 0] - case.start.x, poses[:, 1] - case.start.y) > 0.3
    return result.success or any(room_at(segments, x, y) >= TURNING for x, y, _ in poses[gone][::5])


def parked(seed: int) -> Parked:
    """A room with three boxes; a pose beside one of them, beside a wall or in a corner, that there is a way out of; and a goal
    that there is a way to."""
    rng = np.random.default_rng(seed)
    while True:
        boxes = []
        for _ in range(3):
            x, y, w, h = rng.uniform(0.3, WIDTH - 0.9), rng.uniform(0.3, HEIGHT - 0.9), *rng.uniform(0.1, 0.7, 2)
            boxes.append((x, y, x + w, y + h))
        frame = [(0, 0, WIDTH, 0.05), (0, HEIGHT - 0.05, WIDTH, HEIGHT), (0, 0, 0.05, HEIGHT), (WIDTH - 0.05, 0, WIDTH, HEIGHT)]
        world = grid(WIDTH, HEIGHT, [*boxes, *frame])
        target = rng.uniform(*GAPS)
        start = _beside(world, rng, target)
        goal = None if start is None else _goal(world, rng, start)
        if start is not None and goal is not None and _way_out(world, start, rng):
            return Parked(world, start, target, goal)


def _walls(world: OccupancyGrid, pose: SE2, reach: float) -> Array:
    costs = np.where(world.occupied, np.uint8(LETHAL), np.uint8(0))
    return surfaces(Costmap(costs, world.resolution, world.origin), pose, reach)


def _beside(world: OccupancyGrid, rng: np.random.Generator, gap: float) -> SE2 | None:
    """A pose with this gap to the nearest surface, parallel to it every second time; None where none of some is."""
    segments = _walls(world, SE2(0.5 * WIDTH, 0.5 * HEIGHT), 20.0)
    for _ in range(300):
        x, y = rng.uniform(0.1, WIDTH - 0.1), rng.uniform(0.1, HEIGHT - 0.1)
        theta = rng.choice(4) * math.pi / 2 + (rng.normal(0.0, 0.05) if rng.random() < 0.5 else rng.uniform(-0.8, 0.8))
        way = rng.uniform(-math.pi, math.pi)
        if world.occupied[tuple(world.cell_from_world(np.array([x, y])))]:
            continue
        for _ in range(400):  # towards what lies that way, up to the gap
            apart = clearance(segments, x, y, theta, OUTLINE, 1.0)
            if abs(apart - gap) < 2e-4:
                return SE2(float(x), float(y), float(theta))
            if apart < gap:
                break
            x, y = x + (apart - gap) * math.cos(way), y + (apart - gap) * math.sin(way)
    return None


def _goal(world: OccupancyGrid, rng: np.random.Generator, start: SE2) -> tuple[float, float] | None:
    """A roomy point at least 1.5 m away that a disc with some room can get to from around the start; None where there is none."""
    free = np.asarray(distance_transform_edt(~world.occupied)) * world.resolution
    areas = np.asarray(label(free > 0.25)[0])  # type: ignore[index]
    cell = np.asarray(world.cell_from_world(start.position))
    row, col = int(cell[0]), int(cell[1])
    near = areas[max(0, row - 8) : row + 9, max(0, col - 8) : col + 9]
    rows, cols = np.nonzero((areas > 0) & (areas == near.max()))
    points = world.world_from_cell(np.stack([rows, cols], axis=1))
    points = points[np.hypot(*(points - start.position).T) >= 1.5]
    if len(points) == 0:
        return None
    x, y = points[rng.integers(len(points))]
    return float(x), float(y)


def _way_out(world: OccupancyGrid, start: SE2, rng: np.random.Generator) -> bool:
    """Whether one of many random manoeuvres leads to where there is room to turn."""
    segments = _walls(world, start, 2.0)
    for _ in range(500):
        pose = start
        for _ in range(rng.integers(1, 5)):
            length = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.5) * (rng.random() < 0.8)
            turn = rng.normal(0.0, 1.5) * abs(length) if length else rng.uniform(-0.8, 0.8)
            end = _driven(segments, pose, length, turn)
            if end is None:
                break
            pose = end
        if pose.distance_to(start) > 0.0 and room_at(segments, pose.x, pose.y) >= TURNING:
            return True
    return room_at(segments, start.x, start.y) >= TURNING


def _driven(segments: Array, pose: SE2, length: float, turn: float) -> SE2 | None:
    """The end of an arc; None where it comes nearer to something than `KEPT`."""
    n = max(2, math.ceil(abs(length) / 0.01), math.ceil(abs(turn) / 0.05))
    for _ in range(n):
        half = SE2(0.0, 0.0, 0.5 * turn / n)
        pose = pose @ half @ SE2(length / n, 0.0, 0.0) @ half
        if clearance(segments, pose.x, pose.y, pose.theta, OUTLINE, 2.0 * KEPT) < KEPT:
            return None
    return pose


def _scenario(folder: Path, k: int, case: Parked) -> dict[str, Any]:
    start = [case.start.x, case.start.y, case.start.theta]
    content = room(folder, f"parked_{k}", case.world, start=start, goal=list(case.goal), time_limit=120.0)
    return content | {"prior": "truth", "robot": {"lidar": "scan360"}}


def _job(scenario: dict[str, Any], name: str, seed: int) -> dict[str, Any]:
    mapper = {"mapper": "laser"} if name == "explore" else {}
    return {"scenario": scenario, "navigator": name, "estimator": "truth", "seed": seed, **mapper}


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
