"""Utomo 2015, Table 4.9 and Fig. 4.18: what a car that hears only ahead maps on a straight drive, and what two remedies change.

The car drives ten cells of the field straight ahead, its pose known. The thesis finds that its side walls stay unknown, and
proposes turning on the spot in each cell, or sonars on both sides; a ring of sonars and a laser are there to compare.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.core import Array, OccupancyGrid
from robocar.episode.result import RunResult
from robocar.formats import load_map
from robocar.formats.thesis_picture import save_thesis_picture
from robocar.metrics.map import on_common_cells
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

WORLD = {"start": [0.25, 0.5, 0.0], "goal": [3.25, 0.5]}
POLICIES: dict[str, tuple[str, dict[str, object]]] = {
    "front sonars, straight": ("sonar", {"robot.sonars": "front", "navigator.look_around": "never"}),
    "front sonars, turning in each cell": ("sonar", {"robot.sonars": "front", "navigator.look_around": "always"}),
    "side sonars, straight": ("sonar", {"robot.sonars": "front+sides", "navigator.look_around": "never"}),
    "ring of 16 sonars, straight": ("sonar", {"robot.sonars": "ring", "navigator.look_around": "never"}),
    "laser, straight": ("laser", {"robot.sonars": "front", "robot.lidar": "hokuyo", "navigator.look_around": "never"}),
}


def side_walls(grid: OccupancyGrid, truth: OccupancyGrid) -> float:
    """Share of the two long walls' cells along the way that the map shows, to a cell: what the thesis misses in its Table 4.9."""
    common = on_common_cells(grid, truth)
    assert common is not None
    drawn, true = common
    x = np.arange(0.5, 3.0, drawn.resolution) + drawn.resolution / 2
    found = []
    for y, inwards in ((-0.025, 1), (2.525, -1)):
        cells = true.cell_from_world(np.stack([x, np.full(len(x), y)], axis=1))
        rows = cells[:, 0] + np.array([[-1], [0], [1]]) * inwards
        found.append(drawn.occupied[rows, cells[:, 1]].any(axis=0))
    return float(np.mean(found))


def main(out: Path, quick: bool = False) -> None:
    """Runs, the table and the maps side by side."""
    seeds = range(1 if quick else 5)
    scenario = load_scenario("thesis-field", WORLD | {"unknown_obstacles": []})
    truth = Scene.load(scenario, RobotModel.load().footprint).judged_map
    jobs = [
        {"scenario": scenario, "navigator": "dynamic-a-star", "estimator": "truth", "mapper": mapper, "seed": seed}
        | {"settings": settings, "out": out / "runs", "record": seed == 0, "force": True}
        for mapper, settings in POLICIES.values()
        for seed in seeds
    ]
    results = run_many(jobs)
    report = Report(out, "What the car can map (Table 4.9, Fig. 4.18)")
    rows, grids = [], {}
    for k, policy in enumerate(POLICIES):
        runs = results[k * len(seeds) : (k + 1) * len(seeds)]
        maps = [load_map(r.directory / "map.yaml") for r in runs if r.directory is not None]
        walls = float(np.mean([side_walls(grid, truth) for grid in maps]))
        values = {
            "map_f1": (_mean(runs, "map/around_f1"), "1"),
            "map_precision": (_mean(runs, "map/around_precision"), "1"),
            "unknown": (_mean(runs, "map/around_unknown"), "1"),
            "side_walls_found": (walls, "1"),
            "time": (_mean(runs, "duration"), "s"),
            "distance": (_mean(runs, "path_length"), "m"),
        }
        tag = _tag(policy)
        for name, (value, unit) in values.items():
            report.number(f"{tag}/{name}", value, unit)
        report.number(f"{tag}/success_rate", sum(r.success for r in runs) / len(runs), "1")
        rows.append((policy, *(None if value is None else f"{value:.3g}" for value, _ in values.values())))
        grids[policy] = maps[0]
        save_thesis_picture(maps[0], out / f"{tag.replace('/', '--')}.png")
    report.table(
        ("policy", "F1 of occupied cells", "precision", "share unknown", "side walls found", "time [s]", "distance [m]"),
        rows,
        f"{len(seeds)} seeds each, ten cells of 30 cm along y = 0.5 m; F1 and share unknown over all cells in sight of the way, "
        "whichever way the car looked.",
    )
    straight, *remedies = (100.0 * float(report.numbers[f"{_tag(p)}/side_walls_found"]["value"]) for p in POLICIES)
    report.say(
        f"The thesis' finding: driving straight with sonars ahead shows {straight:.0f} % of the side walls; its remedies show "
        f"{remedies[0]:.0f} % (turning in each cell) and {remedies[1]:.0f} % (side sonars); a ring {remedies[2]:.0f} %, a laser "
        f"{remedies[3]:.0f} %."
    )
    report.write()
    _picture(out / "maps.png", grids, results, len(seeds))


def _tag(policy: str) -> str:
    return policy.replace(", ", "/").replace(" ", "_")


def _mean(runs: list[RunResult], name: str) -> float | None:
    values = [float(v) for r in runs if (v := r.value(name)) is not None]
    return float(np.mean(values)) if values else None


def _picture(path: Path, grids: dict[str, OccupancyGrid], results: list[RunResult], per_policy: int) -> None:
    figure, axes = plt.subplots(1, len(grids), figsize=(4.0 * len(grids), 3.4), layout="constrained")
    for k, (axis, (policy, grid)) in enumerate(zip(axes.flat, grids.items(), strict=True)):
        width, height = grid.size
        extent = (grid.origin.x, grid.origin.x + width, grid.origin.y, grid.origin.y + height)
        axis.imshow(_levels(grid), cmap="gray", vmin=0, vmax=255, extent=extent)
        axis.plot(*results[k * per_policy].truth.poses[:, :2].T, color="tab:red", lw=1)
        axis.set(title=policy, xlim=(-0.3, 3.8), ylim=(-0.3, 2.8), facecolor="black", aspect="equal")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _levels(grid: OccupancyGrid) -> Array:
    """The thesis' grey levels, the free ones brighter so that they can be told on paper."""
    return np.where(grid.occupied, 255.0, np.where(grid.free, 110.0, 0.0))[::-1]


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
