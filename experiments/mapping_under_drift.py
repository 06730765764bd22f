"""What an error of the pose does to the map: the same drives mapped with the true pose, with odometry, and with localization.

On the field the car turns on the spot in each cell, which is hard on odometry, and maps by its sonars or by a laser; the particle
filter sees the corner balls. Across the rooms, where there are no balls, a compass is the help. Every drive is mapped by the
poses that it was driven by.
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
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many

FIELD_POSES = ("truth", "odometry", "odometry-compass", "particle-filter")
SENSING: dict[str, tuple[str, dict[str, object]]] = {
    "sonars": ("sonar", {}),
    "laser": ("laser", {"robot.lidar": "hokuyo"}),
}
FIT_OUT: dict[str, dict[str, object]] = {
    "truth": {},
    "odometry": {},
    "odometry-compass": {"robot.compass": True},
    "particle-filter": {"robot.camera": True},
}


def jobs_of(seeds: range, out: Path) -> dict[tuple[str, str, str], list[dict[str, object]]]:
    """Runs by world, sensing and where the pose comes from."""
    jobs: dict[tuple[str, str, str], list[dict[str, object]]] = {}
    common = {"out": out / "runs", "force": True}
    for sensing, (mapper, settings) in SENSING.items():
        for pose in FIELD_POSES:
            chosen = settings | FIT_OUT[pose] | {"navigator.look_around": "always", "on_contact": "continue"}
            job = {"scenario": "thesis-field", "navigator": "dynamic-a-star", "estimator": pose, "mapper": mapper}
            jobs["field", sensing, pose] = [
                job | common | {"settings": chosen, "seed": seed, "record": seed == 0} for seed in seeds
            ]
    for pose in ("truth", "odometry", "odometry-compass"):
        job = {"scenario": "thesis-rooms", "navigator": "a-star", "estimator": pose, "mapper": "laser"}
        settings = FIT_OUT[pose] | {"on_contact": "continue"}
        jobs["rooms", "laser", pose] = [
            job | common | {"settings": settings, "seed": seed, "record": seed == 0} for seed in seeds
        ]
    return jobs


def main(out: Path, quick: bool = False) -> None:
    """Runs, the table and the maps side by side."""
    seeds = range(1 if quick else 5)
    jobs = jobs_of(seeds, out)
    flat = run_many([job for group in jobs.values() for job in group])
    grouped = {case: flat[k * len(seeds) : (k + 1) * len(seeds)] for k, case in enumerate(jobs)}
    report = Report(out, "What localization error does to the map")
    rows = []
    for (world, sensing, pose), runs in grouped.items():
        values = {
            "position_rmse": (_mean(runs, "position_rmse"), "m"),
            "heading_rmse": (_mean(runs, "heading_rmse"), "rad"),
            "f1": (_mean(runs, "map/f1"), "1"),
            "precision": (_mean(runs, "map/precision"), "1"),
            "recall": (_mean(runs, "map/recall"), "1"),
            "iou": (_mean(runs, "map/iou"), "1"),
        }
        for name, (value, unit) in values.items():
            report.number(f"{world}/{sensing}/{pose}/{name}", value, unit)
        reached = sum(run.success for run in runs)
        report.number(f"{world}/{sensing}/{pose}/success_rate", reached / len(runs), "1")
        numbers = [value for value, _ in values.values()]
        position, heading = numbers[0], numbers[1]
        rows.append(
            (
                world,
                sensing,
                pose,
                f"{reached}/{len(runs)}",
                None if position is None else f"{100 * position:.1f}",
                None if heading is None else f"{np.degrees(heading):.2f}",
                *(None if value is None else f"{value:.3f}" for value in numbers[2:]),
            )
        )
    report.table(
        ("world", "map from", "pose from", "reached", "position [cm]", "heading [deg]", "F1", "precision", "recall", "IoU"),
        rows,
        f"{len(seeds)} seeds each; errors are RMS over the run; F1, precision and recall with a tolerance of one cell of 5 cm, "
        "over the cells that came into view.",
    )
    report.say(_finding(report, grouped))
    report.write()
    _picture(out / "maps.png", grouped)


def _finding(report: Report, grouped: dict[tuple[str, str, str], list[RunResult]]) -> str:
    """The loss of F1 against the true pose, beside the position error that causes it."""
    parts = []
    for world, sensing, pose in grouped:
        f1, best = (report.numbers[f"{world}/{sensing}/{p}/f1"]["value"] for p in (pose, "truth"))
        error = report.numbers[f"{world}/{sensing}/{pose}/position_rmse"]["value"]
        if pose != "truth" and None not in (f1, best, error):
            parts.append(f"{world}, {sensing}, {pose}: {100 * error:.1f} cm, F1 {f1 - best:+.3f}")
    return "Change of F1 against the true pose: " + "; ".join(parts) + "."


def _mean(runs: list[RunResult], name: str) -> float | None:
    values = [float(v) for r in runs if (v := r.value(name)) is not None]
    return float(np.mean(values)) if values else None


def _picture(path: Path, grouped: dict[tuple[str, str, str], list[RunResult]]) -> None:
    """The map of the first seed of each case, with the true way in green and the believed one in blue."""
    columns = len(FIELD_POSES)
    figure, axes = plt.subplots(3, columns, figsize=(4.0 * columns, 10.0), layout="constrained")
    lines = {("field", "sonars"): 0, ("field", "laser"): 1, ("rooms", "laser"): 2}
    for axis in axes.flat:
        axis.set_axis_off()
    for (world, sensing, pose), runs in grouped.items():
        axis, run = axes[lines[world, sensing], FIELD_POSES.index(pose)], runs[0]
        axis.set_axis_on()
        if run.directory is not None and (run.directory / "map.yaml").is_file():
            grid = load_map(run.directory / "map.yaml")
            width, height = grid.size
            extent = (grid.origin.x, grid.origin.x + width, grid.origin.y, grid.origin.y + height)
            axis.imshow(_levels(grid), cmap="gray", vmin=0, vmax=255, extent=extent)
        axis.plot(*run.truth.poses[:, :2].T, color="tab:green", lw=1)
        axis.plot(*run.estimate.poses[:, :2].T, color="tab:blue", lw=1)
        axis.set_title(f"{world}, {sensing}, {pose}", fontsize=9)
        margin = 0.3
        low, high = ((-8, 8) if world == "rooms" else (0, 3.5)), ((-8, 8) if world == "rooms" else (0, 2.5))
        axis.set(
            xlim=(low[0] - margin, low[1] + margin), ylim=(high[0] - margin, high[1] + margin), aspect="equal", facecolor="0.59"
        )
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _levels(grid: OccupancyGrid) -> Array:
    return np.where(grid.occupied, 0.0, np.where(grid.free, 255.0, 150.0))[::-1]


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
