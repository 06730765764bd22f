"""What a decision of the bugs costs: a scan of 360 beams, twenty obstacles followed. `python -m robocar.benchmarks.bench_bugs`.

Times are medians over scans, of the shortest of several runs. `decision` is all that the Operative Critical Point Bug does with a
scan (following obstacles, open points, sub-goals, safety, prediction), `scan` all that it costs the control loop, with its trace.
"""

from __future__ import annotations

import math
from time import perf_counter

import numpy as np
from rich.console import Console
from rich.table import Table

from robocar.core import SE2, Array, Belief, Context, Goal, Observation, RangeSensor, Robot, Scan, State
from robocar.episode.registry import build
from robocar.planners.bugs.ocpb.strategy import OperativeCriticalPointBug
from robocar.planners.bugs.open_points import find_open_points
from robocar.planners.bugs.view import BugView
from robocar.planners.tracking.panorama import Surround
from robocar.sim.robot_model import RobotModel

BEAMS, MAX_RANGE, OBSTACLES, RADIUS = 360, 6.0, 20, 0.12
BUGS = ("ocpb", "bug1", "bug2", "dist-bug", "tangent-bug", "point-bug", "critical-point-bug")
GOAL = Goal(np.array([20.0, 0.3]))


def laser() -> Robot:
    bearings = np.linspace(-math.pi, math.pi, BEAMS, endpoint=False)
    lidar = RangeSensor("scan360", SE2(), bearings, 0.0, 0.06, MAX_RANGE, 0.1)
    model = RobotModel.load()
    return Robot(model.footprint, model.limits, model.calibration(), model.drive.pulses_per_turn, lidar=lidar)


def scan(time: float, moving: bool, rng: np.random.Generator) -> Scan:
    """Twenty discs on two rings around the robot, that go round it, or stand; nothing else."""
    bearings = np.linspace(-math.pi, math.pi, BEAMS, endpoint=False)
    ranges = np.full(BEAMS, math.inf)
    for k in range(OBSTACLES):
        far = 2.2 if k % 2 else 3.4
        angle = math.tau * k / OBSTACLES + (0.2 / far * time if moving else 0.0)
        x, y = far * math.cos(angle), far * math.sin(angle)
        along, across = x * np.cos(bearings) + y * np.sin(bearings), y * np.cos(bearings) - x * np.sin(bearings)
        hit = (along > 0) & (np.abs(across) < RADIUS)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(RADIUS**2 - across[hit] ** 2))
    return Scan(time, ranges + rng.normal(0.0, 0.01, BEAMS), bearings, MAX_RANGE)


def time_steps(name: str, moving: bool, rounds: int = 5, scans: int = 60) -> dict[str, float]:
    """Medians [s] of the command, and of the strategy's decision, after two seconds of scans have been taken in."""
    robot = laser()
    observed = [Observation(0.1 * k, lidar=scan(0.1 * k, moving, np.random.default_rng(k))) for k in range(scans)]
    whole, inner = np.full((rounds, scans), np.inf), np.full((rounds, scans), np.inf)
    followed = 0
    for r in range(rounds):
        navigator = build("navigator", name, Context(robot, None, SE2(), (), {}, np.random.default_rng(0), 0.05))
        bug = navigator.controller
        step = bug.strategy.step

        def timed(view: BugView, r: int = r, step=step) -> object:
            start = perf_counter()
            move = step(view)
            inner[r, round(view.time * 10)] = perf_counter() - start
            return move

        bug.strategy.step = timed
        for k, observation in enumerate(observed):
            if isinstance(bug.strategy, OperativeCriticalPointBug):
                bug.strategy.leg = None  # each scan is decided upon
                bug.strategy._lookout._looks = 1
            start = perf_counter()
            navigator.command(State.of(Belief(SE2())), observation, GOAL)
            whole[r, k] = perf_counter() - start
        if isinstance(bug.strategy, OperativeCriticalPointBug):
            followed = len(bug.strategy.obstacles.tracked)
    after = slice(20, None)
    return {
        "decision": float(np.median(inner.min(axis=0)[after])),
        "scan": float(np.median(whole.min(axis=0)[after])),
        "slowest": float(np.max(inner.min(axis=0)[after])),
        "followed": followed,
    }


def open_point_time() -> Array:
    """Finding the open points alone [s]."""
    panorama = Surround(laser(), 0.4).panorama(Observation(0.0, lidar=scan(0.0, False, np.random.default_rng(0))), SE2())
    assert panorama is not None
    times = []
    for _ in range(300):
        start = perf_counter()
        find_open_points(panorama, 0.2, 0.01)
        times.append(perf_counter() - start)
    return np.array(times)


def main() -> None:
    """The table."""
    table = Table(title=f"{BEAMS} beams, {OBSTACLES} obstacles (target: a decision of ocpb at most 0.5 ms)")
    for column in ("bug", "obstacles", "followed", "decision [ms]", "slowest [ms]", "scan [ms]"):
        table.add_column(column, justify="right" if column != "bug" else "left")
    for name in BUGS:
        for moving in (False, True) if name == "ocpb" else (False,):
            found = time_steps(name, moving)
            numbers = [f"{1e3 * found[key]:.2f}" for key in ("decision", "slowest", "scan")]
            followed = str(found["followed"]) if name == "ocpb" else "–"
            table.add_row(name, "moving" if moving else "standing", followed, *numbers)
    console = Console()
    console.print(table)
    console.print(f"open points alone: {1e3 * float(np.median(open_point_time())):.3f} ms")


if __name__ == "__main__":
    main()
