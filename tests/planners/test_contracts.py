"""What every navigator promises that drives to a goal, in a small world without physics.

They are all that `robocar.episode.registry` knows, those of other packages included, so that a new one joins by its line there.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from robocar.core import OCCUPIED, SE2, Belief, GiveUp, Goal, Navigator, OccupancyGrid, RangeSensor, Robot, State
from robocar.episode.registry import build, names
from tests.planners.kinematic import DT, car, context, drive, sense

EXPLORERS = {"explore"}
"""Those that draw a map instead; their contracts are in their own tests."""

BUGS = {"ocpb", "bug1", "bug2", "dist-bug", "tangent-bug", "point-bug", "critical-point-bug"}
"""Those that look for the ends of obstacles: eight sonars do not show them, so they get a laser."""

NAVIGATORS = sorted(set(names("navigator")) - EXPLORERS)
START, GOAL = SE2(0.6, 1.5, 0.0), Goal(np.array([3.9, 1.5]))


def ring() -> Robot:
    """The car with eight sonars all round."""
    angles = np.arange(8) * math.pi / 4
    return car(tuple(SE2(0.09 * math.cos(a), 0.09 * math.sin(a), a) for a in angles))


def fit_out(name: str) -> Robot:
    """The car with what the navigator needs."""
    if name not in BUGS:
        return ring()
    lidar = RangeSensor("scan360", SE2(), np.linspace(-math.pi, math.pi, 360, endpoint=False), 0.0, 0.06, 6.0, DT)
    return replace(car(()), lidar=lidar)


def room(*boxes: tuple[float, float, float, float]) -> OccupancyGrid:
    """4.5 x 3 m on 5 cm cells, with boxes given as (x0, y0, x1, y1) [m]."""
    data = np.zeros((60, 90), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
    for x0, y0, x1, y1 in boxes:
        data[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = OCCUPIED
    return OccupancyGrid(data, 0.05)


@pytest.fixture(scope="module", params=NAVIGATORS, name="name")
def _name(request: pytest.FixtureRequest) -> str:
    return request.param


def navigator(name: str, prior: OccupancyGrid | None) -> Navigator:
    return build("navigator", name, context(fit_out(name), prior, START))


@pytest.mark.parametrize("known", [True, False], ids=["map", "no map"])
def test_it_drives_round_a_box_without_contact(name: str, known: bool) -> None:
    """The world checks contact exactly at every tick; a box stands on the straight way."""
    world = room((2.0, 1.1, 2.4, 1.9))
    drives = drive(navigator(name, world if known else None), fit_out(name), world, START, GOAL, ticks=4000)
    assert drives.status == "success", drives.reason
    assert GOAL.reached(drives.poses[-1])


def test_it_keeps_the_speeds_of_the_car(name: str) -> None:
    """Property: every twist is finite and within the robot's limits."""
    world, robot = room((2.0, 1.1, 2.4, 1.9)), fit_out(name)
    twists = drive(navigator(name, world), robot, world, START, GOAL, ticks=4000).twists
    limits = robot.limits
    assert len(twists) > 50
    assert all(limits.min_vel_x - 1e-9 <= twist.v <= limits.max_vel_x + 1e-9 for twist in twists)
    assert all(abs(twist.omega) <= limits.max_vel_theta + 1e-9 for twist in twists)


def test_built_again_it_does_the_same_again(name: str) -> None:
    """Property: bit-identical commands for the same observations and random generator, whatever was driven before."""
    world, robot = room((2.0, 1.1, 2.4, 1.9)), fit_out(name)
    runs = [drive(navigator(name, world), robot, world, START, GOAL, ticks=400).twists for _ in range(2)]
    assert len(runs[0]) > 50
    assert runs[0] == runs[1]


def test_it_gives_up_where_there_is_no_goal(name: str) -> None:
    nav = navigator(name, room())
    command = nav.command(State.of(Belief(START)), sense(fit_out(name), room(), START, 0.0), None)
    assert isinstance(command, GiveUp)
    assert "goal" in command.reason


def test_it_never_drives_into_a_wall_to_reach_what_is_walled_off(name: str) -> None:
    """Oracle: the world; within two minutes the car gives up, or still looks for a way, but touches nothing."""
    world = room((2.0, 0.0, 2.2, 3.0))
    drives = drive(navigator(name, world), fit_out(name), world, START, GOAL, ticks=round(120 / DT))
    assert drives.status in ("no_path", "stuck", "timeout")
    assert all(pose.x < 2.0 for pose in drives.poses)
