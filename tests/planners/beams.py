"""A small world without physics for robots with a laser all round: a grid, discs that move straight, noise, exact contact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robocar.core import (
    SE2,
    Array,
    Belief,
    Drive,
    GiveUp,
    Goal,
    Observation,
    OccupancyGrid,
    RangeSensor,
    Robot,
    Scan,
    State,
    Twist,
)
from robocar.core.rays import cast_rays
from tests.planners import kinematic
from tests.planners.kinematic import car, touches

PERIOD = 0.1
MAX_RANGE = 6.0


def laser_car(beams: int = 360, max_range: float = MAX_RANGE) -> Robot:
    """The size of the Robocar, with a laser in its middle."""
    bearings = np.linspace(-math.pi, math.pi, beams, endpoint=False)
    lidar = RangeSensor("scan360", SE2(), bearings, 0.0, 0.06, max_range, PERIOD)
    robot = car(())
    limits = replace(robot.limits, acc_lim_x=0.8, acc_lim_theta=4.0)
    return replace(robot, lidar=lidar, limits=limits)


@dataclass(frozen=True)
class Disc:
    """A cylinder that moves straight at constant speed: where it is at time 0 (2,) [m], its velocity (2,) [m/s], radius [m]."""

    start: tuple[float, float]
    velocity: tuple[float, float]
    radius: float

    def at(self, time: float) -> Array:
        return np.array(self.start) + time * np.array(self.velocity)


def disc_ranges(origin: Array, bearings: Array, centre: Array, radius: float) -> Array:
    """First intersections of rays with a circle, inf where there is none."""
    dx, dy = centre - origin
    along = dx * np.cos(bearings) + dy * np.sin(bearings)
    across = dy * np.cos(bearings) - dx * np.sin(bearings)
    root = radius**2 - across**2
    hit = (root >= 0) & (along > 0)
    return np.where(hit, along - np.sqrt(np.maximum(root, 0.0)), np.inf)


def scan_of(
    robot: Robot,
    world: OccupancyGrid,
    pose: SE2,
    time: float,
    movers: Sequence[Disc] = (),
    rng: np.random.Generator | None = None,
) -> Scan:
    """What the laser sees; with `rng` the noise and the lost beams of the simulated one."""
    assert robot.lidar is not None
    bearings, reach = robot.lidar.bearings, robot.lidar.max_range
    ranges = cast_rays(world, world.occupied, pose.position, pose.theta + bearings, reach)
    for mover in movers:
        ranges = np.minimum(ranges, disc_ranges(pose.position, pose.theta + bearings, mover.at(time), mover.radius))
    if rng is not None:
        ranges = ranges + rng.normal(0.0, 0.01, len(ranges))
        ranges[rng.random(len(ranges)) < 0.001] = np.nan
    return Scan(time, np.where(ranges > reach, np.inf, np.maximum(ranges, 0.06)), bearings, reach)


@dataclass
class Drives(kinematic.Drives):
    """What came of an episode; `closest` is the least distance to a mover's disc [m]."""

    closest: float = math.inf


def drive(
    navigator,
    world: OccupancyGrid,
    start: SE2,
    goal: Goal,
    *,
    seconds: float = 240.0,
    movers: Sequence[Disc] = (),
    seed: int | None = 0,
    robot: Robot | None = None,
) -> Drives:
    """A scan every 0.1 s, the truth as belief, contact checked twice; `closest` is the least distance to a mover's disc."""
    robot = robot or laser_car()
    rng = None if seed is None else np.random.default_rng(seed)
    pose, result, speed = start, Drives("timeout"), 0.0
    for tick in range(round(seconds / PERIOD)):
        time = tick * PERIOD
        result.poses.append(pose)
        scan = scan_of(robot, world, pose, time, movers, rng)
        command = navigator.command(State.of(Belief(pose)), Observation(time, lidar=scan), goal)
        if command.trace:
            result.traces.append(command.trace)
        if isinstance(command, GiveUp):
            result.status, result.reason = command.status, command.reason
            return result
        assert isinstance(command, Drive)
        result.twists.append(command.twist)
        for half in (1, 2):
            # The car brakes and speeds up as its limits have it.
            speed += min(max(command.twist.v - speed, -0.04), 0.04)
            pose = pose @ Twist(speed, command.twist.omega).step(PERIOD / 2)
            for mover in movers:
                centre = pose.inverse().transform(mover.at(time + half * PERIOD / 2))
                corners = robot.footprint.vertices
                dx = max(corners[:, 0].min() - centre[0], 0.0, centre[0] - corners[:, 0].max())
                dy = max(corners[:, 1].min() - centre[1], 0.0, centre[1] - corners[:, 1].max())
                result.closest = min(result.closest, math.hypot(dx, dy) - mover.radius)
            if touches(robot, world, pose) or result.closest <= 0.0:
                result.status, result.reason = "collision", f"at ({pose.x:.2f}, {pose.y:.2f}), {time:.1f} s"
                return result
        if goal.reached(pose):
            result.poses.append(pose)
            result.status = "success"
            return result
    return result
