"""The bug family on the same worlds, scans and motions: does the Operative Critical Point Bug need fewer iterations and less way?

Das, Dutta and Debnath, IJEECS 18(3), 2020, claim both (sections 2 and 4; their Figure 1 shows the older members of the family).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.episode.result import RunResult
from robocar.experiments._bug_worlds import BUGS, ROBOT, draw, scene_of, turns, worlds
from robocar.metrics.run import shortest_path_length
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.sim.robot_model import RobotModel

SEEDS = 10
TIME_LIMIT = (60.0, 25.0, 400.0)  # [s], [s] more for each metre of the shortest way, [s] at most
COLORS = dict(zip(BUGS, ("tab:red", "tab:blue", "tab:green", "tab:purple", "tab:brown", "tab:cyan", "tab:olive"), strict=True))


def time_limit(world: Mapping[str, Any] | str) -> float:
    """Of a run in this world [s]: about ten times what the shortest way takes, stops and turns with it."""
    scene = scene_of(world)
    assert scene.goal is not None
    shortest = shortest_path_length(scene.judged_map, RobotModel.load().footprint, scene.start, scene.goal, scene.only_discs)
    if shortest is None:  # start or goal lie outside the grid
        shortest = math.dist(scene.start.position, scene.goal.position)
    base, slope, most = TIME_LIMIT
    return min(base + slope * shortest, most)


def main(out: Path, quick: bool = False) -> None:
    """Runs, the tables, and the ways of all over each other."""
    study(out, 1 if quick else SEEDS, SEEDS if not quick else 1, ("boxes", "U", "field") if quick else None)


def study(out: Path, seeds: int, ocpb_seeds: int, chosen: tuple[str, ...] | None = None) -> None:
    """With this many seeds for all, and for `ocpb`; on all worlds, or those chosen by name."""
    places = {name: world for name, world in worlds(out / "maps").items() if chosen is None or name in chosen}
    cases = [(world, bug, k) for world in places for bug in BUGS for k in range(ocpb_seeds if bug == "ocpb" else seeds)]
    limits = {name: time_limit(world) for name, world in places.items()}
    results = run_many(
        [
            {
                "scenario": places[world],
                "navigator": bug,
                "estimator": "truth",
                "seed": k,
                "settings": {**ROBOT, "time_limit": limits[world]},
                "out": out / "runs",
                "record": k == 0 and bug == "ocpb",
                "force": True,
            }
            for world, bug, k in cases
        ]
    )
    grouped: dict[tuple[str, str], list[RunResult]] = {}
    for (world, bug, _), result in zip(cases, results, strict=True):
        grouped.setdefault((world, bug), []).append(result)
    report = Report(out, "The bug family on the same worlds")
    _tables(report, grouped, list(places))
    _failures(report, grouped)
    report.say("Time limits [s]: " + ", ".join(f"{name} {limit:.0f}" for name, limit in limits.items()))
    report.write()
    columns = min(4, len(places))
    rows = -(-len(places) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.0 * columns, 4.0 * rows), layout="constrained", squeeze=False)
    for axis in axes.flat[len(places) :]:
        axis.set_axis_off()
    for axis, (name, world) in zip(axes.flat, places.items(), strict=False):
        draw(axis, scene_of(world))
        for bug in BUGS:
            for k, result in enumerate(grouped[name, bug][:3]):
                style = {"lw": 2.0 if bug == "ocpb" else 0.8, "alpha": 0.8, "label": None if k else bug}
                axis.plot(*result.truth.poses[:, :2].T, color=COLORS[bug], **style)
        axis.set_title(name, fontsize=10)
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(BUGS), frameon=False)
    figure.savefig(out / "trajectories.png", dpi=100)
    plt.close(figure)


def _tables(report: Report, grouped: dict[tuple[str, str], list[RunResult]], places: list[str]) -> None:
    rows = []
    for (world, bug), runs in grouped.items():
        reached = [r for r in runs if r.success]
        ends = Counter(r.status for r in runs if not r.success)
        contacts = sum(int(r.value("contacts") or 0) for r in runs)
        numbers = {
            "length_over_shortest": _mean([_ratio(r) for r in reached]),
            "iterations": _mean([r.value("replans") for r in reached]),
            "turns": _mean([turns(r) for r in reached]),
            "duration": _mean([r.value("duration") for r in reached]),
        }
        tag = f"{world}/{bug}"
        report.number(f"{tag}/success_rate", len(reached) / len(runs), "1")
        report.number(f"{tag}/contacts", contacts, "1")
        for name, value in numbers.items():
            report.number(f"{tag}/{name}", value, "s" if name == "duration" else "1")
        why = ", ".join(f"{count} {status}" for status, count in ends.items()) or "–"
        clearance = min((float(r.value("min_clearance") or 0.0) for r in runs), default=None)
        rows.append((world, bug, f"{len(reached)}/{len(runs)}", why, contacts, *numbers.values(), clearance))
    report.table(
        (
            "world",
            "bug",
            "reached",
            "else",
            "contacts",
            "way / shortest",
            "iterations",
            "turns",
            "time [s]",
            "least clearance [m]",
        ),
        rows,
        "Means over the runs that reached the goal.",
    )
    rows = []
    for bug in BUGS:
        runs = [r for (_, b), group in grouped.items() if b == bug for r in group]
        contacts = sum(int(r.value("contacts") or 0) for r in runs)
        report.number(f"all/{bug}/success_rate", sum(r.success for r in runs) / len(runs), "1")
        report.number(f"all/{bug}/contacts", contacts, "1")
        # Fairly: where both have always arrived.
        both = [p for p in places if all(r.success for b in (bug, "ocpb") for r in grouped[p, b])]
        ratio = {
            what: _mean([_over(grouped[p, "ocpb"], grouped[p, bug], what) for p in both])
            for what in ("replans", "path_length", "duration")
        }
        for what, value in ratio.items():
            report.number(f"all/ocpb_over_{bug}/{what}", value, "1")
        rows.append((bug, f"{sum(r.success for r in runs)}/{len(runs)}", contacts, len(both), *ratio.values()))
    report.table(
        (
            "bug",
            "reached",
            "contacts",
            "worlds where both always arrive",
            "iterations: ocpb / it",
            "way: ocpb / it",
            "time: ocpb / it",
        ),
        rows,
        "All worlds; below 1 ocpb is better. The paper claims fewer iterations and shorter ways than the rest of the family.",
    )


def _failures(report: Report, grouped: dict[tuple[str, str], list[RunResult]]) -> None:
    """Every run of `ocpb` that has not reached the goal, with why and where; of the others, how many for which reason."""
    lines = []
    for (world, bug), runs in grouped.items():
        for seed, r in enumerate(runs):
            if bug == "ocpb" and not r.success:
                x, y, _ = r.truth.poses[-1]
                lines.append(
                    f"* {world}, seed {seed}: {r.status} after {r.value('duration'):.0f} s at ({x:.2f}, {y:.2f}): {r.reason}"
                )
    report.say("Runs of ocpb that have not reached the goal:\n\n" + "\n".join(lines) if lines else "ocpb has reached every goal.")
    others = Counter(
        (world, bug, r.status, _without_numbers(r.reason))
        for (world, bug), runs in grouped.items()
        for r in runs
        if bug != "ocpb" and not r.success
    )
    rows = [(*key, count) for key, count in sorted(others.items())]
    report.table(("world", "bug", "end", "reason", "runs"), rows, "Why the others have not.")


def _without_numbers(reason: str) -> str:
    return reason.partition(" at (")[0]


def _ratio(result: RunResult) -> float | None:
    length, least = result.value("path_length"), result.value("shortest_path_length")
    return float(length) / float(least) if length is not None and least else None


def _over(ours: list[RunResult], theirs: list[RunResult], metric: str) -> float | None:
    mine, other = (_mean([r.value(metric) for r in runs]) for runs in (ours, theirs))
    return mine / other if mine is not None and other else None


def _mean(values: list[float | int | None] | list[float | None] | list[int]) -> float | None:
    known = [float(v) for v in values if v is not None]
    return float(np.mean(known)) if known else None


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
