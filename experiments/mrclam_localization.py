"""Real robots among 15 landmarks (MRCLAM, Leung et al. 2011): dead reckoning, Kalman filter and particle filter.

Position errors are causal (no smoothing), not aligned, against the interpolated ground truth at every line of odometry. The data
is not part of the project: every folder `mrclam*` in `$ROBOCAR_DATA`, else in `../shared/data`, with all of its robots.
"""

from __future__ import annotations

import os
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.core import LogFormatError
from robocar.episode.replay import replay
from robocar.episode.result import RunResult
from robocar.formats.mrclam import is_mrclam, robots
from robocar.reporting.report import Report


def logs(subject: int | None = None) -> list[tuple[Path, int]]:
    """Folders and numbers of the robots in them.

    Args:
        subject: only the robots of this number.

    Raises:
        LogFormatError: there are none.
    """
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    data = Path(os.environ.get("ROBOCAR_DATA") or default)
    found = [(folder, robot) for folder in sorted(data.glob("mrclam*")) if is_mrclam(folder) for robot in robots(folder)]
    chosen = [(folder, robot) for folder, robot in found if subject in (None, robot)]
    if not found:
        raise LogFormatError(f"{data}: no MRCLAM folder mrclam*; set ROBOCAR_DATA to the folder that holds them")
    if not chosen:
        present = ", ".join(f"{robot} ({folder.name})" for folder, robot in found)
        raise LogFormatError(f"{data}: there is no robot {subject}; its robots are {present}")
    return chosen


def main(out: Path, quick: bool = False, subject: int | None = None) -> None:
    """Replays, a table and a picture for each robot."""
    report = Report(out, "MRCLAM: localization of real robots")
    rows = []
    errors: dict[str, list[float]] = {}
    for folder, robot in logs(subject):
        place = f"{folder.name}-robot-{robot}"
        runs = _runs(folder, robot, out / "runs", range(1 if quick else 5))
        for name, results in runs.items():
            off = [value for r in results if (value := r.value("position_rmse")) is not None]
            headings = [value for r in results if (value := r.value("heading_rmse")) is not None]
            errors.setdefault(name, []).append(float(np.mean(off)))
            tag = f"{place}/{name.replace(' ', '_')}"
            report.number(f"{tag}/position_rmse", float(np.mean(off)), "m")
            report.number(f"{tag}/position_rmse_max", max(off), "m")
            report.number(f"{tag}/heading_rmse", float(np.mean(headings)), "rad")
            numbers = (f"{np.mean(off):.3f}", f"{max(off):.3f}", f"{np.degrees(np.mean(headings)):.1f}")
            rows.append((place, name, len(results), *numbers))
        _picture(out / f"trajectories-{place}.png", runs)
    for name, values in errors.items():
        tag = name.replace(" ", "_")
        report.number(f"all/{tag}/position_rmse", float(np.mean(values)), "m")
        report.number(f"all/{tag}/position_rmse_max", max(values), "m")
        rows.append(("all", name, "", f"{np.mean(values):.3f}", f"{max(values):.3f}", ""))
    report.table(
        ("robot", "estimator", "seeds", "position RMSE [m]", "worst seed [m]", "heading RMSE [°]"),
        rows,
        "Default parameters. `all`: mean over the robots, and the worst of them.",
    )
    report.write()


def _runs(folder: Path, robot: int, out: Path, seeds: range) -> dict[str, list[RunResult]]:
    """The replays of one robot's log."""
    return {
        "dead reckoning": [replay(folder, estimator="odometry", subject=robot, out=out, force=True)],
        "ekf": [replay(folder, estimator="ekf", subject=robot, out=out, force=True)],
        "particle-filter": [
            replay(folder, estimator="particle-filter", subject=robot, seed=seed, out=out, record=seed == 0, force=True)
            for seed in seeds
        ],
    }


def _picture(path: Path, runs: dict[str, list[RunResult]]) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    truth = runs["ekf"][0].truth
    axes[0].plot(*truth.poses[:, :2].T, color="black", lw=1.5, label="truth")
    for name, results in runs.items():
        result = results[0]
        if name != "dead reckoning":
            axes[0].plot(*result.estimate.poses[:, :2].T, lw=0.8, label=name)
        true = np.stack([np.interp(result.estimate.times, truth.times, truth.poses[:, k]) for k in (0, 1)], axis=1)
        off = np.linalg.norm(result.estimate.poses[:, :2] - true, axis=1)
        axes[1].plot(result.estimate.times - truth.times[0], off, lw=0.8, label=name)
    axes[0].set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes[1].set(xlabel="time [s]", ylabel="position error [m]", ylim=(0, 1.5))
    for axis in axes:
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
