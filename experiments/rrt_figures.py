"""RRT alone and RRT with the Dynamic Window Approach: Figs 10 to 13 of Izaty and Lubis, AGV path planning by RRT and DWA.

Fig. 10: the tree of RRT alone on a warehouse map (theirs is not published; this is ours), with the settings of their run: at most
10 000 samples, step 0.5. Figs 11 to 13: the same trees driven in physics, by pure pursuit (RRT alone) and by DWA over a local
costmap, where the map is true, where obstacles stand that it does not show, and where some move as well. The claim tested: the
combination reaches the goal without collision among moving obstacles, on a smoother path than RRT alone. A* under DWA and MPPI,
and RRT with shortcuts, run beside them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from robocar.core import Array, NoPathFound
from robocar.episode.result import RunResult
from robocar.paths import MODELS
from robocar.planners.costmap.layered import inflate
from robocar.planners.sampling.random_trees import Growth
from robocar.planners.sampling.rrt import RrtParameters, costmap_world, path_cost, search
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

TABLE_1 = RrtParameters(variant="rrt", step=0.5, max_samples=10_000, adaptive_step=False, shortcuts=0)
_AS_TABLE_1 = {
    f"navigator.planner.{name}": getattr(TABLE_1, name)
    for name in ("variant", "step", "max_samples", "adaptive_step", "shortcuts")
}
DRIVERS: dict[str, tuple[str, dict[str, Any]]] = {
    "RRT alone (pure pursuit)": ("rrt-pursuit", _AS_TABLE_1),
    "RRT + DWA": ("rrt-dwa", _AS_TABLE_1),
    "RRT with shortcuts + DWA": ("rrt-dwa", {}),
    "A* + DWA": ("a-star-dwa", {}),
    "A* + MPPI": ("a-star-mppi", {}),
}
WORLDS = ("mapped", "unmapped", "moving")
MOVER_SPEED = 0.3  # [m/s]
# Ways that movers go to and fro on, ends first: the aisles and the cross aisles.
_LEGS = (
    ((5.4, 0.6), (5.4, 3.0)),
    ((1.9, 2.8), (6.2, 2.8)),
    ((4.0, 4.8), (8.6, 4.8)),
    ((9.7, 0.8), (9.7, 4.4)),
    ((0.75, 2.0), (0.75, 9.0)),
    ((10.2, 6.8), (8.5, 6.8)),
)


def world(kind: str, seed: int) -> dict[str, Any]:
    """The warehouse as a scenario. `mapped`: nothing stands that the map does not show; `unmapped`: as shipped; `moving`: six
    movers besides, each starting somewhere on its way (by the seed)."""
    scenario = yaml.safe_load((MODELS / "scenarios" / "warehouse.yaml").read_text())
    scenario |= {"name": f"warehouse-{kind}", "map": str((MODELS / scenario["map"]).resolve())}
    if kind == "mapped":
        del scenario["unknown_obstacles"]
    if kind == "moving":
        rng = np.random.default_rng(seed)
        scenario["robot"] = {"lidar": "scan360"}  # movers come from behind too
        scenario["movers"] = [_mover(i, np.array(leg), rng) for i, leg in enumerate(_LEGS)]
    return scenario


def _mover(i: int, leg: Array, rng: np.random.Generator) -> dict[str, Any]:
    start = leg[0] + rng.uniform() * (leg[1] - leg[0])
    ends = leg if rng.uniform() < 0.5 else leg[::-1]
    body = {"cylinder": [0.15, 0.4]} if i % 2 else {"box": [0.3, 0.3, 0.4]}
    return {"name": f"mover{i}", **body, "waypoints": [start.tolist(), *ends.tolist()], "speed": MOVER_SPEED}


def smoothness(points: Array) -> float:
    """OMPL's `PathGeometric::smoothness` of a polyline (n, 2) [m]: sum over its corners of (2 turn / (a + b))^2, with a and b the
    segments that meet there [1/m^2]. 0 is straight."""
    steps = np.diff(points, axis=0)
    steps = steps[np.linalg.norm(steps, axis=1) > 1e-9]
    lengths, headings = np.linalg.norm(steps, axis=1), np.arctan2(steps[:, 1], steps[:, 0])
    turns = np.remainder(np.diff(headings) + math.pi, math.tau) - math.pi
    return float(np.sum((2.0 * turns / (lengths[1:] + lengths[:-1])) ** 2))


def driven(result: RunResult, spacing: float = 0.1) -> Array:
    """Positions of a run every `spacing` metres, (n, 2) [m]."""
    points = [result.truth.poses[0, :2]]
    for point in result.truth.poses[:, :2]:
        if math.dist(point, points[-1]) >= spacing:
            points.append(point)
    return np.array(points)


def main(out: Path = Path("runs/rrt_figures"), quick: bool = False) -> None:
    """Writes `summary.json`, `report.md` and pictures to `out`; `quick`: one seed, RRT only."""
    report = Report(out, "RRT alone, and with the Dynamic Window Approach")
    out.mkdir(parents=True, exist_ok=True)
    seeds = range(1 if quick else 20)
    scene = Scene.load(load_scenario("warehouse"), RobotModel.load().footprint)
    grown = trees(report, scene, seeds)
    drivers = dict(list(DRIVERS.items())[:2]) if quick else DRIVERS
    cases = [(kind, driver) for kind in WORLDS for driver in drivers]
    jobs = [
        {
            "scenario": world(kind, seed),
            "navigator": DRIVERS[driver][0],
            "seed": seed,
            "settings": DRIVERS[driver][1],
            "out": out / "runs",
            "record": seed == 0,
            "force": True,
        }
        for kind, driver in cases
        for seed in seeds
    ]
    results = run_many(jobs)
    grouped = {case: results[k * len(seeds) : (k + 1) * len(seeds)] for k, case in enumerate(cases)}
    table(report, grouped, len(seeds))
    report.write()
    picture(out / "fig_11_to_13.png", scene, grown[0], grouped)


def trees(report: Report, scene: Scene, seeds: range) -> list[Growth]:
    """Fig. 10: RRT alone on the map, without obstacles that it does not show; returns the trees."""
    assert scene.goal is not None
    assert scene.prior is not None
    costmap = inflate(scene.prior, RobotModel.load().footprint.inscribed_radius)
    obstacles, r = costmap_world(costmap), costmap.resolution
    start, goal = costmap.grid_from_world([scene.start.position, scene.goal.position])
    rows, all_grown = [], []
    variants = {
        "Table 1": TABLE_1,
        "with shortcuts": RrtParameters(max_samples=10_000),
        "RRT-Connect": RrtParameters(variant="rrt-connect", max_samples=10_000, shortcuts=0),
        "RRT*, 10 000 samples": RrtParameters(variant="rrt-star", max_samples=10_000, shortcuts=0),
    }
    for name, p in variants.items():
        in_cells = replace(p, step=p.step / r, goal_tolerance=p.goal_tolerance / r)
        grown = [search(obstacles, start, goal, in_cells, np.random.default_rng(seed)) for seed in seeds]
        all_grown += grown
        found = [g for g in grown if len(g.path)]
        if not found:
            raise NoPathFound(f"{name}: no tree reached the goal of {scene.scenario.name}")
        lengths = [float(np.linalg.norm(np.diff(g.path * r, axis=0), axis=1).sum()) for g in found]
        values = {
            "length": float(np.mean(lengths)),
            "cost": float(np.mean([path_cost(obstacles, g.path) * r for g in found])),
            "samples": float(np.median([g.samples for g in found])),
            "smoothness": float(np.mean([smoothness(g.path * r) for g in found])),
        }
        tag = name.lower().replace(" ", "_").replace(",", "").replace("*", "_star")
        report.number(f"fig_10/{tag}/success_rate", len(found) / len(seeds), "1")
        for key, unit in (("length", "m"), ("cost", "m"), ("samples", "1"), ("smoothness", "1/m^2")):
            report.number(f"fig_10/{tag}/{key}", values[key], unit)
        rows.append((name, f"{len(found)}/{len(seeds)}", *(f"{v:.4g}" for v in values.values())))
    report.table(
        ("planner", "found", "length [m]", "cost [m]", "samples, median", "smoothness [1/m^2]"),
        rows,
        f"Fig. 10: planned paths on the warehouse map, {len(seeds)} seeds. The paper: at most 10 000 samples, step 0.5, cost"
        " 44.0752 on a map that is not published.",
    )
    return all_grown


def table(report: Report, grouped: dict[tuple[str, str], list[RunResult]], seeds: int) -> None:
    """Figs 11 to 13 in numbers."""
    rows = []
    for (kind, driver), runs in grouped.items():
        reached = [run for run in runs if run.success]
        touched = sum(run.status == "collision" for run in runs)
        tag = f"{kind}/{driver.lower().replace(' ', '_')}"
        report.number(f"{tag}/success_rate", len(reached) / seeds, "1")
        report.number(f"{tag}/collision_rate", touched / seeds, "1")
        means: list[float | None] = []
        for name, unit in (("duration", "s"), ("path_length", "m"), ("angle_over_length", "rad/m"), ("jerk_rms", "m/s^3")):
            values = [value for run in reached if (value := run.value(name)) is not None]
            means.append(float(np.mean(values)) if values else None)
            report.number(f"{tag}/{name}", means[-1], unit)
        means.append(float(np.mean([smoothness(driven(run)) for run in reached])) if reached else None)
        report.number(f"{tag}/smoothness", means[-1], "1/m^2")
        shown = (None if mean is None else f"{mean:.3g}" for mean in means)
        rows.append((kind, driver, f"{len(reached)}/{seeds}", touched, *shown))
    report.table(
        ("world", "driven by", "reached", "collisions", "time [s]", "path [m]", "angle / length [rad/m]", "jerk [m/s^3]",
         "smoothness [1/m^2]"),
        rows,
        f"Figs 11 to 13: the warehouse in physics, {seeds} seeds; means over the runs that reached the goal. RRT with the"
        f" settings of Table 1 unless it has shortcuts. Movers go at {MOVER_SPEED} m/s and give way to nobody.",
    )  # fmt: skip


def picture(path: Path, scene: Scene, grown: Growth, grouped: dict[tuple[str, str], list[RunResult]]) -> None:
    """The tree (blue) and its path (red) of Fig. 10; then what was driven (green, red where it failed) in each world."""
    drivers = list(dict.fromkeys(driver for _, driver in grouped))[:2]
    figure, axes = plt.subplots(1 + len(drivers), len(WORLDS), figsize=(13, 3.9 * (1 + len(drivers))), layout="constrained")
    r, costmap = scene.grid.resolution, scene.grid
    for axis in axes[0]:
        axis.axis("off")
    first = axes[0, 0]
    first.axis("on")
    children = np.flatnonzero(grown.tree.parents >= 0)
    edges = np.stack([grown.tree.nodes[grown.tree.parents[children]], grown.tree.nodes[children]], axis=1)
    _walls(first, scene, solids=False)
    scale = inflate(scene.prior, RobotModel.load().footprint.inscribed_radius).resolution if scene.prior is not None else r
    first.add_collection(LineCollection(list(costmap.origin.transform(edges * scale)), colors="tab:blue", lw=0.5))
    first.plot(*costmap.origin.transform(grown.path * scale).T, color="tab:red", lw=1.8)
    first.set_title(f"Fig. 10: RRT, {grown.samples} samples", fontsize=9)
    for row, driver in enumerate(drivers, start=1):
        for axis, kind in zip(axes[row], WORLDS, strict=True):
            runs = grouped[kind, driver]
            _walls(axis, scene, solids=kind != "mapped")
            if kind == "moving":
                for leg in _LEGS:
                    axis.plot(*np.array(leg).T, color="tab:orange", lw=6, alpha=0.3)
            for run in runs:
                axis.plot(*run.truth.poses[:, :2].T, lw=0.9, color="tab:green" if run.success else "tab:red")
            axis.set_title(f"{driver}, {kind}: {sum(run.success for run in runs)}/{len(runs)}", fontsize=9)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _walls(axis: Axes, scene: Scene, solids: bool) -> None:
    width, height = scene.grid.size
    image = np.where(scene.grid.occupied, 0.3, 1.0)
    axis.imshow(image, cmap="gray", vmin=0, vmax=1, origin="lower", extent=(0.0, width, 0.0, height))
    for solid in scene.solids if solids else ():
        axis.fill(*solid.outline().T, color="tab:brown", alpha=0.6)
    assert scene.goal is not None
    axis.plot(scene.start.x, scene.start.y, "o", color="tab:blue")
    axis.plot(*scene.goal.position, "*", color="tab:orange", ms=11)
    axis.set(aspect="equal", xlim=(0, width), ylim=(0, height))


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
