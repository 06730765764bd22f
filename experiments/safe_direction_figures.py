"""The figures of the safe-direction paper in physics.

Each world is drawn after its figure (`_safe_direction_worlds`); the car knows the goal and what its laser sees, with noise. The
paper gives no numbers: what it claims is counted here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from scipy.stats import spearmanr

from robocar.core import SE2, Array, Footprint, Robot, Scan
from robocar.core.rays import cast_rays
from robocar.core.robot import Calibration, Limits
from robocar.episode.result import RunResult
from robocar.experiments._safe_direction_worlds import FIGURES, Drawn, culdesac, middle_error, outline_clearance, path_clearance
from robocar.planners.safe_direction.method import Directions, SafeDirectionParameters
from robocar.planners.safe_direction.view import DirectionPanorama, Sector
from robocar.planners.search.transforms import descend, distance_transform, obstacle_transform
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.sim.robot_model import RobotModel

FOOTPRINT = RobotModel.load().footprint

ALPHAS = (0.0, 0.2, 0.4, 0.6, 0.8)
RANGES = (1.0, 2.0, 3.0, 4.0, 5.0)
VIEWS = (90.0, 135.0, 180.0, 225.0, 270.0)
BEST = 112.0
"""Direction of the largest N in the paper's Fig. 5 [deg]; 90 is straight ahead."""

WORLDS: dict[str, Drawn] = FIGURES | {f"culdesac-{depth:g}": culdesac(depth) for depth in (1.0, 2.0, 3.0)}
SPIRAL: dict[str, Any] = {"robot.lidar": "scan360", "robot.sonars": "none"}


def figure_4() -> tuple[Drawn, SE2]:
    """A room with its opening 22 degrees left of ahead, and where the robot stands, looking along y."""
    boxes = [(0.0, 2.6, 0.9, 4.2), (2.05, 2.3, 4.0, 4.2), (0.0, 0.0, 0.6, 2.6), (3.3, 0.0, 4.0, 2.3)]
    return Drawn((4.0, 4.2), boxes, (2.2, 0.9, math.pi / 2), (1.6, 4.0)), SE2(2.2, 0.9, math.pi / 2)


def histogram() -> tuple[Array, Array]:
    """N over the fan of Fig. 4's world: directions in the paper's degrees (90 ahead), (181,), and N [m^2], (181,)."""
    world, pose = figure_4()
    grid = world.grid()
    bearings = np.linspace(-math.pi / 2, math.pi / 2, 361)
    ranges = cast_rays(grid, grid.occupied, pose.position, pose.theta + bearings, 3.0)
    parameters = SafeDirectionParameters(view_angle=math.pi, safe_range=3.0)
    sector = Sector(math.pi, 3.0)
    panorama = DirectionPanorama(sector, parameters.resolution, 0.12)
    panorama.look(pose, Scan(0.0, ranges, bearings, 3.0), ())
    method = Directions(bare_car(FOOTPRINT), sector, parameters)
    found = method.decide(method.readings(pose, panorama), pose.theta, np.array(world.goal)).fan
    return 90.0 + np.degrees(found.headings - pose.theta), found.totals


def bare_car(outline: Footprint) -> Robot:
    """The car without sensors, for decisions outside the simulator."""
    limits = Limits(-0.2, 0.4, 1.5, 0.8, 4.0)
    return Robot(outline, limits, Calibration(0.04, np.array([0.0]), np.array([0.2])), 200)


def transform_path(world: Drawn) -> Array:
    """The distance-transform path on the whole map, obstacles grown by the robot's size (n, 2) [m]: the paper's comparison."""
    grid = world.grid()
    goal, start = (tuple(int(i) for i in grid.cell_from_world(p[:2])) for p in (world.goal, world.start))
    blocked = obstacle_transform(grid.occupied) * grid.resolution < FOOTPRINT.circumscribed_radius + 0.5 * grid.resolution
    cells = descend(distance_transform(blocked, goal, "octile"), start)  # type: ignore[arg-type]
    return grid.world_from_cell(cells)


def main(out: Path, quick: bool = False, runs: int = 20, others: int = 5) -> None:
    """Runs, tables and pictures; `runs` seeds of the paper's method in each world, `others` of all that it is compared with."""
    seeds, few = range(1 if quick else runs), range(1 if quick else others)
    report = Report(out, "Safe-direction navigation: the paper's figures in physics")
    _figure_5(report, out)
    names = ("figure-8", "figure-10") if quick else tuple(WORLDS)
    scenarios = {name: WORLDS[name].scenario(name, out / "worlds") for name in WORLDS}
    cases = {(name, n): s for name in names for n, s in (("safe-direction", seeds), ("safe-direction-memory", few))}
    _figures(report, out, cases, scenarios)
    _figure_9(report, out, scenarios["figure-9"], few, (0.0, 0.8) if quick else ALPHAS)
    _ranges(report, out, scenarios, quick)
    _ring(report, out, scenarios, names[:1] if quick else names, few)
    _cycle(report, out, range(1 if quick else 2))
    report.write()


def _figure_5(report: Report, out: Path) -> None:
    degrees, totals = histogram()
    best = float(degrees[np.argmax(totals)])
    report.number("figure-5/best_direction", best, "deg", BEST)
    report.say(f"**Figs 4 and 5.** The largest N of the fan lies at {best:.0f} degrees (the paper's: 112; 90 is straight ahead).")
    figure, axis = plt.subplots(figsize=(7, 3.2), layout="constrained")
    axis.bar(degrees, totals, width=1.0, color="tab:blue")
    axis.axvline(best, color="tab:red", lw=1)
    axis.set(xlabel="direction [deg], 90 is straight ahead", ylabel="N [m²]", title=f"Fig. 5: safest direction {best:.0f}°")
    _save(figure, out / "figure-5.png")


def _figures(report: Report, out: Path, cases: dict[tuple[str, str], range], scenarios: dict[str, dict[str, Any]]) -> None:
    jobs = [
        {"scenario": scenarios[name], "navigator": navigator, "seed": k, "out": out / "runs", "record": k == 0, "force": True}
        for (name, navigator), seeds in cases.items()
        for k in seeds
    ]
    results = iter(run_many(jobs))
    grouped = {case: list(itertools.islice(results, len(seeds))) for case, seeds in cases.items()}
    rows = []
    for (name, navigator), runs in grouped.items():
        reached = [r for r in runs if r.success]
        contacts = sum(int(r.value("contacts") or 0) for r in runs)
        path = transform_path(WORLDS[name])
        grazing = float(path_clearance(path, WORLDS[name].grid()).min())
        ours = [float(path_clearance(r.truth.poses[:, :2], WORLDS[name].grid()).min()) for r in reached]
        ratio = _mean([_ratio(r) for r in reached])
        values = {
            "success_rate": len(reached) / len(runs),
            "contacts": contacts,
            "length_over_shortest": ratio,
            "min_clearance": _mean([r.value("min_clearance") for r in reached]),
            "mean_clearance": _mean([r.value("mean_clearance") for r in reached]),
            "centre_clearance": _mean(ours),
            "centre_clearance_distance_transform": grazing,
            "outline_clearance_distance_transform": outline_clearance(path, WORLDS[name].grid(), FOOTPRINT),
        }
        if name == "corridor":
            values["middle_rms"] = _mean([float(np.sqrt(np.mean(middle_error(r.truth.poses[:, :2]) ** 2))) for r in reached])
            report.say(
                f"Corridor of 1 m, `{navigator}`: {values['middle_rms']} m RMS from the middle line on its straight stretches."
            )
        for key, value in values.items():
            report.number(
                f"{name}/{navigator}/{key}", value, "1" if key in ("success_rate", "contacts", "length_over_shortest") else "m"
            )
        rows.append((name, navigator, f"{len(reached)}/{len(runs)}", *list(values.values())[1:8]))
        if name == "figure-9":
            _verdict(report, navigator, values)
    report.table(
        ("world", "navigator", "reached", "contacts", "way / shortest", "min clearance [m]", "mean clearance [m]",
         "least of the centre [m]", "distance transform's centre [m]", "and outline [m]"),
        rows,
        "Laser of 205 degrees with noise, default parameters (alpha 0.6). Clearances are the "
        "outline's, then the least of the robot's centre; the last two columns are those of the distance-transform path on the "
        "whole map.",
    )  # fmt: skip
    names = list(dict.fromkeys(name for name, _ in cases))
    figure, axes = plt.subplots(
        math.ceil(len(names) / 3), min(3, len(names)), figsize=(15, 4.2 * math.ceil(len(names) / 3)), squeeze=False
    )
    for axis, name in zip(axes.flat, names, strict=False):
        _draw(axis, WORLDS[name], name)
        axis.plot(*transform_path(WORLDS[name]).T, "k--", lw=1, label="distance transform, whole map")
        for navigator, color in (("safe-direction", "tab:blue"), ("safe-direction-memory", "tab:red")):
            for k, result in enumerate(grouped[name, navigator]):
                axis.plot(*result.truth.poses[:, :2].T, color=color, lw=0.8, alpha=0.6, label=None if k else navigator)
    axes.flat[0].legend(fontsize=7)
    _save(figure, out / "figures.png")


def _verdict(report: Report, navigator: str, values: dict[str, Any]) -> None:
    """Fig. 9 at alpha 0.6: at least twice the clearance of the distance-transform path, at most 1.4 times the shortest way."""
    if values["min_clearance"] is None:
        report.say(f"Fig. 9, `{navigator}`: never reached.")
        return
    centre = values["centre_clearance"] / values["centre_clearance_distance_transform"]
    outline = values["min_clearance"] / values["outline_clearance_distance_transform"]
    length = values["length_over_shortest"]
    report.number(f"figure-9/{navigator}/centre_clearance_over_distance_transform", centre, "1", 2.0)
    report.number(f"figure-9/{navigator}/outline_clearance_over_distance_transform", outline, "1", 2.0)
    met = centre >= 2.0 and outline >= 2.0 and length <= 1.4
    report.say(
        f"**Fig. 9, alpha 0.6, `{navigator}`: target {'met' if met else 'missed'}.** Least clearance over that of the "
        f"distance-transform path: {centre:.2f} (centre), {outline:.2f} (outline), target 2; way over the shortest: "
        f"{length:.2f}, target at most 1.4."
    )


def _ring(report: Report, out: Path, scenarios: dict[str, dict[str, Any]], names: Sequence[str], seeds: range) -> None:
    """The paper's sensor of limited range as a ring of 16 sonars with cones of 15 degrees, without a laser."""
    jobs = [
        _job({**scenarios[name], "robot": {"lidar": "none", "sonars": "ring"}}, k, out / "ring", {})
        for name in names
        for k in seeds
    ]
    results = run_many(jobs)
    rows = []
    figure, axes = plt.subplots(
        math.ceil(len(names) / 3), min(3, len(names)), figsize=(15, 4.2 * math.ceil(len(names) / 3)), squeeze=False
    )
    for i, (axis, name) in enumerate(zip(axes.flat, names, strict=False)):
        runs = results[i * len(seeds) : (i + 1) * len(seeds)]
        reached = [r for r in runs if r.success]
        contacts = sum(int(r.value("contacts") or 0) for r in runs)
        ratio, clearance = _mean([_ratio(r) for r in reached]), _mean([r.value("min_clearance") for r in reached])
        failed = ", ".join(f"seed {k}: {r.status}" for k, r in zip(seeds, runs, strict=True) if not r.success)
        report.number(f"ring/{name}/success_rate", len(reached) / len(runs), "1")
        report.number(f"ring/{name}/contacts", contacts, "1")
        report.number(f"ring/{name}/length_over_shortest", ratio, "1")
        rows.append((name, f"{len(reached)}/{len(runs)}", contacts, ratio, clearance, failed or "–"))
        _draw(axis, WORLDS[name], f"{name}, ring of 16 sonars")
        for result in runs:
            axis.plot(*result.truth.poses[:, :2].T, color="tab:blue" if result.success else "tab:red", lw=0.8)
    report.table(
        ("world", "reached", "contacts", "way / shortest", "min clearance [m]", "the rest"),
        rows,
        f"A ring of 16 sonars of 15 degrees instead of the laser, `safe-direction`, {len(seeds)} seeds each.",
    )
    _save(figure, out / "ring.png")


def _figure_9(report: Report, out: Path, scenario: dict[str, Any], seeds: range, alphas: Sequence[float]) -> None:
    """Clearance and length over alpha, with and without the rule of eq. 15; alpha 1 in the paper's own rule ignores the goal."""
    cases = [(alpha, delta) for delta in (0.95, 1.0) for alpha in alphas]
    jobs = [_job(scenario, k, out, {"alpha": a, "delta": d}) for a, d in cases for k in seeds]
    ignoring = _job(scenario, 0, out, {"alpha": 1.0, "delta": 1.0, "safe_sector": math.tau, "approach_distance": 0.0})
    results = run_many([*jobs, ignoring])
    *results, ignored = results
    grouped = {case: results[i * len(seeds) : (i + 1) * len(seeds)] for i, case in enumerate(cases)}
    rows = []
    figure, axes = plt.subplots(1, 3, figsize=(17, 4), layout="constrained")
    for axis, delta in zip(axes, (0.95, 1.0), strict=False):
        _draw(axis, FIGURES["figure-9"], f"Fig. 9, delta {delta:g}")
        for alpha in alphas:
            for k, result in enumerate(grouped[alpha, delta]):
                axis.plot(
                    *result.truth.poses[:, :2].T,
                    color=plt.get_cmap("viridis")(alpha),
                    lw=0.9,
                    label=None if k else f"α = {alpha:g}",
                )
        axis.legend(fontsize=7)
    axes[0].plot(*ignored.truth.poses[:, :2].T, color="tab:red", lw=0.9)
    for delta in (0.95, 1.0):
        means = {a: _mean([r.value("mean_clearance") for r in grouped[a, delta]]) for a in alphas}
        for a in alphas:
            runs = grouped[a, delta]
            values = {
                "reached": sum(r.success for r in runs) / len(runs),
                "mean_clearance": means[a],
                "min_clearance": _mean([r.value("min_clearance") for r in runs]),
                "length_over_shortest": _mean([_ratio(r) for r in runs if r.success]),
            }
            for key, value in values.items():
                report.number(f"figure-9/alpha_{a:g}/delta_{delta:g}/{key}", value, "m" if "clearance" in key else "1")
            rows.append((f"{a:g}", f"{delta:g}", *values.values()))
        pairs = [(a, float(r.value("mean_clearance") or 0.0)) for a in alphas for r in grouped[a, delta]]
        rank = float(spearmanr(*zip(*pairs, strict=True)).statistic)  # type: ignore[attr-defined]
        report.number(f"figure-9/delta_{delta:g}/rank_correlation", rank, "1", 1.0)
        axes[2].plot(alphas, [means[a] for a in alphas], "o-", label=f"mean clearance [m], delta {delta:g}")
    report.number("figure-9/alpha_1/success", int(ignored.success), "1", 0)
    report.table(
        ("alpha", "delta", "reached", "mean clearance [m]", "min clearance [m]", "way / shortest"),
        rows,
        f"Fig. 9, {len(seeds)} seeds each; at delta 1 the rule of eq. 15 is off.",
    )
    report.say(
        f"alpha = 1 with the paper's own choice of the safest direction ignores the goal: {ignored.status} ({ignored.reason})."
    )
    axes[2].set(xlabel="α")
    axes[2].legend(fontsize=7)
    _save(figure, out / "figure-9.png")


def _ranges(report: Report, out: Path, scenarios: dict[str, dict[str, Any]], quick: bool) -> None:
    """The paper's claim that the range matters little, and the same for the view angle."""
    names = ("figure-8",) if quick else ("figure-8", "figure-9", "figure-10", "figure-11", "figure-12")
    settings: list[tuple[str, dict[str, Any]]] = [
        (f"range {r:g} m", {"max_range": r}) for r in (RANGES[::4] if quick else RANGES)
    ]
    settings += [(f"view {v:g} deg", {"view_angle": math.radians(v)}) for v in (VIEWS[2:3] if quick else VIEWS)]
    jobs = [
        _job({**scenarios[name], "robot": {"lidar": "scan360", "sonars": "none"}}, 0, out, extra) | {"record": False}
        for _, extra in settings
        for name in names
    ]
    results = run_many(jobs)
    rows = []
    for i, (label, _) in enumerate(settings):
        runs = results[i * len(names) : (i + 1) * len(names)]
        reached, ratio = sum(r.success for r in runs), _mean([_ratio(r) for r in runs if r.success])
        clearance = _mean([r.value("mean_clearance") for r in runs])
        report.number(f"sensor/{label.replace(' ', '_')}/success_rate", reached / len(runs), "1")
        report.number(f"sensor/{label.replace(' ', '_')}/length_over_shortest", ratio, "1")
        failed = ", ".join(f"{n}: {r.status}" for n, r in zip(names, runs, strict=True) if not r.success)
        rows.append((label, f"{reached}/{len(runs)}", ratio, clearance, failed or "–"))
    report.table(
        ("sensor", "reached", "way / shortest", "mean clearance [m]", "failed"),
        rows,
        f"Range and view angle on {', '.join(names)}, seed 0.",
    )


def _cycle(report: Report, out: Path, seeds: range) -> None:
    """A world in which a method without a memory goes in circles: why it turned back gets out of sight too soon."""
    navigators = ("safe-direction", "safe-direction-memory")
    jobs = [
        {"scenario": "spiral", "navigator": n, "seed": k, "out": out / "runs", "record": k == 0, "force": True,
         "estimator": "truth", "settings": SPIRAL}
        for n in navigators
        for k in seeds
    ]  # fmt: skip
    results = run_many(jobs)
    rows = []
    for i, navigator in enumerate(navigators):
        runs = results[i * len(seeds) : (i + 1) * len(seeds)]
        reached, stuck = (sum(r.status == status for r in runs) for status in ("success", "stuck"))
        report.number(f"spiral/{navigator}/success_rate", reached / len(runs), "1")
        report.number(f"spiral/{navigator}/stuck_rate", stuck / len(runs), "1")
        rows.append((navigator, f"{reached}/{len(runs)}", f"{stuck}/{len(runs)}", runs[0].reason))
    report.table(
        ("navigator", "reached", "stuck", "reason, seed 0"), rows, "The shipped scenario `spiral`, laser of 360 degrees."
    )


def _job(scenario: dict[str, Any], seed: int, out: Path, navigator: dict[str, Any]) -> dict[str, Any]:
    settings = {f"navigator.{key}": value for key, value in navigator.items()}
    return {
        "scenario": scenario,
        "navigator": "safe-direction",
        "seed": seed,
        "out": out / "runs",
        "record": seed == 0,
        "force": True,
        "settings": settings,
    }


def _ratio(result: RunResult) -> float | None:
    length, shortest = result.value("path_length"), result.value("shortest_path_length")
    return length / shortest if length is not None and shortest else None


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _draw(axis: Axes, world: Drawn, title: str) -> None:
    grid = world.grid()
    axis.imshow(
        np.where(grid.occupied, 0.35, 1.0), cmap="gray", vmin=0, vmax=1, origin="lower", extent=(0, grid.size[0], 0, grid.size[1])
    )
    axis.plot(*world.start[:2], "o", color="black", ms=5)
    axis.plot(*world.goal, "*", color="tab:orange", ms=12)
    axis.set_title(title, fontsize=10)


def _save(figure: Any, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
