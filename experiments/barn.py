"""BARN, the benchmark of metric ground navigation: 50 fields of cylinders, no map, a laser (Perille et al. 2020).

Where `$ROBOCAR_DATA/barn` (else `../shared/data/barn` beside the project) is present the worlds are the challenge's 50 test
worlds, else as many of the same family, made here; the report says which. Start, goal, success (within 1 m of the goal, no
collision, within 100 s) and score are the challenge's; the robot is ours, smaller and slower than its Jackal. Its pose is known.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import yaml
from matplotlib.patches import Circle
from scipy.stats import spearmanr

from robocar.episode.registry import names
from robocar.episode.result import RunResult
from robocar.formats import load_barn_cylinders, load_barn_index, load_barn_paths, save_barn_world
from robocar.formats.barn import GOAL, START, BarnReference, BarnWorld
from robocar.formats.barn_difficulty import Difficulty, difficulty
from robocar.formats.barn_generator import PARAMETER_SETS, generate_barn_world
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many

NAVIGATORS = (
    "a-star", "theta-star", "d-star-lite", "rrt-dwa", "a-star-dwa", "theta-star-dwa", "a-star-mppi", "safe-direction",
    "safe-direction-memory", "ocpb", "tangent-bug", "harmonic", "path-transform",
)  # fmt: skip
ALL_ROUND = ("ocpb", "tangent-bug")
"""Those that need a laser all round: they get `scan360`."""
TIME_LIMIT, SUCCESS_RADIUS = 100.0, 1.0  # [s], [m] of the challenge
CHALLENGE_DWA = {"success": 0.88, "score": 0.169}
"""The challenge's own DWA example, with a Jackal."""
COLORS = plt.get_cmap("tab20")
METRICS = {
    "closest_obstacle": "closest obstacle [m]",
    "visibility": "visibility [m]",
    "dispersion": "dispersion",
    "characteristic_dimension": "characteristic dimension [m]",
    "tortuosity": "tortuosity",
}
"""The benchmark's difficulty metrics (`robocar.formats.barn_difficulty`), and how the tables name them."""
ENOUGH = 5  # worlds for a correlation


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A world of the benchmark, its reference numbers, how difficult it is, and the scenario file of its task."""

    name: str
    world: BarnWorld
    reference: BarnReference
    difficulty: Difficulty
    scenario: Path


def score(success: bool, time: float | None, optimal_time: float) -> float:
    """s = S OT / clip(AT, 2 OT, 8 OT): success, optimal and actual time [s] (The BARN Challenge, rules)."""
    if not success or time is None:
        return 0.0
    return optimal_time / min(max(time, 2.0 * optimal_time), 8.0 * optimal_time)


def courses(folder: Path, quick: bool) -> tuple[list[Course], str]:
    """The worlds, written to `folder` with their scenarios, and where they come from; `quick` takes every tenth."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    data = Path(os.environ.get("ROBOCAR_DATA") or default) / "barn"
    step = 10 if quick else 1
    files = [data / name for name in ("barn_cylinders_test50.npz", "barn_paths_test50.npz", "index.csv")]
    if all(file.is_file() for file in files):
        worlds, paths, index = load_barn_cylinders(files[0]), load_barn_paths(files[1]), load_barn_index(files[2])
        chosen = [(f"barn-{k}", worlds[k], index[k], paths[k]) for k in sorted(worlds)[::step]]
        origin = "the challenge's 50 test worlds" if not quick else "every tenth of the challenge's 50 test worlds"
    else:
        chosen = []
        for k in range(0, 50, step):
            made = generate_barn_world(np.random.default_rng([2020, k]), *PARAMETER_SETS[k % len(PARAMETER_SETS)])
            chosen.append((f"generated-{k}", made.world, made.reference, made.path))
        origin = "generated worlds of the same family: the challenge's own are not in ROBOCAR_DATA"
    folder.mkdir(parents=True, exist_ok=True)
    made = [(name, world, ref, difficulty(world, path)) for name, world, ref, path in chosen]
    return [Course(*parts, write_course(folder, parts[0], parts[1])) for parts in made], origin


def write_course(folder: Path, name: str, world: BarnWorld) -> Path:
    """The world's file and, beside it, the scenario of the challenge's task in it."""
    save_barn_world(folder / f"{name}.world", world)
    content = {
        "name": name,
        "map": f"{name}.world",
        "prior": "none",
        "border": "open",
        "start": [START.x, START.y, START.theta],
        "goal": list(GOAL),
        "xy_goal_tolerance": SUCCESS_RADIUS,
        "success_radius": SUCCESS_RADIUS,
        "robot": {"lidar": "hokuyo"},
        "time_limit": TIME_LIMIT,
        "defaults": {"navigator": "a-star", "estimator": "truth", "mapper": "none"},
    }
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def main(out: Path, quick: bool = False) -> None:
    """Runs, tables and a picture; `quick` takes 5 worlds and three navigators."""
    known = names("navigator")
    navigators = [name for name in (("a-star", "a-star-dwa", "rrt-dwa") if quick else NAVIGATORS) if name in known]
    fields, origin = courses(out / "worlds", quick)
    jobs = [
        {"scenario": field.scenario, "navigator": navigator}
        | ({"settings": {"robot.lidar": "scan360"}} if navigator in ALL_ROUND else {})
        for navigator in navigators
        for field in fields
    ]
    done = iter(run_many(jobs))
    results = {navigator: [next(done) for _ in fields] for navigator in navigators}
    report = Report(out, "BARN: fields of cylinders without a map")
    report.say(
        f"Worlds: {origin}. Success: within {SUCCESS_RADIUS:g} m of the goal, no contact, within {TIME_LIMIT:g} s. "
        "Score: S OT / clip(AT, 2 OT, 8 OT), OT = reference length / (2 m/s). The car is 0.20 x 0.18 m and drives at most "
        "0.4 m/s (the challenge's Jackal: 0.51 x 0.43 m, 2 m/s): ways are wider for it, and one as long as the reference cannot "
        f"score more than 0.4 / 2 = 0.2. Laser: 205 degrees, 5.6 m; for {' and '.join(ALL_ROUND)}, which need one all round, 360 "
        "degrees, 6 m. The pose is known."
    )
    _overall(report, fields, results)
    _what_is_difficult(report, fields, results)
    _each(report, fields, results)
    report.write()
    _picture(out / "worlds.png", fields, results)


def _overall(report: Report, fields: Sequence[Course], results: Mapping[str, list[RunResult]]) -> None:
    rows = []
    for navigator, runs in results.items():
        n = len(runs)
        scores = [score(r.success, r.value("duration"), f.reference.optimal_time) for r, f in zip(runs, fields, strict=True)]
        values = {
            "success": sum(r.success for r in runs) / n,
            "collision": sum(r.status == "collision" for r in runs) / n,
            "timeout": sum(r.status == "timeout" for r in runs) / n,
        }
        values["other"] = 1.0 - sum(values.values())
        values["score"] = float(np.mean(scores))
        for name, value in values.items():
            peer = CHALLENGE_DWA.get(name) if navigator.endswith("-dwa") else None
            report.number(f"{navigator}/{name}", value, "1", peer)
        reached = [r for r in runs if r.success]
        means = {name: _mean([r.value(name) for r in reached]) for name in ("duration", "path_length")}
        closest = min((c for r in runs if (c := r.value("min_clearance")) is not None), default=None)
        report.number(f"{navigator}/duration", means["duration"], "s")
        report.number(f"{navigator}/path_length", means["path_length"], "m")
        report.number(f"{navigator}/min_clearance", closest, "m")
        shares = [f"{max(values[name], 0.0):.2f}" for name in ("success", "collision", "timeout", "other")]
        rows.append((navigator, *shares, means["duration"], means["path_length"], values["score"], closest))
    header = ("navigator", "success", "collision", "timeout", "other", "time [s]", "path [m]", "score", "smallest clearance [m]")
    report.table(header, rows, f"Shares of {len(fields)} worlds; time and path are means over the successes.")
    report.say("The challenge's own DWA example, with a Jackal: success 0.88, score 0.169. `other`: stuck, no path, an error.")


def _what_is_difficult(report: Report, fields: Sequence[Course], results: Mapping[str, list[RunResult]]) -> None:
    """Spearman's rank correlation of each difficulty metric with the time, over the worlds where a navigator arrived."""
    rows = []
    for navigator, runs in results.items():
        reached = [i for i, run in enumerate(runs) if run.success]
        cells: list[str | None] = []
        for metric in METRICS:
            values = [getattr(fields[i].difficulty, metric) for i in reached]
            rho = correlation(values, [float(runs[i].value("duration") or 0.0) for i in reached])
            report.number(f"{navigator}/correlation/{metric}", rho, "1")
            cells.append(None if rho is None else f"{rho:+.2f}")
        rows.append((navigator, len(reached), *cells))
    report.table(
        ("navigator", "worlds", *METRICS.values()),
        rows,
        "Difficulty: Spearman's rank correlation of the benchmark's metrics with the time, over the worlds where the navigator"
        " arrived. Closest obstacle, visibility and characteristic dimension are large where it is easy, the others where it is"
        " hard.",
    )


def correlation(a: Sequence[float], b: Sequence[float]) -> float | None:
    """Spearman's rank correlation; None for fewer than `ENOUGH` pairs, or where one of the two never changes."""
    if len(a) < ENOUGH or len(set(a)) < 2 or len(set(b)) < 2:
        return None
    return float(spearmanr(a, b).statistic)  # type: ignore[attr-defined]


def _each(report: Report, fields: Sequence[Course], results: Mapping[str, list[RunResult]]) -> None:
    """A row per world, the narrowest first."""
    order = sorted(range(len(fields)), key=lambda i: fields[i].reference.clearance)
    rows = []
    for i in order:
        ref = fields[i].reference
        cells = [f"{runs[i].value('duration'):.1f}" if runs[i].success else runs[i].status for runs in results.values()]
        hard = [f"{getattr(fields[i].difficulty, metric):.2f}" for metric in METRICS]
        rows.append((fields[i].name, ref.cylinders, f"{ref.clearance:.2f}", f"{ref.path_length:.1f}", *hard, *cells))
    header = ("world", "cylinders", "clearance [m]", "reference [m]", *METRICS.values(), *results)
    report.table(header, rows, "Time [s], or how it ended. Clearance: the largest that some way keeps all along.")


def _mean(values: list[Any]) -> float | None:
    values = [value for value in values if value is not None]
    return float(np.mean(values)) if values else None


def _picture(path: Path, fields: Sequence[Course], results: Mapping[str, list[RunResult]]) -> None:
    """Every world with every way; where a run failed, a cross."""
    columns = min(10, len(fields))
    rows = -(-len(fields) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(1.5 * columns, 3.4 * rows + 0.6), layout="constrained", squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for i, (axis, field) in enumerate(zip(axes.flat, fields, strict=False)):
        x, y, radius = field.world.cylinders.T
        axis.set(aspect="equal", xlim=(-4.6, 0.1), ylim=(1.5, 13.4), title=field.name)
        axis.title.set_fontsize(7)
        for centre_x, centre_y, r in zip(x, y, radius, strict=True):
            axis.add_patch(Circle((centre_x, centre_y), r, color="0.35", lw=0))
        for k, (navigator, runs) in enumerate(results.items()):
            way = runs[i].truth.poses
            axis.plot(*way[:, :2].T, lw=0.7, color=COLORS(k % 20), label=navigator)
            if not runs[i].success:
                axis.plot(*way[-1, :2], "x", ms=5, color=COLORS(k % 20))
        axis.plot(*GOAL, "*", color="tab:red", ms=4)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=7)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
