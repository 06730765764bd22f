"""Safe-direction navigation in an unknown, changing world (Trihatmo, Navigation in dynamic, unstructured environments, BPPT).

From one scan and the goal: the shortest direction over the optimistic reading of the scan, the safest one over the pessimistic
reading, a direction between them by the safety factor, and a local target that way. No map is kept; the variant
`safe-direction-memory` remembers what it has seen around it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from robocar.core import (
    LETHAL,
    SE2,
    STOP,
    Array,
    Belief,
    Command,
    Context,
    Costmap,
    Drive,
    Goal,
    Observation,
    Path,
    Robot,
    Scan,
    State,
    Text,
    Twist,
    declares,
)
from robocar.core.compiling import trial_robot, warm_up
from robocar.core.trace import Drawable, LazyTrace
from robocar.planners.controllers import pure_pursuit
from robocar.planners.controllers.pure_pursuit import STOPPING_SHARE, PurePursuit
from robocar.planners.navigators.reactive import Reactive
from robocar.planners.safe_direction.fan import Fan, fan
from robocar.planners.safe_direction.memory import RollingMemory
from robocar.planners.safe_direction.method import JOINED, Decision, Directions, SafeDirectionParameters
from robocar.planners.safe_direction.movers import Movers
from robocar.planners.safe_direction.progress import SafeDirectionProgress
from robocar.planners.safe_direction.trace import pictures
from robocar.planners.safe_direction.view import DirectionPanorama, Readings, sector_of
from robocar.planners.search.transforms import descend, obstacle_transform
from robocar.planners.tracking.moving_obstacles import unseen

Makers: TypeAlias = dict[str, Callable[[], Drawable]]
"""Of drawables by name, called when somebody looks."""

_REACHED = 0.10  # [m] from a local target, where it counts as reached
_REVERSAL = math.radians(60.0)  # a turn sharper than this waits until the local target is reached
_LEAST = 0.10  # [m] a direction that is free no farther is none
_PICTURE = 5  # decisions from one picture of the grids in the recording to the next


class SafeDirection:
    """Controller: decides at each scan, and drives to the local target by pure pursuit.

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
        parameters: SafeDirectionParameters | None = None,
    ) -> None:
        self.parameters = p = parameters or SafeDirectionParameters()
        self.robot, self.pursuit, self.memory, self._period = robot, pursuit, memory, period
        self.sector = sector_of(robot, p.view_angle, p.max_range)
        self.directions = Directions(robot, self.sector, p)
        self.panorama = DirectionPanorama(self.sector, p.resolution, JOINED)
        self.movers = Movers(robot, p.obstacle_speed, p.padding, period)
        self.progress = SafeDirectionProgress(p, memory)
        self._last: Command = STOP
        self._looked = -math.inf  # [s] time of the last scan
        self._target: Array | None = None
        self._goal: Goal | None = None
        self._turning = self._dodges = False
        self._decisions = 0
        _warm_up(robot.lidar is not None)

    def command(self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal) -> Command:
        """The next command; `path` and `costmap` are not needed."""
        laser = observation.lidar if self.robot.lidar is not None else None
        if laser is None and (self.robot.lidar is not None or not observation.sonars):
            # The sonars of a car with a laser say nothing here; a laser that has fallen silent stops it.
            return self._last if observation.time - self._looked <= 5.0 * self._period else STOP
        self._looked = observation.time
        command = self._decide_and_drive(state, observation, goal)
        self._last = replace(command, trace={})
        return command

    def _decide_and_drive(self, state: State, observation: Observation, goal: Goal) -> Command:
        pose = state.belief.pose
        if self._goal is None or not np.array_equal(self._goal.position, goal.position):
            self._goal, self._target = goal, None
            self.progress.new_goal()
        sonars = () if self.robot.lidar is not None else observation.sonars
        if not self.panorama.look(pose, observation.lidar if self.robot.lidar is not None else None, sonars):
            return replace(STOP, trace={"safe_direction": Text("all beams are lost: standing", "WARN")})
        scanned = seen = self.directions.readings(pose, self.panorama)
        if self.robot.lidar is not None:  # a sonar's arc leaps as its cone sweeps over a corner: that is no motion
            self.movers.update(pose, scanned, observation)
        if self.memory is not None:
            seen = self.memory.merge(pose, seen)
        self.progress.move(pose)
        bound = self.progress.bound if self.parameters.carry_bound and self.memory is None else 0.0
        decision = self.directions.decide(self.movers.swept(seen), pose.theta, goal.position, bound)
        self.progress.carry(decision, observation.time)
        self._decisions += 1
        trouble = self.progress.trouble(pose, seen, decision, observation.time, goal, len(self.movers.edges) > 0)
        if isinstance(trouble, Drive):
            return self._dodging(trouble, trouble.twist, seen, pose, {})
        if trouble is not None:
            return trouble
        if math.dist(pose.position, goal.position) <= STOPPING_SHARE * goal.xy_goal_tolerance:
            return self._drive(state, seen, np.array(goal.position), observation, goal, {})
        notes: Makers = {}
        turn = self._new_target(pose, decision, goal, notes)
        trace = pictures(decision, pose.position, self._target, grids=self._decisions % _PICTURE == 1) | notes
        if turn is not None:
            return self._rotate(state, seen, turn, observation, trace)
        assert self._target is not None
        return self._drive(state, seen, self._target, observation, goal, trace)

    # -- where to -------------------------------------------------------------------------------------------------------

    def _new_target(self, pose: SE2, decision: Decision, goal: Goal, notes: Makers) -> float | None:
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
                notes["safe_direction"] = partial(
                    Text, f"culdesac rule: the shortest way is out of sight, turning by {turn:.0f} degrees"
                )
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

    # -- motion ---------------------------------------------------------------------------------------------------------

    def _drive(self, state: State, seen: Readings, target: Array, observation: Observation, goal: Goal, shown: Makers) -> Drive:
        """Pure pursuit of the straight way to the target, slow enough for what may come the other way."""
        pose, costmap = state.belief.pose, self._costmap(seen)
        path = Path(np.stack([pose.position, target]))
        drive = self.pursuit.drive(state, path, costmap, observation, goal)
        slowed = self.movers.slowed(drive.twist, seen, pose)
        return self._dodging(drive, slowed, seen, pose, shown)

    def _rotate(self, state: State, seen: Readings, heading: float, observation: Observation, shown: Makers) -> Drive:
        """Turns on the spot."""
        pose = state.belief.pose
        goal, costmap = Goal(pose.position, heading, yaw_goal_tolerance=0.1), self._costmap(seen)
        drive = self.pursuit.drive(state, None, costmap, observation, goal)
        return self._dodging(drive, drive.twist, seen, pose, shown)

    def _dodging(self, wanted: Drive, twist: Twist, seen: Readings, pose: SE2, shown: Makers) -> Drive:
        """Out of the way of what comes, where the twist does not lead there; not backwards to where a sector does not look."""
        costmap = self._costmap(seen)
        if not self.sector.whole:
            costmap = Costmap(np.where(seen.free, np.uint8(0), np.uint8(LETHAL)), costmap.resolution, costmap.origin)
        dodged = self.movers.dodged(wanted.twist, twist, costmap, pose)
        shown = {name: partial(wanted.trace.__getitem__, name) for name in wanted.trace} | shown
        if dodged is not None and not self._dodges:
            shown["safe_direction/dodge"] = partial(Text, f"dodging what comes: {dodged.v:.2f} m/s, {dodged.omega:.2f} rad/s")
        self._dodges = dodged is not None
        return Drive(dodged or twist, trace=LazyTrace(shown))

    def _costmap(self, seen: Readings) -> Costmap:
        """What pure pursuit has to keep off: surfaces seen."""
        return Costmap(np.where(seen.occupied, np.uint8(LETHAL), np.uint8(0)), seen.grid.resolution, seen.grid.origin)


@warm_up
def _warm_up(laser: bool) -> None:
    """A look around a closed room, and the bound carried from it."""
    robot = trial_robot(laser)
    sensors = (robot.lidar,) if robot.lidar is not None else robot.sonars
    scans = tuple(
        Scan(0.0, np.full(len(s.bearings), 1.0), s.bearings, s.max_range, s.beam_width, s.robot_from_sensor) for s in sensors
    )
    observation = Observation(0.0, lidar=scans[0]) if laser else Observation(0.0, sonars=scans)
    p = SafeDirectionParameters()
    memory = RollingMemory(p.memory_size, p.resolution) if laser else None
    planner = SafeDirection(robot, 0.1, PurePursuit(robot, 0.1), memory, p)
    for x in (0.3, 20.0):
        goal = Goal(np.array([x, 0.1]))
        planner.command(State.of(Belief(SE2())), None, None, observation, goal)
        seen = planner.directions.readings(SE2(), planner.panorama)
        planner.directions.decide(seen, 0.0, goal.position, 100.0)
    fan(np.zeros(3), np.ones((3, 3)), (1.5, 1.5), 1.0, 1.0, True)
    descend(np.ones((3, 3)), (1, 1))


@declares(avoids_movers=unseen)
def build(context: Context) -> Reactive:
    """The paper's navigator: only what is in sight counts."""
    return _navigator(context, remembers=False)


@declares(avoids_movers=unseen)
def build_with_memory(context: Context) -> Reactive:
    """The variant that remembers the surroundings."""
    return _navigator(context, remembers=True)


def _navigator(context: Context, remembers: bool) -> Reactive:
    parameters, robot = context.parameters_of(SafeDirectionParameters), context.robot
    sector_of(robot, parameters.view_angle, parameters.max_range)  # before anything is compiled
    sensors = (robot.lidar,) if robot.lidar is not None else robot.sonars
    period = max(context.control_period, *(sensor.period for sensor in sensors))
    pursuit = PurePursuit(robot, period, context.part("controller").parameters_of(pure_pursuit.PurePursuitParameters))
    # A sonar's arcs are too coarse to be remembered: a few of them close every passage. Without a laser only the present counts.
    remembers = remembers and robot.lidar is not None
    memory = RollingMemory(parameters.memory_size, parameters.resolution) if remembers else None
    planner = SafeDirection(robot, period, pursuit, memory, parameters)
    return Reactive(planner)
