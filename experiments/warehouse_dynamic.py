"""A warehouse with 5 to 20 moving obstacles that the map does not show (Izaty and Lubis: RRT and DWA, Fig. 12 and 13).

The car crosses the warehouse, whose shelves it knows. Each seed has its own movers, a third of each kind: round carts at constant
speed, boxes that stop, turn and go, and people on random walks, at 0.1 to 0.3 m/s. They see nobody and give way to nobody.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.core import ScenarioError
from robocar.episode.result import RunResult
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario
from robocar.scenario.model import MoverModel
from robocar.scenario.scene import Scene
from robocar.sim.movers import Mover
from robocar.sim.robot_model import RobotModel

NAVIGATORS = ("a-star", "rrt-dwa", "a-star-dwa", "a-star-mppi", "safe-direction-memory", "ocpb")
COUNTS = (5, 10, 20)
SEEDS = 20
TARGET = 19 / 20  # of the runs without contact
KEEP_OFF = 1.2  # [m] from the start of the car, and of each other, at which movers start
TRIES = 10_000  # places that are drawn for the movers of one run
SHAPES: dict[str, dict[str, Any]] = {
    "constant": {"cylinder": [0.20, 0.40]},
    "stop-turn-go": {"box": [0.50, 0.35, 0.40], "pause": 2.0},
    "random-walk": {"cylinder": [0.18, 0.50], "pause": 1.0, "roam": 2.0},
}


def dynamic_scenario(count: int, seed: int) -> dict[str, Any]:
    """`warehouse-dynamic` with `count` movers of this seed in place of its own.

    Raises:
        ScenarioError: they do not all find room.
    """
    base = load_scenario("warehouse-dynamic").model_dump(mode="json", exclude_none=True)
    base |= {"name": f"warehouse-{count}-movers", "movers": []}
    scene = Scene.load(load_scenario(base), RobotModel.load().footprint)
    rng = np.random.default_rng([count, seed])
    kinds = list(SHAPES)
    places: list[np.ndarray] = [scene.start.position]
    movers: list[dict[str, Any]] = []
    for _ in range(TRIES):
        if len(movers) == count:
            return base | {"movers": movers}
        kind = kinds[len(movers) % len(kinds)]
        here, there = rng.uniform(0.0, scene.grid.size, (2, 2))
        waypoints = [here] if kind == "random-walk" else [here, there]
        if min(math.dist(here, place) for place in places) < KEEP_OFF or not 1.5 < math.dist(here, there) < 8.0:
            continue
        mover = {"name": f"{kind}-{len(movers)}", "motion": kind, "waypoints": np.round(waypoints, 3).tolist()}
        mover |= SHAPES[kind] | {"speed": round(float(rng.uniform(0.1, 0.3)), 3)}
        if _fits(scene, MoverModel.model_validate(mover).mover()):
            movers.append(mover)
            places.append(here)
    raise ScenarioError(f"{count} movers find no room in the warehouse in {TRIES} tries")


def _fits(scene: Scene, mover: Mover) -> bool:
    """Whether all that it covers is on the map, free, and not where the car starts."""
    inside = np.array([scene.grid.contains(scene.grid.cell_from_world(p)) for p in (mover.start.position, *mover.waypoints)])
    return bool(inside.all()) and all(scene.clearance(swept.polygon) > swept.radius for swept in mover.sweeps())


def main(out: Path, quick: bool = False) -> None:
    """Runs, tables and a picture; `quick` takes 5 movers, two seeds and two navigators."""
    counts, seeds = (COUNTS[:1], range(2)) if quick else (COUNTS, range(SEEDS))
    navigators = ("a-star-dwa", "ocpb") if quick else NAVIGATORS
    scenarios = {(count, seed): dynamic_scenario(count, seed) for count in counts for seed in seeds}
    cases = [(count, navigator) for count in counts for navigator in navigators]
    jobs = [
        {"scenario": scenarios[count, seed], "navigator": navigator, "seed": seed}
        | ({"out": out / "runs", "force": True} if seed == 0 else {})
        for count, navigator in cases
        for seed in seeds
    ]
    results = iter(run_many(jobs))
    grouped = {case: [next(results) for _ in seeds] for case in cases}
    report = Report(out, "A warehouse with moving obstacles")
    rows = [_row(report, count, navigator, runs) for (count, navigator), runs in grouped.items()]
    header = (
        "movers", "navigator", "reached", "collisions", "other ends", "hit while standing", "time [s]", "path / shortest",
        "least time to collision [s]", "closest approach [m]",
    )  # fmt: skip
    report.table(
        header,
        rows,
        f"{len(seeds)} seeds each, each with its own movers of 0.1 to 0.3 m/s; pose oracle, laser all round. A collision is the "
        "first contact while the car moves, and ends the run; a mover that runs into the standing car is counted apart. Time and "
        "path: means over the runs that reached the goal; time to collision and approach: medians over all runs.",
    )
    report.write()
    _picture(out / "paths.png", scenarios, grouped)


def _row(report: Report, count: int, navigator: str, runs: Sequence[RunResult]) -> tuple[object, ...]:
    n = len(runs)
    reached = [r for r in runs if r.success]
    collisions = sum(r.status == "collision" for r in runs)
    touched = sum(bool(r.value("contacts")) or bool(r.value("contacts_standing")) for r in runs)
    standing = sum(int(r.value("contacts_standing") or 0) for r in runs)
    ratios = [
        length / shortest
        for r in reached
        if (length := r.value("path_length")) is not None and (shortest := r.value("shortest_path_length"))
    ]
    values: dict[str, tuple[float | None, str]] = {
        "success_rate": (len(reached) / n, "1"),
        "without_contact_rate": (1.0 - touched / n, "1"),
        "collisions": (collisions, "1"),
        "contacts_standing": (standing, "1"),
        "duration": (_of(np.mean, [r.value("duration") for r in reached]), "s"),
        "path_over_shortest": (_of(np.mean, ratios), "1"),
        "min_time_to_collision": (_of(np.median, [r.value("movers/min_time_to_collision") for r in runs]), "s"),
        "closest_approach": (_of(np.median, [r.value("movers/closest_approach") for r in runs]), "m"),
    }
    for name, (value, unit) in values.items():
        report.number(f"{count}/{navigator}/{name}", value, unit)
    others = ", ".join(
        f"{sum(r.status == s for r in runs)} {s}" for s in sorted({r.status for r in runs} - {"success", "collision"})
    )
    return (
        count, navigator, f"{len(reached)}/{n}", collisions, others or "none", standing,
        *(values[name][0] for name in ("duration", "path_over_shortest", "min_time_to_collision", "closest_approach")),
    )  # fmt: skip


def _of(reduce: Any, values: Sequence[float | int | None]) -> float | None:
    there = [value for value in values if value is not None]
    return float(reduce(there)) if there else None


def _picture(
    path: Path, scenarios: Mapping[tuple[int, int], dict[str, Any]], grouped: Mapping[tuple[int, str], list[RunResult]]
) -> None:
    """Seed 0 of each number of movers: where they start and what way they go, and the ways of the cars."""
    counts = sorted({count for count, _ in grouped})
    figure, axes = plt.subplots(1, len(counts), figsize=(5.2 * len(counts), 4.8), layout="constrained", squeeze=False)
    for axis, count in zip(axes.flat, counts, strict=True):
        scene = Scene.load(load_scenario(scenarios[count, 0]), RobotModel.load().footprint)
        corner = scene.grid.origin
        axis.imshow(
            np.where(scene.true_grid.occupied, 0.55, 1.0), origin="lower", cmap="gray", vmin=0, vmax=1,
            extent=(corner.x, corner.x + scene.grid.size[0], corner.y, corner.y + scene.grid.size[1]),
        )  # fmt: skip
        for mover in scene.movers:
            _draw_mover(axis, mover)
        for k, navigator in enumerate(navigator for number, navigator in grouped if number == count):
            color = f"C{k}"
            result = grouped[count, navigator][0]
            axis.plot(*result.truth.poses[:, :2].T, lw=1.4, color=color, label=f"{navigator}: {result.status}")
            if not result.success:
                axis.plot(*result.truth.poses[-1, :2], "x", color=color)
        axis.set(title=f"{count} movers", xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axis.set(xlim=(corner.x, corner.x + scene.grid.size[0]), ylim=(corner.y, corner.y + scene.grid.size[1]))
        axis.legend(fontsize=7, loc="upper left")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _draw_mover(axis: Any, mover: Mover) -> None:
    """Its body at the start; its way dashed, or the circle that it walks in."""
    outline = mover.outline(mover.start)
    if len(outline) == 1:
        angles = np.linspace(0, math.tau, 33)
        outline = outline + mover.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    axis.fill(*outline.T, color="tab:purple", alpha=0.8, lw=0)
    if mover.motion == "random-walk":
        angles = np.linspace(0, math.tau, 65)
        circle = mover.start.position + mover.roam * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        axis.plot(*circle.T, ":", lw=0.6, color="tab:purple")
    else:
        axis.plot(*np.vstack([mover.start.position, mover.waypoints]).T, "--", lw=0.7, color="tab:purple")


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
