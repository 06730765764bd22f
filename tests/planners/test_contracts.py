"""What every navigator promises that drives to a goal, in a small world without physics.

They are all that `robocar.episode.registry` knows, those of other packages included, so that a new one joins by its line there.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from robocar.core import OCCUPIED, SE2, UNKNOWN, Belief, GiveUp, Goal, Navigator, OccupancyGrid, RangeSensor, Robot, State
from robocar.episode.registry import build, names
from tests.planners.kinematic import DT, car, context, drive, sense

EXPLORERS = {"explore"}
"""Those that draw a map instead; their contracts are in their own tests."""

BUGS = {"ocpb", "bug1", "bug2", "dist-bug", "tangent-bug", "point-bug", "critical-point-bug"}
"""Those that look for the ends of obstacles: eight sonars do not show them, so they get a laser."""

PLANNERS = sorted(set(names("navigator")) - EXPLORERS - BUGS - {"safe-direction", "safe-direction-memory"})
"""Those that plan on the map that they are given."""

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


def navigator(name: str, prior: OccupancyGrid | None, **settings: object) -> Navigator:
    """With a small budget for random trees: it is used up where there is no way."""
    if name.startswith("rrt"):
        settings = {"planner": {"max_samples": 3000}} | settings
    return build("navigator", name, context(fit_out(name), prior, START, **settings))


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


@pytest.mark.parametrize("heading", [2.0, -2.8])
def test_it_turns_to_the_goal_s_heading_or_refuses_it(name: str, heading: float) -> None:
    """Oracle: the goal's definition. Nobody arrives and then stands there until it is stuck."""
    goal = Goal(np.array([2.6, 1.5]), heading)
    drives = drive(navigator(name, room()), fit_out(name), room(), START, goal, ticks=1600)
    assert drives.status == "success", drives.reason
    assert goal.reached(drives.poses[-1])


DOOR = ((2.0, 0.0, 2.2, 1.4), (2.0, 1.6, 2.2, 3.0))
"""A wall with a door 20 cm wide: too tight for most, and wide enough for the car, which is 18 cm wide."""


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_door_that_is_too_tight_for_it_is_no_proof(planner: str) -> None:
    drives = drive(navigator(planner, room(*DOOR)), fit_out(planner), room(*DOOR), START, GOAL, ticks=300)
    assert drives.status != "no_path", drives.reason


@pytest.mark.parametrize("planner", PLANNERS)
def test_where_the_map_shows_no_way_it_says_so_and_does_not_move(planner: str) -> None:
    """A wall through the whole map."""
    world = room((2.0, 0.0, 2.2, 3.0))
    drives = drive(navigator(planner, world), fit_out(planner), world, START, GOAL, ticks=600)
    assert drives.status == "no_path", drives.reason
    assert drives.reason.endswith("; the map proves that there is none")
    assert max(abs(pose.x - START.x) for pose in drives.poses) < 0.05


@pytest.mark.parametrize("planner", sorted(name for name in PLANNERS if name.startswith("rrt")))
def test_a_budget_that_ran_out_is_no_proof(planner: str) -> None:
    world = room((2.0, 0.0, 2.2, 2.4))
    nav = navigator(planner, world, planner={"max_samples": 1})
    drives = drive(nav, fit_out(planner), world, START, GOAL, ticks=600)
    assert (drives.status, drives.reason[:16]) == ("stuck", "budget exhausted")


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("allowed", [True, False])
def test_unknown_cells_are_free_unless_they_are_forbidden(planner: str, allowed: bool) -> None:
    """The wall of the map has a door that nobody has looked into; in the world it is open."""
    world, data = room((2.0, 0.0, 2.2, 1.0), (2.0, 2.0, 2.2, 3.0)), room((2.0, 0.0, 2.2, 1.0), (2.0, 2.0, 2.2, 3.0)).data.copy()
    data[20:40, 40:44] = UNKNOWN
    own = planner == "dynamic-a-star"
    settings = {"allow_unknown": allowed} if own else {"costmap": {"allow_unknown": allowed}}
    nav = navigator(planner, OccupancyGrid(data, 0.05), **settings)
    drives = drive(nav, fit_out(planner), world, START, GOAL, ticks=1600 if allowed else 300)
    assert drives.status == ("success" if allowed else "stuck"), drives.reason
