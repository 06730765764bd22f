"""Utomo 2015, Tables 4.4 and 4.5: the particle filter with 200, 400 and 600 particles, at four points of the field.

In physics: every seed is a car with its own tyres that drives along the four points from a start that the filter does not know.
The thesis' simulation hears its distances to all landmarks (`ranges`); its robot knows four headings by pairs of colours
(`headings`, with the start told, as headings alone locate nothing); ours sees balls with bearing and range. Errors are taken
where the car passes the points after the filter has converged; as a share of the coordinate, as the thesis has it, which makes
small coordinates look bad, and of the field's sides and of 360 degrees.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import chi2

from robocar.core import Array, wrap_angles
from robocar.episode.run import run
from robocar.experiments._tours import FIELD, SCENARIO, WAY_POINTS, Heard, drive, listen
from robocar.metrics.localization import (
    after_convergence,
    converged_heading_rmse,
    converged_nees,
    converged_position_rmse,
    convergence_time,
)
from robocar.reporting.report import Report

PARTICLES = (200, 400, 600)
THESIS = {  # Table 4.4, as printed: % of x, y, theta; iterations; s
    200: (10.35, 26.98, 17.41, 118, 50),
    400: (3.41, 4.03, 65.79, 42, 86),
    600: (7.45, 15.5, 20.6, 37, 219),
}
THESIS_ROBOT = (4.7, 2.6, 10.8)  # Table 4.5
QUOTED = (
    "The thesis' means are quoted as printed, although they do not follow from its own rows (for 400 particles those give 6.1, "
    "45.9 and 14.9 %). `headings` is its robot's model (Table 4.5) and is told the start."
)


def _fixed(count: int) -> dict[str, int]:
    return {"min_particles": count, "max_particles": count}


CASES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    **{f"ranges, {n}": ("particle-filter", {"model": "ranges", **_fixed(n)}, {"seen": "ranges"}) for n in PARTICLES},
    "headings, 400": ("particle-filter", {"model": "headings", **_fixed(400)}, {"start_known": True}),
    **{f"bearing-range, {n}": ("particle-filter", _fixed(n), {}) for n in PARTICLES},
    "ekf": ("ekf", {}, {}),
}


def errors(heard: Heard) -> Array:
    """|x|, |y| [m], |theta| [rad] errors and the true x, y, theta, at the way points passed after convergence, (n, 6)."""
    tour = heard.tour
    known = after_convergence(tour.times, tour.truth, heard.estimate)
    rows = []
    for _, k in tour.passed:
        if known[k]:
            off = np.abs(heard.estimate[k] - tour.truth[k])
            off[2] = abs(float(wrap_angles(off[2])))
            rows.append(np.concatenate([off, tour.truth[k]]))
    return np.array(rows).reshape(-1, 6)


def shares(rows: Array) -> tuple[Array, Array]:
    """Mean errors in percent, of the sides and of 360 degrees, and of the coordinates (thesis), each (3,)."""
    if not len(rows):
        return np.full(3, np.nan), np.full(3, np.nan)
    of_field = 100 * rows[:, :3].mean(axis=0) / (*FIELD, math.tau)
    coordinates = np.abs(rows[:, 3:])
    coordinates[:, 2] = np.mod(rows[:, 5], math.tau)
    return of_field, 100 * (rows[:, :3] / np.maximum(coordinates, 1e-3)).mean(axis=0)


def iterations(heard: Heard) -> int | None:
    """Updates with sightings until the estimate has converged."""
    seconds = convergence_time(heard.tour.times, heard.tour.truth, heard.estimate)
    if seconds is None:
        return None
    return int(heard.updates[np.searchsorted(heard.tour.times, heard.tour.times[0] + seconds - 1e-9)])


def _one_seed(seed: int, duration: float) -> dict[str, Heard]:
    tour = drive(seed, duration=duration)
    return {name: listen(tour, estimator, parameters, **how) for name, (estimator, parameters, how) in CASES.items()}


def collect(seeds: range, duration: float) -> list[dict[str, Heard]]:
    """All cases over all seeds, in processes of their own."""
    workers = min(len(seeds), os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(_one_seed, seeds, [duration] * len(seeds)))


def main(out: Path, quick: bool = False) -> None:
    """Drives, tables and a picture."""
    seeds = range(2 if quick else 20)
    heard = collect(seeds, 30.0 if quick else 60.0)
    report = Report(out, "Localization on the thesis' field (Tables 4.4 and 4.5)")
    rows, targets = [], []
    for case in CASES:
        runs = [one[case] for one in heard]
        of_field, of_coordinate = shares(np.concatenate([errors(run) for run in runs]))
        needed = [n for run in runs if (n := iterations(run)) is not None]
        judged = [((run.tour.times, run.tour.truth, run.estimate), run.covariances) for run in runs]
        values = {
            "position_rmse": [converged_position_rmse(*poses) for poses, _ in judged],
            "heading_rmse": [converged_heading_rmse(*poses) for poses, _ in judged],
            "convergence_time": [convergence_time(*poses) for poses, _ in judged],
            "nees": [converged_nees(*poses, None, covariances) for poses, covariances in judged],
        }
        seconds = float(np.median([run.wall_time for run in runs]))
        kind, _, count = case.partition(", ")
        paper = THESIS.get(int(count)) if kind == "ranges" else (*THESIS_ROBOT, None, None) if kind == "headings" else None
        tag = case.replace(", ", "_")
        for k, name in enumerate(("x", "y", "theta")):
            report.number(f"{tag}/error_{name}_of_field", _number(of_field[k]), "%")
            report.number(f"{tag}/error_{name}_of_coordinate", _number(of_coordinate[k]), "%", paper[k] if paper else None)
        report.number(f"{tag}/iterations", _mean(needed), "1", paper[3] if paper else None)
        report.number(f"{tag}/filter_time", seconds, "s", paper[4] if paper else None)
        report.number(f"{tag}/converged", len(needed) / len(runs), "1")
        within = [t for t in values["convergence_time"] if t is not None and t <= 10.0]
        report.number(f"{tag}/converged_within_10_s", len(within) / len(runs), "1")
        report.number(f"{tag}/position_rmse", _mean(values["position_rmse"]), "m")
        report.number(f"{tag}/heading_rmse", _mean(values["heading_rmse"]), "rad")
        report.number(f"{tag}/nees", _mean(values["nees"]), "1")
        rows.append(
            (
                case,
                _triple(of_field),
                _triple(of_coordinate),
                "–" if paper is None else _triple(np.array(paper[:3], dtype=float)),
                f"{len(needed)}/{len(runs)}",
                _spread(needed, 1.0, ".0f"),
                "–" if paper is None or paper[3] is None else paper[3],
                f"{seconds:.2f}",
                "–" if paper is None or paper[4] is None else paper[4],
            )
        )
        targets.append(
            (
                case,
                f"{len(within)}/{len(runs)}",
                _spread(values["convergence_time"], 1.0, ".1f"),
                _spread(values["position_rmse"], 100.0, ".2f"),
                _spread(values["heading_rmse"], 180.0 / math.pi, ".2f"),
                _spread(values["nees"], 1.0, ".1f"),
            )
        )
    header = ("filter", "x, y, θ [% of field, 360°]", "x, y, θ [% of coordinate]", "thesis", "converged", "iterations", "thesis")
    report.table(
        (*header, "filter time [s]", "thesis"),
        rows,
        f"Mean errors at the way points {', '.join(WAY_POINTS)} over {len(seeds)} seeds; iterations: mean ± standard deviation. "
        + QUOTED,
    )
    low, high = chi2.ppf((0.025, 0.975), 3 * len(seeds)) / len(seeds)
    report.table(
        ("filter", "within 10 s", "convergence [s]", "position RMSE [cm]", "heading RMSE [°]", "NEES"),
        targets,
        "After convergence, mean ± standard deviation over seeds. "
        f"A consistent filter's mean NEES lies in {low:.2f} to {high:.2f}; less is careful, more is too sure.",
    )
    _claims(report, heard)
    report.write()
    _picture(out / "errors.png", heard)
    run(SCENARIO, seed=0, settings={"estimator.min_particles": 200, "estimator.max_particles": 200}, out=out / "runs", force=True)


def _claims(report: Report, heard: list[dict[str, Heard]]) -> None:
    """Fewer particles need more iterations, and more particles more time: do they?"""
    for kind in ("ranges", "bearing-range"):
        counts, times = [], []
        for n in PARTICLES:
            needed = [k for one in heard if (k := iterations(one[f"{kind}, {n}"])) is not None]
            counts.append(float(np.mean(needed)) if needed else math.nan)
            times.append(float(np.median([one[f"{kind}, {n}"].wall_time for one in heard])))
        fewer = "holds" if counts[0] > counts[1] > counts[2] else "does not hold"
        more = "holds" if times[0] < times[1] < times[2] else "does not hold"
        report.say(
            f"`{kind}`: that more particles need fewer iterations {fewer} here "
            f"({', '.join(f'{n}: {c:.0f}' for n, c in zip(PARTICLES, counts, strict=True))}); that they need more time {more} "
            f"({', '.join(f'{n}: {t:.2f} s' for n, t in zip(PARTICLES, times, strict=True))})."
        )


def _picture(path: Path, heard: list[dict[str, Heard]]) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
    for case, color in (("ranges, 400", "tab:orange"), ("bearing-range, 200", "tab:blue"), ("ekf", "tab:green")):
        for one in heard:
            run = one[case]
            off = run.estimate - run.tour.truth
            axes[0].semilogy(run.tour.times, 100 * np.hypot(off[:, 0], off[:, 1]), color=color, lw=0.5, alpha=0.5)
            axes[1].semilogy(run.tour.times, np.degrees(np.abs(wrap_angles(off[:, 2]))) + 1e-3, color=color, lw=0.5, alpha=0.5)
        axes[0].plot([], color=color, label=case)
    axes[0].set(xlabel="time [s]", ylabel="position error [cm]", ylim=(0.1, 500))
    axes[1].set(xlabel="time [s]", ylabel="heading error [°]", ylim=(0.01, 200))
    axes[0].legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _mean(values: list[Any]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _triple(values: Array) -> str:
    return ", ".join("–" if not np.isfinite(v) else f"{v:.2f}" for v in values)


def _spread(values: list[Any], scale: float, form: str) -> str:
    known = [scale * value for value in values if value is not None]
    return f"{np.mean(known):{form}} ± {np.std(known):{form}}" if known else "–"


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
