"""The navigator that plans on the map and has a controller follow the path; those that avoid obstacles on their own, too."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from robocar.core import (
    SE2,
    STOP,
    Array,
    BudgetExhausted,
    Command,
    Context,
    Controller,
    Costmap,
    Drive,
    EvadingController,
    Field,
    GiveUp,
    GlobalPlanner,
    Goal,
    GoalOccupied,
    Lines,
    NoPathFound,
    Observation,
    OutsideMap,
    Path,
    Plan,
    PlanningError,
    StartOccupied,
    State,
    Text,
    Trace,
    declares,
)
from robocar.core.compiling import warm_up
from robocar.core.trace import PLAN_COLOR, LazyTrace, merged, transformed
from robocar.core.way import through
from robocar.core.work import Work, total
from robocar.planners.controllers.pure_pursuit import STOPPING_SHARE
from robocar.planners.costmap import layered as layered
from robocar.planners.costmap.layered import LayeredCostmap
from robocar.planners.costmap.rolling import RollingCostmap, RollingCostmapParameters
from robocar.planners.geometry.polyline import blocked_ahead, nearest_on_path
from robocar.planners.geometry.reachability import Proof
from robocar.planners.navigators import recovery as behaviours
from robocar.planners.navigators.local_frame import LocalFrame
from robocar.planners.navigators.recovery import Recovery, Watch, standing
from robocar.planners.search.grid_search import nearest_free
from robocar.planners.tracking.moving_obstacles import unseen

_SHOW_PERIOD = 1.0  # [s] of the local costmap in the recording
_GOAL_SHIFT = 0.75  # of the goal's tolerance, the farthest that a blocked goal is moved: the rest is left for arriving


@dataclass(frozen=True, slots=True)
class NavigatorParameters:
    """
    Args:
        max_path_deviation: from the path; farther away it is planned anew [m].
        max_escape: out of blocked cells to the nearest free one, where an obstacle appears too near to plan from [m].
        clearing_distance: to drive, after all that was seen has been forgotten for want of a path, before it is forgotten again
            [m].
        max_clearings: how often it is forgotten at most, for one goal: what has been seen that often is there.
        planner_frequency: how often it is planned anew although nothing asks for it; 0 is never [Hz].
    """

    max_path_deviation: float = 0.3
    max_escape: float = 0.5
    clearing_distance: float = 0.5
    max_clearings: int = 5
    planner_frequency: float = 0.0

    def __post_init__(self) -> None:
        for name in ("max_path_deviation", "max_escape", "clearing_distance"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if self.max_clearings < 0:
            raise ValueError(f"max_clearings must not be negative, not {self.max_clearings}")
        if not 0.0 <= self.planner_frequency < math.inf:
            raise ValueError(f"planner_frequency must not be negative, not {self.planner_frequency}")


class EvasiveRecovery(NamedTuple):
    """What is tried before giving up, and who gets out of the way of what comes meanwhile."""

    behaviours: Recovery
    evade: Callable[[State, Costmap, Observation], Drive | None]


class PlanAndFollow:
    """A global planner on a layered costmap, and a controller that follows its path.

    It plans for every new goal, and again when what is seen blocks the rest of the path or the robot has left it. Where there is
    no path, the obstacle layer, which holds misplaced echoes too, is forgotten and the plan tried again; if that fails, or if it
    has been done less than `clearing_distance` ago or `max_clearings` times, the navigator gives up with the planner's reason.
    It claims `no_path` only where the prior map proves it.

    Args:
        local_costmap: what the controller is given, a window around the robot; by default the planner's costmap.
        recovery: what is tried before giving up, also where the controller gives up, or progress is lost; by default nothing.
    """

    def __init__(
        self,
        global_planner: GlobalPlanner,
        controller: Controller,
        costmap: LayeredCostmap,
        parameters: NavigatorParameters | None = None,
        local_costmap: RollingCostmap | None = None,
        recovery: EvasiveRecovery | None = None,
    ) -> None:
        self.parameters = parameters or NavigatorParameters()
        self.local_costmap = local_costmap
        self.recovery = recovery.behaviours if recovery is not None else None
        self._evade = recovery.evade if recovery is not None else None
        self._watch = Watch(recovery.behaviours.parameters) if recovery is not None else None
        self.global_planner, self.controller, self.costmap = global_planner, controller, costmap
        self._planned_at = self._shown_at = -math.inf
        self._goal: Goal | None = None
        self._target: Goal | None = None
        self._path: Path | None = None
        self._cleared_at: Array | None = None
        self._clearings = 0
        self._bare = False
        self._frame = LocalFrame()
        self._proof = Proof(costmap.prior, costmap.inscribed_radius, costmap.parameters.walled)
        _warm_up()

    def _clear(self) -> None:
        self.costmap.clear()
        if self.local_costmap is not None:
            self.local_costmap.clear()

    def command(self, state: State, observation: Observation, goal: Goal | None) -> Command:
        """Next command; `GiveUp` where the planner finds no way."""
        if goal is None:
            return GiveUp("a navigator that plans needs a goal")
        pose = state.belief.pose
        self._proof.begin(pose.position)
        new_goal = self._goal is None or not _same_goal(goal, self._goal)
        if new_goal:
            self._clearings = 0
            self.costmap.cover(np.array([pose.position, goal.position]))
        local = state
        if self.local_costmap is None:
            self.costmap.update(pose, observation)
        else:
            self.costmap.update(self._frame.follow(state), observation)
            local = self._frame.state(state)
            self.local_costmap.update(local.belief.pose, observation, self._frame.map_from_odom)
        here, time = local.belief.pose, observation.time
        if self._watch is not None and (silent := self._watch.silent(observation)):
            self._watch.restart()
            return standing(f"no reading of the {silent}: standing")
        if self.recovery is not None and self.recovery.running and (evasion := self._evasion(local, observation)) is not None:
            return self._frame.drawn(evasion, state)
        if self.recovery is not None and (step := self.recovery.step(here, self._local(), time)) is not None:
            return step
        trace: Trace = {}
        work: Work = {}
        reason = "new goal" if new_goal else self._reason_to_replan(pose, time)
        if reason:
            try:
                plan = self._plan(pose, goal)
            except PlanningError as error:
                self._goal, self._path = goal, None
                command = self._failed(here, time, GiveUp.because(error), error)
                return self._proof.judged(command, pose.position, goal) if isinstance(command, GiveUp) else command
            work = plan.work if new_goal else {"replans": 1, **plan.work}
            self._goal, self._planned_at = goal, time
            self._follow(plan.path)
            trace = self._plan_trace(plan, reason)
        assert self._target is not None
        if _arrived(pose, self._target):
            return replace(STOP, trace=trace, work=work)
        command = self._drive(local, state, observation)
        if isinstance(command, GiveUp):
            command = self._failed(here, time, command)
        elif self._watch is not None and self._watch.lost_progress(here, time):
            command = self._failed(here, time, GiveUp("no progress", "stuck"))
        if self.local_costmap is not None and time - self._shown_at >= _SHOW_PERIOD:
            self._shown_at = time
            trace = merged(trace, transformed({"costmap/local": Field(self._local())}, state.map_from_odom))
        return replace(command, trace=merged(trace, command.trace), work=total(work, command.work)) if trace else command

    def _drive(self, local: State, state: State, observation: Observation) -> Command:
        """What the controller says, which is given everything in the frame of its costmap."""
        assert self._path is not None and self._target is not None
        path, target, costmap = self._path, self._target, self._local()
        if costmap.frame == "map":
            return self.controller.command(state, path, costmap, observation, target)
        path, target = self._frame.path(path, self._segment), self._frame.goal(target, state)
        return self._frame.drawn(self.controller.command(local, path, costmap, observation, target), state)

    def _evasion(self, state: State, observation: Observation) -> Command | None:
        """Out of the way of something that comes during a recovery, which goes on afterwards."""
        return None if self._evade is None else self._evade(state, self._local(), observation)

    def _local(self) -> Costmap:
        """What the controller is given."""
        return (self.local_costmap or self.costmap).costmap()

    def _failed(self, pose: SE2, time: float, failure: GiveUp, error: PlanningError | None = None) -> Command:
        """The first step of the next recovery, or `failure` where there is none (left).

        Where there is no way although all that was seen is forgotten, no recovery makes one; a goal that something stands on may
        become free.
        """
        recovery = self.recovery
        hopeless = isinstance(error, OutsideMap) or (
            self._bare and isinstance(error, NoPathFound | BudgetExhausted | GoalOccupied)
        )
        if recovery is None or self._watch is None or hopeless:
            self._goal = None
            return failure
        self._watch.restart()
        self._path = None
        if isinstance(error, GoalOccupied):
            self._clear()  # what still stands there is seen again while the car waits
            recovery.wait("something stands on the goal", pose, time)
        else:
            name = recovery.next(failure.reason, pose, time)
            if name is None:
                self._goal = None
                return replace(failure, reason=f"{failure.reason} (after {recovery.count} recoveries)")
            if name == "clear":
                self._clear()
                return standing(recovery.message)
        return recovery.step(pose, self._local(), time) or standing(recovery.message)

    def _reason_to_replan(self, pose: SE2, time: float) -> str:
        """Why the path will not do any longer, or nothing."""
        if self._path is None:
            return "recovery"
        if self.parameters.planner_frequency > 0.0 and time - self._planned_at >= 1.0 / self.parameters.planner_frequency - 1e-9:
            return "time to plan anew"
        self._segment, _, distance = nearest_on_path(self._points, self._segment, pose.x, pose.y, 2.0)
        if distance > self.parameters.max_path_deviation:
            return f"{distance:.2f} m off the path"
        if self._checked_version != self.costmap.version:
            self._checked_version = self.costmap.version
            costmap = self.costmap.costmap()
            if costmap.origin != self._points_origin:  # the grid has grown
                self._points_origin, self._points_in_grid = costmap.origin, costmap.grid_from_world(self._points)
            if blocked_ahead(costmap.data, self._points_in_grid, self._segment):
                return "path blocked"
        return ""

    def _follow(self, path: Path) -> None:
        costmap = self.costmap.costmap()
        self._path, self._points, self._segment = path, np.array(path.points), 0
        self._points_origin, self._points_in_grid = costmap.origin, costmap.grid_from_world(self._points)
        self._checked_version = self.costmap.version

    def _plan(self, pose: SE2, goal: Goal) -> Plan:
        self._bare = False  # whether the last plan failed on the prior map alone
        try:
            return self._plan_from_free(pose, goal)
        except OutsideMap:
            raise
        except PlanningError:
            here = pose.position
            if self._cleared_at is not None and math.dist(here, self._cleared_at) < self.parameters.clearing_distance:
                raise
            if self._clearings >= self.parameters.max_clearings:
                raise
            self._cleared_at = here
            self._clearings += 1
            self.costmap.clear()
            self._bare = True
            plan = self._plan_from_free(pose, goal)
            self._bare = False
            return plan

    def _plan_from_free(self, pose: SE2, goal: Goal) -> Plan:
        """A plan from the robot; where it stands in blocked cells, from the nearest free one, and where the goal is blocked, to
        the nearest free cell within its tolerance."""
        costmap = self.costmap.costmap()
        start, target = pose.position, goal
        for _ in range(3):
            try:
                plan = self.global_planner.plan(costmap, start, target.position)
            except StartOccupied:
                start = _substitute(costmap, start, pose.position, self.parameters.max_escape)
                if start is None:
                    raise
            except GoalOccupied:
                inside = _substitute(costmap, target.position, goal.position, _GOAL_SHIFT * goal.xy_goal_tolerance)
                if inside is None:
                    raise
                left = goal.xy_goal_tolerance - math.dist(inside, goal.position)
                target = replace(goal, position=inside, xy_goal_tolerance=left)
            else:
                self._target = target
                if math.dist(start, pose.position) > 0.0:
                    return replace(plan, path=Path(np.concatenate([[pose.position], plan.path.points])))
                return plan
        raise AssertionError("start and goal are each moved at most once")

    def _plan_trace(self, plan: Plan, reason: str) -> Trace:
        """What a (re)planning shows: path, count, reason, costmap, and what the planner shows of its search."""
        costmap = self.costmap.costmap()
        took = ", ".join(f"{count} {unit}" for unit, count in plan.work.items())
        message = f"{reason}: path of {plan.path.length:.2f} m, {took}"
        if unknown := self.costmap.unknown_length(plan.path.points):
            message += f"; {through(unknown, plan.path.length)}"
        return merged(
            {"global": Lines((plan.path.points,), color=PLAN_COLOR, radius=0.012), "plan": Text(message)},
            LazyTrace({"costmap" if self.local_costmap is None else "costmap/global": lambda: Field(costmap)}),
            plan.trace,
        )


def plan_and_follow(
    context: Context,
    planner: Callable[[Context], GlobalPlanner],
    controller: Callable[[Context], Controller],
) -> PlanAndFollow:
    """The navigator of two factories `build(context)`, on a costmap of the context's prior map."""
    return PlanAndFollow(
        planner(context.part("planner")),
        controller(context.part("controller")),
        _costmap(context),
        context.parameters_of(NavigatorParameters),
    )


@declares(avoids_movers=unseen)
def plan_and_avoid(
    context: Context,
    planner: Callable[[Context], GlobalPlanner],
    controller: Callable[[Context], EvadingController],
) -> PlanAndFollow:
    """The same over two costmaps and with recovery behaviours, for controllers that look for their own way."""
    costmap = context.part("costmap")
    driver = controller(context.part("controller"))
    return PlanAndFollow(
        planner(context.part("planner")),
        driver,
        _costmap(context),
        context.parameters_of(NavigatorParameters),
        RollingCostmap(
            context.prior,
            context.robot,
            costmap.parameters_of(layered.CostmapParameters),
            costmap.parameters_of(RollingCostmapParameters),
        ),
        EvasiveRecovery(behaviours.build(context.part("recovery")), driver.evade),
    )


def _costmap(context: Context) -> LayeredCostmap:
    """Of the prior map; without one it begins around the start."""
    costmap = LayeredCostmap(context.prior, context.robot, context.part("costmap").parameters_of(layered.CostmapParameters))
    if context.start is not None:
        costmap.cover([(context.start.x, context.start.y)])
    return costmap


def _arrived(pose: SE2, goal: Goal) -> bool:
    """Well inside the tolerances, where a controller is to stop."""
    if math.hypot(pose.x - goal.position[0], pose.y - goal.position[1]) > STOPPING_SHARE * goal.xy_goal_tolerance:
        return False
    turn = 0.0 if goal.heading is None else math.remainder(pose.theta - goal.heading, math.tau)
    return abs(turn) <= STOPPING_SHARE * goal.yaw_goal_tolerance


def _same_goal(a: Goal, b: Goal) -> bool:
    return a is b or (
        np.array_equal(a.position, b.position)
        and (a.heading, a.xy_goal_tolerance, a.yaw_goal_tolerance) == (b.heading, b.xy_goal_tolerance, b.yaw_goal_tolerance)
    )


def _substitute(costmap: Costmap, blocked: Array, wanted: Array, reach: float) -> Array | None:
    """The nearest free cell within `reach` [m] of the wanted point; None where there is none or it has been tried."""
    nearest = nearest_free(costmap, wanted)
    if nearest is None or math.dist(nearest, wanted) > reach or np.array_equal(nearest, blocked):
        return None
    return nearest


@warm_up
def _warm_up() -> None:
    points, costs = np.array([[0.5, 0.5], [1.5, 0.5]]), np.zeros((2, 2), dtype=np.uint8)
    costs.flags.writeable = False
    nearest_on_path(points, 0, 0.0, 0.0, 1.0)
    blocked_ahead(costs, points, 0)
