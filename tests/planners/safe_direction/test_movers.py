"""Safe-direction navigation among movers. Oracles: trials by composed poses, geometry by hand, a world without physics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Belief, Costmap, Goal, Observation, State, Twist
from robocar.planners.safe_direction.movers import _HORIZON, Movers, _least_gap
from robocar.planners.safe_direction.planner import build, build_with_memory
from robocar.planners.safe_direction.view import window
from tests.planners.kinematic import DT, car
from tests.planners.safe_direction.test_planner import BEARINGS, context, robot, room, scan


@given(st.integers(0, 2**32 - 1), st.floats(-0.3, 0.4), st.floats(-1.5, 1.5), st.sampled_from([0.0, 0.1, 0.4, math.inf]))
@settings(max_examples=100, deadline=None)
def test_a_trial_keeps_the_distance_of_composed_poses(seed: int, v: float, omega: float, free: float) -> None:
    """Oracle: the pose composed of many short steps, beside discs that go straight on, looked at every 0.1 s from 0.2 s on."""
    rng = np.random.default_rng(seed)
    pose = SE2(rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), rng.uniform(-3.0, 3.0))
    discs = np.column_stack([rng.uniform(-2.0, 2.0, (3, 2)), rng.uniform(-0.3, 0.3, (3, 2)), rng.uniform(0.1, 0.4, 3)])
    least, at = math.inf, pose
    for step in range(round(1000 * _HORIZON) + 1):
        time = 1e-3 * step
        if step >= 200 and step % 100 == 0:
            away = discs[:, :2] + time * discs[:, 2:4] - at.position
            least = min(least, float((np.hypot(away[:, 0], away[:, 1]) - discs[:, 4]).min()))
        if abs(v) * (time + 1e-3) <= free:
            at = at @ Twist(v, omega).step(1e-3)
    assert _least_gap(discs, pose.x, pose.y, pose.theta, v, omega, free) == pytest.approx(least, abs=2e-3)
    assert _least_gap(np.empty((0, 5)), pose.x, pose.y, pose.theta, v, omega, free) == math.inf


def following(discs: np.ndarray) -> Movers:
    """As if these discs were followed."""
    movers = Movers(car(()), 0.3, 0.02, DT)
    movers._discs = discs
    return movers


def free_floor(*boxes: tuple[float, float, float, float]) -> Costmap:
    grid = window(SE2(), 2.0, 0.05)
    costs = np.zeros(grid.shape, dtype=np.uint8)
    for x0, y0, x1, y1 in boxes:
        (r0, c0), (r1, c1) = grid.cell_from_world([[x0, y0], [x1, y1]])
        costs[r0:r1, c0:c1] = 254
    return Costmap(costs, 0.05, grid.origin)


def test_turning_on_the_spot_in_the_way_of_something_it_moves_off() -> None:
    """Something comes from ahead at 0.3 m/s, 0.6 m off. Standing or turning it would be run into; back or aside it would not."""
    movers, turning = following(np.array([[0.6, 0.0, -0.3, 0.0, 0.3]])), Twist(0.0, 1.2)
    twist = movers.dodged(turning, turning, free_floor(), SE2())
    assert twist is not None
    assert abs(twist.v) > 0.1
    walled = free_floor((-1.0, 0.15, 2.0, 0.3), (-1.0, -0.3, 2.0, -0.15))  # aside there is no room: back
    straight = movers.dodged(turning, turning, walled, SE2())
    assert straight is not None
    assert straight.v < 0.0


@pytest.mark.parametrize("discs", [[], [[0.6, 0.0, 0.3, 0.0, 0.3]], [[0.6, 0.6, -0.3, 0.0, 0.3]], [[3.0, 0.0, -0.3, 0.0, 0.3]]])
def test_what_does_not_come_is_not_dodged(discs: list) -> None:
    """Nothing; what goes away, passes by, or is far."""
    movers = following(np.array(discs, dtype=float).reshape(-1, 5))
    assert movers.dodged(Twist(0.0, 1.2), Twist(0.0, 1.2), free_floor(), SE2()) is None


def test_where_every_way_is_closed_it_does_not_drive_on() -> None:
    """Walls at all sides: the wanted 0.3 m/s would end in one; the slowed 0.1 m/s may be driven up to it."""
    movers = following(np.array([[0.6, 0.0, -0.3, 0.0, 0.3]]))
    box = free_floor((-0.2, 0.12, 0.2, 0.2), (-0.2, -0.2, 0.2, -0.12), (0.15, -0.2, 0.2, 0.2), (-0.2, -0.2, -0.15, 0.2))
    twist = movers.dodged(Twist(0.3, 0.0), Twist(0.1, 0.0), box, SE2())
    assert twist is not None
    assert abs(twist.v) <= 0.1


@pytest.mark.parametrize("make", [build, build_with_memory])
def test_a_box_that_comes_along_a_wide_corridor_is_let_by(make) -> None:
    """A world without physics: a box of 0.3 m comes head-on at 0.3 m/s through 1.6 m of corridor; it never gets into the car's
    inscribed circle, by the distance from a rectangle, and the goal behind is reached."""
    navigator, goal = make(context(robot(), None)), Goal(np.array([5.2, 2.0]))
    pose, least = SE2(0.6, 2.0), math.inf
    for tick in range(800):
        time = tick * DT
        x = 5.6 - 0.3 * time
        box = ((x - 0.15, 1.85, x + 0.15, 2.15),) if x > 0.2 else ()
        world = room((0.0, 0.0, 6.0, 1.2), (0.0, 2.8, 6.0, 4.0), *box)
        command = navigator.command(State.of(Belief(pose)), Observation(time, lidar=scan(world, pose, time)), goal)
        pose = pose @ command.twist.step(DT)
        least = min(least, math.hypot(max(abs(pose.x - x) - 0.15, 0.0), max(abs(pose.y - 2.0) - 0.15, 0.0)))
        if goal.reached(pose):
            break
    assert goal.reached(pose)
    assert least > car(()).footprint.inscribed_radius


def test_a_sector_that_looks_ahead_does_not_dodge_backwards_into_what_it_has_not_seen() -> None:
    """Something comes from ahead at 0.3 m/s. All round the car backs off; a sector of 120 degrees has not looked there."""
    pose, goal, backs = SE2(1.5, 2.0), Goal(np.array([5.0, 2.0])), []
    for bearings in (BEARINGS, np.radians(np.arange(-60.0, 61.0))):
        planner = build(context(robot(bearings), None)).controller
        planner.movers.update = lambda *_: None  # what is followed is given
        planner.movers._discs = np.array([[2.1, 2.0, -0.3, 0.0, 0.3]])
        world = room((0.0, 0.0, 6.0, 1.8), (0.0, 2.2, 6.0, 4.0))
        observation = Observation(0.0, lidar=scan(world, pose, 0.0, bearings))
        backs.append(planner.command(State.of(Belief(pose)), None, None, observation, goal).twist.v)
    assert backs[0] < 0.0
    assert backs[1] >= 0.0
