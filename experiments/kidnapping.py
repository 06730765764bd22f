"""The kidnapped robot: carried 2 m away and turned by 120 degrees in mid-run. Does the filter notice, and find itself again?

Thesis, section 2.6 names the problem. 20 cars on its field, 200 particles; detection is the first tick at which the filter
begins to look elsewhere (particles are drawn anew), recovery is when its estimate begins to stay within 10 cm and 10
degrees for 2 s.
"""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.episode.run import run
from robocar.experiments._tours import SCENARIO, Heard, drive, listen
from robocar.metrics.localization import recovery_time
from robocar.reporting.report import Report

WHEN, LIMIT = 30.0, 15.0  # [s]
CASES = {
    "particle filter, 200": ("particle-filter", {"min_particles": 200, "max_particles": 200}),
    "particle filter, 200, no recovery": (
        "particle-filter",
        {"min_particles": 200, "max_particles": 200, "recovery_alpha_fast": 0.0},
    ),
    "ekf": ("ekf", {}),
}


def _one_seed(seed: int) -> dict[str, Heard]:
    tour = drive(seed, kidnap=WHEN)
    return {name: listen(tour, estimator, parameters) for name, (estimator, parameters) in CASES.items()}


def detection_time(heard: Heard) -> float | None:
    """From the kidnapping until the filter begins to look elsewhere [s]."""
    times = heard.tour.times
    event = times[np.flatnonzero(heard.tour.carried)[0]]
    noticed = np.flatnonzero((times >= event) & (heard.lost > 0.0))
    return float(times[noticed[0]] - event) if len(noticed) else None


def main(out: Path, quick: bool = False) -> None:
    """Drives, a table, a picture and a recording."""
    seeds = range(2 if quick else 20)
    with ProcessPoolExecutor(min(len(seeds), os.cpu_count() or 1), mp_context=multiprocessing.get_context("spawn")) as pool:
        heard = list(pool.map(_one_seed, seeds))
    report = Report(out, "Kidnapping: 2 m away, turned by 120 degrees")
    rows = []
    for case in CASES:
        runs = [one[case] for one in heard]
        noticed = [t for r in runs if (t := detection_time(r)) is not None]
        back = [t for r in runs if (t := recovery_time(r.tour.times, r.tour.truth, r.estimate, r.tour.carried)) is not None]
        within = sum(t <= LIMIT for t in back)
        tag = case.replace(", ", "_").replace(" ", "_")
        report.number(f"{tag}/recovered_within_15_s", within / len(runs), "1")
        report.number(f"{tag}/recovered", len(back) / len(runs), "1")
        report.number(f"{tag}/detection_time", float(np.mean(noticed)) if noticed else None, "s")
        report.number(f"{tag}/recovery_time", float(np.mean(back)) if back else None, "s")
        report.number(f"{tag}/recovery_time_max", max(back) if back else None, "s")
        rows.append((case, f"{within}/{len(runs)}", f"{len(back)}/{len(runs)}", _spread(noticed), _spread(back)))
    report.table(
        ("filter", "recovered within 15 s", "recovered", "noticed after [s]", "recovered after [s]"),
        rows,
        f"{len(seeds)} seeds; times as mean ± standard deviation (largest).",
    )
    report.write()
    _picture(out / "kidnapping.png", heard)
    settings = {
        "start": [0.6, 0.6, 0.8],
        "events": [{"time": 12.0, "kidnap": [2.6, 0.6, 2.9]}],
        "estimator.min_particles": 200,
        "estimator.max_particles": 200,
    }
    run(SCENARIO, seed=0, settings=settings, out=out / "runs", force=True)


def _spread(values: list[float]) -> str:
    return f"{np.mean(values):.1f} ± {np.std(values):.1f} ({max(values):.1f})" if values else "–"


def _picture(path: Path, heard: list[dict[str, Heard]]) -> None:
    figure, axes = plt.subplots(1, len(CASES), figsize=(4.2 * len(CASES), 3.2), layout="constrained", sharey=True)
    for axis, case in zip(axes, CASES, strict=True):
        for one in heard:
            off = one[case].estimate - one[case].tour.truth
            axis.semilogy(one[case].tour.times, 100 * np.hypot(off[:, 0], off[:, 1]), lw=0.6)
        axis.axvline(WHEN, color="black", lw=0.8, ls=":")
        axis.set(title=case, xlabel="time [s]", ylim=(0.1, 500))
    axes[0].set(ylabel="position error [cm]")
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
