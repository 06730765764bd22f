"""Utomo 2015, Tables 4.6 and 4.7: each motion command ten times, how far the car really goes and turns.

The thesis' car knows its encoders only; ours is measured so, and once more with the compass that the thesis misses. Each
repetition is another car: tyres and wheel radii differ within their tolerances.
"""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from robocar.core import SE2, Array, Hold, OccupancyGrid, Serial, wrap_angle
from robocar.reporting.report import Report
from robocar.sim.firmware import CELL
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.world import World
from robocar.sim.world_spec import build_world

STRAIGHTS = ("M1", "M2", "M3", "M4", "M5")
TURNS = ("Kr45", "Kr90", "Kn45", "Kn90")
THESIS_DISTANCE, THESIS_HEADING = 4.8, 4.34  # [%] means over all repetitions, Tables 4.6 and 4.7


def execute(command: str, seed: int, compass: bool) -> float:
    """Error of one command [% of what was commanded]."""
    floor = OccupancyGrid(np.zeros((8, 8), dtype=np.int8), 1.0, SE2(-4.0, -4.0))
    world = World(build_world(floor, border="open"), [RobotSetup(SE2(), fit_out=FitOut(compass=compass))], seed=seed)
    for _ in range(10):  # at rest: the compass fills its window
        world.robot.sense()
        world.robot.act(Hold())
        world.step()
    first = world.ground_truth().pose
    pose, turned = first, 0.0
    line = Serial(command)
    while True:
        answers = world.robot.sense().serial
        if answers and answers[-1] != "OK":
            break
        world.robot.act(line)
        world.step()
        line = Hold()
        following = world.ground_truth().pose
        turned += wrap_angle(following.theta - pose.theta)
        pose = following
    if answers[-1] != "DONE":
        raise RuntimeError(f"{command}: the firmware answered {answers[-1]}")
    if command.startswith("M"):
        wanted = CELL * int(command[1:])
        return 100.0 * abs(first.distance_to(pose) - wanted) / wanted
    wanted = math.radians(float(command[2:])) * (1 if command.startswith("Kr") else -1)
    return 100.0 * abs(turned - wanted) / abs(wanted)


def main(out: Path, quick: bool = False) -> None:
    """Both tables, encoders only and with the compass."""
    seeds = range(3 if quick else 10)
    report = Report(out, "Motion commands (Tables 4.6 and 4.7)")
    errors: dict[str, dict[str, Array]] = {}
    for name, compass in (("encoders only", False), ("with compass", True)):
        errors[name] = {c: np.array([execute(c, seed, compass) for seed in seeds]) for c in (*STRAIGHTS, *TURNS)}
    rows = []
    for command in (*STRAIGHTS, *TURNS):
        row: list[object] = [command]
        for name in errors:
            values = errors[name][command]
            row += [f"{values.mean():.2f}", f"{values.max():.2f}"]
        rows.append(row)
    for kind, commands, paper in (("distance", STRAIGHTS, THESIS_DISTANCE), ("heading", TURNS, THESIS_HEADING)):
        row = [f"**{kind}, mean** (thesis {paper} %)"]
        for name in errors:
            values = np.concatenate([errors[name][command] for command in commands])
            row += [f"**{values.mean():.2f}**", f"{values.max():.2f}"]
            tag = name.replace(" ", "_")
            report.number(f"{kind}_error_mean/{tag}", float(values.mean()), "%", paper if name == "encoders only" else None)
            report.number(f"{kind}_error_max/{tag}", float(values.max()), "%")
        rows.append(row)
    report.table(
        ("command", "encoders: mean [%]", "max [%]", "compass: mean [%]", "max [%]"),
        rows,
        f"Error of what the car did, in % of what was commanded, over {len(seeds)} cars each.",
    )
    report.write()
    _picture(out / "errors.png", errors)


def _picture(path: Path, errors: dict[str, dict[str, Array]]) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", sharey=True)
    for axis, (name, table) in zip(axes, errors.items(), strict=True):
        axis.boxplot(list(table.values()), tick_labels=list(table))
        axis.axhline(THESIS_HEADING, color="tab:red", ls="--", lw=1, label="thesis, heading mean")
        axis.axhline(THESIS_DISTANCE, color="tab:orange", ls="--", lw=1, label="thesis, distance mean")
        axis.set(title=name, ylabel="error [%]")
        axis.legend()
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
