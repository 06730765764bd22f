"""Doors little wider than the robot, in walls at any angle: who that knows the map passes which, and does anyone touch a post?

Pose and map are exact, so what is judged is the room that a navigator keeps for its own slip. Cells cut the walls into steps;
physics has the same steps. A door's width is what is really free between its posts.
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

from robocar.core import OCCUPIED, Array, OccupancyGrid
from robocar.episode.algorithms import NAVIGATORS
from robocar.episode.result import RunResult
from robocar.formats import save_ros_map
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many

KNOW_THE_MAP = tuple(name for name, entry in NAVIGATORS.items() if name == "dynamic-a-star" or "costmap" in entry.parameters)
DOORS, QUICK_DOORS = 55, 9  # rooms for each navigator, each with one door
SIDE = 2.4  # [m] of a room
WIDTHS = (0.22, 0.60)  # [m] of doors before cells cut them
RESOLUTIONS = (0.02, 0.025, 0.03, 0.039, 0.05)  # [m]
TIME_LIMIT = 60.0  # [s]


@dataclass(frozen=True, slots=True)
class Door:
    """A room with a wall across it.

    Args:
        grid: the room, whose outer wall is its border; width: really free between the posts [m].
        start: x, y [m], heading [rad]; goal: x, y [m], beyond the door.
        lidar: what the robot has beside its sonars.
    """

    grid: OccupancyGrid
    width: float
    start: tuple[float, float, float]
    goal: tuple[float, float]
    lidar: str


def door(seed: int) -> Door:
    """A room by its seed; every other one is seen by a laser too."""
    rng = np.random.default_rng(seed)
    resolution, angle = float(rng.choice(RESOLUTIONS)), rng.uniform(0.0, math.pi)
    nominal = WIDTHS[0] + (WIDTHS[1] - WIDTHS[0]) * rng.random() ** 2  # more of the narrow ones
    thickness = rng.uniform(0.06, 0.20)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    middle = SIDE / 2 + rng.uniform(-0.1, 0.1, 2)
    n = round(SIDE / resolution)
    centres = (np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1) + 0.5) * resolution - middle
    wall = (np.abs(centres @ across) < thickness / 2) & (np.abs(centres @ along) >= nominal / 2)
    grid = OccupancyGrid(np.where(wall, OCCUPIED, 0).astype(np.int8), resolution)
    sides = [middle + sign * rng.uniform(0.55, 0.65) * across + rng.uniform(-0.25, 0.25) * along for sign in (1, -1)]
    (x, y), (gx, gy) = (side.tolist() for side in sides)
    width = _width(centres[wall] @ along, resolution * float(np.abs(along).sum()) / 2)
    return Door(grid, width, (x, y, rng.uniform(-math.pi, math.pi)), (gx, gy), ("none", "hokuyo")[seed % 2])


def _width(along: Array, half: float) -> float:
    """Between the posts' cells, whose centres lie at `along` (n,) [m] from the door's middle and reach `half` [m] either way."""
    return float(np.min(along[along > 0.0]) - np.max(along[along < 0.0])) - 2.0 * half


def scenario(place: Door, folder: Path, name: str) -> dict[str, Any]:
    """The run's scenario, its map written to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    return {
        "name": name,
        "map": str(save_ros_map(place.grid, folder / name)),
        "start": list(place.start),
        "goal": list(place.goal),
        "time_limit": TIME_LIMIT,
        "robot": {"lidar": place.lidar},
    }


def main(out: Path, quick: bool = False, first_seed: int = 0) -> None:
    """Runs, a table by navigator, and a picture of who has passed which door."""
    doors = {seed: door(seed) for seed in range(first_seed, first_seed + (QUICK_DOORS if quick else DOORS))}
    scenarios = {seed: scenario(place, out / "maps", f"door-{seed}") for seed, place in doors.items()}
    cases = [(name, seed) for seed in doors for name in KNOW_THE_MAP]
    results = run_many(
        [{"scenario": scenarios[seed], "navigator": name, "estimator": "truth", "seed": seed} for name, seed in cases]
    )
    runs = {name: [(doors[s], r) for (n, s), r in zip(cases, results, strict=True) if n == name] for name in KNOW_THE_MAP}
    report = Report(out, "Doors little wider than the robot")
    _table(report, runs)
    touched = sum(_touches(result) for result in results)
    report.number("runs", len(results), "1")
    report.number("contacts", touched, "1")
    report.say(f"{len(results)} runs, {touched} with a contact. The robot is 0.18 m wide and 0.20 m long; its pose is exact.")
    for (name, seed), result in zip(cases, results, strict=True):
        if not result.success:
            report.say(f"* {name}, seed {seed}, {doors[seed].width:.3f} m: {result.status}: {result.reason}")
    report.write()
    _picture(out, runs)


def _touches(result: RunResult) -> bool:
    return bool(result.value("contacts"))


def _table(report: Report, runs: dict[str, list[tuple[Door, RunResult]]]) -> None:
    rows = []
    for name, group in runs.items():
        passed = sorted(place.width for place, result in group if result.success)
        refused = sorted(place.width for place, result in group if not result.success)
        touched = sum(_touches(result) for _, result in group)
        statuses = [result.status for _, result in group if not result.success]
        said = ", ".join(f"{statuses.count(status)} {status}" for status in sorted(set(statuses))) or "–"
        # From here on every door was passed.
        sure = next((w for w in passed if not refused or w > refused[-1]), None)
        report.number(f"{name}/passed", len(passed) / len(group), "1")
        report.number(f"{name}/contacts", touched, "1")
        report.number(f"{name}/narrowest_passed", passed[0] if passed else None, "m")
        report.number(f"{name}/widest_refused", refused[-1] if refused else None, "m")
        rows.append((name, f"{len(passed)}/{len(group)}", touched, passed[0] if passed else None, sure, said))
    header = ("navigator", "passed", "contacts", "narrowest passed [m]", "all passed from [m]", "else")
    low, high = (1e3 * width for width in WIDTHS)
    report.table(header, rows, f"Doors drawn {low:g} to {high:g} mm wide; widths below are what cells leave free of them.")


def _picture(out: Path, runs: dict[str, list[tuple[Door, RunResult]]]) -> None:
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    for row, group in enumerate(runs.values()):
        for success, mark, color in ((True, "o", "tab:green"), (False, "x", "tab:red")):
            widths = [place.width for place, result in group if result.success == success]
            axis.plot(widths, [row] * len(widths), mark, color=color, ms=4)
    axis.set_yticks(range(len(runs)), list(runs))
    axis.axvline(0.18, color="gray", ls=":")
    axis.set(xlabel="door width [m]; green: passed; dotted: the robot's width")
    figure.savefig(out / "doors.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
