"""The Dynamic Window Approach: the best of the twists that the car can reach and stop from.

Fox, Burgard and Thrun, The Dynamic Window Approach to Collision Avoidance, IEEE Robotics and Automation Magazine 4(1), 1997;
Izaty and Lubis, AGV path planning by RRT and DWA (JITET), eq. 1 to 6, whose two scorings can be chosen. Twists are sampled from
V_s (the car's limits, eq. 2) and V_d (what its accelerations reach within `window`, eq. 4), driven `sim_time` ahead with these
accelerations, and kept if the car can stop before what it would meet (V_a, eq. 3).
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
    Points,
    Robot,
    State,
    Trace,
)
from robocar.core.compiling import trial_robot, warm_up
from robocar.core.trace import LazyTrace
from robocar.planners.controllers.steering import SLOWEST, Steering, SteeringParameters
from robocar.planners.controllers.trajectory_costs import (
    CLOSE,
    COLLIDES,
    COST,
    DEPTH,
    GOAL,
    HEADING,
    NEVER,
    PATH,
    TRAVELLED,
    TURNED,
    LocalPath,
    PathFollower,
    RobotBody,
    RolloutAim,
    RolloutHorizon,
    drawn,
    exercise,
    here,
    rollouts,
)
from robocar.planners.costmap import layered as layered
from robocar.planners.costmap.layered import safe_cost
from robocar.planners.geometry.outlines import CostmapView
from robocar.planners.tracking.moving_obstacles import STAY, MovingObstacles, met

_DODGE = 0.8  # [s] of an arc after which the car may also stop
DRAWN, CORNERS = 40, 6  # candidates in the recording, and points of each
DRAW_PERIOD = 0.5  # [s]
LOCAL_COLOR = (44, 160, 44)


@dataclass(frozen=True, slots=True)
class DwaParameters:
    """Names are Nav2's (DWB's) where it has them.

    Args:
        scoring: `cost` is eq. 6 of Izaty and Lubis, `objective` eq. 5, Fox's.
        vx_samples, vtheta_samples: of speed and turning rate.
        sim_time, sim_granularity: how far ahead twists are driven, in which steps [s].
        window: the time in which a twist must be reachable, the t of eq. 4; eq. 5 looks at the heading after it [s].
        cost_scale, goal_distance_scale, path_distance_scale, slowness_scale: a to d of eq. 6. Its terms are made comparable: the
            mean cost of the cells crossed by the highest, distances by the way that the car makes at most in `sim_time`, 1 / v^2
            by its value at 0.05 m/s, below which it grows no further, so that turning on the spot may be best. With equal a and
            b a trajectory costs what `grid_search` says of a path, less what it brings the car nearer.
        heading_scale, clearance_scale, velocity_scale: a to c of eq. 5.
        lookahead_dist: along the path, to the local goal, or as far as it is in sight [m].
        forward_point_distance: the point that is to come near to the local goal lies this far ahead of the car's centre, so that
            it turns there too [m].
    """

    scoring: str = "cost"
    vx_samples: int = 20
    vtheta_samples: int = 40
    sim_time: float = 2.0
    sim_granularity: float = 0.1
    window: float = 0.5
    cost_scale: float = 0.5
    goal_distance_scale: float = 1.0
    path_distance_scale: float = 0.5
    slowness_scale: float = 0.2
    heading_scale: float = 0.8
    clearance_scale: float = 0.3
    velocity_scale: float = 0.3
    lookahead_dist: float = 1.0
    forward_point_distance: float = 0.15

    def __post_init__(self) -> None:
        if self.scoring not in ("cost", "objective"):
            raise ValueError(f"scoring is 'cost' (eq. 6) or 'objective' (eq. 5), not {self.scoring!r}")
        for name in ("vx_samples", "vtheta_samples"):
            if not 1 <= getattr(self, name) <= 1000:
                raise ValueError(f"{name} must be from 1 to 1000, not {getattr(self, name)}")
        zero_is_fine = {n for n in self.__dataclass_fields__ if n.endswith("_scale")}
        zero_is_fine |= {"forward_point_distance"}
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if isinstance(value, str) or name.endswith("_samples"):
                continue
            if not (math.isfinite(value) and (value > 0.0 or (value == 0.0 and name in zero_is_fine))):
                word = "not be negative" if name in zero_is_fine else "be positive"
                raise ValueError(f"{name} must {word}, not {value}")
        if not self.sim_granularity <= self.sim_time <= 1000.0 * self.sim_granularity:
            raise ValueError(f"sim_time {self.sim_time} must be from 1 to 1000 steps of sim_granularity {self.sim_granularity}")


class DynamicWindow:
    """Controller. It drives backwards, where few sensors look, to get out of the way of what moves only: else
    `robocar.planners.navigators.recovery` backs up where nothing else helps.

    Args:
        inflation: how the costmaps are inflated, if it is known; then the outline is checked near obstacles only.

    Raises:
        ValueError: the robot's limits are zero, crossed or not finite.
    """

    def __init__(
        self,
        robot: Robot,
        control_period: float,
        parameters: DwaParameters | None = None,
        steering: SteeringParameters | None = None,
        inflation: layered.CostmapParameters | None = None,
    ) -> None:
        self.parameters = p = parameters or DwaParameters()
        self._steering = Steering(robot, control_period, steering or SteeringParameters())
        self._footprint, self._inflation = robot.footprint, inflation
        self._steps = max(1, round(p.sim_time / p.sim_granularity))
        soon = min(self._steps, max(1, round(p.window / p.sim_granularity)))
        self._horizon = RolloutHorizon(p.sim_granularity, self._steps, soon, NEVER)
        self._outlines = self._steering.outlines
        self._follower = PathFollower()
        self._movers = MovingObstacles(robot)
        self._drawn_at = -math.inf
        _warm_up()

    def command(self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal) -> Command:
        """The twist for the next control period; `GiveUp` (`stuck`) where there has been none for `failure_tolerance`.

        Args:
            path: to follow; None is the straight way to the goal.
            costmap: obstacles; None is a world without.
        """
        p, pose = self.parameters, state.belief.pose
        self._steering.resume(observation.time)
        self._movers.update(pose, observation)
        views = self._outlines.views(costmap, pose)
        if (arrival := self._steering.at_goal(views, pose, goal)) is not None:
            return arrival
        local = self._follower.ahead(path, goal.position, costmap, views[0], p.lookahead_dist, 2.0 * p.forward_point_distance)
        movers = self._movers.discs(views[0], costmap, observation.time)
        if len(movers) == 0 and (turn := self._steering.to_path(views, local.bearing)) is not None:
            return turn
        return self._choice(views, local, movers, costmap, observation.time) or self._steering.stuck(observation.time)

    def evade(self, state: State, costmap: Costmap | None, observation: Observation) -> Drive | None:
        """A twist out of the way of what comes, for whoever else drives or lets the car stand; None where nothing comes."""
        pose = state.belief.pose
        views = self._outlines.views(costmap, pose)
        movers = self._movers.coming(pose, observation, views[0], costmap)
        if movers is None:
            return None
        self._steering.resume(observation.time)
        return self._choice(views, here(views[0]), movers, costmap, observation.time)

    def _choice(
        self, views: list[CostmapView], local: LocalPath, movers: Array, costmap: Costmap | None, time: float
    ) -> Drive | None:
        """The cheapest of the samples; None where none is admissible."""
        for view in views:
            samples = self._window(local, view, movers)
            scores = self._best_scores(view, local, samples, movers)
            best = int(np.argmin(scores))
            if scores[best] < math.inf:
                self._steering.found()
                trace = self._trace(view, local, samples, scores, best, costmap, time)
                return self._steering.drive(samples[best, 0] * view.resolution, samples[best, 1], trace)
        return None

    def _window(self, local: LocalPath, view: CostmapView, movers: Array) -> Array:
        """The twists of V_s and V_d, (vx_samples * vtheta_samples, 2) [cells/s, rad/s]."""
        p, limits, last = self.parameters, self._steering.limits, self._steering.last
        reverse = len(movers) > 0
        fastest = self._steering.highest_speed(view, local.left * view.resolution, movers)
        v_reach, w_reach = limits.acc_lim_x * p.window, limits.acc_lim_theta * p.window
        slowest = min(0.0, limits.min_vel_x) if reverse else 0.0
        low_v, high_v = max(slowest, last.v - v_reach), min(fastest, last.v + v_reach)
        low_w = max(-limits.max_vel_theta, last.omega - w_reach)
        high_w = min(limits.max_vel_theta, last.omega + w_reach)
        speeds = np.linspace(max(high_v, low_v), low_v, p.vx_samples)
        if reverse:
            speeds[np.argmin(np.abs(speeds))] = 0.0  # and to stand
        turns = np.linspace(low_w, high_w, p.vtheta_samples)
        turns[np.argmin(np.abs(turns))] = 0.0  # straight on is among them
        samples = np.empty((p.vx_samples, p.vtheta_samples, 2))
        samples[..., 0] = speeds[:, None] / view.resolution
        samples[..., 1] = turns
        return samples.reshape(-1, 2)

    def _best_scores(self, view: CostmapView, local: LocalPath, samples: Array, movers: Array) -> Array:
        """Costs of all samples (n,), smaller is better, inf where not admissible.

        Among movers the car may also drive on for `_DODGE` only and then stop: beside them in an aisle there is no room for a
        whole arc. And who backs away from what comes goes on doing so, and does not stop for it to run into him: without that,
        the only way out seems to lead forward past it.
        """
        scores = self._score(view, local, samples, movers, self._horizon)
        if len(movers) > 0:
            brake = max(1, round(_DODGE / self.parameters.sim_granularity))
            scores = np.minimum(scores, self._score(view, local, samples, movers, self._horizon._replace(brake=brake)))
            backwards = samples[:, 0] < 0.0
            if backwards.any():
                on = self._horizon._replace(steps=self._steps + round(STAY / self.parameters.sim_granularity), stay=0.0)
                retreats = self._score(view, local, samples[backwards], movers, on)
                scores[backwards] = np.minimum(scores[backwards], retreats)
        return scores

    def _score(self, view: CostmapView, local: LocalPath, samples: Array, movers: Array, horizon: RolloutHorizon) -> Array:
        """The costs of all samples, driven so far."""
        p, r = self.parameters, view.resolution
        distance = math.hypot(local.goal[0] - view.x, local.goal[1] - view.y) * r
        # Close to the goal the car's centre itself is to arrive.
        forward = p.forward_point_distance * min(1.0, max(0.0, distance / p.lookahead_dist - 0.2) / 0.3)
        outline = view.outline if view.outline is not None else np.empty((0, 2))
        safe = 0.0 if self._inflation is None else safe_cost(self._inflation, self._footprint, r)
        fastest, limits = self._steering.fastest, self._steering.limits
        body = RobotBody(outline, self._footprint.circumscribed_radius / r, safe, view.walled)
        aim = RolloutAim(local.points, local.goal, forward / r)
        terms = rollouts(view.costs, self._start(view), self._accelerations(view), samples, body, aim, horizon, movers)
        v, w = samples[:, 0] * r, np.abs(samples[:, 1])
        reach = fastest * p.sim_time
        hit = terms[:, COLLIDES] > 0.0
        # To stand is no way to the goal (`Steering.stuck` stands, and says so), unless something passes by.
        standing = (v == 0.0) & (w == 0.0) & (len(movers) == 0)
        meets = met(terms[:, DEPTH], terms[:, CLOSE])
        if p.scoring == "cost":  # eq. 6
            scores = (
                p.cost_scale * terms[:, COST] / 252.0
                + p.goal_distance_scale * terms[:, GOAL] * r / reach
                + p.path_distance_scale * terms[:, PATH] * r / reach
                + p.slowness_scale * (SLOWEST / np.maximum(v, SLOWEST)) ** 2
            )
            scores += meets
            scores[hit | standing] = math.inf  # "discarded"
            return scores
        # eq. 5, its sign changed; a trajectory that hits nothing has the largest distance that one can have.
        clearance = np.where(hit, np.minimum(terms[:, TRAVELLED] * r / reach, 1.0), 1.0)
        objective = (
            p.heading_scale * (1.0 - terms[:, HEADING] / math.pi) + p.velocity_scale * v / fastest + p.clearance_scale * clearance
        )
        # eq. 3: it can stop, straight and turning, before it hits.
        stops = np.abs(v) <= np.sqrt(2.0 * terms[:, TRAVELLED] * r * limits.acc_lim_x)
        stops &= w <= np.sqrt(2.0 * terms[:, TURNED] * limits.acc_lim_theta)
        return np.where((hit & ~stops) | standing, math.inf, meets - objective)

    def _start(self, view: CostmapView) -> Array:
        last = self._steering.last
        return np.array([view.x, view.y, view.theta, last.v / view.resolution, last.omega])

    def _accelerations(self, view: CostmapView) -> Array:
        limits = self._steering.limits
        return np.array([limits.acc_lim_x / view.resolution, limits.acc_lim_theta])

    def _trace(
        self, view: CostmapView, local: LocalPath, samples: Array, scores: Array, best: int, costmap: Costmap | None, time: float
    ) -> Trace:
        """What the recording shows, twice a second: candidates coloured by cost, the chosen trajectory, the local goal."""
        if time - self._drawn_at < DRAW_PERIOD:
            return {}
        self._drawn_at = time
        origin = SE2() if costmap is None else costmap.origin
        args = self._start(view), self._accelerations(view), self.parameters.sim_granularity, self._steps

        def world(points: Array) -> Array:
            return origin.transform(points * view.resolution)

        def trajectories(chosen: Array) -> Array:
            return world(drawn(args[0], args[1], chosen, args[2], args[3]))

        def candidates() -> Lines:
            good = np.flatnonzero(scores < math.inf)
            shown: NDArray[np.intp] = good[:: max(1, len(good) // DRAWN)]
            return Lines(tuple(thinned(trajectories(samples[shown]))), values=scores[shown], radius=0.003)

        return LazyTrace({
            "candidates": candidates,
            "local": lambda: Lines((trajectories(samples[best : best + 1])[0],), color=LOCAL_COLOR, radius=0.01),
            "local_goal": lambda: Points(world(local.goal[None])),
        })  # fmt: skip


def thinned(trajectories: Array) -> Array:
    """`CORNERS` points of each trajectory (n, k, 2), its ends among them."""
    k = trajectories.shape[1]
    return trajectories[:, np.unique(np.linspace(0, k - 1, min(k, CORNERS)).round().astype(int))]


@warm_up
def _warm_up() -> None:
    exercise(lambda: DynamicWindow(trial_robot(), 0.1))


def build(context: Context) -> DynamicWindow:
    """The planner for the context's robot, with its parameters."""
    return DynamicWindow(
        context.robot,
        context.control_period,
        context.parameters_of(DwaParameters),
        context.parameters_of(SteeringParameters),
        context.part("costmap").parameters_of(layered.CostmapParameters),
    )
