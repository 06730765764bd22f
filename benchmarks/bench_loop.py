"""The closed loop against bare physics: real-time factor, cost of everything that is not `mj_step`, cost and size of a recording.

All figures are medians over runs taken in turn in one process, so that ratios hold on a shared machine.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import mujoco

import robocar
from robocar.sim import world

SCENARIO = "corridors"
CASES = {
    "front sonars, odometry, a-star": {
        "navigator": "a-star",
        "estimator": "odometry",
        "settings": {"robot.lidar": "none", "robot.sonars": "front"},
    },
    "front sonars, odometry, dynamic-a-star": {
        "navigator": "dynamic-a-star",
        "estimator": "odometry",
        "settings": {"robot.lidar": "none", "robot.sonars": "front"},
    },
    "laser (360 beams), odometry, a-star": {
        "navigator": "a-star",
        "estimator": "odometry",
        "settings": {"robot.lidar": "scan360", "robot.sonars": "front"},
    },
}
SECONDS = 60.0


class _Stopwatch:
    """Stands in for the simulator's `mujoco` and adds up the time that `mj_step` takes."""

    def __init__(self) -> None:
        self.total = 0.0

    def __getattr__(self, name: str) -> object:
        return getattr(mujoco, name)

    def mj_step(self, model: mujoco.MjModel, data: mujoco.MjData, nstep: int = 1) -> None:
        started = time.perf_counter()
        mujoco.mj_step(model, data, nstep)
        self.total += time.perf_counter() - started


def measure(case: dict, out: Path | None) -> tuple[float, float, float, float]:
    """One run: simulated seconds, ticks, wall time of the loop, of which in `mj_step` [s]."""
    watch = _Stopwatch()
    world.mujoco = watch
    try:
        settings = {"time_limit": SECONDS, **case["settings"]}
        result = robocar.run(
            SCENARIO, navigator=case["navigator"], estimator=case["estimator"], settings=settings, out=out, force=True
        )
    finally:
        world.mujoco = mujoco
    duration, loop = result.value("duration"), result.value("wall_time")
    assert duration is not None and loop is not None
    return duration, len(result.truth.times), loop, watch.total


def main(repeats: int = 7) -> None:
    """Prints the tables."""
    print(f"{'closed loop, no recording':42} {'x real time':>12} {'x bare mj_step':>15} {'other [us/tick]':>16}")
    for name, case in CASES.items():
        measure(case, None)  # warm-up
        runs = [measure(case, None) for _ in range(repeats)]
        factor = statistics.median(duration / loop for duration, _, loop, _ in runs)
        ratio = statistics.median(loop / physics for _, _, loop, physics in runs)
        other = statistics.median((loop - physics) / ticks for _, ticks, loop, physics in runs)
        print(f"{name:42} {factor:12.0f} {ratio:15.2f} {1e6 * other:16.0f}")

    case = CASES["front sonars, odometry, a-star"]
    with tempfile.TemporaryDirectory() as folder:
        measure(case, Path(folder))
        pairs = [(measure(case, Path(folder)), measure(case, None)) for _ in range(repeats)]
        share = statistics.median(a[2] / a[0] / (b[2] / b[0]) - 1.0 for a, b in pairs)
        (recording,) = Path(folder).glob("*/run.rrd")
        size = recording.stat().st_size / 1e6 * 60.0 / pairs[0][0][0]
    print(f"\nrecording: {100 * share:+.1f} % of the loop's time, {size:.2f} MB for 60 s")

    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        subprocess.run([sys.executable, "-m", "robocar", "--help"], check=True, capture_output=True)
        times.append(time.perf_counter() - started)
    print(f"robocar --help: {statistics.median(times):.2f} s")


if __name__ == "__main__":
    main()
