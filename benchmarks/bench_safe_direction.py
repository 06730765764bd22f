"""Time of one decision of safe-direction navigation, and of the transforms.

`python -m robocar.benchmarks.bench_safe_direction` prints medians (compilation is not counted); beside the distance transform
stands scipy's Dijkstra on the same grid graph.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from robocar.core import SE2, Scan
from robocar.core.rays import cast_rays
from robocar.experiments._safe_direction_worlds import FIGURES
from robocar.experiments.safe_direction_figures import bare_car
from robocar.planners.safe_direction.method import Directions, SafeDirectionParameters
from robocar.planners.safe_direction.view import DirectionPanorama, Sector
from robocar.planners.search.transforms import METRICS, distance_transform, obstacle_transform, path_transform
from robocar.sim.robot_model import RobotModel

FOOTPRINT = RobotModel.load().footprint


def median(function: Callable[[], Any], runs: int = 51) -> float:
    """Milliseconds."""
    function()
    seconds = []
    for _ in range(runs):
        begin = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - begin)
    return 1e3 * statistics.median(seconds)


def peer(blocked: np.ndarray, goal: tuple[int, int]) -> Callable[[], Any]:
    """scipy's Dijkstra from the goal; its graph is there already."""
    rows, cols = blocked.shape
    number = np.arange(rows * cols).reshape(rows, cols)
    parts = []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, rows - dr), slice(0, cols - dc) if dc >= 0 else slice(1, cols))
        b = (slice(dr, rows), slice(dc, cols) if dc >= 0 else slice(0, cols - 1))
        both = ~blocked[a] & ~blocked[b]
        parts.append((number[a][both], number[b][both], np.full(int(both.sum()), math.hypot(dr, dc))))
    i, j, lengths = (np.concatenate(p) for p in zip(*parts, strict=True))
    graph = coo_array((lengths, (i, j)), shape=(rows * cols, rows * cols)).tocsr()
    return lambda: dijkstra(graph, directed=False, indices=goal[0] * cols + goal[1])


def main() -> None:
    """Prints the table."""
    world = FIGURES["figure-12"]
    grid, pose = world.grid(), SE2(4.4, 4.4, 0.6)
    bearings = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    scan = Scan(0.0, cast_rays(grid, grid.occupied, pose.position, pose.theta + bearings, 6.0), bearings, 6.0)
    parameters = SafeDirectionParameters()
    sector = Sector(math.tau, 3.0)
    method, panorama = Directions(bare_car(FOOTPRINT), sector, parameters), DirectionPanorama(sector, 0.05, 0.12)
    goals = {"goal in sight": (5.4, 4.9), "goal far off": (8.3, 6.2), "goal behind": (0.6, 0.7)}

    def decide(goal: tuple[float, float]) -> None:
        panorama.look(pose, scan, ())
        method.decide(method.readings(pose, panorama), pose.theta, np.array(goal))

    print("one decision from the scan on, 6 x 6 m at 5 cm, 181 directions (target 1 ms)")
    for name, goal in goals.items():
        print(f"  {name:14} {median(lambda goal=goal: decide(goal)):7.2f} ms")
    print("transforms of a 512 x 512 map, a quarter in blocks of 8 cells (target of the distance transform 10 ms)")
    rng = np.random.default_rng(0)
    blocked = np.kron(rng.random((64, 64)) < 0.25, np.ones((8, 8), dtype=bool))
    goal = 256, 256
    blocked[250:262, 250:262] = False
    for metric in METRICS:
        print(f"  distance, {metric:10} {median(lambda metric=metric: distance_transform(blocked, goal, metric), 21):7.2f} ms")
    print(f"  the same by scipy's Dijkstra {median(peer(blocked, goal), 5):7.2f} ms")
    print(f"  obstacle            {median(lambda: obstacle_transform(blocked), 21):7.2f} ms")
    print(f"  path                {median(lambda: path_transform(blocked, goal, 10.0, 20.0), 21):7.2f} ms")


if __name__ == "__main__":
    main()
