"""Replanning in physics: Dynamic A*, A* from scratch and D* Lite on the same worlds, unknown to the car in part or in whole.

Thesis field, offices and warehouse come with a prior map that lacks some obstacles; the generated rooms, caves and mazes come
with none, and each seed has its own. All three navigators carry the same sensors. The searches are compared by the cells that
they expand; the time is that of the whole tick in which a navigator replans: marking what is seen, planning and following.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

from robocar.core import LETHAL, Array, Costmap, OccupancyGrid
from robocar.core.distance import obstacle_distance
from robocar.episode.result import RunResult
from robocar.formats import save_ros_map
from robocar.formats.generated import cave, maze, rooms
from robocar.planners.search.a_star import AStar
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

NAVIGATORS = {"dynamic-a-star": "tab:orange", "a-star": "tab:blue", "d-star-lite": "tab:green"}
PARTLY_KNOWN = ("thesis-field", "office-plan", "warehouse")
UNKNOWN = ("rooms", "cave", "maze")
ROOM = 0.35  # [m] from start and goal of a generated world, and of one way between them, to the nearest wall
CANDIDATES = 40  # goals that are drawn for each generated world; the farthest is taken
VALUES = {
    "replans": "1",
    "expanded_first": "1",
    "expanded_per_replan": "1",
    "expanded_per_run": "1",
    "replanning_tick": "ms",
    "path_length": "m",
    "path_over_shortest": "1",
    "duration": "s",
}


@dataclass(frozen=True, slots=True, eq=False)
class Plans:
    """The plans of one run, the first one included: cells expanded (n,), and time of the tick (n,) [s]."""

    expanded: Array
    ticks: Array


def generated_world(kind: str, seed: int, folder: Path) -> dict[str, Any]:
    """A scenario without a prior map; its map is written to `folder`.

    Start and goal are far apart, and there is a way between them that keeps `ROOM` to the walls, wide enough for cells of 30 cm.
    Maps without two such places are drawn again.
    """
    rng = np.random.default_rng(seed)
    draw = {"rooms": _rooms, "cave": _cave, "maze": _maze}[kind]
    grid = draw(rng)
    while (ends := far_apart(grid, rng)) is None:
        grid = draw(rng)
    start, goal = ends
    folder.mkdir(parents=True, exist_ok=True)
    save_ros_map(grid, folder / f"{kind}-{seed}")
    return {
        "name": f"unknown-{kind}",
        "map": str((folder / f"{kind}-{seed}.yaml").resolve()),
        "prior": "none",
        "start": [*start.tolist(), 0.0],
        "goal": goal.tolist(),
        "robot": {"lidar": "scan360"},
        "time_limit": 600.0,
    }


def _rooms(rng: np.random.Generator) -> OccupancyGrid:
    return rooms(160, 160, rng, smallest=30, door=15)


def _cave(rng: np.random.Generator) -> OccupancyGrid:
    return cave(80, 80, rng, resolution=0.10, density=0.42)


def _maze(rng: np.random.Generator) -> OccupancyGrid:
    return maze(25, 25, 3, rng, resolution=0.30)


def far_apart(grid: OccupancyGrid, rng: np.random.Generator) -> tuple[Array, Array] | None:
    """Start and goal (2,) [m]: of `CANDIDATES` random goals with room, the one with the longest way from a random start.

    None where no way is longer than the map is wide.
    """
    roomy = obstacle_distance(grid.occupied, grid.resolution) >= ROOM
    costmap = Costmap(np.where(roomy, 0, LETHAL).astype(np.uint8), grid.resolution, grid.origin)
    cells, planner = np.argwhere(roomy), AStar()
    if len(cells) == 0:
        return None
    start, *goals = ((int(row), int(col)) for row, col in rng.choice(cells, CANDIDATES + 1))
    searches = [planner.search(costmap, start, goal) for goal in goals]
    ways = [-1.0 if search.cells is None else search.cost for search in searches]
    longest = int(np.argmax(ways))
    if ways[longest] <= max(grid.size):
        return None
    return costmap.world_from_cell(start), costmap.world_from_cell(goals[longest])


def plans_of(result: RunResult) -> Plans:
    """What the run says of its plans."""
    plans = [effort for effort in result.efforts if "expansions" in effort.work]
    return Plans(np.array([plan.work["expansions"] for plan in plans], dtype=float), np.array([plan.seconds for plan in plans]))


def main(out: Path, quick: bool = False) -> None:
    """Runs, tables and pictures; `quick` takes one seed on two worlds."""
    seeds = range(1 if quick else 10)
    known, unknown = (("warehouse",), ("maze",)) if quick else (PARTLY_KNOWN, UNKNOWN)
    worlds: dict[str, list[str | Mapping[str, Any]]] = {name: [name] * len(seeds) for name in known}
    worlds |= {f"unknown-{kind}": [generated_world(kind, seed, out / "worlds") for seed in seeds] for kind in unknown}
    jobs = [
        {
            "scenario": scenario,
            "navigator": navigator,
            "estimator": "truth",
            "mapper": "none",
            "seed": seed,
            "out": out / "runs",
            "force": True,
        }
        for scenarios in worlds.values()
        for navigator in NAVIGATORS
        for seed, scenario in zip(seeds, scenarios, strict=True)
    ]
    results = iter(run_many(jobs))
    grouped = {(world, navigator): [next(results) for _ in seeds] for world in worlds for navigator in NAVIGATORS}
    plans = {case: [plans_of(result) for result in runs] for case, runs in grouped.items()}
    for runs in grouped.values():
        for result in runs[1:]:  # the recording of seed 0 is kept to look at
            assert result.recording is not None
            result.recording.unlink()

    report = Report(out, "Replanning on worlds that the car does not know")
    rows = []
    for (world, navigator), runs in grouped.items():
        values = summary(runs, plans[world, navigator])
        reached, contacts = sum(r.success for r in runs), sum(int(r.value("contacts") or 0) for r in runs)
        report.number(f"{world}/{navigator}/success_rate", reached / len(runs), "1")
        report.number(f"{world}/{navigator}/contacts", contacts, "1")
        for name, unit in VALUES.items():
            report.number(f"{world}/{navigator}/{name}", values[name], unit)
        numbers = [f"{value:.0f}" if value is not None and value >= 100 else value for value in values.values()]
        rows.append((world, navigator, f"{reached}/{len(runs)}", contacts, *numbers))
    report.table(
        (
            "world", "navigator", "reached", "contacts", "replans", "expanded, first plan", "expanded, each replan",
            "expanded, whole run", "tick of a replan [ms]", "path [m]", "path / shortest", "time [s]",
        ),
        rows,
        f"{len(seeds)} seeds each, pose oracle. First plan, each replan and its tick: medians over all plans; the others: means "
        "over the runs, path and time over those that reached the goal. The shortest path is that of the inscribed disc on the "
        "true map.",
    )  # fmt: skip
    report.say(
        "Dynamic A* searches cells of 30 cm, the others cells of 5 cm (36 times as many for the same floor) with costs for "
        "nearness. A* searches from the car and D* Lite from the goal to the car, so that a change near the car leaves most of "
        "the search valid; where the car has to come out of a dead end, much of it changes."
    )
    report.write()
    _paths(out / "paths.png", worlds, grouped)
    _expansions(out / "expansions.png", plans)


def summary(runs: list[RunResult], plans: list[Plans]) -> dict[str, float | None]:
    """The `VALUES` of the runs of one navigator on one world."""
    reached = [r for r in runs if r.success]
    ratios = [
        length / shortest
        for r in reached
        if (length := r.value("path_length")) is not None and (shortest := r.value("shortest_path_length"))
    ]
    return {
        "replans": _mean([r.value("replans") for r in runs]),
        "expanded_first": _median([p.expanded[:1] for p in plans]),
        "expanded_per_replan": _median([p.expanded[1:] for p in plans]),
        "expanded_per_run": _mean([float(p.expanded.sum()) for p in plans]),
        "replanning_tick": _median([1e3 * p.ticks[1:] for p in plans]),
        "path_length": _mean([r.value("path_length") for r in reached]),
        "path_over_shortest": _mean(ratios),
        "duration": _mean([r.value("duration") for r in reached]),
    }


def _mean(values: list[Any]) -> float | None:
    values = [value for value in values if value is not None]
    return float(np.mean(values)) if values else None


def _median(values: list[Array]) -> float | None:
    together = np.concatenate(values)
    return float(np.median(together)) if len(together) else None


def _paths(path: Path, worlds: Mapping[str, list[Any]], grouped: Mapping[tuple[str, str], list[RunResult]]) -> None:
    """Where each navigator drove on each world, seed 0."""
    columns = min(3, len(worlds))
    rows = -(-len(worlds) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.6 * columns, 4.2 * rows), layout="constrained", squeeze=False)
    for axis, (world, scenarios) in zip(axes.flat, worlds.items(), strict=False):
        _draw_world(axis, Scene.load(load_scenario(scenarios[0]), RobotModel.load().footprint))
        for navigator, color in NAVIGATORS.items():
            result = grouped[world, navigator][0]
            style = "-" if result.success else ":"
            axis.plot(*result.truth.poses[:, :2].T, style, lw=1.3, color=color, label=f"{navigator}: {result.status}")
        axis.set_title(world, fontsize=10)
        axis.legend(fontsize=6, loc="best")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _draw_world(axis: Axes, scene: Scene) -> None:
    """Walls; those that the prior map lacks are red."""
    grid = scene.true_grid
    colors = np.ones((*grid.shape, 3))
    colors[grid.occupied] = 0.45
    if scene.prior is not None and scene.prior.same_place(grid):
        colors[grid.occupied & ~scene.prior.occupied] = (0.85, 0.35, 0.30)
    image = axis.imshow(colors, origin="lower", extent=(0, grid.size[0], 0, grid.size[1]))
    image.set_transform(Affine2D().rotate(grid.origin.theta).translate(grid.origin.x, grid.origin.y) + axis.transData)
    corners = grid.corners()
    axis.plot(*np.vstack([corners, corners[:1]]).T, color="black", lw=1)
    assert scene.goal is not None
    axis.plot(scene.start.x, scene.start.y, "o", color="tab:blue")
    axis.plot(*scene.goal.position, "*", color="tab:red", ms=12)
    axis.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")


def _expansions(path: Path, plans: Mapping[tuple[str, str], list[Plans]]) -> None:
    """Cells expanded by every replanning, as points, and their median."""
    worlds = list(dict.fromkeys(world for world, _ in plans))
    figure, axis = plt.subplots(figsize=(1.8 * len(worlds) + 1.5, 4.0), layout="constrained")
    for k, (navigator, color) in enumerate(NAVIGATORS.items()):
        for i, world in enumerate(worlds):
            expanded = np.concatenate([p.expanded[1:] for p in plans[world, navigator]])
            at = i + 0.25 * (k - 1)
            spread = np.linspace(-0.08, 0.08, len(expanded)) if len(expanded) > 1 else np.zeros(len(expanded))
            axis.plot(at + spread, np.maximum(expanded, 1), ".", ms=3, color=color, alpha=0.5)
            if len(expanded):
                axis.plot([at - 0.1, at + 0.1], [np.median(expanded)] * 2, color=color, lw=2)
        axis.plot([], [], color=color, lw=2, label=navigator)
    axis.set(yscale="log", xticks=range(len(worlds)), ylabel="cells expanded by each replanning")
    axis.set_xticklabels(worlds, fontsize=8)
    axis.legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
