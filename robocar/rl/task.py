"""Driving to a goal as a decision process: what is observed, what is rewarded, what ends an episode."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from robocar.core import STOP, Array, Context, Drive, Observation, ScenarioError, Twist
from robocar.core.distance import obstacle_distance
from robocar.core.randomness import stream
from robocar.episode.run import world_of
from robocar.estimation.odometry.odometry import OdometryEstimator
from robocar.scenario.load import load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.scene import Scene
from robocar.scenario.settings import split_overrides

PSD_RANGE = 10.0
"""What the infrared sensor is taken to say where it sees nothing [m]."""


@dataclass(frozen=True, slots=True)
class Reward:
    """reward = progress * (d_before - d_now) - contact * [touches now] - time * period + success * [at the goal]

    with d the way to the goal round the map's walls (progress `geodesic`) or straight (`straight`).

    Args:
        progress: per metre nearer to the goal.
        contact: for every control tick with a contact.
        time: per second.
        success: once, at the goal.
        distance: which d.
    """

    progress: float = 1.0
    contact: float = 1.0
    time: float = 0.0
    success: float = 10.0
    distance: Literal["geodesic", "straight"] = "geodesic"

    def __post_init__(self) -> None:
        for name in ("progress", "contact", "time", "success"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be a finite number, not {getattr(self, name)!r}")
        if self.distance not in ("geodesic", "straight"):
            raise ValueError(f"distance must be 'geodesic' or 'straight', not {self.distance!r}")


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """One step: observation and reward, whether the episode ended (terminated) or ran out of time (truncated), and why."""

    observation: dict[str, NDArray[Any]]
    reward: float
    terminated: bool
    truncated: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Space:
    """What an array may hold: shape, type and limits."""

    shape: tuple[int, ...]
    dtype: type
    low: float
    high: float


class DrivingTask:
    """One scenario, to be driven again and again.

    The action is a twist (v [m/s], omega [rad/s]) for one control period. The observation is what the fitted sensors have said
    last, and the goal as dead reckoning sees it, or as it truly is (`pose="truth"`):

    * `goal`: distance [m], cosine and sine of its bearing in the robot's frame (3,)
    * `sonars` (n,), `lidar` (beams,), `psd` (1,): ranges [m]; the sensor's largest one where nothing was heard or the reading was
      dropped
    * `speed`: v [m/s] and omega [rad/s] by the encoders (2,); `acceleration` (2,) [m/s^2]; `bumper` (1,) 0 or 1
    * `compass`: cosine and sine of the heading (2,); `image` (height, width, 3) uint8

    Terminated: true position within the goal's tolerance; contact, where the scenario says `on_contact: end`; physics diverged.
    Truncated: the scenario's time limit.

    Args:
        scenario: name, file, mapping or `Scenario`; it must have a goal and no events.
        settings: as `robocar run --set`, for the scenario.
        reward: its weights.
        pose: where the goal's direction comes from.

    Raises:
        RobocarError: the scenario cannot be loaded.
    """

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario,
        settings: Mapping[str, Any] | None = None,
        reward: Reward | None = None,
        pose: Literal["odometry", "truth"] = "odometry",
    ) -> None:
        scenario_settings, parameters = split_overrides(settings or {})
        if any(parameters.values()):
            raise ScenarioError("a learning environment has no navigator, estimator or mapper to be set")
        if pose not in ("odometry", "truth"):
            raise ValueError(f"pose must be 'odometry' or 'truth', not {pose!r}")
        loaded = load_scenario(scenario, scenario_settings)
        self.scene = Scene.load(loaded, loaded.robot_model().footprint)
        if self.scene.goal is None:
            raise ScenarioError(f"{self.scene.scenario.name}: a learning environment needs a goal")
        if self.scene.scenario.events:
            raise ScenarioError(f"{self.scene.scenario.name}: a learning environment plays no events")
        self.goal = self.scene.goal
        self.reward, self._pose = reward or Reward(), pose
        self.field = _distance_field(self.scene) if self.reward.distance == "geodesic" else None
        self.world = world_of(self.scene, 0)  # whose sensors say what is observed
        limits = self.world.robot.robot.limits
        self.low = np.array([limits.min_vel_x, -limits.max_vel_theta], dtype=np.float32)
        self.high = np.array([limits.max_vel_x, limits.max_vel_theta], dtype=np.float32)
        first = self.world.robot.sense()
        self.spaces = self._spaces(first)
        self.period = self.world.control_period

    def reset(self, seed: int) -> dict[str, NDArray[Any]]:
        """A new episode: a new car with new tolerances and noise. Equal seeds and actions give equal episodes."""
        self.world.close()
        self.world = world_of(self.scene, seed)
        robot = self.world.robot.robot
        context = Context(
            robot,
            None,
            self.scene.start if self.scene.scenario.start_known else None,
            (),
            {},
            stream(seed, "odometry"),
            self.period,
        )
        self._odometry = OdometryEstimator(context)
        self._command: Any = STOP
        self._wheels: tuple[float, float, float] | None = None
        self._seen = {name: np.full(space.shape, space.high, dtype=space.dtype) for name, space in self.spaces.items()}
        for name in ("speed", "acceleration", "bumper", "image"):
            if name in self._seen:
                self._seen[name] = np.zeros_like(self._seen[name])
        observation = self._observe()
        self._distance = self.distance()
        return observation

    def step(self, action: Any) -> StepOutcome:
        """One control period under a twist (2,); it is clipped to the car's limits.

        Raises:
            ValueError: not two finite numbers.
        """
        twist = np.asarray(action, dtype=float)
        if twist.shape != (2,) or not np.isfinite(twist).all():
            raise ValueError(f"an action is two finite numbers (v, omega), not {action!r}")
        v, omega = np.clip(twist, self.low, self.high)
        self._command = Drive(Twist(float(v), float(omega)))
        self.world.robot.act(self._command)
        self.world.step()
        problem = self.world.diverged()
        if problem is not None:
            return StepOutcome(self._copy(), 0.0, True, False, f"diverged: {problem}")
        observation = self._observe()
        truth, before = self.world.ground_truth(), self._distance
        self._distance = self.distance()
        gap = math.dist((truth.pose.x, truth.pose.y), self.goal.position)
        arrived = gap <= self.goal.xy_goal_tolerance
        weights = self.reward
        reward = weights.progress * (before - self._distance) - weights.contact * truth.contact - weights.time * self.period
        reward += weights.success * arrived
        scenario = self.scene.scenario
        hit = truth.contact and scenario.on_contact == "end"
        late = truth.time >= scenario.time_limit - 1e-9
        reason = "success" if arrived else "collision" if hit else "timeout" if late else ""
        return StepOutcome(observation, float(reward), bool(arrived or hit), bool(late and not (arrived or hit)), reason)

    def distance(self) -> float:
        """What the reward's progress is measured by: from the true position to the goal [m]."""
        pose = self.world.ground_truth().pose
        if self.field is None:
            return math.dist((pose.x, pose.y), self.goal.position)
        x, y = self.scene.grid.grid_from_world(pose.position)
        # Between the centres of the cells, so that every bit of the way counts.
        return float(map_coordinates(self.field, [[y - 0.5], [x - 0.5]], order=1, mode="nearest")[0])

    def close(self) -> None:
        """Frees the renderer."""
        self.world.close()

    # -- what is seen ---------------------------------------------------------------------------------------------------

    def _spaces(self, first: Observation) -> dict[str, Space]:
        robot, far = self.world.robot.robot, float(np.linalg.norm(self.scene.grid.size)) * 2.0 + 10.0
        spaces = {"goal": Space((3,), np.float32, -far, far), "speed": Space((2,), np.float32, -100.0, 100.0)}
        if robot.sonars:
            spaces["sonars"] = Space((len(robot.sonars),), np.float32, 0.0, max(s.max_range for s in robot.sonars))
        if robot.lidar is not None:
            spaces["lidar"] = Space((len(robot.lidar.bearings),), np.float32, 0.0, robot.lidar.max_range)
        spaces["psd"] = Space((1,), np.float32, 0.0, PSD_RANGE)
        spaces["acceleration"] = Space((2,), np.float32, -1000.0, 1000.0)
        spaces["bumper"] = Space((1,), np.float32, 0.0, 1.0)
        if self.scene.scenario.robot.compass:
            spaces["compass"] = Space((2,), np.float32, -1.0, 1.0)
        if first.image is not None:
            spaces["image"] = Space(first.image.pixels.shape, np.uint8, 0, 255)
        return spaces

    def _observe(self) -> dict[str, NDArray[Any]]:
        new = self.world.robot.sense()
        belief = self._odometry.update(new, self._command)
        pose = self.world.ground_truth().pose if self._pose == "truth" else belief.pose
        dx, dy = self.goal.position[0] - pose.x, self.goal.position[1] - pose.y
        bearing = math.atan2(dy, dx) - pose.theta
        self._see("goal", (math.hypot(dx, dy), math.cos(bearing), math.sin(bearing)))
        self._see("speed", (belief.twist.v, belief.twist.omega))
        for scan in new.sonars:
            names = [sensor.name for sensor in self.world.robot.robot.sonars]
            self._seen["sonars"][names.index(scan.name)] = self._range(float(scan.ranges[0]), scan.max_range)
        if new.lidar is not None:
            ranges = np.where(np.isfinite(new.lidar.ranges), new.lidar.ranges, new.lidar.max_range)
            self._see("lidar", ranges)
        if new.psd is not None:
            self._see("psd", (self._range(new.psd.value, PSD_RANGE),))
        if new.acceleration is not None and np.isfinite(new.acceleration.value).all():
            self._see("acceleration", new.acceleration.value)
        if new.bumper is not None:
            self._see("bumper", (float(new.bumper.value),))
        if new.compass is not None and math.isfinite(new.compass.value):
            self._see("compass", (math.cos(new.compass.value), math.sin(new.compass.value)))
        if new.image is not None and "image" in self.spaces:
            self._seen["image"] = np.array(new.image.pixels)
        return self._copy()

    def _see(self, name: str, values: Any) -> None:
        if (space := self.spaces.get(name)) is not None:
            self._seen[name] = np.clip(np.asarray(values, dtype=space.dtype), space.low, space.high).astype(space.dtype)

    @staticmethod
    def _range(value: float, far: float) -> float:
        return min(value, far) if math.isfinite(value) else far

    def _copy(self) -> dict[str, NDArray[Any]]:
        return {name: value.copy() for name, value in self._seen.items()}


def _distance_field(scene: Scene) -> Array:
    """The way of the footprint's inscribed disc to the goal from every cell, along eight directions, (rows, cols) [m].

    Cells without a way to the goal, walls among them, count as the nearest cell that has one, and the straight line to it.
    """
    grid = scene.true_grid
    assert scene.goal is not None
    radius = scene.scenario.robot_model().footprint.inscribed_radius
    goal = grid.cell_inside(scene.goal.position, "goal")
    around = np.pad(grid.occupied, 1, constant_values=scene.scenario.border == "wall")
    free = obstacle_distance(around, grid.resolution)[1:-1, 1:-1] > radius
    free[goal] = True
    number = np.arange(free.size).reshape(free.shape)
    tails, heads, lengths = [], [], []
    rows, cols = free.shape
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, rows - dr), slice(max(0, -dc), cols - max(0, dc)))
        b = (slice(dr, rows), slice(max(0, dc), cols - max(0, -dc)))
        both = free[a] & free[b]
        tails.append(number[a][both])
        heads.append(number[b][both])
        lengths.append(np.full(int(both.sum()), math.hypot(dr, dc) * grid.resolution))
    graph = coo_array((np.concatenate(lengths), (np.concatenate(tails), np.concatenate(heads))), shape=(free.size, free.size))
    field = dijkstra(graph.tocsr(), directed=False, indices=number[goal]).reshape(free.shape)
    reached = np.isfinite(field)
    gap, nearest = distance_transform_edt(~reached, sampling=grid.resolution, return_indices=True)  # type: ignore[misc]
    return np.where(reached, field, field[tuple(nearest)] + gap)
