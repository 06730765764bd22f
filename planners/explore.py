"""Frontier exploration: draws the map of an unknown world by driving to where it ends, until it ends nowhere.

Yamauchi, A Frontier-Based Approach for Autonomous Exploration (1997): the robot goes to the nearest frontier, looks, and again.
Here the ways lead through what the mapper has seen to be free, as A* finds them, and a frontier that has been seen through from
afar is no longer gone to.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from planners import costmap as layered
from planners.costmap import inflate
from planners.frontiers import Frontier, find_frontiers
from planners.grid_search import nearest_free
from planners.polyline import nearest_on_path
from planners.pure_pursuit import STOPPING_SHARE, PurePursuit
from robocar.core import (
    INSCRIBED,
    NO_INFORMATION,
    SE2,
    STOP,
    Array,
    Belief,
    Command,
    Context,
    Costmap,
    Done,
    GlobalPlanner,
    Goal,
    Lines,
    Mapper,
    Observation,
    OccupancyGrid,
    Path,
    PlanningError,
    Points,
    Robot,
    Scalar,
    Text,
    Trace,
)
from robocar.core.trace import PLAN_COLOR

_SAME = 0.3  # [m] frontiers that are nearer to each other than this are one that has changed
_LOCAL = layered.Parameters(walled=False)


@dataclass(frozen=True, slots=True)
class Parameters:
    """
    Args:
        min_frontier_cells: smaller frontiers are not worth the way.
        decision_period: at least between two choices of where to go [s].
        loyalty: how much longer the way to the frontier chosen before may be than that to another one [m].
        frontier_tolerance: it counts as gone to from this near [m].
        look_time: to look at a frontier from its viewpoint, before it is given up as nothing that can be seen [s].
        patience: without moving by `required_movement_radius` [m] towards a frontier, before it is given up [s].
        margin: of the ways around the inscribed circle, given up where nothing else is left to be explored [m].
        window: half the side of the costmap that the path follower sees [m].
    """

    min_frontier_cells: int = 2
    decision_period: float = 1.0
    loyalty: float = 0.5
    frontier_tolerance: float = 0.12
    look_time: float = 1.0
    patience: float = 6.0
    required_movement_radius: float = 0.2
    margin: float = 0.03
    window: float = 1.5

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            zero_is_fine = name in ("loyalty", "margin", "look_time", "decision_period")
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0 or (zero_is_fine and value == 0))):
                raise ValueError(f"{name} must be {'not negative' if zero_is_fine else 'positive'}, not {value}")


@dataclass(slots=True, eq=False)
class _Errand:
    """A frontier that is being gone to."""

    spot: Array  # of the unknown cell to look at (2,) [m]
    goal: Goal  # its viewpoint, looking at the spot
    path: Path
    points: Array  # of the path, (n, 2) [m]
    segment: int
    place: Array  # of the robot when it last had moved on (2,) [m]
    since: float  # and the time [s]
    arrived: float | None = None  # when it began to look [s]


class Explore:
    """The navigator `explore`: ends with `Done` when no frontier is left that it can come to.

    Args:
        robot: for its footprint.
        planner: of the ways to frontiers.
        follower: drives along them.
    """

    explores = True
    """It draws a map: it needs a mapper and ignores the scenario's goal (`robocar.run`)."""

    def __init__(self, robot: Robot, planner: GlobalPlanner, follower: PurePursuit, parameters: Parameters | None = None) -> None:
        self.parameters = parameters or Parameters()
        self._planner, self._follower = planner, follower
        self._radius = robot.footprint.inscribed_radius
        self._compile()
        self._forget()

    def reset(self, rng: np.random.Generator) -> None:
        """A new episode."""
        self._planner.reset(rng)
        self._follower.reset(rng)
        self._forget()

    def _forget(self) -> None:
        self._errand: _Errand | None = None
        self._given_up: set[tuple[int, int]] = set()  # unknown cells, by their place in the map frame
        self._decided = -math.inf
        self._decisions = 0
        self._grid: OccupancyGrid | None = None
        self._local: Costmap | None = None
        self._local_centre = np.zeros(2)

    def command(self, belief: Belief, mapper: Mapper, observation: Observation, goal: Goal | None) -> Command:
        """Next command; `goal` does not matter. It waits where the mapper has no map yet."""
        grid, pose, time = mapper.grid(), belief.pose, observation.time
        if grid is None:
            return STOP
        if grid is not self._grid or math.dist(self._local_centre, pose.position) > 0.3 * self.parameters.window:
            self._grid, self._local = grid, self._window(grid, pose)
        trace: Trace = {}
        if self._must_decide(grid, pose, time):
            self._decided = time
            trace = self._decide(grid, pose, time)
            if self._errand is None:
                known = float(np.count_nonzero(~grid.unknown)) * grid.resolution**2
                return Done(f"explored: {known:.1f} m^2 are known, no frontier is left to go to", trace=trace)
        errand = self._errand
        assert errand is not None
        command = self._follower.command(belief, errand.path, self._local, observation, errand.goal)
        return replace(command, trace={**command.trace, **trace}) if trace else command

    # -- where to go ------------------------------------------------------------------------------------------------------

    def _must_decide(self, grid: OccupancyGrid, pose: SE2, time: float) -> bool:
        """Whether the errand is done, given up, blocked, or has lasted long enough to think again."""
        errand, p = self._errand, self.parameters
        if errand is None:
            return True
        if self._known(grid, errand.spot):
            return time - self._decided >= min(0.2, p.decision_period)
        distance = math.dist(pose.position, errand.goal.position)
        if math.dist(pose.position, errand.place) >= p.required_movement_radius:
            errand.place, errand.since = pose.position, time
        turn = math.remainder((errand.goal.heading or 0.0) - pose.theta, math.tau)
        there = distance <= errand.goal.xy_goal_tolerance and abs(turn) <= errand.goal.yaw_goal_tolerance
        if there and errand.arrived is None:
            errand.arrived = time
        looked = errand.arrived is not None and time - errand.arrived >= p.look_time
        if looked or (errand.arrived is None and time - errand.since > p.patience):
            self._give_up(grid, errand.spot)
            return True
        if self._blocked(errand, pose):
            return time - self._decided >= min(0.2, p.decision_period)
        return errand.arrived is None and distance > 2.0 * p.frontier_tolerance and time - self._decided >= p.decision_period

    def _decide(self, grid: OccupancyGrid, pose: SE2, time: float) -> Trace:
        """Chooses the next errand, or none."""
        open_ends = grid.unknown
        for cell in self._given_up:
            row, col = self._cell(grid, cell)
            if 0 <= row < grid.shape[0] and 0 <= col < grid.shape[1]:
                open_ends[row, col] = False
        last, self._errand = self._errand, None
        self._decisions += 1
        frontiers: list[Frontier] = []
        for margin in (self.parameters.margin, 0.0):  # squeezing through only where there is nothing else to do
            costmap = self._costmap(grid, margin)
            start = _free_start(costmap, pose)
            if start is not None:
                cell = costmap.cell_inside(start)
                frontiers = find_frontiers(costmap, open_ends, cell, self.parameters.min_frontier_cells)
                self._errand = self._choose(grid, costmap, start, pose, frontiers, last, time)
            if self._errand is not None:
                break
        return self._trace(grid, frontiers)

    def _choose(
        self,
        grid: OccupancyGrid,
        costmap: Costmap,
        start: Array,
        pose: SE2,
        frontiers: list[Frontier],
        last: _Errand | None,
        time: float,
    ) -> _Errand | None:
        """The errand to the frontier with the cheapest way, loyalty counted; the last one goes on if it is that."""

        def same(frontier: Frontier) -> bool:
            if last is None:
                return False
            return bool(np.min(np.linalg.norm(grid.world_from_cell(frontier.cells) - last.spot, axis=1)) < _SAME)

        ranked = sorted(frontiers, key=lambda f: f.cost - (self.parameters.loyalty if same(f) else 0.0))
        for frontier in ranked:
            if last is not None and same(frontier) and not self._known(grid, last.spot) and not self._blocked(last, pose):
                return last
            errand = self._go_to(grid, costmap, start, pose, frontier, time)
            if errand is not None:
                if last is not None and math.dist(last.spot, errand.spot) < _SAME:
                    errand.place, errand.since = last.place, last.since
                return errand
        return None

    def _go_to(
        self, grid: OccupancyGrid, costmap: Costmap, start: Array, pose: SE2, frontier: Frontier, time: float
    ) -> _Errand | None:
        viewpoint, spot = grid.world_from_cell(frontier.viewpoint), grid.world_from_cell(frontier.nearest)
        try:
            plan = self._planner.plan(costmap, start, viewpoint)
        except PlanningError:
            return None
        points = plan.path.points if np.array_equal(start, pose.position) else np.vstack([pose.position, plan.path.points])
        heading = math.atan2(spot[1] - viewpoint[1], spot[0] - viewpoint[0])
        # The follower stops at a share of the tolerance.
        goal = Goal(viewpoint, heading, self.parameters.frontier_tolerance / STOPPING_SHARE, 0.4)
        return _Errand(spot, goal, Path(points), np.array(points), 0, pose.position, time)

    def _give_up(self, grid: OccupancyGrid, spot: Array) -> None:
        """The unknown cells around a spot are not gone to again."""
        row, col = (int(i) for i in grid.cell_from_world(spot))
        reach = 3
        for r in range(row - reach, row + reach + 1):
            for c in range(col - reach, col + reach + 1):
                x, y = grid.world_from_cell((r, c))
                self._given_up.add((round(y / grid.resolution - 0.5), round(x / grid.resolution - 0.5)))

    def _cell(self, grid: OccupancyGrid, place: tuple[int, int]) -> tuple[int, int]:
        """The cell (row, col) at a place of `_given_up`: the grid may have grown since."""
        x, y = (place[1] + 0.5) * grid.resolution, (place[0] + 0.5) * grid.resolution
        row, col = grid.cell_from_world((x, y))
        return int(row), int(col)

    # -- what is known ----------------------------------------------------------------------------------------------------

    def _costmap(self, grid: OccupancyGrid, margin: float) -> Costmap:
        """Where the robot can go with a margin [m] around it: not into the unknown, which may well be come near."""
        inflated = inflate(grid, self._radius + margin, _LOCAL)
        costs = np.where(grid.unknown, np.uint8(NO_INFORMATION), inflated.data)
        return Costmap(costs, grid.resolution, grid.origin)

    def _window(self, grid: OccupancyGrid, pose: SE2) -> Costmap:
        """The costmap around the robot, unknown cells free in it: what the follower must not touch."""
        self._local_centre = pose.position
        row, col = (int(i) for i in grid.cell_from_world(pose.position))
        reach = math.ceil(self.parameters.window / grid.resolution)
        rows, cols = grid.shape
        r0, c0 = min(max(0, row - reach), rows - 1), min(max(0, col - reach), cols - 1)
        r1, c1 = max(r0 + 1, min(rows, row + reach + 1)), max(c0 + 1, min(cols, col + reach + 1))
        origin = grid.origin @ SE2(c0 * grid.resolution, r0 * grid.resolution)
        return inflate(OccupancyGrid(grid.data[r0:r1, c0:c1], grid.resolution, origin), self._radius, _LOCAL)

    def _known(self, grid: OccupancyGrid, spot: Array) -> bool:
        row, col = (int(i) for i in grid.cell_from_world(spot))
        return bool(grid.contains((row, col))) and grid.data[row, col] >= 0

    def _blocked(self, errand: _Errand, pose: SE2) -> bool:
        """Whether the path runs into what the follower must not touch, as far as its costmap goes."""
        assert self._local is not None
        errand.segment, _, _ = nearest_on_path(errand.points, errand.segment, pose.x, pose.y, 2.0)
        ahead = errand.points[errand.segment + 1 :]
        cells = self._local.cell_from_world(ahead)
        cells = cells[self._local.contains(cells)]
        blocked = self._local.data[cells[:, 0], cells[:, 1]] >= INSCRIBED
        # A stretch that begins in blocked cells leads out of them: the robot is there already.
        return bool(np.any(blocked[np.argmin(blocked) :])) if len(blocked) and not blocked.all() else bool(len(blocked))

    def _trace(self, grid: OccupancyGrid, frontiers: list[Frontier]) -> Trace:
        cells = np.concatenate([f.cells for f in frontiers]) if frontiers else np.empty((0, 2), dtype=int)
        trace = {
            "frontiers": Points(grid.world_from_cell(cells), color=(235, 120, 20), radius=0.5 * grid.resolution),
            "frontiers_left": Scalar(len(frontiers)),
            "replans": Scalar(max(0, self._decisions - 1)),
        }
        if self._errand is not None:
            x, y = self._errand.spot
            trace["global"] = Lines((self._errand.path.points,), color=PLAN_COLOR, radius=0.012)
            trace["plan"] = Text(
                f"to the frontier at ({x:.2f}, {y:.2f}), {self._errand.path.length:.2f} m; {len(frontiers)} left"
            )
        return trace

    def _compile(self) -> None:
        """Compiles, or loads, what is called while driving."""
        data = np.zeros((4, 4), dtype=np.int8)
        data[:, 3] = -1
        grid = OccupancyGrid(data, 1.0)
        find_frontiers(self._costmap(grid, 0.0), grid.unknown, (0, 0))
        nearest_on_path(np.array([[0.5, 0.5], [1.5, 0.5]]), 0, 0.0, 0.0, 1.0)


def _free_start(costmap: Costmap, pose: SE2) -> Array | None:
    """Where the robot is, or the nearest free cell where that seems to be blocked (2,) [m]."""
    cell = costmap.cell_from_world(pose.position)
    if costmap.contains(cell) and costmap.data[cell[0], cell[1]] < INSCRIBED:
        return pose.position
    return nearest_free(costmap, pose.position)


def build(context: Context, planner: Callable[[Context], GlobalPlanner], follower: Callable[[Context], PurePursuit]) -> Explore:
    """`explore`, of the factories of a global planner and of a path follower.

    The follower keeps more room than in a world that is known: walls are seen to a few centimetres.
    """
    careful = replace(context, parameters={"footprint_padding": 0.03} | context.parameters)
    return Explore(context.robot, planner(context), follower(careful), context.parameters_of(Parameters))
