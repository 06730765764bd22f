"""Encounters with moving obstacles: how often does the Operative Critical Point Bug touch one?

Das, Dutta and Debnath, IJEECS 18(3), 2020, assumption A6: they move straight at constant speed. Each encounter is timed so that
the two would meet if nobody gave way; a second part has many of them at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.core import Array
from robocar.episode.result import RunResult
from robocar.experiments._bug_worlds import ROBOT, grid, room
from robocar.planners.bugs.view import BugParameters
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many

CROWDS = (1, 2, 4, 6, 8)
CROWD_SPEEDS = (0.1, 0.2, 0.3, 0.4)  # [m/s]
SEEDS = 8
SIZE = 12.0  # [m]
START, GOAL = (3.0, 6.0), (9.0, 6.0)
LAG = 0.7  # [s] until the car is under way


@dataclass(frozen=True)
class Encounters:
    """Movers that would meet the car.

    Args:
        speeds: of theirs [m/s]; angles: between the two directions [deg].
        start, goal: of the car [m]; meet: from where to where on its way they meet it, as shares.
        first_seed: of the runs.
        sizes: radius of the cylinders, half the side of the boxes, from and to [m].
    """

    speeds: tuple[float, ...]
    angles: tuple[int, ...]
    start: tuple[float, float]
    goal: tuple[float, float]
    meet: tuple[float, float]
    first_seed: int
    sizes: tuple[float, float]


# The rules were made on the first set. Of the second, speeds, angles, way, sizes and seeds were not used for anything before.
SETS = {
    "": Encounters((0.1, 0.2, 0.3, 0.4), (0, 30, 60, 90, 120, 150, 180), START, GOAL, (1.0 / 3.0, 2.0 / 3.0), 0, (0.15, 0.15)),
    "held_out/": Encounters(
        (0.15, 0.25, 0.35), (15, 45, 75, 105, 135, 165), (2.6, 9.2), (9.6, 3.4), (0.25, 0.75), 1000, (0.10, 0.24)
    ),
}


def _inside(point: np.ndarray) -> np.ndarray:
    return np.clip(point, 0.5, SIZE - 0.5)


def _leg(meet: Array, velocity: Array, before: float, after: float, car: Array) -> tuple[Array, Array] | None:
    """Where a mover starts and turns round, on the line through `meet`; None where it would start on the car or outside."""
    start, end = meet - before * velocity, meet + after * velocity
    if not np.allclose(_inside(start), start):
        return None
    for _ in range(40):  # the end may be nearer
        if np.allclose(_inside(end), end):
            break
        end = meet + 0.9 * (end - meet)
    return None if math.dist(start, car) < 1.0 else (start, end)


def encounter(folder: Path, kind: Encounters, speed: float, angle: float, seed: int) -> dict[str, Any] | None:
    """One mover that would meet the car on its straight way; None where it would have to start on the car."""
    rng = np.random.default_rng([seed, round(10 * speed), round(angle)])
    car, goal = np.array(kind.start), np.array(kind.goal)
    way = math.dist(car, goal)
    heading = math.atan2(*(goal - car)[::-1])
    gone = way * rng.uniform(*kind.meet)
    time = LAG + gone / BugParameters().desired_linear_vel + rng.uniform(-0.7, 0.7)
    a = heading + math.radians(angle) * rng.choice((-1.0, 1.0))
    leg = _leg(car + gone / way * (goal - car), speed * np.array([math.cos(a), math.sin(a)]), time, 40.0, car)
    if leg is None:
        return None
    half = float(rng.uniform(*kind.sizes))
    body = {"cylinder": [half, 0.3]} if seed % 2 else {"box": [2 * half, 2 * half, 0.3], "heading": float(a)}
    mover = {"name": "mover", "waypoints": [leg[0].tolist(), leg[1].tolist()], "speed": speed, **body}
    start = [*kind.start, heading]
    return room(folder, "open_room", grid(SIZE, SIZE), start=start, goal=list(kind.goal), movers=[mover], time_limit=90.0)


def crowd(folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Several movers to and fro across the car's way, at speeds from 0.1 to 0.4 m/s."""
    rng = np.random.default_rng([seed, count])
    movers: list[dict[str, Any]] = []
    while len(movers) < count:
        ends = rng.uniform([4.0, 2.0], [8.5, 10.0], (2, 2))
        if math.dist(*ends) < 3.0 or math.dist(ends[0], START) < 1.0:
            continue
        if any(math.dist(ends[0], other["waypoints"][0]) < 0.6 for other in movers):
            continue
        speed = float(rng.choice(CROWD_SPEEDS))
        movers.append({"name": f"m{len(movers)}", "waypoints": ends.tolist(), "speed": speed, "cylinder": [0.15, 0.3]})
    return room(folder, "open_room", grid(SIZE, SIZE), start=[*START, 0.0], goal=list(GOAL), movers=movers, time_limit=120.0)


def touched(result: RunResult) -> tuple[bool, bool]:
    """Whether it was touched driving, and standing (a mover ran into it)."""
    return bool(result.value("contacts")), bool(result.value("contacts_standing"))


def main(out: Path, quick: bool = False) -> None:
    """Encounters over speed and angle, and crowds."""
    seeds = 1 if quick else SEEDS
    cases = [
        (name, speed, angle, kind.first_seed + k, scenario)
        for name, kind in SETS.items()
        for speed in (kind.speeds[1::2] if quick else kind.speeds)
        for angle in (kind.angles[3::3] if quick else kind.angles)
        for k in range(seeds)
        if (scenario := encounter(out / "maps", kind, speed, angle, kind.first_seed + k)) is not None
    ]
    crowds = [(n, k, crowd(out / "maps", n, k)) for n in ((2,) if quick else CROWDS) for k in range(seeds)]
    jobs = [
        {
            "scenario": scenario,
            "navigator": "ocpb",
            "estimator": "truth",
            "seed": k,
            "settings": ROBOT,
        }
        for *_, k, scenario in [*cases, *crowds]
    ]
    results = run_many(jobs)
    report = Report(out, "Encounters with moving obstacles")
    pictures = {}
    for name, kind in SETS.items():
        runs = [(case, result) for case, result in zip(cases, results, strict=False) if case[0] == name]
        pictures[name] = _encounters(report, name, kind, runs)
    together = list(zip(crowds, results[len(cases) :], strict=True))
    rows = []
    for n in dict.fromkeys(n for n, *_ in crowds):
        group = [r for (m, *_), r in together if m == n]
        hits = [touched(r) for r in group]
        report.number(f"crowd/{n}/contact_rate", sum(any(h) for h in hits) / len(group), "1")
        report.number(f"crowd/{n}/success_rate", sum(r.success for r in group) / len(group), "1")
        rows.append(
            (n, f"{sum(r.success for r in group)}/{len(group)}", sum(h[0] for h in hits), sum(h[1] and not h[0] for h in hits))
        )
    report.table(
        ("movers", "reached", "contacts driving", "contacts standing"),
        rows,
        "Many movers, which go to and fro and turn back at once.",
    )
    report.write()
    figure, axes = plt.subplots(1, len(pictures), figsize=(11, 3), layout="constrained")
    for axis, (name, picture) in zip(axes, pictures.items(), strict=True):
        kind = SETS[name]
        image = axis.imshow(picture, cmap="Reds", vmin=0.0, vmax=0.25, aspect="auto")
        axis.set(xticks=range(len(kind.angles)), xticklabels=kind.angles, yticks=range(len(kind.speeds)), yticklabels=kind.speeds)
        axis.set(xlabel="crossing angle [deg]", ylabel="speed [m/s]", title=name.strip("/").replace("_", " "))
        figure.colorbar(image, label="contact rate")
    figure.savefig(out / "moving.png", dpi=110)
    plt.close(figure)


def _encounters(report: Report, name: str, kind: Encounters, runs: list[tuple[Any, RunResult]]) -> Array:
    """Table and numbers of a set; contact rate over speed and angle, nan where there was no run."""
    rows, picture = [], np.full((len(kind.speeds), len(kind.angles)), np.nan)
    for i, speed in enumerate(kind.speeds):
        row: list[object] = [speed]
        for j, angle in enumerate(kind.angles):
            group = [touched(r) for (_, v, a, *_), r in runs if (v, a) == (speed, angle)]
            hits = sum(driving or standing for driving, standing in group)
            row.append(f"{hits}/{len(group)}" if group else None)
            if group:
                picture[i, j] = hits / len(group)
                report.number(f"{name}contact_rate/{speed}/{angle}", hits / len(group), "1")
        rows.append(row)
    report.table(
        ("speed [m/s]", *(f"{angle}°" for angle in kind.angles)),
        rows,
        ("Held out: speeds, angles, way, sizes and seeds that nothing was made on. " if name else "")
        + "Encounters with a contact, driving or standing; 0° is a mover that goes the car's way, 180° head-on. Without number: "
        "it would have to start less than a metre from the car.",
    )
    driving = sum(touched(r)[0] for _, r in runs)
    standing = sum(touched(r)[1] and not touched(r)[0] for _, r in runs)
    report.number(f"{name}encounters", len(runs), "1")
    report.number(f"{name}contacts_driving", driving, "1")
    report.number(f"{name}contacts_standing", standing, "1")
    report.number(f"{name}success_rate", sum(r.success for _, r in runs) / max(len(runs), 1), "1")
    report.say(
        f"{len(runs)} encounters: {driving} with a contact while the car drove, {standing} more while it stood. "
        "Target: at most 1 in 200."
    )
    for (_, v, a, k, _), r in runs:
        if any(touched(r)) or not r.success:
            report.say(f"* {v} m/s, {a}°, seed {k}: {r.status}: {r.reason}")
    return picture


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
