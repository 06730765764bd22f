"""The local costmap lives in `odom`: what a jump of the pose must not move, and what a navigator sees of it. Oracles: geometry,
and the same drive with the two frames on top of each other."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import (
    OCCUPIED,
    SE2,
    Arrows,
    Belief,
    Costmap,
    Drive,
    Field,
    Goal,
    Lines,
    Observation,
    OccupancyGrid,
    Path,
    Points,
    Scalar,
    Scan,
    Segments,
    State,
)
from robocar.core.trace import transformed
from robocar.planners.controllers import dwa, mppi
from robocar.planners.costmap.rolling import RollingCostmap
from robocar.planners.navigators.local_frame import LocalFrame
from robocar.planners.navigators.plan_and_follow import plan_and_avoid
from robocar.planners.search import a_star
from tests.planners.kinematic import DT, car, context, sense, touches

AWAY = SE2(3.0, -2.0, 0.7)
"""Where the odometry's frame lies in the map."""


def state(pose: SE2, map_from_odom: SE2) -> State:
    return State.of(Belief(pose, odom_from_robot=map_from_odom.inverse() @ pose))


def field(*boxes: tuple[float, float, float, float]) -> OccupancyGrid:
    """5 x 3 m on 5 cm cells, with boxes given as (x0, y0, x1, y1) [m]."""
    data = np.zeros((60, 100), dtype=np.int8)
    for x0, y0, x1, y1 in boxes:
        data[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = OCCUPIED
    return OccupancyGrid(data, 0.05)


def lethal(costmap: Costmap) -> np.ndarray:
    """Centres of the obstacles, (n, 2) [m]."""
    return costmap.world_from_cell(np.argwhere(costmap.data >= 254))


def test_a_jump_of_the_pose_leaves_what_was_seen_where_it_is_around_the_robot() -> None:
    """One hit 1 m ahead; then the estimate jumps by 0.5 m and 0.3 rad: in `odom` the obstacle has not moved, and there is one."""
    local = RollingCostmap(None, car())
    hit = Observation(0.0, lidar=Scan(0.0, np.array([1.0]), np.array([0.0]), 5.0))
    robot = SE2(1.01, 1.01, 0.0)
    for _ in range(2):
        local.update(robot, hit)
    before = lethal(local.costmap())
    assert len(before) == 1
    assert local.costmap().frame == "odom"
    local.update(robot, Observation(0.1), SE2(0.5, 0.0, 0.3))
    np.testing.assert_array_equal(lethal(local.costmap()), before)
    assert before[0] == pytest.approx((2.01, 1.01), abs=0.05)


@pytest.mark.parametrize("map_from_odom", [SE2(), SE2(0.31, -0.17, 0.0), AWAY], ids=["same", "shifted", "turned"])
def test_the_prior_map_lies_under_the_window_where_the_estimate_puts_it(map_from_odom: SE2) -> None:
    """A box of the prior, seen from `odom`: every blocked cell lies in it, and every point well inside of it is blocked."""
    prior = field((2.0, 1.0, 2.6, 1.6))
    local = RollingCostmap(prior, car())
    odom_from_map = map_from_odom.inverse()
    local.update(odom_from_map @ SE2(1.5, 1.5, 0.0), Observation(0.0), map_from_odom)
    costmap = local.costmap()
    found = map_from_odom.transform(lethal(costmap))
    walls = found[(found[:, 0] > 0.1) & (found[:, 0] < 4.9) & (found[:, 1] > 0.1) & (found[:, 1] < 2.9)]
    assert len(walls) > 100
    assert np.all((walls > np.array([2.0, 1.0]) - 0.04) & (walls < np.array([2.6, 1.6]) + 0.04))
    inside = np.stack(np.meshgrid(np.linspace(2.06, 2.54, 9), np.linspace(1.06, 1.54, 9)), axis=-1).reshape(-1, 2)
    cells = costmap.cell_from_world(odom_from_map.transform(inside))
    assert np.all(costmap.data[cells[:, 0], cells[:, 1]] >= 253)


@pytest.mark.parametrize("controller", [dwa, mppi], ids=["dwa", "mppi"])
@pytest.mark.parametrize("map_from_odom", [SE2(), AWAY], ids=["same", "turned"])
def test_it_drives_round_a_box_wherever_odom_lies(controller, map_from_odom: SE2) -> None:
    """A box that the map does not show; while it drives, the estimate jumps to and fro by 5 cm and 0.03 rad. No contact."""
    prior, world = field(), field((2.2, 1.1, 2.6, 1.9))
    pose, goal = SE2(0.6, 1.5, 0.0), Goal(np.array([4.3, 1.5]))
    navigator = plan_and_avoid(context(car(), prior, pose), a_star.build, controller.build)
    for tick in range(1500):
        jump = SE2(0.05, 0.0, 0.03) if tick % 40 < 20 and map_from_odom != SE2() else SE2()
        command = navigator.command(state(pose, map_from_odom @ jump), sense(car(), world, pose, tick * DT), goal)
        assert isinstance(command, Drive), command
        pose = pose @ command.twist.step(DT)
        assert not touches(car(), world, pose)
        if goal.reached(pose):
            return
    pytest.fail("it did not arrive")


def test_what_is_drawn_is_in_the_map_frame() -> None:
    """The local goal of a drive straight ahead lies on the path, wherever `odom` is; and so does the window of the costmap."""
    pose, goal = SE2(0.6, 1.5, 0.0), Goal(np.array([4.3, 1.5]))
    found = []
    for map_from_odom in (SE2(), AWAY):
        navigator = plan_and_avoid(context(car(), field(), pose), a_star.build, dwa.build)
        trace = navigator.command(state(pose, map_from_odom), Observation(0.0), goal).trace
        found.append((trace["local_goal"].positions, trace["local"].lines[0], trace["costmap/local"].grid))
    (goal_here, way_here, _), (goal_away, way_away, window) = found
    np.testing.assert_allclose(goal_away, goal_here, atol=0.06)
    np.testing.assert_allclose(way_away, way_here, atol=0.06)
    assert window.contains(window.cell_from_world(pose.position))


def test_a_path_is_the_same_object_until_a_correction_moves_it() -> None:
    """Controllers keep their place on a path: only what a correction moves is handed out anew, from where the robot is."""
    frame, path = LocalFrame(), Path(np.column_stack([np.linspace(0.0, 4.0, 81), np.zeros(81)]))
    robot = SE2(1.02, 0.0, 0.0)
    frame.follow(state(robot, SE2()))
    assert frame.path(path, 20) is path
    frame.follow(state(robot, AWAY))
    first = frame.path(path, 20)
    np.testing.assert_allclose(AWAY.transform(first.points), path.points[20:], atol=1e-12)
    frame.follow(state(robot, AWAY @ SE2(0.005, 0.0, 0.001)))
    assert frame.path(path, 21) is first
    frame.follow(state(robot, AWAY @ SE2(0.05, 0.0, 0.0)))
    again = frame.path(path, 22)
    assert again is not first
    assert len(again.points) == 59


@given(st.lists(st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)), max_size=20))
def test_costmaps_and_path_follow_one_correction(jumps: list[tuple[float, float, float]]) -> None:
    """Whatever the estimate does, what the robot sees, and its path, lie in the map where it puts them, to 2.5 cm; and a path is
    moved by the correction that also places what is seen."""
    frame, path = LocalFrame(), Path(np.array([[1.0, 0.0], [2.0, 0.0]]))
    robot = SE2(1.0, -2.0, 0.4)
    for jump in jumps:
        now = AWAY @ SE2(*jump)
        here = frame.follow(state(now @ robot, now))
        assert here == frame.map_from_odom @ state(now @ robot, now).odom_from_robot
        seen = (here @ SE2(1.0)).position, (now @ robot @ SE2(1.0)).position
        assert math.dist(*seen) <= 0.025 + 1e-9
        np.testing.assert_allclose(frame.map_from_odom.transform(frame.path(path, 0).points), path.points, atol=1e-9)
    pose = SE2(0.3, 0.2, 0.1)
    assert frame.follow(State.of(Belief(pose))) is pose  # nothing is computed where there is no correction
    assert frame.path(path, 0) is path


def test_every_drawable_with_a_place_is_moved() -> None:
    """By hand: a quarter turn about the origin, and 1 m along x."""
    pose, point = SE2(1.0, 0.0, math.pi / 2), np.array([[2.0, 0.0]])
    grid = Costmap(np.zeros((2, 2), dtype=np.uint8), 1.0, SE2(2.0, 0.0, 0.0), "odom")
    trace = {
        "points": Points(point),
        "high": Points(np.array([[2.0, 0.0, 0.5]])),
        "lines": Lines((point,)),
        "segments": Segments(point[None].repeat(2, axis=1)),
        "arrows": Arrows(point, point),
        "field": Field(grid),
        "number": Scalar(1.0),
    }
    moved = transformed(trace, pose)
    assert list(moved) == list(trace)
    np.testing.assert_allclose(moved["points"].positions, [[1.0, 2.0]], atol=1e-12)
    np.testing.assert_allclose(moved["high"].positions, [[1.0, 2.0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(moved["lines"].lines[0], [[1.0, 2.0]], atol=1e-12)
    np.testing.assert_allclose(moved["segments"].segments[0, 1], [1.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(moved["arrows"].origins, [[1.0, 2.0]], atol=1e-12)
    np.testing.assert_allclose(moved["arrows"].vectors, [[0.0, 2.0]], atol=1e-12)
    assert isinstance(moved["field"].grid, Costmap)
    assert (grid.frame, moved["field"].grid.frame) == ("odom", "map")
    assert moved["field"].grid.origin.position == pytest.approx((1.0, 2.0))
    assert moved["number"] is trace["number"]
