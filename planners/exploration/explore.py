"""Frontier exploration: draws the map of an unknown world by driving to where it ends, until it ends nowhere.

Yamauchi, A Frontier-Based Approach for Autonomous Exploration (1997): the robot goes to the nearest frontier, looks, and again.
Here the ways lead through what the mapper has seen to be free, as A* finds them, and a frontier that has been seen through from
afar is no longer gone to. A robot that has only sonars sees too little of what lies beside its way: it stops where it would brush
the unknown and turns around once to hear all sides (the thesis' remedy, Fig. 4.18).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robocar.core import (
    INSCRIBED,
    SE2,
    STOP,
    Array,
    Command,
    Context,
    Costmap,
    Done,
    Drive,
    GiveUp,
    GlobalPlanner,
    Goal,
    Lines,
    Observation,
    OccupancyGrid,
    Path,
    PlanningError,
    Points,
    Robot,
    Scalar,
    State,
    Text,
    Trace,
    Twist,
    declares,
)
from robocar.core.compiling import warm_up
from robocar.core.trace import PLAN_COLOR
from robocar.core.work import Work
from robocar.planners.controllers.pure_pursuit import STOPPING_SHARE, PurePursuit
from robocar.planners.costmap import known_space
from robocar.planners.costmap.known_space import is_known
from robocar.planners.exploration.frontiers import Frontier, find_frontiers
from robocar.planners.geometry.collision import footprint_free
from robocar.planners.geometry.polyline import nearest_on_path

_CAREFUL = {"footprint_padding": 0.02, "lookahead_dist": 0.15}
_SAME = 0.3  # [m] frontiers that are nearer to each other than this are one that has changed
_SILENCE = 0.5  # [s] without a reading, or two and a half periods of the sensor, after which it stands
_GIVE_UP_REACH = 3  # [cells] around what was looked for in vain


@dataclass(frozen=True, slots=True)
class ExploreParameters:
    """
    Args:
        min_frontier_cells: smaller frontiers are not worth the way.
        decision_period: at least between two choices of where to go [s].
        loyalty: how much longer the way to the frontier chosen before may be than that to another one [m].
        frontier_tolerance: it counts as gone to from this near [m].
        look_time: to look at a frontier from its viewpoint, before it is given up as nothing that can be seen [s].
        patience: without moving by `required_movement_radius` [m] towards a frontier, before it is given up [s].
        margin: of the ways around the inscribed circle, given up where nothing else is left to be explored [m]; sonar_margin:
            before that, where the robot looks around, since sonars see walls late.
        look_around: turn once where the known space ends: `auto` does without a laser.
        look_around_spacing: between two such places [m]; turn_rate: while turning [rad/s].
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
    sonar_margin: float = 0.09
    look_around: str = "auto"
    look_around_spacing: float = 0.3
    turn_rate: float = 1.2
    window: float = 1.5

    def __post_init__(self) -> None:
        if self.look_around not in ("auto", "always", "never"):
            raise ValueError(f"look_around is auto, always or never, not {self.look_around!r}")
        for name in (n for n in self.__dataclass_fields__ if n != "look_around"):
            zero_is_fine = name in ("loyalty", "margin", "sonar_margin", "look_time", "decision_period")
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
    whole: bool  # whether the path leads to the frontier itself, not only to where the known space ends
    place: Array  # of the robot when it last had moved on (2,) [m]
    since: float  # and the time [s]
    arrived: float | None = None  # when it began to look [s]


class Explore:
    """The navigator `explore`: ends with `Done` when no frontier is left that it can come to.

    Whether that is a success its map decides (`robocar.episode.exploration`).

    Args:
        robot: for its footprint, and whether it has a laser.
        planner: of the ways to frontiers.
        follower: drives along them.
    """

    def __init__(
        self, robot: Robot, planner: GlobalPlanner, follower: PurePursuit, parameters: ExploreParameters | None = None
    ) -> None:
        self.parameters = parameters or ExploreParameters()
        self._planner, self._follower = planner, follower
        self._outline = np.array(robot.footprint.vertices)
        self._radius = robot.footprint.inscribed_radius
        self._turning_radius = robot.footprint.circumscribed_radius
        self._looks_around = {"auto": robot.lidar is None, "always": True, "never": False}[self.parameters.look_around]
        self._errand: _Errand | None = None
        self._given_up: set[tuple[int, int]] = set()  # unknown cells, as row and column counted from the map frame's origin
        self._looked: list[Array] = []  # where it has turned around
        self._turned: tuple[float, float] | None = None  # while it does: how far [rad], and the last heading
        self._decided = -math.inf
        self._nothing_since: float | None = None
        self._decisions = 0
        self._ranging = "sonars" if robot.lidar is None else "laser"
        sensors = robot.sonars if robot.lidar is None else (robot.lidar,)
        self._silence = max([_SILENCE, *(2.5 * sensor.period for sensor in sensors)])
        self._read_at: float | None = None  # when a range sensor gave a reading [s]
        self._grid: OccupancyGrid | None = None
        self._local: Costmap | None = None  # around the robot, the unknown free in it
        self._closed: Costmap | None = None  # the same with the unknown as obstacle, where the robot looks around
        self._local_centre = np.zeros(2)
        _warm_up()

    def command(self, state: State, observation: Observation, goal: Goal | None) -> Command:
        """Next command; `goal` does not matter. It waits while there is no map yet, and gives up where its sensors are dead."""
        if (blind := self._blind(state, observation)) is not None:
            return blind
        grid, pose, time = None if state.map is None else state.map.grid(), state.belief.pose, observation.time
        if grid is None:
            return STOP
        p = self.parameters
        if grid is not self._grid or math.dist(self._local_centre, pose.position) > 0.3 * p.window:
            self._grid, self._local_centre = grid, pose.position
            self._local = known_space.surroundings(grid, pose, p.window, self._radius)
            if self._looks_around:
                self._closed = known_space.surroundings(grid, pose, p.window, self._radius, allow_unknown=False)
        if self._turned is not None and (turn := self._turn_on(pose, time)) is not None:
            return turn
        trace: Trace = {}
        work: Work = {}
        if self._must_decide(grid, pose, time):
            self._decided = time
            trace = self._decide(grid, pose, time)
            work = {"replans": 1} if self._decisions > 1 else {}
            if self._errand is not None:
                self._nothing_since = None
            elif self._nothing_since is None:
                self._nothing_since = time
        if self._turned is not None:
            return Drive(Twist(), trace=trace, work=work)
        if self._errand is None:
            if self._nothing_since is None or time - self._nothing_since < p.look_time:
                return replace(STOP, trace=trace, work=work)  # it may be but a passing error of the map that shuts the robot in
            known = float(np.count_nonzero(~grid.unknown)) * grid.resolution**2
            return Done(f"explored: {known:.1f} m^2 are known, no frontier is left to go to", trace=trace, work=work)
        seen = self._closed if self._closed is not None and self._stands_free(self._closed, pose) else self._local
        command = self._follower.drive(state, self._errand.path, seen, observation, self._errand.goal)
        return replace(command, trace={**command.trace, **trace}, work=work) if trace else command

    def _blind(self, state: State, observation: Observation) -> Command | None:
        """It stands where no range sensor has given a reading for a while, lost beams are none; in the end it gives up."""
        time = observation.time
        whole = state.map is not None and state.map.complete  # a camera sees instead
        scans = observation.sonars if self._ranging == "sonars" else observation.lidars
        if whole or self._read_at is None or any(not np.isnan(scan.ranges).all() for scan in scans):
            self._read_at = time
        if time - self._read_at <= self._silence:
            return None
        self._errand, message = None, f"no reading of the {self._ranging}, all are lost"
        if time - self._read_at > self.parameters.patience:
            return GiveUp(f"{message} for {self.parameters.patience:g} s")
        return replace(STOP, trace={"plan": Text(f"{message}: standing", "WARN")})

    # -- when to think again ----------------------------------------------------------------------------------------------

    def _must_decide(self, grid: OccupancyGrid, pose: SE2, time: float) -> bool:
        """Whether the errand is done, given up, blocked, or has lasted long enough to think again."""
        errand, p = self._errand, self.parameters
        waited = time - self._decided
        if errand is None:
            return True
        if is_known(grid, errand.spot):
            return waited >= min(0.2, p.decision_period)
        distance = math.dist(pose.position, errand.goal.position)
        if math.dist(pose.position, errand.place) >= p.required_movement_radius:
            errand.place, errand.since = pose.position, time
        turn = math.remainder((errand.goal.heading or 0.0) - pose.theta, math.tau)
        there = distance <= errand.goal.xy_goal_tolerance and abs(turn) <= errand.goal.yaw_goal_tolerance
        if there and errand.arrived is None:
            errand.arrived = time
        if there and self._looks_around and not self._has_looked(pose):
            self._look_around(pose)
            return True
        if errand.arrived is not None and not errand.whole:
            return waited >= min(0.2, p.decision_period)
        looked = errand.arrived is not None and time - errand.arrived >= p.look_time
        if looked or (errand.arrived is None and time - errand.since > p.patience):
            self._give_up(grid, errand.spot)
            self._errand = None
            return True
        if self._blocked(errand, pose):
            return waited >= min(0.2, p.decision_period)
        return errand.arrived is None and distance > 2.0 * p.frontier_tolerance and waited >= p.decision_period

    def _blocked(self, errand: _Errand, pose: SE2) -> bool:
        """Whether the path runs into what the follower must not touch, as far as its costmap goes."""
        assert self._local is not None
        errand.segment, _, _ = nearest_on_path(errand.points, errand.segment, pose.x, pose.y, 2.0)
        cells = self._local.cell_from_world(errand.points[errand.segment + 1 :])
        cells = cells[self._local.contains(cells)]
        blocked = self._local.data[cells[:, 0], cells[:, 1]] >= INSCRIBED
        # A stretch that begins in blocked cells leads out of them: the robot is there already.
        return bool(np.any(blocked[np.argmin(blocked) :])) if len(blocked) else False

    def _give_up(self, grid: OccupancyGrid, spot: Array) -> None:
        """The unknown cells around a spot are not gone to again."""
        row, col = self._absolute(grid) + grid.cell_from_world(spot)
        reach = range(-_GIVE_UP_REACH, _GIVE_UP_REACH + 1)
        self._given_up |= {(int(row) + i, int(col) + j) for i in reach for j in reach}

    def _absolute(self, grid: OccupancyGrid) -> NDArray[np.intp]:
        """Row and column of the grid's first cell, counted from the map frame's origin: the grid may grow."""
        return np.rint(np.array([grid.origin.y, grid.origin.x]) / grid.resolution).astype(np.intp)

    def _stands_free(self, costmap: Costmap, pose: SE2) -> bool:
        """Whether the car's outline lies in known free cells, so that the follower can be held to them."""
        at, size = costmap.origin.inverse() @ pose, costmap.resolution
        return bool(footprint_free(costmap.data, at.x / size, at.y / size, at.theta, self._outline / size))

    # -- looking around ---------------------------------------------------------------------------------------------------

    def _has_looked(self, pose: SE2) -> bool:
        return any(math.dist(place, pose.position) < self.parameters.look_around_spacing for place in self._looked)

    def _look_around(self, pose: SE2) -> None:
        """Begins a turn, unless something known is in the way of the car's corners."""
        assert self._local is not None
        self._looked.append(pose.position)
        rows, cols = np.nonzero(self._local.data >= INSCRIBED + 1)
        obstacles = self._local.world_from_cell(np.stack([rows, cols], axis=1))
        reach = self._turning_radius + 0.75 * self._local.resolution
        if not len(obstacles) or np.min(np.linalg.norm(obstacles - pose.position, axis=1)) > reach:
            self._turned = 0.0, pose.theta

    def _turn_on(self, pose: SE2, time: float) -> Command | None:
        """Goes on turning, until it has been once around."""
        assert self._turned is not None
        angle, last = self._turned
        angle += abs(math.remainder(pose.theta - last, math.tau))
        self._turned = (angle, pose.theta) if angle < math.tau else None
        if self._errand is not None:
            self._errand.since = time
        return Drive(Twist(0.0, self.parameters.turn_rate)) if self._turned is not None else None

    # -- where to go ------------------------------------------------------------------------------------------------------

    def _decide(self, grid: OccupancyGrid, pose: SE2, time: float) -> Trace:
        """Chooses the next errand, or none."""
        open_ends = grid.unknown
        if self._given_up:
            cells = np.array(sorted(self._given_up)) - self._absolute(grid)
            cells = cells[grid.contains(cells)]
            open_ends[cells[:, 0], cells[:, 1]] = False
        last, self._errand = self._errand, None
        self._decisions += 1
        frontiers: list[Frontier] = []
        wide = (self.parameters.sonar_margin,) if self._looks_around else ()
        for margin in (*wide, self.parameters.margin, 0.0):  # squeezing through only where there is nothing else to do
            sure = known_space.surely_free(grid, self._radius + margin) if self._looks_around else None
            costmap = known_space.ways(grid, self._radius + margin, sure)
            start = known_space.free_start(costmap, pose)
            if start is not None:
                cell = costmap.cell_inside(start)
                frontiers = find_frontiers(costmap, open_ends, cell, self.parameters.min_frontier_cells)
                self._errand = self._choose(costmap, sure, start, pose, frontiers, last, time)
            if self._errand is not None:
                break
        return self._trace(grid, frontiers)

    def _choose(
        self,
        costmap: Costmap,
        sure: NDArray[np.bool_] | None,
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
            return bool(np.min(np.linalg.norm(costmap.world_from_cell(frontier.cells) - last.spot, axis=1)) < _SAME)

        goes_on = last is not None and last.arrived is None and self._grid is not None and not is_known(self._grid, last.spot)
        for frontier in sorted(frontiers, key=lambda f: f.cost - (self.parameters.loyalty if same(f) else 0.0)):
            if last is not None and goes_on and same(frontier) and not self._blocked(last, pose):
                return last
            errand = self._go_to(costmap, sure, start, pose, frontier, time)
            if errand is not None:
                if last is not None and last.arrived is None and math.dist(last.spot, errand.spot) < _SAME:
                    errand.place, errand.since = last.place, last.since
                return errand
        return None

    def _go_to(
        self, costmap: Costmap, sure: NDArray[np.bool_] | None, start: Array, pose: SE2, frontier: Frontier, time: float
    ) -> _Errand | None:
        spot = costmap.world_from_cell(frontier.nearest)
        try:
            plan = self._planner.plan(costmap, start, costmap.world_from_cell(frontier.viewpoint))
        except PlanningError:
            return None
        points = plan.path.points
        if math.dist(start, pose.position) > 0.0:
            points = np.vstack([pose.position, points])
        end = len(points) if sure is None else self._safe_length(costmap, sure, points, pose)
        whole, points = end == len(points), points[:end]
        viewpoint = points[-1]
        heading = math.atan2(spot[1] - viewpoint[1], spot[0] - viewpoint[0])
        # The follower stops at a share of the tolerance.
        goal = Goal(viewpoint, heading, self.parameters.frontier_tolerance / STOPPING_SHARE, 0.4)
        return _Errand(spot, goal, Path(points), np.array(points), 0, whole, pose.position, time)

    def _safe_length(self, costmap: Costmap, sure: NDArray[np.bool_], points: Array, pose: SE2) -> int:
        """How many points of a path may be driven before looking around: until it leaves the sure cells, and where the robot has
        looked around already, a little farther than it has seen from there."""
        cells = costmap.cell_from_world(points)
        unsure = ~sure[cells[:, 0], cells[:, 1]]
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        if self._has_looked(pose):
            unsure &= way > 1.2 * self.parameters.look_around_spacing
        return max(1, int(np.argmax(unsure))) if unsure.any() else len(points)

    def _trace(self, grid: OccupancyGrid, frontiers: list[Frontier]) -> Trace:
        cells = np.concatenate([f.cells for f in frontiers]) if frontiers else np.empty((0, 2), dtype=int)
        trace = {
            "frontiers": Points(grid.world_from_cell(cells), color=(235, 120, 20), radius=0.5 * grid.resolution),
            "frontiers_left": Scalar(len(frontiers)),
        }
        if self._errand is not None:
            x, y = self._errand.spot
            trace["global"] = Lines((self._errand.path.points,), color=PLAN_COLOR, radius=0.012)
            trace["plan"] = Text(
                f"to the frontier at ({x:.2f}, {y:.2f}), {self._errand.path.length:.2f} m; {len(frontiers)} left"
            )
        return trace


@warm_up
def _warm_up() -> None:
    data = np.zeros((4, 4), dtype=np.int8)
    data[:, 3] = -1
    grid = OccupancyGrid(data, 1.0)
    find_frontiers(known_space.ways(grid, 0.1), grid.unknown, (0, 0))
    footprint_free(np.zeros((4, 4), dtype=np.uint8), 2.0, 2.0, 0.0, np.ones((3, 2)))
    nearest_on_path(np.array([[0.5, 0.5], [1.5, 0.5]]), 0, 0.0, 0.0, 1.0)


@declares(explores=True)
def build(context: Context, planner: Callable[[Context], GlobalPlanner], follower: Callable[[Context], PurePursuit]) -> Explore:
    """`explore`, of the factories of a global planner and of a path follower.

    The follower keeps more room and cuts corners less than in a world that is known: walls are seen to a few centimetres.
    """
    controller = context.part("controller")
    careful = replace(controller, parameters=_CAREFUL | dict(controller.parameters))
    return Explore(context.robot, planner(context.part("planner")), follower(careful), context.parameters_of(ExploreParameters))
