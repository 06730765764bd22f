"""Zelinsky's path transform on a known map: the cheapest way where nearness to obstacles costs.

A. Zelinsky, Using path transforms to guide the search for findpath in 2D, Int. J. Robotics Research 13(4), 1994.

The global relative of safe-direction navigation: clearance is bought with length, by a weight, on the whole map at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import LETHAL, Array, Context, Costmap, Field, Plan
from robocar.core.compiling import warm_up
from robocar.core.trace import LazyTrace
from robocar.planners.search import transforms
from robocar.planners.search.grid_search import endpoints, no_path, path_through
from robocar.planners.search.transforms import descend


@dataclass(frozen=True, slots=True)
class PathTransformParameters:
    """
    Args:
        weight: alpha of the paper: what a cell at an obstacle costs, in cells of way; 0 is the distance transform.
        safe_distance: from obstacles to where they cost nothing [m].
    """

    weight: float = 10.0
    safe_distance: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.weight <= 1e4:
            raise ValueError(f"weight goes from 0 to 10000, not {self.weight}")
        if not 0.0 < self.safe_distance < math.inf:
            raise ValueError(f"safe_distance must be positive, not {self.safe_distance}")


class PathTransform:
    """Global planner: steepest descent over the path transform of a costmap's free cells.

    Of the costmap only what is blocked counts: obstacles grown by the robot's size, as the paper grows them. The cost of its
    plans is the path transform at the start, in metres; its work counts the cells that the transform reached.
    """

    def __init__(self, parameters: PathTransformParameters | None = None) -> None:
        self.parameters = parameters or PathTransformParameters()
        _warm_up()

    def plan(self, costmap: Costmap, start: Array, goal: Array) -> Plan:
        """Path from `start` to `goal`, both (2,) [m].

        Raises:
            OutsideMap, StartOccupied, GoalOccupied: an endpoint is not on the map or not free.
            NoPathFound: they are not connected.
        """
        start_cell, goal_cell = endpoints(costmap, start, goal)
        p = self.parameters
        values = transforms.path_transform(costmap.blocked, goal_cell, p.weight, p.safe_distance / costmap.resolution)
        reached = np.isfinite(values)
        if not reached[start_cell]:
            raise no_path(start, goal, int(reached.sum()))
        path = path_through(costmap, descend(values, start_cell), start, goal)

        def field() -> Field:
            return Field(costmap.with_data(np.where(reached, values * costmap.resolution, np.nan).astype(np.float32)))

        cost = float(values[start_cell]) * costmap.resolution
        return Plan(path, cost, {"expansions": int(reached.sum())}, LazyTrace({"path_transform": field}))


@warm_up
def _warm_up() -> None:
    costs = np.zeros((4, 4), dtype=np.uint8)
    costs[1, 1] = LETHAL
    PathTransform().plan(Costmap(costs, 1.0), np.array([0.5, 0.5]), np.array([3.5, 3.5]))


def build(context: Context) -> PathTransform:
    """The planner with the parameters of the context."""
    return PathTransform(context.parameters_of(PathTransformParameters))
