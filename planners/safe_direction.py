"""Safe-direction navigation in an unknown, changing world (Trihatmo, Navigation in dynamic, unstructured environments, BPPT).

From one scan and the goal: the shortest direction over the optimistic reading of the scan, the safest one over the pessimistic
reading, a direction between them by the safety factor, and a local target that way. No map is kept; the variant
`safe-direction-memory` remembers what it has seen around it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from planners import pure_pursuit
from planners.grid_search import LazyTrace
from planners.navigator import Reactive
from planners.pure_pursuit import STOPPING_SHARE, PurePursuit
from planners.safe_direction_fan import Fan, fan
from planners.safe_direction_memory import RollingMemory
from planners.safe_direction_method import DOUBT, DOUBT_SHARE, JOINED, Decision, Directions, Parameters
from planners.safe_direction_view import Panorama, Readings, leading_edges, sector_of
from planners.transforms import descend, obstacle_transform
from robocar.core import (
    LETHAL,
    SE2,
    STOP,
    Array,
    Arrows,
    Belief,
    Command,
    Context,
    Costmap,
    Drive,
    Field,
    GiveUp,
    Goal,
    Lines,
    Observation,
    Path,
    Points,
    Robot,
    Scalar,
    Scan,
    Text,
    Trace,
    Twist,
)
from robocar.core.trace import PLAN_COLOR, Drawable

_REACHED = 0.10  # [m] from a local target, where it counts as reached
_REVERSAL = math.radians(60.0)  # a turn sharper than this waits until the local target is reached
_LEAST = 0.10  # [m] a direction that is free no farther is none
_GROUND = 0.25  # [m] side of the squares that count as ground covered
_TURNING = 0.15  # [m/rad] what turning counts as, in metres of way
_CONFIRMED = 1.0  # [s] that what lengthens the way has to stay in sight to count: what moves goes away again
_FORGET_AGAIN, _FORGET_MOST = 0.5, 20  # [m, 1] way between two clearings of the memory for want of a way, and their number
_FORGET_PERIOD = 1.0  # [s] or the time between them, where the car stands
_MOMENT = 0.6  # [s] between two scans that are compared to see what moves
_KEEP_OFF, _LOOK_AHEAD = 0.10, 1.0  # [m, s] the car does not get so near to what moves sooner than this
_PICTURE = 5  # decisions from one picture of the grids in the recording to the next


class SafeDirection:
    """Local planner: decides at each scan, and drives to the local target by pure pursuit.

    The paper's loop is scan, decide, drive to the local target, scan again. Here each scan decides anew, so that what moves is
    seen at once; but a decision to turn round waits until the local target is reached, or its way blocked. Deciding that at once,
    a method without a map turns back as soon as it cannot see any longer why it went that way.

    Args:
        memory: what has been seen is kept there; None is the paper's method.
    """

    def __init__(
        self,
        robot: Robot,
        period: float,
        pursuit: PurePursuit,
        memory: RollingMemory | None,
        parameters: Parameters | None = None,
    ) -> None:
        self.parameters = p = parameters or Parameters()
        self.robot, self.pursuit, self.memory, self._period = robot, pursuit, memory, period
        self.sector = sector_of(robot, p.view_angle, p.max_range)
        self.directions = Directions(robot, self.sector, p)
        self.panorama = Panorama(self.sector, p.resolution, JOINED)
        self._forget()
        self._compile()

    def _compile(self) -> None:
        """Compiles here, not in the control loop: a look around a closed room, and the bound carried from it."""
        sensors = (self.robot.lidar,) if self.robot.lidar is not None else self.robot.sonars
        scans = tuple(
            Scan(0.0, np.full(len(s.bearings), 1.0), s.bearings, s.max_range, s.beam_width, s.robot_from_sensor) for s in sensors
        )
        laser = scans[0] if self.robot.lidar is not None else None
        observation = Observation(0.0, sonars=() if laser is not None else scans, lidar=laser)
        for x in (0.3, 20.0):
            goal = Goal(np.array([x, 0.1]))
            self.command(Belief(SE2()), None, None, observation, goal)
            seen = self.directions.readings(SE2(), self.panorama)
            self.directions.decide(seen, 0.0, goal.position, 100.0)
        fan(np.zeros(3), np.ones((3, 3)), 1.5, 1.5, 1.0, 1.0, True)
        descend(np.ones((3, 3)), (1, 1))
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """A new episode; there is no chance in it."""
        self.pursuit.reset(rng)
        self._forget()

    def _forget(self) -> None:
        self.panorama.forget()
        if self.memory is not None:
            self.memory.forget()
        self._last: Command = STOP
        self._looked = -math.inf  # [s] time of the last scan
        self._target: Array | None = None
        self._goal: Goal | None = None
        self._ground: set[tuple[int, int]] = set()
        self._idle = 0.0  # [m] driven since the last new ground
        self._before: SE2 | None = None
        self._driven = 0.0  # [m]
        self._bound = 0.0  # [m]
        self._recent: deque[tuple[float, Readings]] = deque()
        self._moved = np.empty((0, 2))  # [m] leading edges of what moves
        self._coming = math.inf  # [m] how near is what comes
        self._bounds: deque[tuple[float, float]] = deque()  # of the last seconds: time, way to the goal plus way driven
        self._waiting_since: float | None = None
        self._turning = False
        self._forgotten, self._forgotten_at, self._forgot = 0, -math.inf, -math.inf
        self._decisions = 0

    def command(
        self, belief: Belief, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal
    ) -> Command:
        """The next command; `path` and `costmap` are not needed."""
        laser = observation.lidar if self.robot.lidar is not None else None
        if laser is None and (self.robot.lidar is not None or not observation.sonars):
            # The sonars of a car with a laser say nothing here; a laser that has fallen silent stops it.
            return self._last if observation.time - self._looked <= 5.0 * self._period else STOP
        self._looked = observation.time
        command = self._decide_and_drive(belief, observation, goal)
        self._last = replace(command, trace={})
        return command

    def _decide_and_drive(self, belief: Belief, observation: Observation, goal: Goal) -> Command:
        pose = belief.pose
        if self._goal is None or not np.array_equal(self._goal.position, goal.position):
            self._goal, self._target, self._idle, self._forgotten = goal, None, 0.0, 0
            self._bound = 0.0
            self._bounds.clear()
            self._ground.clear()
        sonars = () if self.robot.lidar is not None else observation.sonars
        if not self.panorama.look(pose, observation.lidar if self.robot.lidar is not None else None, sonars):
            return replace(STOP, trace={"safe_direction": Text("all beams are lost: standing", "WARN")})
        scanned = seen = self.directions.readings(pose, self.panorama)
        if self.robot.lidar is not None:  # a sonar's arc leaps as its cone sweeps over a corner: that is no motion
            self._coming = self._approaching(scanned, pose.theta, observation.time)
        if self.memory is not None:
            seen = self.memory.merge(pose, seen)
        self._count_ground(pose)
        bound = self._bound - self._driven if self.parameters.carry_bound and self.memory is None else 0.0
        decision = self.directions.decide(self._swept(seen), pose.theta, goal.position, bound)
        self._carry(decision, observation.time)
        self._decisions += 1
        trouble = self._trouble(pose, seen, decision, observation.time, goal)
        if isinstance(trouble, GiveUp | Drive):
            return trouble
        if math.dist(pose.position, goal.position) <= STOPPING_SHARE * goal.xy_goal_tolerance:
            return self._drive(belief, seen, np.array(goal.position), observation, goal, {})
        notes: dict[str, Text] = {}
        turn = self._new_target(pose, decision, goal, notes)
        trace = self._trace(pose, decision, notes)
        if turn is not None:
            return replace(self._rotate(belief, seen, turn, observation), trace=trace)
        assert self._target is not None
        return self._drive(belief, seen, self._target, observation, goal, trace)

    # -- where to -------------------------------------------------------------------------------------------------------

    def _new_target(self, pose: SE2, decision: Decision, goal: Goal, notes: dict[str, Text]) -> float | None:
        """Sets the local target; a heading to turn to on the spot where there is none (eq. 12, 13)."""
        p, choice, here = self.parameters, decision.choice, pose.position
        assert choice is not None
        apart = math.dist(here, goal.position)
        if apart <= p.approach_distance and self._straight(decision, goal.position):
            self._target, self._turning = np.array(goal.position), False
            return None
        heading, length = choice.heading, choice.length
        if not choice.turn and length < _LEAST:
            around = np.abs(np.remainder(decision.fan.headings - heading + math.pi, math.tau) - math.pi)
            around[decision.fan.lengths < _LEAST] = math.inf
            k = int(np.argmin(around))
            if around[k] <= math.pi / 2:
                heading, length = float(decision.fan.headings[k]), float(decision.fan.lengths[k])
        if self._under_way(pose, decision.fan):
            assert self._target is not None
            dx, dy = self._target - here
            if choice.turn or abs(math.remainder(heading - math.atan2(dy, dx), math.tau)) > _REVERSAL:
                return None  # first to the local target
        if choice.turn or length < _LEAST:
            if choice.turn and not self._turning:
                turn = math.degrees(math.remainder(choice.heading - pose.theta, math.tau))
                notes["safe_direction"] = Text(f"culdesac rule: the shortest way is out of sight, turning by {turn:.0f} degrees")
            self._target, self._turning = None, choice.turn
            return heading
        self._turning = False
        step = min(p.step_share * length, p.max_step, max(apart, _LEAST))
        self._target = here + step * np.array([math.cos(heading), math.sin(heading)])
        return None

    def _under_way(self, pose: SE2, found: Fan) -> bool:
        """Whether there is a local target still ahead, with a free way to it."""
        if self._target is None:
            return False
        dx, dy = self._target - pose.position
        apart = math.hypot(dx, dy)
        if apart <= _REACHED:
            return False
        heading = math.atan2(dy, dx)
        if abs(math.remainder(heading - pose.theta, math.tau)) > 0.5 * self.sector.width:
            return False
        return bool(found.lengths[found.nearest(heading)] >= apart - _REACHED)

    def _straight(self, decision: Decision, goal: Array) -> bool:
        """Whether the car can drive straight to a goal nearby, over cells that are seen free."""
        seen, r = decision.seen, self.parameters.resolution
        dx, dy = (v / r for v in (goal[0] - seen.grid.origin.x - seen.x * r, goal[1] - seen.grid.origin.y - seen.y * r))
        room = obstacle_transform(~seen.free) - 0.5
        along = np.linspace(0.0, 1.0, 2 + int(2.0 * math.hypot(dx, dy)))
        rows, cols = (seen.y + along * dy).astype(int), (seen.x + along * dx).astype(int)
        return bool((room[rows, cols] * r >= min(self.robot.footprint.inscribed_radius, room[rows[0], cols[0]] * r)).all())

    # -- trouble --------------------------------------------------------------------------------------------------------

    def _trouble(self, pose: SE2, seen: Readings, decision: Decision, time: float, goal: Goal) -> Command | None:
        """A reason to stand or to give up, if there is one."""
        x, y = goal.position
        cell = seen.grid.cell_from_world(goal.position)
        inside = bool(seen.grid.contains(cell))
        buried = inside and bool(seen.occupied[tuple(cell)])
        apart = math.dist(pose.position, goal.position)
        if self._idle > self.parameters.patience:
            why = "the goal lies in an obstacle" if buried else "what is in sight does not lead on"
            return GiveUp(
                f"going in circles: {self._idle:.1f} m driven without new ground, {apart:.2f} m from the goal; {why}", "stuck"
            )
        if (
            buried
            and decision.choice is not None
            and float(decision.distance[int(seen.y), int(seen.x)]) * seen.grid.resolution <= (self._nearest(decision) + _REACHED)
        ):
            return GiveUp(
                f"the goal ({x:.2f}, {y:.2f}) lies in an obstacle; {apart:.2f} m from it is as near as the car gets", "stuck"
            )
        if decision.choice is not None:
            self._waiting_since = None
            return None
        again = self._driven - self._forgotten_at >= _FORGET_AGAIN or time - self._forgot >= _FORGET_PERIOD
        if self.memory is not None and self._forgotten < _FORGET_MOST and again:
            self._forgotten, self._forgotten_at, self._forgot = self._forgotten + 1, self._driven, time
            self.memory.forget()
            return replace(STOP, trace={"safe_direction": Text("no way: what was seen is forgotten", "WARN")})
        if self._waiting_since is None:
            self._waiting_since = time
        if time - self._waiting_since >= self.parameters.wait_time:
            return GiveUp(f"obstacles all round: no way to the goal ({x:.2f}, {y:.2f}) is in sight", "no_path")
        return replace(STOP, trace={"safe_direction": Text("no way in sight: waiting", "WARN")})

    def _nearest(self, decision: Decision) -> float:
        """The smallest value of the distance transform [m]: how far from a blocked goal the free cell next to it is."""
        return float(decision.distance.min()) * self.parameters.resolution

    def _carry(self, decision: Decision, time: float) -> None:
        """Keeps the largest lower bound of the way to the goal, plus what was driven until then."""
        u = float(decision.distance[int(decision.seen.y), int(decision.seen.x)]) * self.parameters.resolution
        self._bounds.append((time, u + self._driven))
        while self._bounds[0][0] < time - _CONFIRMED:
            self._bounds.popleft()
        if self._bounds[0][0] <= time - 0.8 * _CONFIRMED:
            least = min(bound for _, bound in self._bounds)
            if math.isfinite(least):
                self._bound = max(self._bound, least) if u + self._driven >= self._bound - DOUBT - DOUBT_SHARE * u else least

    def _count_ground(self, pose: SE2) -> None:
        if self._before is not None:
            turned = abs(math.remainder(pose.theta - self._before.theta, math.tau))
            self._idle += self._before.distance_to(pose) + _TURNING * turned
            self._driven += self._before.distance_to(pose)
        self._before = pose
        square = math.floor(pose.x / _GROUND), math.floor(pose.y / _GROUND)
        if square not in self._ground:
            self._ground.add(square)
            self._idle = 0.0

    # -- motion ---------------------------------------------------------------------------------------------------------

    def _drive(self, belief: Belief, seen: Readings, target: Array, observation: Observation, goal: Goal, trace: Trace) -> Drive:
        """Pure pursuit of the straight way to the target, slow enough for what may come the other way."""
        path = Path(np.stack([belief.pose.position, target]))
        drive = self.pursuit.command(belief, path, self._costmap(seen), observation, goal)
        v, omega = drive.twist.v, drive.twist.omega
        slow = min(
            self._share_of_speed(seen, belief.pose, v),
            max(self._coming - _KEEP_OFF, 0.05) / max(abs(v) * _LOOK_AHEAD, 1e-9),
            self.robot.limits.max_vel_theta / max(abs(omega), 1e-9),
            1.0,
        )
        return Drive(Twist(slow * v, slow * omega), trace=LazyTrace(_makers(drive.trace) | _makers(trace)))

    def _rotate(self, belief: Belief, seen: Readings, heading: float, observation: Observation) -> Drive:
        """Turns on the spot."""
        here = belief.pose.position
        goal = Goal(here, heading, yaw_goal_tolerance=0.1)
        return self.pursuit.command(belief, None, self._costmap(seen), observation, goal)

    def _costmap(self, seen: Readings) -> Costmap:
        """What pure pursuit has to keep off: surfaces seen."""
        return Costmap(np.where(seen.occupied, np.uint8(LETHAL), np.uint8(0)), seen.grid.resolution, seen.grid.origin)

    def _share_of_speed(self, seen: Readings, pose: SE2, v: float) -> float:
        """By what share to slow down so that the car stands before what comes towards it at `obstacle_speed` is there.

        With free way d ahead: v t + v^2 / 2a + w (t + v / a) <= d, for the reaction time t of two scans.
        """
        if v <= 0.0:
            return 1.0
        a, t, w = self.robot.limits.acc_lim_x, 2.0 * self._period, self.parameters.obstacle_speed
        free = self._free_ahead(seen, pose)
        b = t + w / a
        root = b * b - 2.0 * (w * t - free) / a
        allowed = a * (math.sqrt(root) - b) if root > b * b else 0.0
        return min(1.0, max(allowed, 0.05) / v)

    def _approaching(self, seen: Readings, theta: float, time: float) -> float:
        """Distance from the car's circumscribed circle to the nearest leading edge of what moves [m], inf if nothing does.

        A leading edge is a surface where the cell was seen empty a moment ago, off all that stood there then. What recedes has
        its leading edge on its far side, out of sight.
        """
        self._recent.append((time, seen))
        while time - self._recent[0][0] > _MOMENT + 1e-6:
            self._recent.popleft()
        then, before = self._recent[0]
        self._moved = np.empty((0, 2))
        if time - then < 0.6 * _MOMENT:
            return math.inf
        moved = leading_edges(before, seen)
        self._moved = seen.grid.world_from_cell(moved)
        if len(moved) == 0:
            return math.inf
        dx, dy = moved[:, 1] + 0.5 - seen.x, moved[:, 0] + 0.5 - seen.y
        ahead = math.cos(theta) * dx + math.sin(theta) * dy > 0.0
        if not ahead.any():
            return math.inf
        return float(np.hypot(dx, dy)[ahead].min()) * seen.grid.resolution - self.robot.footprint.circumscribed_radius

    def _swept(self, seen: Readings) -> Readings:
        """The readings with what leading edges may reach within `_LOOK_AHEAD` taken for occupied."""
        if len(self._moved) == 0:
            return seen
        r = seen.grid.resolution
        spots = np.zeros(seen.grid.shape, dtype=np.uint8)
        spots[tuple(seen.grid.cell_from_world(self._moved).T)] = 1
        reach = round(self.parameters.obstacle_speed * _LOOK_AHEAD / r)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        swept = cv2.dilate(spots, disc) > 0
        body = round(self.robot.footprint.circumscribed_radius / r) + 1
        row, col = int(seen.y), int(seen.x)
        swept[row - body : row + body + 1, col - body : col + body + 1] = False
        return replace(seen, free=seen.free & ~swept, occupied=seen.occupied | swept)

    def _free_ahead(self, seen: Readings, pose: SE2) -> float:
        """From the car's front to the nearest surface in the strip that it drives into, a little wider than itself [m]."""
        rows, cols = np.nonzero(seen.occupied)
        if len(rows) == 0:
            return math.inf
        r = seen.grid.resolution
        dx, dy = (cols + 0.5 - seen.x) * r, (rows + 0.5 - seen.y) * r
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        ahead, aside = c * dx + s * dy, np.abs(c * dy - s * dx)
        front = float(self.robot.footprint.vertices[:, 0].max())
        half = float(np.abs(self.robot.footprint.vertices[:, 1]).max()) + self.parameters.padding + 0.5 * r
        inside = (aside <= half) & (ahead > 0.0)
        return float(ahead[inside].min()) - front - 0.5 * r if inside.any() else math.inf

    # -- the recording --------------------------------------------------------------------------------------------------

    def _trace(self, pose: SE2, decision: Decision, notes: dict[str, Text]) -> LazyTrace:
        choice, found, grid = decision.choice, decision.fan, decision.seen.grid
        assert choice is not None
        target = self._target
        here = pose.position

        def arrow(heading: float, color: tuple[int, int, int]) -> Arrows:
            return Arrows(here[None], 0.6 * np.array([[math.cos(heading), math.sin(heading)]]), color)

        def rays() -> Lines:
            ends = here + found.lengths[:, None] * np.stack([np.cos(found.headings), np.sin(found.headings)], axis=1)
            return Lines(tuple(np.stack([here, end]) for end in ends), values=found.totals, radius=0.003)

        shown = {
            "safe_direction/fan": rays,
            "safe_direction/safe": lambda: arrow(choice.safe, (0, 158, 115)),
            "safe_direction/shortest": lambda: arrow(choice.shortest, (0, 114, 178)),
            "safe_direction/target": lambda: Points((here if target is None else target)[None], color=PLAN_COLOR, radius=0.04),
            "safe_direction/alpha": lambda: Scalar(0.0 if choice.turn else choice.alpha),
        }
        if self._decisions % _PICTURE == 1:
            r = grid.resolution
            shown |= {
                "safe_direction/pessimistic": lambda: Field(
                    grid.with_data(np.where(decision.clearance > 0.0, decision.clearance * r, np.nan).astype(np.float32))
                ),
                "safe_direction/optimistic": lambda: Field(
                    grid.with_data(np.where(np.isfinite(decision.distance), decision.distance * r, np.nan).astype(np.float32))
                ),
            }
        return LazyTrace(shown | {name: (lambda text=text: text) for name, text in notes.items()})


def _makers(trace: Trace) -> dict[str, Callable[[], Drawable]]:
    """The drawables of a trace, made when looked at."""
    return {name: partial(trace.__getitem__, name) for name in trace}


def build(context: Context) -> Reactive:
    """The paper's navigator: only what is in sight counts."""
    return _navigator(context, remembers=False)


def build_with_memory(context: Context) -> Reactive:
    """The variant that remembers the surroundings."""
    return _navigator(context, remembers=True)


def _navigator(context: Context, remembers: bool) -> Reactive:
    parameters, robot = context.parameters_of(Parameters), context.robot
    sector_of(robot, parameters.view_angle, parameters.max_range)  # before anything is compiled
    sensors = (robot.lidar,) if robot.lidar is not None else robot.sonars
    period = max(context.control_period, *(sensor.period for sensor in sensors))
    pursuit = PurePursuit(robot, period, context.parameters_of(pure_pursuit.Parameters))
    # A sonar's arcs are too coarse to be remembered: a few of them close every passage. Without a laser only the present counts.
    remembers = remembers and robot.lidar is not None
    memory = RollingMemory(parameters.memory_size, parameters.resolution) if remembers else None
    planner = SafeDirection(robot, period, pursuit, memory, parameters)
    return Reactive(planner)
