"""Utomo 2015, Figs 4.12-4.17: an occupancy grid map of the 16 x 16 m world, drawn by a laser of 205 degrees on the way across it.

The thesis drives in Player/Stage from (-8, 8) to (8, -8), guided by A*, with an ideal sensor; here start and goal keep clear of
the walls, the car is a physics run, its laser has noise, and its pose is known, as the thesis assumes for mapping.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.core import SE2, Array, Belief, OccupancyGrid
from robocar.episode.result import RunResult
from robocar.estimation.mapping.mapping import OccupancyMapper
from robocar.formats.thesis_picture import save_thesis_picture, thesis_picture
from robocar.recording import read_observations
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

SCENARIO = "thesis-rooms"
STAGES = {
    "first scan (Fig. 4.12)": 0.0,
    "on the way (Fig. 4.13)": 0.33,
    "so far (Fig. 4.14)": 0.67,
    "at the finish (Fig. 4.15)": 1.0,
}
F1_TARGET = 0.98
METRICS = ("f1", "precision", "recall", "accuracy", "iou", "unknown", "path_blocked", "around_f1", "around_unknown", "explored")


def redrawn(result: RunResult, shares: list[float]) -> list[OccupancyGrid]:
    """The map as it was at these shares of the run, drawn again from the recording's sensor data and the poses of the run."""
    assert result.recording is not None
    seen = [observation for observation, _ in read_observations(result.recording)]
    stops = [round(share * (len(seen) - 1)) for share in shares]
    mapper = OccupancyMapper(True, False, RobotModel.load().footprint.inscribed_radius)
    grids = []
    for k, (observation, pose) in enumerate(zip(seen, result.estimate.poses, strict=True)):
        mapper.update(Belief(SE2(*map(float, pose))), observation)
        grid = mapper.grid() if k in stops else None
        if grid is not None:
            grids.append(grid)
    return grids


def main(out: Path, quick: bool = False) -> None:
    """Runs, the table and the thesis' pictures."""
    seeds = range(1 if quick else 5)
    jobs = [
        {"scenario": SCENARIO, "navigator": "a-star", "estimator": "truth", "mapper": "laser", "seed": seed, "out": out / "runs"}
        | {"record": seed == 0, "force": True}
        for seed in seeds
    ]
    results = run_many(jobs)
    report = Report(out, "Occupancy grid map of the thesis' simulated world (Figs 4.12-4.17)")
    rows = []
    for name in METRICS:
        values = [float(v) for r in results if (v := r.value(f"map/{name}")) is not None]
        report.number(f"map/{name}", float(np.mean(values)) if values else None, "1")
        rows.append(
            (name, float(np.mean(values)), float(np.min(values)), float(np.max(values))) if values else (name, None, None, None)
        )
    reached = sum(r.success for r in results)
    report.number("success_rate", reached / len(results), "1", 1.0)
    report.number("map/f1_worst", min(float(r.value("map/f1") or 0.0) for r in results), "1")
    report.table(
        ("map metric", "mean", "least", "most"),
        rows,
        f"{len(results)} seeds, {reached} reached the finish. Over the cells that came into the laser's view; `around_*` over "
        f"all in sight of the way, also behind the car. Target: F1 of at least {F1_TARGET}, no cell of the way drawn as occupied "
        "(`path_blocked` 0).",
    )
    report.say(
        "The thesis prints pictures, no numbers. Its finding, that what lies off the way stays unseen (black in Fig. 4.15), is "
        "the share `explored` of the reachable floor: one drive across is no exploration."
    )
    grids = redrawn(results[0], list(STAGES.values()))
    _picture(out / "stages.png", grids, results[0])
    _close_up(out / "cells.png", grids[-1], results[0].truth.poses)
    exported = save_thesis_picture(grids[-1], out / "map.pgm")
    report.say(f"Pictures: `stages.png` (Figs 4.12-4.15), `cells.png` (Figs 4.16, 4.17); the map itself: `{exported.name}`.")
    report.write()


def _picture(path: Path, grids: list[OccupancyGrid], result: RunResult) -> None:
    """Four stages in the thesis' colours: black unknown, green seen free, white occupied."""
    scene = Scene.load(load_scenario(SCENARIO), RobotModel.load().footprint)
    corners = scene.grid.corners()
    figure, axes = plt.subplots(1, len(grids), figsize=(4.3 * len(grids), 4.6), layout="constrained")
    for axis, grid, (title, share) in zip(axes.flat, grids, STAGES.items(), strict=True):
        axis.imshow(_colors(grid), extent=_extent(grid))
        way = result.truth.poses[: max(1, round(share * len(result.truth.poses)))]
        axis.plot(*way[:, :2].T, color="tab:red", lw=1.2)
        axis.plot(*way[-1, :2], "o", color="tab:red", ms=4)
        axis.set(
            title=title, aspect="equal", facecolor="black", xlim=(corners[:, 0].min() - 0.3, corners[:, 0].max() + 0.3),
            ylim=(corners[:, 1].min() - 0.3, corners[:, 1].max() + 0.3), xlabel="x [m]",
        )  # fmt: skip
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _close_up(path: Path, grid: OccupancyGrid, way: Array) -> None:
    """Values of single cells, 0, 64 and 255, around a place where all three occur."""
    levels = thesis_picture(grid)
    rows, cols = levels.shape
    size = 14
    best, at = -1, (0, 0)
    for row in range(0, rows - size, 4):
        for col in range(0, cols - size, 4):
            counts = [np.count_nonzero(levels[row : row + size, col : col + size] == level) for level in (0, 64, 255)]
            if min(counts) > best:
                best, at = min(counts), (row, col)
    part = levels[at[0] : at[0] + size, at[1] : at[1] + size]
    figure, axis = plt.subplots(figsize=(7, 7), layout="constrained")
    axis.imshow(part, cmap="gray", vmin=0, vmax=255)
    for (row, col), level in np.ndenumerate(part):
        axis.text(col, row, str(level), ha="center", va="center", fontsize=7, color="black" if level > 128 else "white")
    axis.set(title="Values of cells (Figs 4.16, 4.17)", xticks=[], yticks=[])
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _colors(grid: OccupancyGrid) -> Array:
    """RGB of the thesis: unknown black, seen free green of 64, occupied white, (rows, cols, 3) in [0, 1]."""
    levels = thesis_picture(grid)
    white = levels == 255
    return np.stack([np.where(white, 1.0, 0.0), levels / 255.0 * np.where(white, 1.0, 2.0), np.where(white, 1.0, 0.0)], axis=-1)


def _extent(grid: OccupancyGrid) -> tuple[float, float, float, float]:
    width, height = grid.size
    return grid.origin.x, grid.origin.x + width, grid.origin.y, grid.origin.y + height


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
