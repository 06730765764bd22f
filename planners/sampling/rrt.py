"""Rapidly-exploring random trees as global planners: RRT, RRT-Connect and RRT*.

LaValle, Rapidly-Exploring Random Trees (TR 98-11, 1998), as in Table 1 of Izaty and Lubis (JITET); Kuffner and LaValle,
RRT-Connect (ICRA 2000); Karaman and Frazzoli, Sampling-based Algorithms for Optimal Motion Planning (IJRR 30(7), 2011).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core import INSCRIBED, Array, BudgetExhausted, Context, Costmap, Footprint, Path, Plan, Segments, Trace
from robocar.core.compiling import warm_up
from robocar.core.trace import LazyTrace
from robocar.planners.costmap import layered as layered
from robocar.planners.costmap.layered import safe_cost
from robocar.planners.sampling.random_trees import Growth, TreeObstacles, connect, edge_cost, grow, shortcut
from robocar.planners.sampling.rrt_star import grow_star
from robocar.planners.search.grid_search import endpoints

VARIANTS = ("rrt", "rrt-connect", "rrt-star")
TREE_COLOR = (70, 110, 230)


@dataclass(frozen=True, slots=True)
class RrtParameters:
    """
    Args:
        variant: `rrt`, `rrt-connect` or `rrt-star`.
        step: longest edge; the paper's run has 0.5 [m].
        max_samples: after so many samples there is no path; `rrt-star` uses them all. The paper's run has 10 000.
        goal_tolerance: the epsilon of Table 1: a node so near to the goal is joined to it, if the way is free [m].
        goal_bias: share of samples that are the goal (not in `rrt-connect`).
        adaptive_step: whether a blocked step is tried at half its length, and so on; in Table 1 it is not.
        roomy: whether a way is looked for first on which the car can turn everywhere (its circumscribed circle touches nothing);
            only where none is found, one on which its inscribed circle touches nothing.
        shortcuts: how often two random points of the path are joined straight where that costs less; 0 leaves the tree's path.
    """

    variant: str = "rrt"
    step: float = 0.5
    max_samples: int = 50_000
    goal_tolerance: float = 0.5
    goal_bias: float = 0.05
    adaptive_step: bool = True
    roomy: bool = True
    shortcuts: int = 200

    def __post_init__(self) -> None:
        if self.variant not in VARIANTS:
            raise ValueError(f"variant is one of {', '.join(VARIANTS)}, not {self.variant!r}")
        for name in ("step", "goal_tolerance"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if not 1 <= self.max_samples <= 10_000_000:
            raise ValueError(f"max_samples must be from 1 to 10000000, not {self.max_samples}")
        if not 0.0 <= self.goal_bias <= 1.0:
            raise ValueError(f"goal_bias must be from 0 to 1, not {self.goal_bias}")
        if not 0 <= self.shortcuts <= 1_000_000:
            raise ValueError(f"shortcuts must be from 0 to 1000000, not {self.shortcuts}")


def circle_world(circles: ArrayLike, low: ArrayLike, high: ArrayLike) -> TreeObstacles:
    """A world without a grid: circles (n, 3) as x, y, radius, sampled between the corners `low` and `high`, both (2,)."""
    circles = np.array(circles, dtype=float).reshape(-1, 3)
    bounds = np.concatenate([np.asarray(low, dtype=float), np.asarray(high, dtype=float)])
    if not (np.all(np.isfinite(circles)) and np.all(circles[:, 2] >= 0.0)):
        raise ValueError("circles need finite centres and radii that are not negative")
    if not (np.all(np.isfinite(bounds)) and np.all(bounds[2:] > bounds[:2])):
        raise ValueError(f"the corners must span an area, not {bounds.tolist()}")
    return TreeObstacles(_read_only(np.zeros((0, 0), dtype=np.uint8)), circles, bounds)


def costmap_world(costmap: Costmap) -> TreeObstacles:
    """The blocked cells of a costmap, in grid coordinates."""
    rows, cols = costmap.shape
    costs = _read_only(np.ascontiguousarray(costmap.data).view())
    return TreeObstacles(costs, np.zeros((0, 3)), np.array([0.0, 0.0, cols, rows]))


def _read_only(array: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """One kind of array is one compiled version for all."""
    array.flags.writeable = False
    return array


def search(
    obstacles: TreeObstacles, start: ArrayLike, goal: ArrayLike, parameters: RrtParameters, rng: np.random.Generator
) -> Growth:
    """One search in the obstacles' own coordinates and units, the `step` and `goal_tolerance` of the parameters too.

    Args:
        start, goal: free points (2,).

    Returns:
        The tree, and the path (k, 2) from start to goal, shortcuts made; it is empty where none was found.
    """
    p = parameters
    start, goal = np.array(start, dtype=float), np.array(goal, dtype=float)
    if p.variant == "rrt-connect":
        grown = connect(obstacles, start, goal, p.step, p.max_samples, p.adaptive_step, rng)
    elif p.variant == "rrt-star":
        low, high = obstacles.bounds[:2], obstacles.bounds[2:]
        area = float(np.prod(high - low))
        if obstacles.costs.size > 0:
            area = float(np.count_nonzero(obstacles.costs < INSCRIBED))
        grown = grow_star(obstacles, start, goal, p.step, p.goal_bias, p.max_samples, p.adaptive_step, area, rng)
    else:
        grown = grow(obstacles, start, goal, p.step, p.goal_tolerance, p.goal_bias, p.max_samples, p.adaptive_step, rng)
    if p.shortcuts and len(grown.path) > 2:
        return grown._replace(path=shortcut(obstacles, grown.path, p.shortcuts, rng))
    return grown


class RRT:
    """Global planner; its cost is the line integral of 1 + c / 252 along the path [m], as `grid_search` measures it.

    A plan begins with a new tree, and draws on where the last one left off: equal seeds, equal sequence of plans.

    Args:
        rng: the source of its samples.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        parameters: RrtParameters | None = None,
        footprint: Footprint | None = None,
        inflation: layered.CostmapParameters | None = None,
    ) -> None:
        """`footprint` and `inflation` say at which costs the car can turn; without them every way is as good as a roomy one."""
        self.parameters = parameters or RrtParameters()
        self._footprint, self._inflation = footprint, inflation
        self._rng = rng
        _warm_up(self.parameters.variant)

    def plan(self, costmap: Costmap, start: ArrayLike, goal: ArrayLike) -> Plan:
        """Path from `start` to `goal`, both (2,) [m].

        Raises:
            OutsideMap, StartOccupied, GoalOccupied: see `grid_search.endpoints`.
            BudgetExhausted: no path after `max_samples`; its trace holds the tree.
        """
        endpoints(costmap, start, goal)
        p, resolution = self.parameters, costmap.resolution
        obstacles = costmap_world(costmap)
        first, last = costmap.grid_from_world(np.array([start, goal], dtype=float))
        in_cells = replace(p, step=p.step / resolution, goal_tolerance=p.goal_tolerance / resolution)
        samples = 0
        grown = None
        for world in (self._roomy(costmap, first, last), obstacles):
            if world is not None:
                grown = search(world, first, last, in_cells, self._rng)
                samples += grown.samples
                if len(grown.path) > 0:
                    break
        assert grown is not None
        trace = _tree_trace(costmap, grown)
        if len(grown.path) == 0:
            (x0, y0), (x1, y1) = np.asarray(start), np.asarray(goal)
            raise BudgetExhausted(
                f"budget exhausted: no way from ({x0:.3f}, {y0:.3f}) to ({x1:.3f}, {y1:.3f}) found with {samples} samples "
                "(max_samples)",
                trace,
            )
        points = np.empty((max(2, len(grown.path)), 2))
        points[:] = costmap.origin.transform(grown.path * resolution)
        points[0], points[-1] = start, goal
        return Plan(Path(points), path_cost(obstacles, grown.path) * resolution, {"samples": samples}, trace)

    def _roomy(self, costmap: Costmap, start: Array, goal: Array) -> TreeObstacles | None:
        """The world without cells where the car could not turn; None where start or goal (2,) [cells] are such cells."""
        if not self.parameters.roomy or self._footprint is None or self._inflation is None:
            return None
        clear = safe_cost(self._inflation, self._footprint, costmap.resolution)
        costs = costmap.data.copy()
        costs[costs >= max(clear, 1.0)] = INSCRIBED
        (x0, y0), (x1, y1) = start, goal
        if INSCRIBED in (costs[math.floor(y0), math.floor(x0)], costs[math.floor(y1), math.floor(x1)]):
            return None
        return costmap_world(replace(costmap, data=costs))


def path_cost(obstacles: TreeObstacles, path: Array) -> float:
    """Cost of a polyline (n, 2), inf where it touches something."""
    return sum(edge_cost(obstacles, *a, *b) for a, b in zip(path[:-1].tolist(), path[1:].tolist(), strict=True))


def _tree_trace(costmap: Costmap, grown: Growth) -> Trace:
    def tree() -> Segments:
        children: NDArray[np.intp] = np.flatnonzero(grown.tree.parents >= 0)
        edges = np.stack([grown.tree.nodes[grown.tree.parents[children]], grown.tree.nodes[children]], axis=1)
        return Segments(costmap.origin.transform(edges * costmap.resolution), color=TREE_COLOR)

    return LazyTrace({"tree": tree})


@warm_up
def _warm_up(variant: str) -> None:
    planner = RRT(np.random.default_rng(0), RrtParameters(variant, max_samples=1000))
    planner.plan(Costmap(np.zeros((9, 9), dtype=np.uint8), 1.0), np.array([0.5, 0.5]), np.array([8.0, 8.0]))


def build(context: Context) -> RRT:
    """The planner with the context's parameters and random generator."""
    inflation = context.part("costmap").parameters_of(layered.CostmapParameters)
    return RRT(context.rng, context.parameters_of(RrtParameters), context.robot.footprint, inflation)
