"""Doors from 0.9 to 1.6 times the virtual circle's diameter: which does the Operative Critical Point Bug pass, which refuse?

Das, Dutta and Debnath, IJEECS 18(3), 2020, SAFE_POINT: gaps wider than 2 r are passed, narrower ones are not.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from experiments._bug_worlds import CIRCLE, ROBOT, grid, room
from robocar.experiment import Report, run_many

SHARES = (0.90, 0.95, 0.98, 1.00, 1.02, 1.05, 1.08, 1.10, 1.15, 1.20, 1.30, 1.40, 1.60)
STARTS = {"frontal": (1.0, 2.0, 0.0), "oblique": (1.2, 0.8, 0.0)}
WALL = (3.0, 0.10)  # where it stands and how thick it is [m]
SEEDS = 4


def door(folder: Path, share: float, start: tuple[float, float, float], shift: float) -> dict[str, Any]:
    """A room of 6 x 4 m, a wall across with a door of `share` times 2 r around y = 2 + `shift`."""
    half = share * CIRCLE.radius
    low, high = 2.0 + shift - half, 2.0 + shift + half
    boxes = [(0.0, low), (high, 4.0)]
    obstacles = [{"box": [WALL[1], b - a, 0.3], "pose": [WALL[0], 0.5 * (a + b), 0.0]} for a, b in boxes]
    return room(
        folder,
        "gap_room",
        grid(6.0, 4.0),
        start=list(start),
        goal=[5.0, 2.0],
        unknown_obstacles=obstacles,
        time_limit=150.0,
        goal_may_be_blocked=False,
    )


def main(out: Path, quick: bool = False) -> None:
    """Runs and the share of doors passed over their width."""
    seeds = 1 if quick else SEEDS
    shares = (0.95, 1.15) if quick else SHARES
    rng = np.random.default_rng(0)
    cases = [(share, side, k, float(rng.uniform(-0.3, 0.3))) for share in shares for side in STARTS for k in range(seeds)]
    results = run_many(
        [
            {
                "scenario": door(out / "maps", share, STARTS[side], shift),
                "navigator": "ocpb",
                "estimator": "truth",
                "seed": k,
                "settings": ROBOT,
            }
            for share, side, k, shift in cases
        ]
    )
    report = Report(out, "Doors about as wide as the virtual circle")
    rows, passed_share = [], []
    for share in shares:
        row: list[object] = [f"{share:.2f}", f"{2 * share * CIRCLE.radius:.3f}"]
        passed = entered = count = contacts = 0
        clearances = []
        for (s, _, _, _), result in zip(cases, results, strict=True):
            if s == share:
                count += 1
                passed += result.success
                entered += bool(np.max(result.truth.poses[:, 0]) > WALL[0] - 0.5 * WALL[1])
                contacts += int(result.value("contacts") or 0)
                clearances.append(float(result.value("min_clearance") or 0.0))
        report.number(f"{share:.2f}/passed", passed / count, "1")
        report.number(f"{share:.2f}/entered", entered / count, "1")
        report.number(f"{share:.2f}/contacts", contacts, "1")
        rows.append([*row, f"{passed}/{count}", f"{entered}/{count}", contacts, min(clearances)])
        passed_share.append(passed / count)
    report.table(
        ("width / 2 r", "width [m]", "passed", "entered", "contacts", "least clearance [m]"),
        rows,
        f"r = {CIRCLE.radius:.4f} m; frontal and oblique starts, doors shifted by up to 0.3 m. Target: above 1.1 all are passed, "
        "below 1.0 none is entered. Entered: the car's middle is between the jambs.",
    )
    report.write()
    figure, axis = plt.subplots(figsize=(5, 3), layout="constrained")
    axis.plot(shares, passed_share, "o-")
    axis.axvline(1.0, color="gray", ls=":")
    axis.axvline(1.1, color="gray", ls=":")
    axis.set(xlabel="door width / 2 r", ylabel="share passed")
    figure.savefig(out / "gaps.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
