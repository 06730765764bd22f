"""A planner of one's own: Dijkstra's algorithm on a grid where a cell costs more the nearer it lies to a wall."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np

from robocar.core import INSCRIBED, Array, Context, Costmap, NoPathFound, Path, Plan, declares
from robocar.planners.controllers import pure_pursuit
from robocar.planners.controllers.pure_pursuit import PurePursuitParameters
from robocar.planners.costmap.layered import CostmapParameters
from robocar.planners.navigators.plan_and_follow import NavigatorParameters, PlanAndFollow, plan_and_follow

STEPS = [(dr, dc, math.hypot(dr, dc)) for dr in (-1, 0, 1) for dc in (-1, 0, 1) if dr or dc]


@dataclass(frozen=True)
class WallShyParameters:
    """
    Args:
        wall_weight: how many times its length a step costs beside a wall, beyond the length itself.
    """

    wall_weight: float = 3.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.wall_weight) and self.wall_weight >= 0):
            raise ValueError(f"wall_weight must be a finite number from 0 on, not {self.wall_weight}")


class WallShy:
    """A `GlobalPlanner`: `plan` is asked again whenever the robot has seen something that blocks its path."""

    def __init__(self, parameters: WallShyParameters) -> None:
        self.parameters = parameters

    def plan(self, costmap: Costmap, start: Array, goal: Array) -> Plan:
        costs = costmap.data.astype(float)  # 0 free, 253 and more blocked, 255 unknown
        blocked = (costmap.data >= INSCRIBED) & (costmap.data != 255)
        price = 1.0 + self.parameters.wall_weight * np.minimum(costs, 252.0) / 252.0
        price[costmap.data == 255] = 1.0
        first, last = costmap.cell_inside(start, "start"), costmap.cell_inside(goal, "goal")
        best, parent, expanded = {first: 0.0}, {}, set()
        queue = [(0.0, first)]
        while queue:
            cost, cell = heapq.heappop(queue)
            if cell in expanded:
                continue
            expanded.add(cell)
            if cell == last:
                cells = [last]
                while cells[-1] != first:
                    cells.append(parent[cells[-1]])
                between = costmap.world_from_cell(cells[-2:0:-1]) if len(cells) > 2 else np.empty((0, 2))
                return Plan(Path(np.concatenate([[start], between, [goal]])), cost, {"expansions": len(expanded)})
            for dr, dc, length in STEPS:
                to = (cell[0] + dr, cell[1] + dc)
                if not (0 <= to[0] < blocked.shape[0] and 0 <= to[1] < blocked.shape[1]) or blocked[to]:
                    continue
                new = cost + length * costmap.resolution * price[to]
                if new < best.get(to, math.inf):
                    best[to], parent[to] = new, cell
                    heapq.heappush(queue, (new, to))
        raise NoPathFound(f"no way from {tuple(start)} to {tuple(goal)}")


@declares(
    parameters={
        "": (WallShyParameters, NavigatorParameters),
        "controller": (PurePursuitParameters,),
        "costmap": (CostmapParameters,),
    }
)
def build(context: Context) -> PlanAndFollow:
    """What `--navigator wall_shy:build` calls: our planner, Robocar's costmap and its path follower."""
    parameters = context.parameters_of(WallShyParameters)
    return plan_and_follow(context, lambda _: WallShy(parameters), pure_pursuit.build)
