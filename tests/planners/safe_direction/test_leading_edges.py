"""Leading edges: what moves has them, what stands has none. Oracles: a world that stands; a disc that is known to move."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from robocar.core import SE2, Drive, Goal, OccupancyGrid, Robot, Scan, Twist
from robocar.core.rays import cast_rays
from robocar.planners.safe_direction.fan import Fan
from robocar.planners.safe_direction.method import JOINED, Decision, Directions, SafeDirectionParameters
from robocar.planners.safe_direction.progress import SafeDirectionProgress
from robocar.planners.safe_direction.view import DirectionPanorama, Readings, leading_edges, sector_of, window
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_model import RobotModel
from tests.planners.beams import Disc, disc_ranges


def readings(
    robot: Robot, world: OccupancyGrid, pose: SE2, movers: tuple[Disc, ...], time: float, rng: np.random.Generator
) -> Readings:
    """One scan of the fitted laser on cells, with its noise."""
    assert robot.lidar is not None
    sensor, p = robot.lidar, SafeDirectionParameters()
    at = pose @ sensor.robot_from_sensor
    bearings = at.theta + sensor.bearings
    ranges = cast_rays(world, world.occupied, at.position, bearings, sensor.max_range)
    for mover in movers:
        ranges = np.minimum(ranges, disc_ranges(at.position, bearings, mover.at(time), mover.radius))
    ranges = ranges + rng.normal(0.0, 0.01, len(ranges))
    ranges[rng.random(len(ranges)) < 0.001] = np.nan
    ranges = np.where(ranges > sensor.max_range, np.inf, np.maximum(ranges, 0.06))
    sector = sector_of(robot, p.view_angle, p.max_range)
    panorama = DirectionPanorama(sector, p.resolution, JOINED)
    panorama.look(pose, Scan(time, ranges, sensor.bearings, sensor.max_range, 0.0, sensor.robot_from_sensor), ())
    return Directions(robot, sector, p).readings(pose, panorama)


@pytest.mark.parametrize("lidar", ["hokuyo", "scan360"])
@pytest.mark.parametrize("scenario", ["spiral", "corridors", "cluttered", "office", "maze", "narrow-gap"])
def test_what_stands_seldom_seems_to_move_wherever_the_car_drives(scenario: str, lidar: Literal["hokuyo", "scan360"]) -> None:
    """Oracle: nothing moves. Random poses and twists, the laser's noise; walls at all angles that the maps have.

    A beam that skims a corner may still show a cell too few or too many. Before, a car in a lane of the spiral saw something move
    in 98 % of its scans all round.
    """
    world = Scene.load(load_scenario(scenario), RobotModel.load().footprint).true_grid
    robot, rng = RobotModel.load().describe(FitOut(sonars="none", lidar=lidar)), np.random.default_rng(11)
    room = ndimage.distance_transform_edt(~world.occupied)  # [cells]
    free, phantoms = np.argwhere(room > 4), []
    while len(phantoms) < 40:
        start = SE2(*world.world_from_cell(free[rng.integers(len(free))]), rng.uniform(-math.pi, math.pi))
        twist = Twist(rng.uniform(0.1, 0.4), rng.uniform(-0.5, 0.5))
        poses = [start @ twist.step(0.1 * k) for k in range(10)]
        if min(room[tuple(world.cell_from_world(pose.position))] for pose in poses) > 4:
            seen = [readings(robot, world, pose, (), 0.1 * k, rng) for k, pose in enumerate(poses)]
            phantoms += [len(leading_edges(*pair)) > 0 for pair in zip(seen, seen[6:], strict=False)]
    assert np.mean(phantoms) <= 0.2


class Forgetful:
    """A memory that counts how often it is told to forget."""

    forgotten = 0

    def forget(self) -> None:
        self.forgotten += 1


@pytest.mark.parametrize("moves", [True, False])
def test_what_moves_and_bars_the_way_is_no_reason_to_forget_or_to_give_up(moves: bool) -> None:
    """Walled in for a minute: nothing is forgotten and nothing given up as long as it is something that moves."""
    memory, seen = Forgetful(), window(SE2(), 3.0, 0.05)
    nothing = np.zeros(seen.shape, dtype=np.bool_)
    around = Readings(seen, nothing, nothing, *seen.grid_from_world(np.zeros(2)).tolist())
    closed = Decision(around, np.zeros(seen.shape), np.full(seen.shape, math.inf), Fan(*(np.zeros(3),) * 3, True), None)
    progress = SafeDirectionProgress(SafeDirectionParameters(), memory)  # type: ignore[arg-type]
    said = [progress.trouble(SE2(), around, closed, 0.1 * k, Goal(np.array([2.0, 0.0])), moves) for k in range(600)]
    assert (memory.forgotten == 0) == moves
    assert all(isinstance(one, Drive) for one in said) == moves


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.5, 1.8), st.floats(-2.0, 2.0), st.floats(0.1, 0.3), st.floats(-0.4, 0.4), st.sampled_from(["hokuyo", "scan360"])
)
def test_what_comes_has_leading_edges(
    apart: float, bearing: float, radius: float, aside: float, lidar: Literal["hokuyo", "scan360"]
) -> None:
    """A disc that comes at 0.3 m/s, seen twice 0.6 s apart from a car that stands in the open."""
    world, robot = OccupancyGrid(np.zeros((200, 200), dtype=np.int8), 0.05), RobotModel.load().describe(FitOut("none", lidar))
    assume(abs(bearing) < 1.4 or lidar == "scan360")
    rng, pose, heading = np.random.default_rng(0), SE2(5.0, 5.0), bearing + math.pi + aside
    there = np.array([math.cos(bearing), math.sin(bearing)]) * (apart + radius + 0.3)
    disc = Disc(tuple(pose.position + there), (0.3 * math.cos(heading), 0.3 * math.sin(heading)), radius)
    before, now = (readings(robot, world, pose, (disc,), time, rng) for time in (0.0, 0.6))
    edges = now.grid.world_from_cell(leading_edges(before, now))
    assert len(edges) >= 2
    assert np.linalg.norm(edges - disc.at(0.6), axis=1).max() < radius + 0.1
