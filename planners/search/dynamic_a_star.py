"""Dynamic A* of the HBE-Robocar (thesis, eq. 2.44, sections 2.6, 3.5, 4.3 and 4.4).

The floor is a lattice of 30 cm cells. The car drives from cell centre to cell centre along the A* path; whenever its sonars
find that a cell is blocked, the cell is marked and the path is planned again from where the car is. With sonars that look
only forward it turns 360 degrees in each cell it has not looked around in yet; with sonars on its sides it does not need to.

What the thesis leaves open is decided here. Echoes are gathered on a fine grid, because the echo of a 15 degree cone does
not say where on its arc the surface is: later readings that look farther through the same place take it back. A cell is
blocked when an obstacle lies where the car would be while turning on its centre, a step when one lies where the car would
drive, so the footprint never touches what is known. Diagonal steps need both cells beside them free, and are driven around
the corner where something stands between the four cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np

from robocar.core import (
    SE2,
    STOP,
    Array,
    Command,
    Context,
    Costmap,
    Drive,
    GiveUp,
    Goal,
    Lines,
    Observation,
    OccupancyGrid,
    Plan,
    PlanningError,
    Points,
    Robot,
    State,
    Text,
    Twist,
    wrap_angle,
)
from robocar.core.trace import PLAN_COLOR, Drawable, LazyTrace
from robocar.core.way import length_over, through
from robocar.planners.geometry.escape import CELLS, MARGIN, Escape
from robocar.planners.geometry.reachability import Proof
from robocar.planners.search import a_star
from robocar.planners.search.car_lattice import CarLattice
from robocar.planners.search.clear_legs import search_clear_legs
from robocar.planners.search.dynamic_a_star_parameters import DynamicAStarParameters
from robocar.planners.search.obstacle_memory import ObstacleMemory

Makers: TypeAlias = dict[str, Callable[[], Drawable]]  # of drawables by name, called when somebody looks, within the tick

_STOPPING_SHARE = 0.5  # of the goal's tolerances: where it turns to the heading, and where it stands
_ROOM = 0.005  # [m] free around the circumscribed circle, where a way out of a tight place ends


class DynamicAStar:
    """The navigator `dynamic-a-star`."""

    def __init__(self, context: Context) -> None:
        self._robot: Robot = context.robot
        self._dt = context.control_period
        self._prior = context.prior
        self._parameters = context.parameters_of(DynamicAStarParameters)
        self._footprint = context.robot.footprint
        self._proof = Proof(context.prior, context.robot.footprint.inscribed_radius)
        self._keep(self._parameters.margin)
        looks_sideways = any(abs(math.sin(s.robot_from_sensor.theta)) > 0.7 for s in context.robot.sonars)
        sees_around = looks_sideways or context.robot.lidar is not None
        self._look_around = {"always": True, "never": False, "auto": not sees_around}[self._parameters.look_around]
        self._search = a_star.AStar(a_star.AStarParameters(metric=self._parameters.metric))
        ObstacleMemory(SE2(), (0.1, 0.1), None, 0.0)  # compiles its kernels before the control loop
        self._lattice: CarLattice | None = None
        self._memory: ObstacleMemory | None = None
        self._shown: OccupancyGrid | None = None
        self._blocked = np.zeros((0, 0), dtype=bool)
        self._way: list[Array] = []  # points still to be reached, the next one first
        self._planned_to: Array | None = None
        self._anchor: Array | None = None  # the last point that was reached: back there the way is free
        self._retreating = False
        self._looked: set[tuple[int, int]] = set()
        self._spin: tuple[float, float] | None = None  # still to turn [rad], last heading
        self._spin_sign = 1.0
        self._turning = True
        self._plans = self._counted = 0  # plans made, and told of as replans
        self._desperate = False
        self._escape = Escape(context.robot, _ROOM, CELLS)
        self._overhang = 0.0  # [m] how far the car's nose reaches beyond the last point of the way

    def _keep(self, margin: float) -> None:
        """How much room the footprint takes from now on [m]."""
        self._margin = margin
        self._disc = self._footprint.circumscribed_radius + margin
        self._half_width = self._footprint.inscribed_radius + margin
        self._front = float(self._footprint.vertices[:, 0].max()) + margin

    # -- one tick -----------------------------------------------------------------------------------------------------

    def command(self, state: State, observation: Observation, goal: Goal | None) -> Command:
        if goal is None:
            return GiveUp("dynamic-a-star needs a goal")
        pose = state.belief.pose
        self._proof.begin(pose.position)
        memory = self._prepare(pose, goal)
        if state.map is not None and state.map.complete:  # a camera above the field: the thesis' other source of obstacles
            self._look_around = self._parameters.look_around == "always"
            seen = state.map.grid()
            if seen is not None and seen is not self._shown:
                memory.show(seen)
                self._shown = seen
        else:
            for scan in observation.scans:
                memory.mark(pose, scan, self._parameters.hit_range, self._parameters.free_range)
        if (escaping := self._get_out(pose)) is not None:
            return escaping
        if goal.heading is not None and math.dist(pose.position, goal.position) <= _STOPPING_SHARE * goal.xy_goal_tolerance:
            return self._align(pose, goal, goal.heading)
        shown: Makers = {}
        work: dict[str, int] = {}
        if self._planned_to is None or (not self._retreating and self._must_replan(pose)):
            problem = self._replan(pose, goal, shown, work)
            if problem is not None:
                return problem
        return Drive(self._drive(pose), trace=LazyTrace(shown), work=work)

    def _prepare(self, pose: SE2, goal: Goal) -> ObstacleMemory:
        if self._lattice is None or self._memory is None:
            lattice = CarLattice(self._parameters.cell_size, self._prior, pose, goal.position)
            if self._prior is not None:
                origin, extent = self._prior.origin, self._prior.size
            else:
                rows, cols = lattice.shape
                origin, extent = lattice.origin, (cols * lattice.cell_size, rows * lattice.cell_size)
            self._lattice, self._memory = (
                lattice,
                ObstacleMemory(origin, extent, self._prior, self._parameters.prior_tolerance, self._parameters.allow_unknown),
            )
            self._blocked = np.zeros(lattice.shape, dtype=bool)
        return self._memory

    # -- planning -----------------------------------------------------------------------------------------------------

    def _must_replan(self, pose: SE2) -> bool:
        """Whether something has turned up on the way that is left."""
        lattice, memory = self._lattice, self._memory
        assert lattice is not None and memory is not None
        nearby = self._parameters.hit_range + 2.0 * self._parameters.cell_size
        previous = pose.position
        for k, point in enumerate(self._way):
            if math.dist(point, pose.position) > nearby:
                break
            last = k == len(self._way) - 1
            # From where the car is now the leg differs a little from the one that was planned: it may use up the margin.
            half_width = self._half_width - (self._margin if k == 0 else 0.0)
            if memory.way_blocked(previous, point, half_width, self._overhang if last else 0.0):
                return True
            if not last and self._is_blocked(lattice.cell(point)):
                return True
            previous = point
        return False

    def _replan(self, pose: SE2, goal: Goal, shown: Makers, work: dict[str, int]) -> Command | None:
        """A new way from where the car is, with what it shows and took; returns why there is none."""
        lattice, memory = self._lattice, self._memory
        assert lattice is not None and memory is not None
        self._plans += 1
        rows, cols = lattice.shape
        self._blocked = np.array([[self._is_blocked((r, c)) for c in range(cols)] for r in range(rows)])
        costmap = lattice.costmap(self._blocked)
        base = self._base(pose)
        start_cells = self._access(costmap, base, to_point=False)
        # The last leg ends as soon as the goal is near enough.
        self._overhang = max(self._front - 0.8 * goal.xy_goal_tolerance, 0.0)
        goal_cells = self._access(costmap, goal.position, to_point=True)
        reason = "no cell beside the car is free" if not start_cells else "no cell beside the goal is free"
        for start in start_cells:
            for end in goal_cells:
                try:
                    plan, points = search_clear_legs(self._search, lattice, memory, self._half_width, self._blocked, (start, end))
                except PlanningError as error:
                    reason = str(error)
                    continue
                goes_on = len(self._way) > 0 and base is self._way[0]
                if math.dist(points[0], base) < 0.05:
                    points = points[1:]
                self._way = [*([base] if goes_on else []), *points, goal.position]
                self._planned_to = goal.position
                self._turning = not goes_on
                drawn = np.array([pose.position, *self._way])
                self._show(shown, drawn, plan)
                again = self._plans - 1 - self._counted
                work |= {"replans": again, **plan.work} if again else plan.work
                self._counted += again
                took = f"{plan.path.length:.2f} m, {plan.work['expansions']} expansions"
                if self._prior is not None and (unknown := length_over(self._prior, self._prior.unknown, drawn)):
                    took += f"; {through(unknown, float(np.linalg.norm(np.diff(drawn, axis=0), axis=1).sum()))}"
                shown["status"] = partial(Text, f"plan {self._plans}: {len(self._way)} cells, {took}")
                return None
        if self._spin is not None:  # still looking around
            return Drive(self._turn_on(pose))
        if self._margin > 0.0:
            self._keep(0.0)
            shown["status"] = partial(Text, f"no way left ({reason}); giving up the margin", "WARN")
        elif not self._desperate:
            # Echoes of one surface, seen from poses that drift, may add up to a wall that is not there: look again.
            self._desperate = True
            memory.forget()
            self._looked.clear()
            self._spin = (math.tau, pose.theta)
            shown["status"] = partial(Text, f"no way left ({reason}); forgetting all echoes and looking again", "WARN")
        else:
            return self._proof.judged(GiveUp(f"no way to the goal through free cells: {reason}"), pose.position, goal)
        self._way, self._planned_to = [], None
        return Drive(Twist(), trace=LazyTrace(shown), work=work)

    def _show(self, shown: Makers, way: Array, plan: Plan) -> None:
        """The way (n, 2) [m], the search, blocked cells and echoes."""
        lattice, memory, blocked = self._lattice, self._memory, self._blocked
        assert lattice is not None and memory is not None
        shown |= {name: partial(plan.trace.__getitem__, name) for name in plan.trace}
        shown["global"] = lambda: Lines((way,), color=PLAN_COLOR, radius=0.012)
        shown["blocked_cells"] = lambda: Lines(lattice.outlines(blocked), color=(200, 60, 60), radius=0.004)
        shown["echoes"] = lambda: Points(memory.echoes(), color=(255, 80, 40), radius=0.012)

    def _base(self, pose: SE2) -> Array:
        """Where the new way begins. Between two cells the car has no room to turn that it knows of: it goes on to the next one
        if that is still free, else straight back to where it came from."""
        lattice, memory = self._lattice, self._memory
        assert lattice is not None and memory is not None
        self._retreating = False
        if self._anchor is None or not self._way or self._turning or math.dist(pose.position, self._anchor) <= 0.05:
            return pose.position
        ahead = self._way[0]
        overhang = self._overhang if len(self._way) == 1 else 0.0
        clear = not memory.way_blocked(pose.position, ahead, self._half_width - self._margin, overhang)
        if clear and not self._is_blocked(lattice.cell(ahead)):
            return ahead
        self._retreating = True
        return self._anchor

    def _access(self, costmap: Costmap, point: Array, *, to_point: bool) -> list[tuple[int, int]]:
        """Free cells, nearest first, between whose centre and the point the car can drive straight, to it or from it."""
        lattice, memory = self._lattice, self._memory
        assert lattice is not None and memory is not None
        row, col = (int(i) for i in costmap.cell_from_world(point))
        found = []
        for r in range(row - 1, row + 2):
            for c in range(col - 1, col + 2):
                if not costmap.contains((r, c)) or self._blocked[r, c]:
                    continue
                centre = costmap.world_from_cell((r, c))
                start, end = (centre, point) if to_point else (point, centre)
                if not memory.way_blocked(start, end, self._half_width, self._overhang if to_point else 0.0):
                    found.append((math.dist(centre, point), (r, c)))
        return [cell for _, cell in sorted(found)[:4]]

    def _is_blocked(self, cell: tuple[int, int]) -> bool:
        lattice, memory = self._lattice, self._memory
        assert lattice is not None and memory is not None
        return memory.disc_blocked(lattice.centre(cell), self._disc)

    def _get_out(self, pose: SE2) -> Command | None:
        """Where the car cannot turn as it is about to, it drives to where it can, and plans again from there; None elsewhere."""
        memory, escape = self._memory, self._escape
        assert memory is not None
        if not escape.running:
            turns = self._planned_to is None or self._spin is not None or (self._turning and not self._retreating)
            if not turns or not memory.disc_blocked((pose.x, pose.y), self._footprint.circumscribed_radius + MARGIN):
                return None
            known = memory.surfaces(pose)
            if self._planned_to is not None and escape.turns(pose, known, self._next_turn(pose)):
                return None
            if not escape.begin(pose, known):
                return None
        escaping = escape.command(pose, memory.surfaces(pose), self._dt)
        if escaping is None:
            self._way, self._planned_to, self._anchor, self._retreating, self._turning = [], None, None, False, True
        return escaping

    def _next_turn(self, pose: SE2) -> float:
        """What the car is about to turn on the spot [rad]."""
        if self._spin is not None:
            return self._spin_sign * self._spin[0]
        dx, dy = self._way[0] - pose.position
        return wrap_angle(math.atan2(dy, dx) - pose.theta)

    # -- driving ------------------------------------------------------------------------------------------------------

    def _drive(self, pose: SE2) -> Twist:
        """Look around where that is needed, else turn to the next point and drive straight there."""
        if self._spin is not None:
            return self._turn_on(pose)
        if self._retreating:
            return self._back_up(pose)
        lattice = self._lattice
        assert lattice is not None
        cell = lattice.cell(pose.position)
        if self._look_around and len(self._way) > 1 and cell not in self._looked:
            centred = math.dist(lattice.centre(cell), pose.position) < 0.06
            if centred or not self._looked:
                self._looked.add(cell)
                self._spin = (math.tau, pose.theta)
                self._spin_sign = -self._spin_sign  # left and right in turn: what one turn adds to the drift, the next takes back
                return self._turn_on(pose)
        if self._anchor is None:
            self._anchor = pose.position
        while len(self._way) > 1 and math.dist(self._way[0], pose.position) < 0.02:
            self._reach()
        target = self._way[0]
        dx, dy = target[0] - pose.x, target[1] - pose.y
        distance = math.hypot(dx, dy)
        error = wrap_angle(math.atan2(dy, dx) - pose.theta)
        if self._turning and abs(error) > 0.04:
            return Twist(0.0, self._rate(error))
        self._turning = False
        if math.cos(error) * distance <= 0.01:  # passed it
            if len(self._way) > 1:
                self._reach()
            self._turning = True
            return Twist()
        speed = min(self._parameters.speed, math.sqrt(2.0 * 0.5 * self._robot.limits.acc_lim_x * distance))
        return Twist(max(speed, 0.03) * max(math.cos(error), 0.0), min(max(2.5 * error, -0.8), 0.8))

    def _reach(self) -> None:
        """The next point is reached; the car turns there."""
        self._anchor = self._way.pop(0)
        self._turning = True

    def _back_up(self, pose: SE2) -> Twist:
        """Straight back to the last point that was reached."""
        assert self._anchor is not None
        dx, dy = self._anchor[0] - pose.x, self._anchor[1] - pose.y
        behind = -(dx * math.cos(pose.theta) + dy * math.sin(pose.theta))
        if behind <= 0.01:
            self._retreating = False
            self._turning = True
            return Twist()
        error = wrap_angle(math.atan2(-dy, -dx) - pose.theta)
        return Twist(-min(0.5 * self._parameters.speed, behind + 0.03), min(max(1.5 * error, -0.5), 0.5))

    def _rate(self, error: float) -> float:
        """Turning rate towards a heading: slows down in time to stop there."""
        top = min(self._parameters.turn_rate, math.sqrt(2.0 * 0.5 * self._robot.limits.acc_lim_theta * abs(error)))
        return math.copysign(max(top, 0.15), error)

    def _align(self, pose: SE2, goal: Goal, heading: float) -> Command:
        """At the goal: stand, or turn to its heading where the car has the room to turn."""
        error = wrap_angle(heading - pose.theta)
        if abs(error) <= _STOPPING_SHARE * goal.yaw_goal_tolerance:
            return STOP
        assert self._memory is not None
        if self._memory.disc_blocked((pose.x, pose.y), self._footprint.circumscribed_radius):
            return GiveUp(f"no room to turn to the goal's heading at ({pose.x:.2f}, {pose.y:.2f})")
        return Drive(Twist(0.0, self._rate(error)))

    def _turn_on(self, pose: SE2) -> Twist:
        """Goes on with the full turn."""
        assert self._spin is not None
        left, last = self._spin
        left -= self._spin_sign * wrap_angle(pose.theta - last)
        if left <= 0.05:
            self._spin = None
            self._turning = True
            return Twist()
        self._spin = (left, pose.theta)
        return Twist(0.0, self._rate(self._spin_sign * left))


def build(context: Context) -> DynamicAStar:
    """`dynamic-a-star`"""
    return DynamicAStar(context)
