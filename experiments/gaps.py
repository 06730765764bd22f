"""Doors from 0.9 to 1.6 times the virtual circle's diameter: which does the Operative Critical Point Bug pass, which refuse?

Das, Dutta and Debnath, IJEECS 18(3), 2020, SAFE_POINT: gaps wider than 2 r are passed, narrower ones are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.episode.result import RunResult
from robocar.experiments._bug_worlds import CIRCLE, ROBOT, grid, room
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many

SEEDS = 4
WALL = 3.0  # [m] where it stands


@dataclass(frozen=True)
class Doors:
    """Doors in a wall across a room of 6 x 4 m.

    Args:
        shares: of their widths in 2 r; shift: up to which they are out of the middle [m].
        thickness: of the wall [m], chosen by the run.
        starts: of the car (x [m], y [m], heading [rad]); goal: [m]; first_seed: of the runs.
    """

    shares: tuple[float, ...]
    shift: float
    thickness: tuple[float, ...]
    starts: dict[str, tuple[float, float, float]]
    goal: tuple[float, float]
    first_seed: int


# The rules were made on the first set. Of the second, widths, walls, starts, goal and seeds were not used for anything before.
SETS = {
    "": Doors(
        (0.90, 0.95, 0.98, 1.00, 1.02, 1.05, 1.08, 1.10, 1.15, 1.20, 1.30, 1.40, 1.60),
        0.3,
        (0.10,),
        {"frontal": (1.0, 2.0, 0.0), "oblique": (1.2, 0.8, 0.0)},
        (5.0, 2.0),
        0,
    ),
    "held_out/": Doors(
        (0.92, 0.96, 0.99, 1.01, 1.04, 1.06, 1.11, 1.14, 1.18, 1.25, 1.35, 1.50),
        0.9,
        (0.05, 0.20, 0.35),
        {"behind": (0.6, 3.3, 2.5), "close": (2.3, 1.1, -1.2)},
        (5.3, 2.9),
        1000,
    ),
}


def door(
    folder: Path, share: float, start: tuple[float, float, float], shift: float, thickness: float = 0.10,
    goal: tuple[float, float] = (5.0, 2.0),
) -> dict[str, Any]:  # fmt: skip
    """A room of 6 x 4 m, a wall across with a door of `share` times 2 r around y = 2 + `shift`."""
    half = share * CIRCLE.radius
    low, high = 2.0 + shift - half, 2.0 + shift + half
    boxes = [(0.0, low), (high, 4.0)]
    obstacles = [{"box": [thickness, b - a, 0.3], "pose": [WALL, 0.5 * (a + b), 0.0]} for a, b in boxes]
    return room(
        folder,
        "gap_room",
        grid(6.0, 4.0),
        start=list(start),
        goal=list(goal),
        unknown_obstacles=obstacles,
        time_limit=150.0,
        goal_may_be_blocked=False,
    )


def main(out: Path, quick: bool = False) -> None:
    """Runs and the share of doors passed over their width."""
    rng, cases = np.random.default_rng(0), []
    for name, doors in SETS.items():
        for share in doors.shares[1::5] if quick else doors.shares:
            for side in doors.starts:
                for k in range(doors.first_seed, doors.first_seed + (1 if quick else SEEDS)):
                    shift, thick = float(rng.uniform(-doors.shift, doors.shift)), float(rng.choice(doors.thickness))
                    cases.append((name, share, thick, k, door(out / "maps", share, doors.starts[side], shift, thick, doors.goal)))
    results = run_many(
        [
            {"scenario": scenario, "navigator": "ocpb", "estimator": "truth", "seed": k, "settings": ROBOT}
            for *_, k, scenario in cases
        ]
    )
    report = Report(out, "Doors about as wide as the virtual circle")
    figure, axis = plt.subplots(figsize=(5, 3), layout="constrained")
    for name in SETS:
        runs = [(case, result) for case, result in zip(cases, results, strict=True) if case[0] == name]
        axis.plot(*_doors(report, name, runs), "o-", label=name.strip("/").replace("_", " ") or "first")
    report.write()
    axis.axvline(1.0, color="gray", ls=":")
    axis.axvline(1.1, color="gray", ls=":")
    axis.set(xlabel="door width / 2 r", ylabel="share passed")
    axis.legend(frameon=False)
    figure.savefig(out / "gaps.png", dpi=110)
    plt.close(figure)


def _doors(report: Report, name: str, runs: list[tuple[Any, RunResult]]) -> tuple[list[float], list[float]]:
    """Table and numbers of a set; the widths, and the shares of doors passed."""
    rows, passed_share, notes = [], {}, []
    for share in dict.fromkeys(case[1] for case, _ in runs):
        group = [(case, r) for case, r in runs if case[1] == share]
        passed = sum(r.success for _, r in group)
        entered = sum(bool(np.max(r.truth.poses[:, 0]) > WALL - 0.5 * thick) for (_, _, thick, *_), r in group)
        contacts = sum(int(r.value("contacts") or 0) for _, r in group)
        clearance = min(float(r.value("min_clearance") or 0.0) for _, r in group)
        report.number(f"{name}{share:.2f}/passed", passed / len(group), "1")
        report.number(f"{name}{share:.2f}/entered", entered / len(group), "1")
        report.number(f"{name}{share:.2f}/contacts", contacts, "1")
        counts = (f"{passed}/{len(group)}", f"{entered}/{len(group)}", contacts, clearance)
        rows.append((f"{share:.2f}", f"{2 * share * CIRCLE.radius:.3f}", *counts))
        passed_share[share] = passed / len(group)
        notes += [f"* {share:.2f}, seed {k}: {r.status}: {r.reason}" for (*_, k, _), r in group if share > 1.1 and not r.success]
    report.table(
        ("width / 2 r", "width [m]", "passed", "entered", "contacts", "least clearance [m]"),
        rows,
        ("Held out: widths, walls of 5 to 35 cm, starts, goal and seeds that nothing was made on. " if name else "")
        + f"r = {CIRCLE.radius:.4f} m; doors shifted by up to 0.3 m (held out: 0.9 m). Target: above 1.1 all are passed, "
        "below 1.0 none is entered. Entered: the car's middle is between the jambs.",
    )
    for note in notes:
        report.say(note)
    return list(passed_share), list(passed_share.values())


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
