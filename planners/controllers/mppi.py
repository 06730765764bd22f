"""Model predictive path integral control: the mean of random controls, weighted by what they cost.

Williams, Aldrich and Theodorou, Model Predictive Path Integral Control (Journal of Guidance, Control, and Dynamics 40(2), 2017),
as Nav2's MPPI controller has it: controls are twists under the car's accelerations, costs come from the costmap and the path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robocar.core import (
    SE2,
    Array,
    Command,
    Context,
    Costmap,
    Drive,
    Goal,
    Lines,
    Observation,
    Path,
    Robot,
    State,
    Trace,
)
from robocar.core.compiling import trial_robot, warm_up
from robocar.core.trace import LazyTrace
from robocar.planners.controllers.dwa import DRAW_PERIOD, DRAWN, LOCAL_COLOR, thinned
from robocar.planners.controllers.sampled_controls import (
    COLLISION,
    ControlLimits,
    CostWeights,
    Sampling,
    correlate,
    positions,
    sample_costs,
)
from robocar.planners.controllers.steering import SLOWEST, Steering, SteeringParameters
from robocar.planners.controllers.trajectory_costs import (
    LocalPath,
    PathFollower,
    RobotBody,
    RolloutAim,
    exercise,
    here,
)
from robocar.planners.costmap import layered as layered
from robocar.planners.costmap.layered import safe_cost
from robocar.planners.geometry.outlines import CostmapView
from robocar.planners.tracking.moving_obstacles import MovingObstacles

_CREEP = 0.01  # [m/s, rad/s]
_FAR_WORSE = 5.0  # of costs: more than what trajectories differ by that touch nothing and meet nobody


@dataclass(frozen=True, slots=True)
class MppiParameters:
    """Names are Nav2's where it has them.

    Args:
        batch_size: trajectories sampled at each tick.
        time_steps, model_dt: how far they reach, in steps of [s].
        vx_std, wz_std: of the noise on the controls [m/s, rad/s].
        noise_correlation: from one step to the next; smooth noise reaches farther than white noise of the same strength.
        temperature: lambda: the lower, the more the best trajectory counts, in units of the cost.
        gamma: weight of what the noise costs beside the last controls.
        cost_weight, goal_weight, path_weight, slowness_weight: of the mean cost of the cells crossed by the highest; of the
            distance to the local goal and of the mean distance from the path, by the way that the car makes at most; of
            1 / v^2 by its value at 0.05 m/s, in the mean over the trajectory.
        lookahead: along the path, to the local goal, or as far as it is in sight [m].
        forward_point: the point that is to come near to the local goal lies this far ahead of the car's centre [m].
    """

    batch_size: int = 1000
    time_steps: int = 30
    model_dt: float = 0.1
    vx_std: float = 0.2
    wz_std: float = 0.8
    noise_correlation: float = 0.7
    temperature: float = 0.05
    gamma: float = 0.002
    cost_weight: float = 0.6
    goal_weight: float = 1.0
    path_weight: float = 0.5
    slowness_weight: float = 0.2
    lookahead: float = 1.3
    forward_point: float = 0.15

    def __post_init__(self) -> None:
        for name, highest in (("batch_size", 100_000), ("time_steps", 1000)):
            if not 1 <= getattr(self, name) <= highest:
                raise ValueError(f"{name} must be from 1 to {highest}, not {getattr(self, name)}")
        if not 0.0 <= self.noise_correlation < 1.0:
            raise ValueError(f"noise_correlation must be from 0 to below 1, not {self.noise_correlation}")
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            zero_is_fine = name.endswith("_weight") or name in ("gamma", "forward_point", "noise_correlation")
            if not (math.isfinite(value) and (value > 0.0 or (value == 0.0 and zero_is_fine))):
                raise ValueError(f"{name} must {'not be negative' if zero_is_fine else 'be positive'}, not {value}")


class MPPI:
    """Controller; forward only but for movers, like `robocar.planners.controllers.dwa`.

    Args:
        rng: the source of its noise.
        inflation: how the costmaps are inflated, if it is known; then the outline is checked near obstacles only.

    Raises:
        ValueError: the robot's limits are zero, crossed or not finite.
    """

    def __init__(
        self,
        robot: Robot,
        control_period: float,
        rng: np.random.Generator,
        parameters: MppiParameters | None = None,
        steering: SteeringParameters | None = None,
        inflation: layered.CostmapParameters | None = None,
    ) -> None:
        self.parameters = parameters or MppiParameters()
        self._steering = Steering(robot, control_period, steering or SteeringParameters())
        self._footprint, self._inflation, self._dt = robot.footprint, inflation, control_period
        self._outlines = self._steering.outlines
        self._follower = PathFollower()
        self._movers = MovingObstacles(robot)
        self._rng = rng
        self._mean = np.zeros((self.parameters.time_steps, 2))  # [m/s, rad/s]
        self._drawn_at = -math.inf
        _warm_up()

    def command(self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal) -> Command:
        """The twist for the next control period; `GiveUp` (`stuck`) where all trajectories have collided for
        `failure_tolerance`.

        Args:
            path: to follow; None is the straight way to the goal.
            costmap: obstacles; None is a world without.
        """
        p, pose, steering = self.parameters, state.belief.pose, self._steering
        self._movers.update(pose, observation)
        if steering.resume(observation.time):
            self._mean[:] = 0.0
        views = self._outlines.views(costmap, pose)
        local = self._follower.ahead(path, goal.position, costmap, views[0], p.lookahead, 2.0 * p.forward_point)
        movers = self._movers.discs(views[0], costmap, observation.time)
        turn = steering.at_goal(views, pose, goal)
        if turn is None and len(movers) == 0:
            turn = steering.to_path(views, local.bearing)
        if turn is not None:
            self._mean[:] = 0.0
            return turn
        command = self._choice(views, local, movers, costmap, observation.time)
        return command or steering.stuck(observation.time)

    def evade(self, state: State, costmap: Costmap | None, observation: Observation) -> Drive | None:
        """A twist out of the way of what comes, for whoever else drives or lets the car stand; None where nothing comes."""
        pose = state.belief.pose
        views = self._outlines.views(costmap, pose)
        movers = self._movers.coming(pose, observation, views[0], costmap)
        if movers is None:
            return None
        if self._steering.resume(observation.time):
            self._mean[:] = 0.0
        return self._choice(views, here(views[0]), movers, costmap, observation.time)

    def _choice(
        self, views: list[CostmapView], local: LocalPath, movers: Array, costmap: Costmap | None, time: float
    ) -> Drive | None:
        """The weighted mean of the samples; None where all collide, or where to stand is best and nothing moves."""
        p, steering = self.parameters, self._steering
        noise = self._rng.standard_normal((p.batch_size, p.time_steps, 2))
        correlate(noise, p.noise_correlation)
        noise[0] = 0.0  # the last plan goes on
        for view in views:
            totals, controls = self._sample(view, local, self._mean / (view.resolution, 1.0), noise, movers)
            best = int(np.argmin(totals))
            if totals[best] >= COLLISION:
                continue
            weights = np.exp((totals[best] - totals) / p.temperature)
            mean = np.tensordot(weights / weights.sum(), controls, axes=1)
            # The mean of two ways round an obstacle or a mover leads into it: then the best sample counts alone.
            if self._sample(view, local, mean, noise[:1], movers)[0][0] > totals[best] + _FAR_WORSE:
                mean = controls[best]
            last = steering.last
            creeping = max(abs(mean[0, 0]) * view.resolution, abs(mean[0, 1]), abs(last.v), abs(last.omega)) < _CREEP
            if creeping and not len(movers):
                return None  # to stand is no way to the goal
            steering.found()
            trace = self._trace(view, totals, controls, mean, costmap, time)
            command = steering.drive(mean[0, 0] * view.resolution, mean[0, 1], trace)
            self._mean = self._shifted(mean * (view.resolution, 1.0))
            return command
        self._mean[:] = 0.0
        return steering.drive(0.0, 0.0) if len(movers) else None  # until it has passed

    def _sample(self, view: CostmapView, local: LocalPath, mean: Array, noise: Array, movers: Array) -> tuple[Array, Array]:
        """`sample_costs` in the view; `mean` (steps, 2) in cells per second."""
        p, r, limits, last = self.parameters, view.resolution, self._steering.limits, self._steering.last
        fastest = self._steering.highest_speed(view, local.left * r, movers)
        slowest = min(0.0, limits.min_vel_x) if len(movers) else 0.0
        distance = math.hypot(local.goal[0] - view.x, local.goal[1] - view.y) * r
        # Close to the goal the car's centre itself is to arrive.
        forward = p.forward_point * min(1.0, max(0.0, distance / p.lookahead - 0.2) / 0.3)
        reach = self._steering.fastest * p.model_dt * p.time_steps
        outline = view.outline if view.outline is not None else np.empty((0, 2))
        safe = 0.0 if self._inflation is None else safe_cost(self._inflation, self._footprint, r)
        return sample_costs(
            view.costs,
            np.array([view.x, view.y, view.theta, last.v / r, last.omega]),
            ControlLimits(
                limits.acc_lim_x / r,
                float(limits.acc_lim_theta),
                slowest / r,
                fastest / r,
                float(limits.max_vel_theta),
                SLOWEST / r,
            ),
            Sampling(mean, noise, np.array([p.vx_std / r, p.wz_std]), p.model_dt),
            RobotBody(outline, self._footprint.circumscribed_radius / r, safe, view.walled),
            RolloutAim(local.points, local.goal, forward / r),
            CostWeights(
                p.cost_weight / 252.0,
                p.goal_weight * r / reach,
                p.path_weight * r / reach,
                float(p.slowness_weight),
                float(p.gamma),
            ),
            movers,
        )

    def _shifted(self, controls: Array) -> Array:
        """The controls one control period later, (steps, 2); the last one goes on."""
        share = min(1.0, self._dt / self.parameters.model_dt)
        following = np.concatenate([controls[1:], controls[-1:]])
        return (1.0 - share) * controls + share * following

    def _trace(
        self, view: CostmapView, totals: Array, controls: Array, mean: Array, costmap: Costmap | None, time: float
    ) -> Trace:
        """What the recording shows, twice a second: samples coloured by cost, and the trajectory of their mean."""
        if time - self._drawn_at < DRAW_PERIOD:
            return {}
        self._drawn_at = time
        origin, dt = SE2() if costmap is None else costmap.origin, self.parameters.model_dt
        start = np.array([view.x, view.y, view.theta])

        def trajectories(chosen: Array) -> Array:
            return origin.transform(positions(start, chosen, dt) * view.resolution)

        def candidates() -> Lines:
            good = np.flatnonzero(totals < COLLISION)
            shown: NDArray[np.intp] = good[:: max(1, len(good) // DRAWN)]
            return Lines(tuple(thinned(trajectories(controls[shown]))), values=totals[shown], radius=0.003)

        def local() -> Lines:
            return Lines((trajectories(mean[None])[0],), color=LOCAL_COLOR, radius=0.01)

        return LazyTrace({"candidates": candidates, "local": local})


@warm_up
def _warm_up() -> None:
    exercise(lambda: MPPI(trial_robot(), 0.1, np.random.default_rng(0)))


def build(context: Context) -> MPPI:
    """The planner for the context's robot, with its parameters and random generator."""
    return MPPI(
        context.robot,
        context.control_period,
        context.rng,
        context.parameters_of(MppiParameters),
        context.parameters_of(SteeringParameters),
        context.part("costmap").parameters_of(layered.CostmapParameters),
    )
