"""Figures of the Operative Critical Point Bug (Das, Dutta and Debnath, IJEECS 18(3), 2020).

7 and 8: open points and sub-goals of scans without noise, checked against the world's corners. 9: a mover that crosses. 10: one
that comes head-on. 11: the safety measure at a gap. 12: eight snapshots of a run among standing obstacles and a mover. The runs
are in physics, with noise.
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
from matplotlib.axes import Axes

from robocar.core import SE2, STOP, Array, Belief, Command, Context, Done, GiveUp, Goal, OccupancyGrid, State
from robocar.core.randomness import stream
from robocar.core.rays import cast_rays
from robocar.episode.registry import build
from robocar.episode.run import simulate
from robocar.experiments._bug_worlds import CIRCLE, ROBOT, circle, draw, grid, room, scene_of
from robocar.planners.bugs.ocpb.strategy import OperativeCriticalPointBug
from robocar.planners.bugs.open_points import OpenPoint, find_open_points
from robocar.planners.bugs.view import BugParameters
from robocar.planners.tracking.panorama import ScanPanorama
from robocar.reporting.report import Report

BEAMS, MAX_RANGE = 360, 6.0
BOXES = ((1.5, 1.5, 2.2, 2.0), (4.0, 1.0, 4.4, 2.8), (2.5, 3.6, 3.8, 4.2), (4.6, 4.4, 5.0, 4.8), (0.8, 3.2, 1.1, 4.6))


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What there is to draw of one scan."""

    time: float
    pose: SE2
    movers: tuple[SE2, ...]
    open_points: tuple[OpenPoint, ...]
    target: Array | None
    collisions: tuple[tuple[Array, Array, Array, float], ...]


def main(out: Path, quick: bool = False) -> None:
    """All figures and the numbers behind them."""
    out.mkdir(parents=True, exist_ok=True)
    report = Report(out, "Figures of the Operative Critical Point Bug")
    _scans(report, out, 100 if quick else 2000)
    open_room = grid(8.0, 6.0)
    keys = {"start": [1.5, 3.0, 0.0], "goal": [6.5, 3.0], "time_limit": 60.0}
    body = {"name": "mover", "box": [0.3, 0.3, 0.3], "speed": 0.3}
    crossing = room(out / "maps", "open", open_room, movers=[{**body, "waypoints": [[4.0, 0.8], [4.0, 5.4]]}], **keys)
    head_on = room(out / "maps", "open", open_room, movers=[{**body, "waypoints": [[7.2, 3.0], [0.6, 3.0]]}], **keys)
    gap = [{"box": [0.1, 2.0, 0.3], "pose": [4.0, y, 0.0]} for y in (3.0 + 1.2 + CIRCLE.radius, 3.0 - 1.2 - CIRCLE.radius)]
    safety = room(out / "maps", "open", open_room, unknown_obstacles=gap, **{**keys, "start": [1.5, 2.0, 0.0]})
    boxes = [(2.4, 1.6, 3.0, 3.4), (3.8, 3.4, 4.6, 4.0), (5.7, 1.4, 6.2, 2.4), (3.6, 0.8, 4.2, 1.4)]
    mixed = room(out / "maps", "mixed", grid(8.0, 6.0, boxes), movers=[{**body, "waypoints": [[5.15, 0.5], [5.15, 5.5]]}], **keys)
    figures = {"9_crossing": crossing, "10_head_on": head_on, "11_safety": safety, "12_snapshots": mixed}
    rows = []
    for name, scenario in figures.items():
        frames, status, least, length = _drive(scenario)
        rows.append((name, status, f"{frames[-1].time:.1f}", f"{length:.2f}", f"{least:.3f}"))
        report.number(f"{name}/reached", int(status == "reached"), "1")
        report.number(f"{name}/min_clearance", least, "m")
        report.number(f"{name}/path_length", length, "m")
        _snapshots(out / f"figure_{name}.png", scenario, frames)
    report.table(("figure", "end", "time [s]", "way [m]", "least clearance [m]"), rows, "Runs of Figures 9 to 12.")
    report.write()


def _scans(report: Report, out: Path, count: int) -> None:
    """Figures 7 and 8, and how well open points match corners."""
    rng, p = np.random.default_rng(0), BugParameters()
    errors, strict, along, placed = [], [], [], []
    while len(errors) < count:
        boxes = BOXES if not errors else _boxes(rng)  # another world each time
        world, corners = grid(6.0, 6.0, boxes), np.array([(x, y) for x0, y0, x1, y1 in boxes for x in (x0, x1) for y in (y0, y1)])
        for x, y in rng.uniform(0.3, 5.7, (20, 2)):
            if any(x0 - 0.3 < x < x1 + 0.3 and y0 - 0.3 < y < y1 + 0.3 for x0, y0, x1, y1 in boxes):
                continue
            seen = _look(world, SE2(x, y, rng.uniform(-math.pi, math.pi)))
            ends = seen.origin + seen.ranges[:, None] * np.stack([np.cos(seen.bearings), np.sin(seen.bearings)], axis=1)
            for point in find_open_points(seen, p.range_jump, p.range_std):
                if point.sure:
                    last, before = np.argsort(np.remainder(point.side * (point.bearing - seen.bearings), math.tau))[:2]
                    errors.append(float(np.linalg.norm(corners - point.position, axis=1).min()))
                    strict.append(max(0.05, point.range * seen.spacing))
                    along.append(max(0.05, math.dist(ends[last], ends[before])))
                    placed.append(max(point.before, point.beyond) <= strict[-1])
    error, located = np.array(errors), np.array(placed)
    across, surface = np.mean(error <= strict), np.mean(error <= along)
    report.number("open_points", len(errors), "1")
    report.number("within_beam_spacing_across", float(across), "1", 0.99)
    report.number("within_beam_spacing_on_surface", float(surface), "1", 0.99)
    report.number("located", float(located.mean()), "1")
    report.number("located_within_beam_spacing_across", float(np.mean((error <= strict)[located])), "1", 0.99)
    report.number("median_error", float(np.median(error)), "m")
    report.say(
        f"{len(errors)} open points of scans without noise, from random places in random worlds of boxes. Tolerance: 5 cm or one "
        "spacing of the beams (range times angle), whichever is larger. Where the end lies, between what one beam hits and the "
        f"next would, is no more than that to either side of the point in {located.mean():.1%} of cases; of these "
        f"{np.mean((error <= strict)[located]):.1%} lie within it of a visible corner. Of all, {across:.1%}: on a wall seen at a "
        "grazing angle the beams lie farther apart, and do not tell where between two of them it ends; "
        f"{surface:.1%} lie within 5 cm or one spacing of the beams on that surface. Median error {np.median(error):.3f} m."
    )
    world = grid(6.0, 6.0, BOXES)
    figure, axes = plt.subplots(1, 2, figsize=(10, 5), layout="constrained")
    for axis, pose in zip(axes, (SE2(3.2, 2.6, 0.0), SE2(1.4, 2.6, 0.0)), strict=True):
        seen = _look(world, pose)
        axis.imshow(np.where(world.occupied, 0.6, 1.0), cmap="gray", vmin=0, vmax=1, origin="lower", extent=(0, 6, 0, 6))
        axis.plot(*seen.hits().T, ".", color="black", ms=2)
        axis.plot(*pose.position, "o", color="tab:blue")
        axis.plot(*circle(pose.position, CIRCLE.radius).T, color="tab:blue", lw=1)
        for point in find_open_points(seen, p.range_jump, p.range_std):
            target = point.subgoal(CIRCLE.radius)
            axis.plot(*np.array([pose.position, point.position]).T, color="gray", lw=0.5)
            axis.plot(*point.position, "o", color="tab:red" if point.sure else "tab:orange", ms=4)
            axis.plot(*np.array([point.position, target]).T, color="tab:green", lw=1)
            axis.plot(*circle(target, CIRCLE.radius).T, color="tab:green", lw=0.7)
        axis.set(aspect="equal", xticks=[], yticks=[])
    figure.suptitle("Open points (red; orange: not sure) and sub-goals (green)")
    figure.savefig(out / "figure_7_8.png", dpi=110)
    plt.close(figure)


def _boxes(rng: np.random.Generator) -> tuple[tuple[float, float, float, float], ...]:
    """Five boxes that keep 0.6 m from each other and from the walls, their corners on the grid's [m]."""
    boxes: list[tuple[float, float, float, float]] = []
    while len(boxes) < 5:
        x0, y0 = np.round(rng.uniform(0.6, 5.0, 2) / 0.05) * 0.05
        x1, y1 = np.round((np.array([x0, y0]) + rng.uniform(0.1, 1.5, 2)) / 0.05) * 0.05
        apart = all(max(x0 - b[2], b[0] - x1, y0 - b[3], b[1] - y1) >= 0.6 for b in boxes)
        if max(x1, y1) <= 5.4 and apart:
            boxes.append((float(x0), float(y0), float(x1), float(y1)))
    return tuple(boxes)


def _look(world: OccupancyGrid, pose: SE2) -> ScanPanorama:
    """A scan without noise."""
    bearings = pose.theta + np.linspace(-math.pi, math.pi, BEAMS, endpoint=False)
    ranges = cast_rays(world, world.occupied, pose.position, bearings, MAX_RANGE)
    return ScanPanorama(0.0, pose.position, bearings, np.where(ranges > MAX_RANGE, np.inf, ranges), MAX_RANGE, math.tau / BEAMS)


def _drive(scenario: dict[str, Any], seed: int = 0) -> tuple[list[Frame], str, float, float]:
    """A run on the true pose: frames, how it ended, the least clearance and the length of the way [m]."""
    world = simulate(scenario, seed=seed, settings=ROBOT)
    context = Context(world.robot.robot, None, None, (), {}, stream(seed, "navigator/ocpb"), world.control_period)
    navigator = build("navigator", "ocpb", context)
    strategy = navigator.controller.strategy
    assert isinstance(strategy, OperativeCriticalPointBug)
    goal, frames, status, least = Goal(np.array(scenario["goal"])), [], "timeout", math.inf
    command: Command = STOP
    while world.time < scenario["time_limit"]:
        observation, truth = world.robot.sense(), world.ground_truth()
        least = min(least, truth.clearance)
        command = navigator.command(State.of(Belief(truth.pose)), observation, goal)
        frames.append(
            Frame(
                truth.time,
                truth.pose,
                tuple(truth.movers.values()),
                tuple(strategy.open_points),
                strategy.leg.target if strategy.leg is not None else None,
                tuple((c.point, c.start, c.end, c.obstacle.radius) for c in strategy.collisions),
            )
        )
        if truth.contact or goal.reached(truth.pose) or isinstance(command, GiveUp | Done):
            status = "contact" if truth.contact else "reached" if goal.reached(truth.pose) else "given up"
            break
        world.robot.act(command)
        world.step()
    world.close()
    way = np.array([frame.pose.position for frame in frames])
    return frames, status, least, float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def _snapshots(path: Path, scenario: dict[str, Any], frames: list[Frame]) -> None:
    """Eight moments of a run; d_min in red, the way in black, virtual obstacles in orange."""
    scene = scene_of(scenario)
    figure, axes = plt.subplots(2, 4, figsize=(16, 6.4), layout="constrained")
    way = np.array([frame.pose.position for frame in frames])
    for axis, k in zip(axes.flat, np.linspace(0, len(frames) - 1, 8).astype(int), strict=True):
        _snapshot(axis, frames[k], way[: k + 1], np.array(scenario["goal"]))
        draw(axis, scene)
        for solid in scene.solids:
            axis.fill(*solid.outline().T, color="tab:green", alpha=0.6)
        for mover, pose in zip(scene.movers, frames[k].movers, strict=True):
            axis.fill(*mover.outline(pose).T, color="gray")
        axis.set_title(f"{frames[k].time:.1f} s", fontsize=9)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _snapshot(axis: Axes, frame: Frame, way: Array, goal: Array) -> None:
    position = frame.pose.position
    axis.plot(*way.T, color="black", lw=1.2, zorder=3)
    axis.plot(*np.array([position, goal]).T, color="tab:red", lw=0.8, zorder=3)
    axis.plot(*circle(position, CIRCLE.radius).T, color="tab:blue", lw=1.2, zorder=3)
    for point in frame.open_points:
        axis.plot(*point.position, "o", color="tab:red", ms=2.5, zorder=3)
    if frame.target is not None:
        axis.plot(*frame.target, "x", color="tab:purple", ms=7, zorder=3)
    for point, start, end, radius in frame.collisions:
        axis.plot(*point, "P", color="red", ms=6, zorder=3)
        for centre in (start, end):
            axis.plot(*circle(centre, radius).T, color="tab:orange", lw=1, zorder=3)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
