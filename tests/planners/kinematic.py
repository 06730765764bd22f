"""A small world without physics: the car moves exactly as told, its sonars see the first surface in their cones."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from robocar.core import (
    SE2,
    Belief,
    Calibration,
    Context,
    Drive,
    Footprint,
    GiveUp,
    Goal,
    Limits,
    Observation,
    OccupancyGrid,
    RangeSensor,
    Robot,
    Scan,
    State,
    Twist,
)
from robocar.core.rays import cast_rays
from robocar.core.work import Work
from robocar.planners.geometry.collision import footprint_free

DT = 0.05
BEAM = np.radians(15.0)


def car(mounts: tuple[SE2, ...] = (SE2(0.1, 0.05, 0.2), SE2(0.1, -0.05, -0.2))) -> Robot:
    """The size and the sonars of the Robocar."""
    sonars = tuple(RangeSensor(f"s{i}", mount, np.zeros(1), BEAM, 0.02, 4.0, DT) for i, mount in enumerate(mounts))
    return Robot(
        Footprint.rectangle(front=0.11, rear=0.10, half_width=0.09),
        Limits(min_vel_x=-0.2, max_vel_x=0.4, max_vel_theta=1.5, acc_lim_x=1.0, acc_lim_theta=6.0),
        Calibration(0.042, np.array([0.0]), np.array([0.4])),
        200,
        sonars,
    )


def context(robot: Robot, prior: OccupancyGrid | None, start: SE2 | None = None, **parameters: object) -> Context:
    return Context(robot, prior, start, (), parameters, np.random.default_rng(0), DT)


def sense(robot: Robot, world: OccupancyGrid, pose: SE2, time: float) -> Observation:
    """First echo in each cone, nothing where the surface is met at less than 30 degrees is not modelled: every cone answers."""
    scans = []
    for sonar in robot.sonars:
        at = pose @ sonar.robot_from_sensor
        rays = cast_rays(world, world.occupied, at.position, at.theta + np.linspace(-BEAM / 2, BEAM / 2, 9), sonar.max_range)
        scans.append(Scan(time, np.array([rays.min()]), np.zeros(1), sonar.max_range, BEAM, sonar.robot_from_sensor))
    lidar = None
    if robot.lidar is not None:
        at = pose @ robot.lidar.robot_from_sensor
        bearings, reach = robot.lidar.bearings, robot.lidar.max_range
        ranges = cast_rays(world, world.occupied, at.position, at.theta + bearings, reach)
        lidar = Scan(time, ranges, bearings, reach, 0.0, robot.lidar.robot_from_sensor)
    return Observation(time, sonars=tuple(scans), lidar=lidar)


@dataclass
class Drives:
    """What came of an episode."""

    status: str
    poses: list[SE2] = field(default_factory=list)
    twists: list[Twist] = field(default_factory=list)
    traces: list = field(default_factory=list)
    work: list[Work] = field(default_factory=list)
    reason: str = ""

    @property
    def length(self) -> float:
        points = np.array([pose.position for pose in self.poses])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def touches(robot: Robot, world: OccupancyGrid, pose: SE2) -> bool:
    """Exact overlap of the true outline with a wall."""
    at = world.origin.inverse() @ pose
    r = world.resolution
    costs = np.where(world.occupied, 254, 0).astype(np.uint8)
    return not footprint_free(costs, at.x / r, at.y / r, at.theta, np.array(robot.footprint.vertices / r))


def drive(navigator, robot: Robot, world: OccupancyGrid, start: SE2, goal: Goal, ticks: int = 2400) -> Drives:
    """The loop of the design, with the truth as belief and contact checked at every tick."""
    pose, result = start, Drives("timeout")
    for tick in range(ticks):
        result.poses.append(pose)
        command = navigator.command(State.of(Belief(pose)), sense(robot, world, pose, tick * DT), goal)
        if command.trace:
            result.traces.append(command.trace)
        if command.work:
            result.work.append(command.work)
        if isinstance(command, GiveUp):
            result.status, result.reason = command.status, command.reason
            return result
        assert isinstance(command, Drive)
        result.twists.append(command.twist)
        pose = pose @ command.twist.step(DT)
        if touches(robot, world, pose):
            result.status = "collision"
            result.poses.append(pose)
            return result
        if goal.reached(pose) and command.twist == Twist():
            result.status = "success"
            return result
    return result
