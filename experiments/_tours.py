"""Drives along the thesis' four way points, and estimators that listen to what was sensed on the way.

The car is driven by `a-star` on its true pose, so every estimator gets the same sensor data. Pictures are searched for balls
once; what was found goes into the observations in their place.
"""

from __future__ import annotations

import math
import time as wall
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robocar.core import (
    SE2,
    STOP,
    Array,
    Belief,
    Context,
    Detection,
    Goal,
    Landmark,
    Observation,
    OccupancyGrid,
    Robot,
    State,
)
from robocar.core.randomness import stream
from robocar.episode.registry import build
from robocar.episode.run import simulate
from robocar.estimation.landmarks.balls import BallDetector
from robocar.estimation.landmarks.particle_filter import ParticleFilterEstimator
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

FOOTPRINT = RobotModel.load().footprint

SCENARIO = "thesis-localization"
WAY_POINTS = {"A": (0.6, 0.6), "B": (2.9, 0.6), "C": (2.9, 2.2), "D": (0.6, 2.2)}
FIELD = (3.5, 2.5)  # [m]
DURATION, SPEED = 60.0, 0.25  # [s], [m/s]
RANGE_STD = 0.05  # [m] of the ideal range sensor in the thesis' simulation, which does not say it


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """What one car sensed, and where it was.

    Args:
        observations: without pictures; what was found in them is in `landmarks`.
        times: (n,) [s]; truth: (n, 3) x, y [m], theta [rad]; carried: (n,) bool.
        passed: names and ticks of the way points in the order in which they were passed.
    """

    seed: int
    observations: tuple[Observation, ...]
    times: Array
    truth: Array
    carried: Array
    passed: tuple[tuple[str, int], ...]
    robot: Robot
    prior: OccupancyGrid | None
    landmarks: tuple[Landmark, ...]
    period: float


def drive(seed: int, kidnap: float | None = None, duration: float = DURATION) -> Tour:
    """One car, from a start of its own; at time `kidnap` [s] it is put 2 m away, turned by 120 degrees."""
    rng = stream(seed, "experiment/tour")
    scene = Scene.load(load_scenario(SCENARIO), FOOTPRINT)
    start = _free_pose(scene, rng)
    settings = {"start": [start.x, start.y, start.theta], "robot.sonars": "none"}
    world = simulate(SCENARIO, seed=seed, settings=settings)
    detector = BallDetector(scene.landmarks)
    names, points = list(WAY_POINTS), np.array(list(WAY_POINTS.values()))
    target = int(np.argmin(np.hypot(*(points - start.position).T)))
    parameters = {"controller": {"desired_linear_vel": SPEED}}
    context = Context(world.robot.robot, scene.prior, start, (), parameters, rng, world.control_period)
    driver = build("navigator", "a-star", context)
    observations, truth, carried, passed = [], [], [], []
    moved = False
    while world.time < duration - 1e-9:
        sensed = world.robot.sense()
        seen = detector.detect(sensed.image) if sensed.image is not None else ()
        observations.append(sensed.with_readings({"camera": None, "landmarks": seen}))
        pose = world.ground_truth().pose
        truth.append((sensed.time, *pose.as_array()))
        carried.append(moved)
        moved = kidnap is not None and abs(world.time - kidnap) < 1e-6
        if moved:
            pose = _carried(scene, pose, rng)
            world.robot.kidnap(pose)
            driver = build("navigator", "a-star", context)
        if math.dist(points[target], (pose.x, pose.y)) < 0.10:
            passed.append((names[target], len(truth) - 1))
            target = (target + 1) % len(names)
        driver_sees = Observation(sensed.time)  # the map is all that it needs
        goal = Goal(points[target], xy_goal_tolerance=0.05)
        world.robot.act(driver.command(State.of(Belief(pose)), driver_sees, goal))
        world.step()
    world.close()
    table = np.array(truth)
    return Tour(
        seed,
        tuple(observations),
        table[:, 0],
        table[:, 1:],
        np.array(carried),
        tuple(passed),
        world.robot.robot,
        scene.prior,
        scene.landmarks,
        world.control_period,
    )


def _free_pose(scene: Scene, rng: np.random.Generator) -> SE2:
    for _ in range(10_000):
        pose = SE2(*rng.uniform((0.3, 0.3, -math.pi), (FIELD[0] - 0.3, FIELD[1] - 0.3, math.pi)))
        if scene.clearance(FOOTPRINT.at(pose)) > 0.15:
            return pose
    raise RuntimeError("the field has no room for the car")


def _carried(scene: Scene, pose: SE2, rng: np.random.Generator) -> SE2:
    """2 m away in a random direction in which there is room, turned by 120 degrees to either side."""
    for _ in range(10_000):
        direction, side = rng.uniform(-math.pi, math.pi), rng.choice((-1.0, 1.0))
        there = SE2(pose.x + 2 * math.cos(direction), pose.y + 2 * math.sin(direction), pose.theta + side * math.radians(120.0))
        if 0.3 < there.x < FIELD[0] - 0.3 and 0.3 < there.y < FIELD[1] - 0.3 and scene.clearance(FOOTPRINT.at(there)) > 0.1:
            return there
    raise RuntimeError("there is no room 2 m away")


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What an estimator made of a tour.

    Args:
        estimate: (n, 3); covariances: (n, 3, 3); lost: share of particles drawn anew, (n,), nan where it did not say.
        updates: how many ticks with sightings there were up to each tick, (n,).
        wall_time: of the estimator, all ticks together [s].
    """

    tour: Tour
    estimate: Array
    covariances: Array
    lost: Array
    updates: Array
    wall_time: float


def listen(
    tour: Tour,
    estimator: str,
    parameters: Mapping[str, Any],
    *,
    seen: Literal["camera", "ranges"] = "camera",
    start_known: bool = False,
) -> Heard:
    """An estimator over a tour.

    Args:
        seen: what the camera found, or the thesis' world: distances to all landmarks, ten times a second.
        start_known: whether it is told where the car starts.
    """
    start = SE2(*tour.truth[0]) if start_known else None
    rng = stream(tour.seed, f"estimator/{estimator}")
    context = Context(tour.robot, tour.prior, start, tour.landmarks, dict(parameters), rng, tour.period)
    listener = build("estimator", estimator, context)
    observations: Sequence[Observation] = tour.observations if seen == "camera" else _with_ranges(tour)
    estimate, covariances, lost, updates = [], [], [], []
    count, spent = 0, 0.0
    for observation in observations:
        begun = wall.perf_counter()
        belief = listener.update(observation, STOP)
        spent += wall.perf_counter() - begun
        count += bool(observation.landmarks)
        estimate.append(belief.pose.as_array())
        covariances.append(belief.covariance)
        filtered = isinstance(listener, ParticleFilterEstimator) and observation.landmarks
        lost.append(listener.filter.lost_share if filtered else math.nan)
        updates.append(count)
    return Heard(tour, np.array(estimate), np.array(covariances), np.array(lost), np.array(updates), spent)


def _with_ranges(tour: Tour) -> list[Observation]:
    rng = stream(tour.seed, "sensor/ideal_ranges")
    covariance = np.diag([math.pi**2, RANGE_STD**2])
    changed = []
    for k, observation in enumerate(tour.observations):
        pose = SE2(*tour.truth[k])
        found: list[Detection] = []
        for mark in tour.landmarks if k % 2 == 0 else ():
            distance = math.dist(mark.position[:2], (pose.x, pose.y)) + RANGE_STD * rng.standard_normal()
            found.append(Detection(observation.time, mark.name, 0.0, max(0.01, distance), covariance))
        changed.append(observation.with_readings({"landmarks": tuple(found)}))
    return changed
