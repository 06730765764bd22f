"""Harmonic navigation in physics, against A* and safe-direction on the same worlds: way, clearance and smoothness.

`harmonic` follows the streamline of the potential, `harmonic-local` heads down its gradient at every tick, `a-star` follows the
shortest path on the inflated costs; these share costmap and pure pursuit. `safe-direction` knows no map and drives by its sensors
alone. Each drives every shipped scenario that has a goal, with the scenario's own estimator. Beside the runs, the first plans of
both planners are compared on the prior map.
"""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

from robocar.core import OCCUPIED, SE2, Array, Costmap, OccupancyGrid
from robocar.core.distance import ClearanceField
from robocar.episode.result import RunResult
from robocar.planners.costmap.layered import CostmapParameters, inflate
from robocar.planners.harmonic.laplace import laplace_problem, solve
from robocar.planners.harmonic.planner import Harmonic
from robocar.planners.harmonic.streamline import streamline
from robocar.planners.search.a_star import AStar
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario, scenario_names
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

FOOTPRINT = RobotModel.load().footprint

NAVIGATORS = {"harmonic": "tab:green", "harmonic-local": "tab:purple", "a-star": "tab:blue", "safe-direction": "tab:red"}
STYLES = {"harmonic-local": "--", "safe-direction": ":"}
PLANNERS = {"harmonic": Harmonic, "a-star": AStar}
QUICK = ("doors", "narrow-gap", "thesis-field")
SAMPLING = 0.01  # [m] along planned paths
FINER = 4
METRICS = {
    "path_length": "m",
    "min_clearance": "m",
    "mean_clearance": "m",
    "angle_over_length": "rad/m",
    "jerk_rms": "m/s^3",
    "duration": "s",
}


def path_clearance(points: Array, grid: OccupancyGrid) -> Array:
    """Distance of a path to the nearest obstacle of a map, walls all around it included.

    Args:
        points: (n, 2) [m].

    Returns:
        (k,) [m], at points `SAMPLING` apart along the path, so that the mean weighs every stretch by its length.
    """
    walled = OccupancyGrid(
        np.pad(grid.data, 1, constant_values=OCCUPIED),
        grid.resolution,
        grid.origin @ SE2(-grid.resolution, -grid.resolution),
    )
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, way[-1], math.ceil(way[-1] / SAMPLING) + 1)
    sampled = np.stack([np.interp(at, way, points[:, k]) for k in range(2)], axis=1)
    return ClearanceField(walled, walled.occupied).points(sampled)


def on_finer_cells(costmap: Costmap, start: Array, goal: Array, times: int) -> Array:
    """The streamline with every cell of the costmap cut into `times` x `times`, (n, 2) [m]."""
    blocked = np.kron(costmap.blocked, np.ones((times, times), dtype=bool))
    first, last = (costmap.grid_from_world(point) * times for point in (start, goal))
    potential = solve(laplace_problem(blocked, np.floor(last[::-1]).astype(int)))
    return costmap.origin.transform(streamline(potential, first) * (costmap.resolution / times))


def main(out: Path, quick: bool = False) -> None:
    """Runs, tables and the pictures of the ways driven."""
    seeds = range(2 if quick else 20)
    scenes = {name: Scene.load(load_scenario(name), FOOTPRINT) for name in (QUICK if quick else scenario_names())}
    scenes = {name: scene for name, scene in scenes.items() if scene.goal is not None}
    cases = [(scenario, navigator) for scenario in scenes for navigator in NAVIGATORS]
    jobs = [
        {"scenario": s, "navigator": n, "seed": k, "out": out / "runs", "record": k == 0, "force": True}
        for s, n in cases
        for k in seeds
    ]
    results = run_many(jobs)
    grouped = {case: results[k * len(seeds) : (k + 1) * len(seeds)] for k, case in enumerate(cases)}
    report = Report(out, "Harmonic navigation in physics, beside A*")
    _runs(report, grouped, len(seeds))
    _plans(report, scenes)
    report.say(
        "`safe-direction` has no map: where it has to search, it may fail. Seed 0 of every case is recorded in `runs`; "
        "`trajectories.png` shows all seeds over each other."
    )
    report.write()
    _picture(out / "trajectories.png", grouped, scenes)


def _runs(report: Report, grouped: dict[tuple[str, str], list[RunResult]], seeds: int) -> None:
    rows = []
    for (scenario, navigator), runs in grouped.items():
        reached = [r for r in runs if r.success]
        contacts = sum(int(r.value("contacts") or 0) for r in runs)
        means = {name: _mean(reached, name) for name in METRICS}
        tag = f"{scenario}/{navigator}"
        report.number(f"{tag}/success_rate", len(reached) / len(runs), "1")
        report.number(f"{tag}/contacts", contacts, "1")
        for name, unit in METRICS.items():
            report.number(f"{tag}/{name}", means[name], unit)
        rows.append((scenario, navigator, f"{len(reached)}/{len(runs)}", contacts, *means.values()))
    for navigator in NAVIGATORS:
        runs = [r for (_, n), group in grouped.items() if n == navigator for r in group]
        report.number(f"all/{navigator}/success_rate", sum(r.success for r in runs) / len(runs), "1")
        report.number(f"all/{navigator}/contacts", sum(int(r.value("contacts") or 0) for r in runs), "1")
        report.number(f"all/{navigator}/plan_time_max", max(float(r.value("plan_time_max") or 0.0) for r in runs), "s")
    report.table(
        ("scenario", "navigator", "reached", "contacts", "way [m]", "min clearance [m]", "mean clearance [m]",
         "turning [rad/m]", "jerk [m/s³]", "time [s]"),
        rows,
        f"{seeds} seeds each; means over the runs that reached the goal. Clearance is the outline's, over time.",
    )  # fmt: skip


def _plans(report: Report, scenes: dict[str, Scene]) -> None:
    rows = []
    nearer = []
    larger = 0
    for name, scene in scenes.items():
        if scene.prior is None:
            continue
        assert scene.goal is not None
        costmap = inflate(scene.prior, FOOTPRINT.inscribed_radius, CostmapParameters())
        row: dict[str, tuple[float, float, float]] = {}
        for planner, make in PLANNERS.items():
            points = make().plan(costmap, scene.start.position, scene.goal.position).path.points
            clearance = path_clearance(points, scene.prior)
            length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            row[planner] = length, float(clearance.min()), float(clearance.mean())
            for what, value in zip(("length", "min_clearance", "mean_clearance"), row[planner], strict=True):
                report.number(f"{name}/plan/{planner}/{what}", value, "m")
        larger += row["harmonic"][2] > row["a-star"][2]
        if row["harmonic"][2] <= row["a-star"][2]:
            finer = on_finer_cells(costmap, scene.start.position, scene.goal.position, FINER)
            limit = float(path_clearance(finer, scene.prior).mean())
            report.number(f"{name}/plan/harmonic/mean_clearance_finer", limit, "m")
            nearer.append(
                f"On {name}, with cells cut into {FINER} x {FINER}, the streamline's mean is {limit:.3f} m: it is the potential "
                "that rounds the bends of a lane inside its middle line, not the grid."
            )
        rows.append((name, *(f"{row['harmonic'][k]:.3f} / {row['a-star'][k]:.3f}" for k in range(3))))
    report.number("all/plans_with_larger_mean_clearance", larger / len(rows) if rows else None, "1", 1.0)
    report.table(
        ("scenario", "length [m]", "min clearance [m]", "mean clearance [m]"),
        rows,
        "First plans on the prior map, harmonic / A*. Clearance is the path's, to the obstacles of that map; its mean is larger "
        f"for harmonic on {larger} of {len(rows)}.",
    )
    for line in nearer:
        report.say(line)


def _mean(results: list[RunResult], name: str) -> float | None:
    values = [value for r in results if (value := r.value(name)) is not None]
    return float(np.mean(values)) if values else None


def _picture(path: Path, grouped: dict[tuple[str, str], list[RunResult]], scenes: dict[str, Scene]) -> None:
    columns = min(4, len(scenes))
    rows = math.ceil(len(scenes) / columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.2 * columns, 3.8 * rows), layout="constrained", squeeze=False)
    for axis in axes.flat[len(scenes) :]:
        axis.set_axis_off()
    for axis, (name, scene) in zip(axes.flat, scenes.items(), strict=False):
        _draw_world(axis, scene)
        for navigator, color in NAVIGATORS.items():
            for k, result in enumerate(grouped[name, navigator]):
                style = {"color": color, "ls": STYLES.get(navigator, "-"), "lw": 0.9, "alpha": 0.6}
                axis.plot(*result.truth.poses[:, :2].T, **style, label=None if k else navigator)
        axis.set_title(name, fontsize=10)
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(NAVIGATORS), frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_world(axis: Axes, scene: Scene) -> None:
    grid = scene.grid
    image = axis.imshow(
        np.where(grid.occupied, 0.35, 1.0), cmap="gray", vmin=0, vmax=1, origin="lower", extent=(0, grid.size[0], 0, grid.size[1])
    )
    image.set_transform(Affine2D().rotate(grid.origin.theta).translate(grid.origin.x, grid.origin.y) + axis.transData)
    for solid in scene.solids:
        axis.fill(*solid.outline().T, color="tab:red", alpha=0.5)
    corners = grid.corners()
    axis.plot(*np.vstack([corners, corners[:1]]).T, color="black", lw=2)
    assert scene.goal is not None
    axis.plot(scene.start.x, scene.start.y, "o", color="black", ms=5)
    axis.plot(*scene.goal.position, "*", color="tab:orange", ms=12)
    low, high = corners.min(axis=0) - 0.05, corners.max(axis=0) + 0.05
    axis.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
