"""Safe-direction navigation among movers that cross corridors: two to six of them, up to 0.3 m/s, in contact physics.

The car crosses a hall of corridors between blocks; cylinders and boxes go to and fro across its way. Where they go, how fast and
how large they are is drawn by the seed. A contact while the car moves ends a run.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.episode.result import RunResult
from robocar.experiments._safe_direction_worlds import Box, Drawn
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many

MOVERS = (2, 4, 6)
FASTEST = 0.3  # [m/s]
NAVIGATORS = ("safe-direction", "safe-direction-memory")
BLOCKS: tuple[Box, ...] = tuple((x, y, x + 1.2, y + 1.0) for x in (1.6, 4.4) for y in (0.0, 2.4, 4.8))
CROSSINGS = (((3.2, 0.5), (3.2, 5.3)), ((4.0, 5.3), (4.0, 0.5)), ((6.1, 0.6), (6.1, 3.4)), ((1.0, 2.9), (1.0, 5.2)),
             ((0.9, 3.9), (4.0, 3.9)), ((3.2, 1.4), (6.4, 1.4)))  # fmt: skip
"""Ways of the movers [m], to and fro: along the cross aisles, so across the corridors that the car drives, and along these."""


def world(seed: int, movers: int) -> Drawn:
    """The hall with `movers` of the crossings in use, in the seed's order, at 0.1 to 0.3 m/s, 0.1 to 0.2 m in radius."""
    rng = np.random.default_rng([seed, movers])
    chosen: list[dict[str, Any]] = []
    for k, i in enumerate(rng.permutation(len(CROSSINGS))[:movers]):
        a, b = CROSSINGS[i] if rng.random() < 0.5 else CROSSINGS[i][::-1]
        radius, speed = round(float(rng.uniform(0.10, 0.20)), 2), round(float(rng.uniform(0.1, FASTEST)), 2)
        shape: dict[str, Any] = {"cylinder": [radius, 0.4]} if rng.random() < 0.5 else {"box": [2 * radius, 1.5 * radius, 0.4]}
        chosen.append({"name": f"mover{k}", **shape, "waypoints": [list(a), list(b)], "speed": speed, "mass": 5.0})
    return Drawn((7.4, 5.8), BLOCKS, (0.6, 1.7, 0.0), (6.8, 4.1), "scan360", 180.0, chosen)


def main(out: Path, quick: bool = False, first: int = 0) -> None:
    """Runs, table and picture, of 20 seeds from the `first` on."""
    seeds = range(first, first + (2 if quick else 20))
    cases = [(n, m) for n in NAVIGATORS for m in (MOVERS[:1] if quick else MOVERS)]
    jobs = [
        {"scenario": world(k, m).scenario(f"dynamic-{m}-{k}", out / "worlds"), "navigator": n, "seed": k, "out": out / "runs",
         "force": True}
        for n, m in cases
        for k in seeds
    ]  # fmt: skip
    results = run_many(jobs)
    report = Report(out, "Safe-direction navigation among movers")
    rows = []
    figure, axes = plt.subplots(1, len(cases), figsize=(4.5 * len(cases), 4), squeeze=False, layout="constrained")
    for i, (navigator, movers) in enumerate(cases):
        runs = results[i * len(seeds) : (i + 1) * len(seeds)]
        reached, touched = sum(r.success for r in runs), sum(r.status == "collision" for r in runs)
        met = sum(int(r.value("contacts_standing") or 0) > 0 for r in runs)  # a mover ran into the standing car
        failed = [f"seed {k}: {r.status}" for k, r in zip(seeds, runs, strict=True) if not r.success]
        for result in runs:  # recordings are kept of the first run and of those that failed
            if result.success and result is not runs[0] and result.recording is not None:
                result.recording.unlink()
        tag = f"{navigator}/{movers}_movers"
        duration = float(np.mean([r.value("duration") or np.nan for r in runs if r.success])) if reached else None
        report.number(f"{tag}/success_rate", reached / len(runs), "1")
        report.number(f"{tag}/without_contact", (len(runs) - touched) / len(runs), "1")
        report.number(f"{tag}/run_into_standing", met / len(runs), "1")
        report.number(f"{tag}/closest_approach", nearest := _least(runs), "m")
        report.number(f"{tag}/duration", duration, "s")
        rows.append(
            (
                navigator,
                movers,
                f"{reached}/{len(runs)}",
                f"{len(runs) - touched}/{len(runs)}",
                f"{met}/{len(runs)}",
                nearest,
                duration,
                ", ".join(failed) or "–",
            )
        )
        axis, drawn = axes[0, i], world(first, movers)
        axis.imshow(
            np.where(drawn.grid().occupied, 0.35, 1.0), cmap="gray", vmin=0, vmax=1, origin="lower", extent=(0, 7.4, 0, 5.8)
        )
        for a, b in CROSSINGS:
            axis.plot(*np.array([a, b]).T, ":", color="tab:purple")
        for result in runs:
            axis.plot(*result.truth.poses[:, :2].T, lw=0.8, color="tab:blue" if result.success else "tab:red")
        axis.plot(*drawn.goal, "*", color="tab:orange", ms=12)
        axis.set_title(f"{navigator}, {movers} movers", fontsize=9)
    report.table(
        (
            "navigator",
            "movers",
            "reached",
            "without contact",
            "run into standing",
            "closest approach [m]",
            "time [s]",
            "the rest",
        ),
        rows,
        f"Seeds {seeds[0]} to {seeds[-1]}, each its own movers; laser of 360 degrees with noise. Movers do not give way: the "
        "column of those that ran into the standing car is not among the contacts, which are begun by the moving one.",
    )
    report.say("Recordings of the runs that failed, and of the first seed, are in `runs`.")
    report.write()
    figure.savefig(out / "dynamic.png", dpi=110)
    plt.close(figure)


def _least(runs: list[RunResult]) -> float | None:
    """How near the movers came in those runs [m]."""
    known = [value for r in runs if (value := r.value("movers/closest_approach")) is not None]
    return min(known) if known else None


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
