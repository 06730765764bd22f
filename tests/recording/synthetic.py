"""A run without a simulator: a walled room with a block, a car that drives around it and is wrong about where it is."""

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import (
    SE2,
    Belief,
    Calibration,
    Costmap,
    Done,
    Drive,
    Footprint,
    Goal,
    Landmark,
    Limits,
    Observation,
    OccupancyGrid,
    Reading,
    Robot,
    Scan,
    State,
    Twist,
    WheelAngles,
)
from robocar.core.rays import cast_rays
from robocar.core.trace import Field, Lines, Points, Scalar, Text
from robocar.core.truth import GroundTruth
from robocar.recording import Box, Cylinder, Scenery

DT, RADIUS, SPEED = 0.05, 1.0, 0.25
MOUNTS = {"front_left": SE2(0.12, 0.05, 0.3), "front_right": SE2(0.12, -0.05, -0.3)}


def room() -> OccupancyGrid:
    """3.5 x 3 m at 5 cm, walls all around, a block in the middle and one that breaks every symmetry in the lower left."""
    data = np.zeros((60, 70), dtype=np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    data[26:34, 31:39] = 100
    data[1:5, 1:13] = 100
    return OccupancyGrid(data, 0.05)


def car() -> Robot:
    calibration = Calibration(0.042, np.array([0.0, 1.0]), np.array([0.45, 0.45]))
    limits = Limits(0.0, 0.5, 2.0, 1.0, 4.0)
    return Robot(Footprint.rectangle(0.13, 0.13, 0.1), limits, calibration, 20)


def scenery(**changes) -> Scenery:
    parts = {
        "truth": room(),
        "robot": car(),
        "goal": Goal(np.array([1.0, 2.3]), heading=math.pi / 2),
        "landmarks": tuple(
            Landmark(f"{color}_ball", color, np.array([x, y, 0.2]), 0.08)
            for color, x, y in (("blue", 3.4, 0.1), ("red", 0.1, 0.1), ("green", 3.4, 2.9), ("orange", 0.1, 2.9))
        ),
        "solids": (Box((0.3, 0.2, 0.2), SE2(2.9, 2.6, 0.4)), Cylinder(0.12, 0.25, SE2(0.3, 2.7, 0.0))),
        "movers": {"cart": Box((0.2, 0.2, 0.3))},
    }
    return Scenery(**(parts | changes))


class GrowingMap:
    """A map that shows every tick one column more of the room."""

    revision, complete = 0, False

    def __init__(self) -> None:
        self.asked = 0
        self.known = 1
        self._room = room()

    def update(self) -> None:
        self.known = min(self.known + 1, 45)

    def grid(self) -> OccupancyGrid:
        self.asked += 1
        data = np.full(self._room.shape, -1, dtype=np.int8)
        data[:, : self.known] = self._room.data[:, : self.known]
        return OccupancyGrid(data, self._room.resolution)


@dataclass(frozen=True)
class Tick:
    observation: Observation
    belief: Belief
    command: object
    truth: GroundTruth
    odometry: SE2


def drive(ticks: int, seed: int = 0) -> list[Tick]:
    """Once around the block per 25 s: sonars and encoders at every tick, a new plan and costmap every 2 s."""
    rng = np.random.default_rng(seed)
    world = room()
    costs = np.where(world.occupied, 254, 0).astype(np.uint8)
    costs[:, 1:-1] = np.maximum(costs[:, 1:-1], np.where(world.occupied[:, 2:] | world.occupied[:, :-2], 253, 0))
    angles = np.linspace(0.0, 1.5 * np.pi, 40)
    run = []
    trace: dict = {}
    for k in range(ticks):
        time, phase = k * DT, k * DT * SPEED / RADIUS
        pose = SE2(1.75 + RADIUS * math.cos(phase), 1.5 + RADIUS * math.sin(phase), phase + math.pi / 2)
        drift = 0.004 * time
        estimate = SE2(pose.x + 0.03 * math.sin(time), pose.y + 0.02, pose.theta + 0.05)
        odometry = SE2(pose.x + drift, pose.y - drift, pose.theta + 0.2 * drift)
        scans = []
        for name, mount in MOUNTS.items():
            sensor = pose @ mount
            distance = cast_rays(world, world.occupied, sensor.position, [sensor.theta], 3.0)[0] + 0.01 * rng.standard_normal()
            scans.append(Scan(time, np.array([distance if rng.random() > 0.1 else np.inf]), np.zeros(1), 3.0, 0.26, mount, name))
        wheels = Reading(time, WheelAngles(6.0 * time, 6.5 * time))
        observation = Observation(time, wheel_angles=wheels, sonars=tuple(scans), serial=("OK",) if k % 100 == 3 else ())
        if k % 40 == 0:
            ring = phase + angles
            path = np.stack([1.75 + RADIUS * np.cos(ring), 1.5 + RADIUS * np.sin(ring)], axis=1)
            trace = {
                "global": Lines((path,), color=(214, 39, 160), radius=0.012),
                "target": Points(path[5:6], color=(214, 39, 160), radius=0.03),
                "costmap/global": Field(Costmap(costs, 0.05)),
                "replanned": Text(f"new plan at {time:.0f} s"),
            }
        command = Drive(Twist(SPEED, SPEED / RADIUS), trace=trace | {"lookahead": Scalar(0.3, "m")})
        if k == ticks - 1:
            command = Done("driven around")
        cart = SE2(1.0 + 0.01 * time, 0.7, 0.0)
        truth = GroundTruth(time, pose, Twist(SPEED, SPEED / RADIUS), 0.4 + 0.1 * math.sin(time), {"cart": cart}, (4.0, 5.0))
        belief = Belief(estimate, np.diag([4e-4, 2e-4, 1e-3]), Twist(SPEED, SPEED / RADIUS))
        run.append(Tick(observation, belief, command, truth, odometry))
    return run


def record(recorder, run: list[Tick], mapper=None) -> GrowingMap:
    """Log the run; the caller closes."""
    mapper = mapper or GrowingMap()
    for tick in run:
        mapper.update()
        recorder.log(tick.observation, State.of(tick.belief, mapper), tick.command, tick.truth, odometry=tick.odometry)
    return mapper
