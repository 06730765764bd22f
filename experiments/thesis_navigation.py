"""Utomo 2015, Figs 4.4-4.8 and Table 4.8: Dynamic A* on the field, among obstacles that the car does not know.

Four ways of sensing: a car that turns 360 degrees in each cell to see all sides (the thesis') and one with sonars on its
sides, each with its pose from above (the thesis' top camera, here the pose oracle), from the encoders alone, and from
encoders and compass. Table 4.8 asks, cell by cell along the path, how many cells the car is off where it believes to be.
"""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from robocar.core import SE2, Array
from robocar.episode.result import RunResult
from robocar.planners.search.car_lattice import CarLattice
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

SCENARIO = "thesis-field"
CELL = 0.30
THESIS_CELL_ERRORS = (0, 0, 1, 1, 1)  # Table 4.8
SENSING = {"spin": {"robot.sonars": "front"}, "side sonars": {"robot.sonars": "front+sides"}}
POSES = {"truth": {}, "odometry": {}, "odometry-compass": {"robot.compass": True}}


def cell_errors(result: RunResult, lattice: CarLattice) -> list[int]:
    """For each cell that the car believed to have reached the middle of: how many cells away it truly was.

    Eight-connected cells: the larger of the differences in rows and columns.
    """
    errors = []
    last = None
    for believed, true in zip(result.estimate.poses, result.truth.poses, strict=True):
        x, y = lattice.origin.inverse_apply(float(believed[0]), float(believed[1]))
        cell = math.floor(y / CELL), math.floor(x / CELL)
        middle = lattice.centre(cell)
        if cell == last or math.dist(middle, believed[:2]) > 0.03:
            continue
        last = cell
        x, y = lattice.origin.inverse_apply(float(true[0]), float(true[1]))
        errors.append(max(abs(math.floor(y / CELL) - cell[0]), abs(math.floor(x / CELL) - cell[1])))
    return errors


def main(out: Path, quick: bool = False) -> None:
    """Runs, tables and the pictures of the paths."""
    seeds = range(2 if quick else 10)
    report = Report(out, "Dynamic A* on the thesis' field (Figs 4.4-4.8, Table 4.8)")
    cases = [(sensing, pose) for sensing in SENSING for pose in POSES]
    jobs = [
        {
            "scenario": SCENARIO,
            "navigator": "dynamic-a-star",
            "estimator": pose,
            "seed": seed,
            "settings": SENSING[sensing] | POSES[pose],
            "out": out / "runs",
            "record": seed == 0,
            "force": True,
        }
        for sensing, pose in cases
        for seed in seeds
    ]
    results = run_many(jobs)
    grouped = {case: results[k * len(seeds) : (k + 1) * len(seeds)] for k, case in enumerate(cases)}
    scene = Scene.load(load_scenario(SCENARIO), RobotModel.load().footprint)
    assert scene.goal is not None
    lattice = CarLattice(CELL, scene.prior, scene.start, scene.goal.position)

    rows, cells = [], []
    for (sensing, pose), runs in grouped.items():
        reached = [r for r in runs if r.success]
        errors = [cell_errors(r, lattice) for r in runs]
        longest = max(map(len, errors))
        by_cell = [max((e[k] for e in errors if k < len(e)), default=0) for k in range(longest)]
        off = float(np.mean([e > 0 for run in errors for e in run]))
        tag = f"{sensing.replace(' ', '_')}/{pose}"
        values = {name: _mean(reached, name) for name in ("duration", "path_length", "replans", "min_clearance", "position_rmse")}
        report.number(f"{tag}/success_rate", len(reached) / len(runs), "1", 1.0 if (sensing, pose) == ("spin", "truth") else None)
        for name, unit in (
            ("duration", "s"),
            ("path_length", "m"),
            ("replans", "1"),
            ("min_clearance", "m"),
            ("position_rmse", "m"),
        ):
            report.number(f"{tag}/{name}", values[name], unit)
        report.number(f"{tag}/cells_off_max", max(by_cell), "1", max(THESIS_CELL_ERRORS) if pose == "odometry" else None)
        report.number(f"{tag}/cells_off_share", off, "1")
        contacts = sum(int(r.value("contacts") or 0) for r in runs)
        report.number(f"{tag}/contacts", contacts, "1", None)
        rows.append(
            (
                sensing,
                pose,
                f"{len(reached)}/{len(runs)}",
                contacts,
                *(None if values[n] is None else f"{values[n]:.1f}" for n in ("duration", "path_length", "replans")),
                None if values["position_rmse"] is None else f"{100 * values['position_rmse']:.1f}",
            )
        )
        cells.append((sensing, pose, " ".join(map(str, by_cell)), f"{100 * off:.1f}"))
    report.table(
        ("sensing", "pose from", "reached", "contacts", "time [s]", "path [m]", "replans", "position RMSE [cm]"),
        rows,
        f"{len(seeds)} seeds each; means over the runs that reached the goal. The thesis: every one of 10 runs finds it.",
    )
    report.table(
        ("sensing", "pose from", "cells off, cell by cell, worst of all runs", "share of cells off [%]"),
        cells,
        f"Table 4.8 (the thesis: {', '.join(map(str, THESIS_CELL_ERRORS))} cells off along its path).",
    )
    report.write()
    _picture(out / "paths.png", grouped, scene)


def _mean(results: list[RunResult], name: str) -> float | None:
    values = [value for r in results if (value := r.value(name)) is not None]
    return float(np.mean(values)) if values else None


def _picture(path: Path, grouped: dict[tuple[str, str], list[RunResult]], scene: Scene) -> None:
    figure, axes = plt.subplots(len(SENSING), len(POSES), figsize=(4.2 * len(POSES), 3.4 * len(SENSING)), layout="constrained")
    for axis, ((sensing, pose), runs) in zip(axes.flat, grouped.items(), strict=True):
        _draw_world(axis, scene)
        for result in runs:
            axis.plot(*result.truth.poses[:, :2].T, lw=1, color="tab:green" if result.success else "tab:red")
        axis.set_title(f"{sensing}, pose: {pose}", fontsize=9)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _draw_world(axis: Axes, scene: Scene) -> None:
    grid = scene.grid
    extent = (0, grid.size[0], 0, grid.size[1])
    image = axis.imshow(np.where(grid.occupied, 0.35, 1.0), cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent)
    image.set_transform(_placed(grid.origin) + axis.transData)
    for solid in scene.solids:
        axis.fill(*_closed(solid.outline()).T, color="tab:red", alpha=0.5)
    corners = grid.corners()
    axis.plot(*_closed(corners).T, color="black", lw=2)
    assert scene.goal is not None
    axis.plot(scene.start.x, scene.start.y, "o", color="tab:blue")
    axis.plot(*scene.goal.position, "*", color="tab:orange", ms=12)
    axis.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")


def _placed(origin: SE2):
    from matplotlib.transforms import Affine2D

    return Affine2D().rotate(origin.theta).translate(origin.x, origin.y)


def _closed(points: Array) -> Array:
    return np.vstack([points, points[:1]])


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
