"""The world of a scenario: its maps, what stands and moves in it, and whether everything fits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robocar.core import (
    OCCUPIED,
    SE2,
    Array,
    Footprint,
    Goal,
    GoalOccupied,
    Landmark,
    MapFormatError,
    OccupancyGrid,
    OutsideMap,
    RobocarError,
    ScenarioError,
    StartOccupied,
)
from robocar.core.discs import Discs
from robocar.core.distance import ClearanceField, polygon_distance
from robocar.core.solids import Box, Cylinder, Solid
from robocar.formats import file_kind, load_barn_world, load_map
from robocar.scenario.model import Scenario, goal_heading, pose_of
from robocar.scenario.nearest import nearest_free
from robocar.sim.movers import Mover
from robocar.sim.world_spec import WorldSpec, add_top_camera, build_world

BARN_RESOLUTION = 0.05  # [m] cells of the map of a world of cylinders, unless the scenario says otherwise: a third of its lattice
FLOOR = 1.0  # [m] that such a map shows around start and goal, where they lie outside


@dataclass(frozen=True)
class Scene:
    """A checked scenario with its files loaded.

    Args:
        scenario: as written.
        grid: the map that physics is built from.
        prior: the map that the robot is given, or None.
        solids: obstacles that stand in the world but not on the prior; of a world of cylinders (BARN) the cylinders too, which
            a prior `truth` shows in the cells that they cover.
        landmarks: coloured balls.
        start: true world_from_robot at the beginning.
        goal: or None.
        notes: on its files: what is legal but probably not meant.
    """

    scenario: Scenario
    grid: OccupancyGrid
    prior: OccupancyGrid | None
    solids: tuple[Solid, ...]
    landmarks: tuple[Landmark, ...]
    start: SE2
    goal: Goal | None
    notes: tuple[str, ...] = ()

    @classmethod
    def load(cls, scenario: Scenario, footprint: Footprint) -> Scene:
        """Load the files and check that the car fits where it shall be.

        Raises:
            MapFormatError: a map cannot be read.
            StartOccupied, GoalOccupied, OutsideMap, ScenarioError: something lies where it must not.
        """
        notes: list[str] = []
        grid, pillars, drawn = _load_world(scenario, notes)
        if scenario.prior == "none":
            prior = None
        elif scenario.prior == "truth":
            prior = drawn
        else:
            prior = load_map(scenario.file("prior"), scenario.resolution, notes)
        goal = None
        if scenario.goal is not None:
            goal = Goal(
                np.array(scenario.goal[:2]),
                goal_heading(scenario.goal),
                scenario.xy_goal_tolerance,
                scenario.yaw_goal_tolerance,
            )
        scene = cls(
            scenario,
            grid,
            prior,
            (*(obstacle.solid() for obstacle in scenario.unknown_obstacles), *pillars),
            _landmarks(scenario),
            pose_of(scenario.start),
            goal,
            tuple(notes),
        )
        scene._check(footprint)
        return scene

    @cached_property
    def enclosed(self) -> OccupancyGrid:
        """The map with the wall around it, where there is one, as a ring of occupied cells."""
        return enclosed(self.grid, self.scenario.border == "wall")

    @cached_property
    def judged_map(self) -> OccupancyGrid:
        """What a drawn map and the way driven are compared with: walls, solids, and the wall around."""
        return enclosed(self.true_grid, self.scenario.border == "wall")

    @cached_property
    def _walls(self) -> ClearanceField:
        return ClearanceField(self.enclosed, self.enclosed.occupied)

    def clearance(self, polygon: Array) -> float:
        """Distance from a convex polygon (n, 2) to the nearest wall or solid, 0 where they overlap [m]."""
        nearest = min(float(self._walls.footprint(polygon)), self._discs.distance(polygon))
        reach = max(math.dist(polygon[0], corner) for corner in polygon)
        for outline, centre, radius in self._outlines:
            if math.dist(centre, polygon[0]) - radius - reach < nearest:
                nearest = min(nearest, polygon_distance(polygon, outline))
        return nearest

    @cached_property
    def movers(self) -> tuple[Mover, ...]:
        """The moving obstacles."""
        return tuple(mover.mover() for mover in self.scenario.movers)

    @cached_property
    def _outlines(self) -> list[tuple[Array, tuple[float, float], float]]:
        """Of the boxes, with their centres and the radii around them."""
        boxes = [solid for solid in self.solids if isinstance(solid, Box)]
        return [(box.outline(), (box.pose.x, box.pose.y), box.radius) for box in boxes]

    @cached_property
    def _discs(self) -> Discs:
        """The cylinders, which are round: a polygon in their place would be felt before it is touched."""
        return Discs([(c.pose.x, c.pose.y, c.radius) for c in self.solids if isinstance(c, Cylinder)])

    @cached_property
    def only_discs(self) -> Array | None:
        """x, y and radius of all obstacles, (n, 3) [m], where the world is open and holds nothing but cylinders; else None."""
        bare = self.scenario.border == "open" and not self.grid.occupied.any() and not self._outlines
        return self._discs.array if bare else None

    @cached_property
    def true_grid(self) -> OccupancyGrid:
        """The map with the solids drawn in: every cell that one of them covers or touches."""
        data = self.grid.data.copy()
        for solid in self.solids:
            rows, cols = self._cells_near(solid)
            half = 0.5 * self.grid.resolution
            square = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
            outline = solid.outline()
            for row in rows:
                for col in cols:
                    corners = self.grid.world_from_cell((row, col)) + SE2(theta=self.grid.origin.theta).transform(square)
                    if polygon_distance(corners, outline) == 0.0:
                        data[row, col] = OCCUPIED
        return OccupancyGrid(data, self.grid.resolution, self.grid.origin)

    def _cells_near(self, solid: Solid) -> tuple[range, range]:
        row, col = (int(i) for i in self.grid.cell_from_world(solid.pose.position))
        reach = math.ceil(solid.radius / self.grid.resolution) + 1
        rows, cols = self.grid.shape
        return range(max(0, row - reach), min(rows, row + reach + 1)), range(max(0, col - reach), min(cols, col + reach + 1))

    def world(self) -> WorldSpec:
        """The MuJoCo world, without robots."""
        scenario = self.scenario
        spec = build_world(
            self.grid,
            wall_height=scenario.wall_height,
            landmarks=self.landmarks,
            solids=self.solids,
            movers=self.movers,
            border=scenario.border,
            lighting=scenario.lighting,
        )
        if scenario.robot.top_camera:
            add_top_camera(spec, self.grid, scenario.wall_height)
        return spec

    # -- checks ---------------------------------------------------------------------------------------------------------

    def _check(self, footprint: Footprint) -> None:
        where = f"scenario {self.scenario.name}"
        for i, solid in enumerate(self.solids[: len(self.scenario.unknown_obstacles)]):
            self._check_inside(solid.pose.position, f"{where}: unknown_obstacles.{i}")
        self._check_pose(footprint, self.start, f"{where}: start", StartOccupied)
        for event in self.scenario.events:
            self._check_pose(footprint, SE2(*event.kidnap), f"{where}: kidnap at {event.time:g} s", ScenarioError)
        if self.goal is not None and not self.scenario.goal_may_be_blocked:
            self._check_goal(footprint, self.goal, f"{where}: goal")
        for mover in self.movers:
            self._check_mover(mover, footprint, f"{where}: mover {mover.name!r}")

    def _check_inside(self, point: Array, what: str) -> None:
        """On the map, unless the world goes on beyond it."""
        if self.scenario.border == "wall":
            self.grid.cell_inside(point, what)

    def _check_mover(self, mover: Mover, footprint: Footprint, what: str) -> None:
        """What it covers from each way point to the next, and back from the last to the first, must be free."""
        start = mover.start
        self._check_inside(start.position, f"{what} at its start")
        if polygon_distance(mover.outline(start), footprint.at(self.start)) <= mover.radius:
            raise ScenarioError(f"{what} stands at ({start.x:g}, {start.y:g}), where the car starts")
        for a, b, swept, radius in mover.sweeps():
            if self.clearance(swept) <= radius:
                leg = f"({a.x:g}, {a.y:g}) and ({b.x:g}, {b.y:g})"
                raise ScenarioError(f"{what} hits a wall or an obstacle between {leg}; lead it through free cells")

    def _check_pose(self, footprint: Footprint, pose: SE2, what: str, error: type[RobocarError]) -> None:
        def fits(pose: SE2) -> bool:
            return self.clearance(footprint.at(pose)) > 0.0

        def nearest() -> str:
            return nearest_free(self.grid, pose.position, pose.theta, self._walls.points, fits)

        try:
            self._check_inside(pose.position, what)
        except OutsideMap as failure:
            raise OutsideMap(f"{failure}{nearest()}") from failure
        if fits(pose):
            return
        spot = f"({pose.x:g}, {pose.y:g}, {pose.theta:g})"
        if float(self._walls.points(pose.position[None])[0]) == 0.0:
            raise error(f"{what} {spot} lies in a wall{nearest()}")
        raise error(f"{what} {spot} is too tight: the car's footprint touches an obstacle there{nearest()}")

    def _check_goal(self, footprint: Footprint, goal: Goal, what: str) -> None:
        try:
            self._check_goal_point(footprint, goal.position, what)
        except (OutsideMap, GoalOccupied) as failure:
            # In any heading, unless one is asked for.
            outline = Footprint.circle(footprint.circumscribed_radius) if goal.heading is None else footprint

            def fits(pose: SE2) -> bool:
                try:
                    self._check_goal_point(footprint, pose.position, what)
                except (OutsideMap, GoalOccupied):
                    return False
                return self.clearance(outline.at(pose)) > 0.0

            near = nearest_free(self.grid, goal.position, goal.heading, self._walls.points, fits)
            raise type(failure)(f"{failure}{near}") from failure

    def _check_goal_point(self, footprint: Footprint, point: Array, what: str) -> None:
        x, y = point
        for name, (grid, walls) in self._known_walls.items():
            try:
                cell = grid.cell_inside(point, what)
            except OutsideMap:
                if self.scenario.border == "wall":
                    raise
                continue
            if grid.occupied[cell]:
                raise GoalOccupied(f"{what} ({x:g}, {y:g}) lies in a wall of the {name}")
            near = walls.around(point, footprint.inscribed_radius + grid.resolution)
            room = float(ClearanceField(near, near.occupied).points(point[None])[0])
            if room < footprint.inscribed_radius:
                raise GoalOccupied(
                    f"{what} ({x:g}, {y:g}) is too tight: the nearest wall of the {name} is {room:.3f} m away, "
                    f"the car needs {footprint.inscribed_radius:.3f} m"
                )
        spot = Footprint.circle(footprint.inscribed_radius).at(SE2(float(x), float(y)))
        if self.clearance(spot) == 0.0:
            raise GoalOccupied(f"{what} ({x:g}, {y:g}) is too tight: an unknown obstacle or the border stands there")

    @cached_property
    def _known_walls(self) -> dict[str, tuple[OccupancyGrid, OccupancyGrid]]:
        """The maps that a goal must fit on, and the same with their border."""
        maps = {"map": self.grid} if self.prior is None else {"prior map": self.prior, "map": self.grid}
        return {name: (grid, enclosed(grid, self.scenario.border == "wall")) for name, grid in maps.items()}


def _load_world(scenario: Scenario, notes: list[str]) -> tuple[OccupancyGrid, tuple[Solid, ...], OccupancyGrid]:
    """The grid of walls, the cylinders, and the map that shows both: of a BARN world the first is empty."""
    path = scenario.file("map")
    if file_kind(path) != "barn_world":
        grid = load_map(path, scenario.resolution, notes)
        return grid, (), grid
    barn = load_barn_world(path)
    ends = [pose_of(scenario.start).position, *([] if scenario.goal is None else [np.array(scenario.goal[:2])])]
    corners = np.concatenate([barn.cylinders[:, :2] - barn.cylinders[:, 2:], barn.cylinders[:, :2] + barn.cylinders[:, 2:]])
    low = np.min([corners.min(axis=0), *(end - FLOOR for end in ends)], axis=0)
    high = np.max([corners.max(axis=0), *(end + FLOOR for end in ends)], axis=0)
    try:
        drawn = barn.grid(scenario.resolution or BARN_RESOLUTION, (*low.tolist(), *high.tolist()))
    except MapFormatError as failure:
        raise MapFormatError(f"{path}: {failure}") from failure
    floor = OccupancyGrid(np.zeros_like(drawn.data), drawn.resolution, drawn.origin)
    return floor, tuple(Cylinder(r, scenario.wall_height, SE2(x, y)) for x, y, r in barn.cylinders.tolist()), drawn


def _landmarks(scenario: Scenario) -> tuple[Landmark, ...]:
    balls = []
    for i, ball in enumerate(scenario.landmarks):
        x, y, *rest = ball.position
        z = rest[0] if rest else scenario.wall_height + ball.radius
        balls.append(Landmark(ball.name or f"{ball.color}_{i}", ball.color, np.array([x, y, z]), ball.radius))
    return tuple(balls)


def enclosed(grid: OccupancyGrid, walled: bool) -> OccupancyGrid:
    """The map with a ring of occupied cells around it, where the world has one."""
    if not walled:
        return grid
    edge = -grid.resolution
    data = np.pad(grid.data, 1, constant_values=OCCUPIED)
    return OccupancyGrid(data, grid.resolution, grid.origin @ SE2(edge, edge))
