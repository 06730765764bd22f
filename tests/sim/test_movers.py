"""Moving obstacles: kinematics by hand, pushes by Newton."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, OccupancyGrid, ScenarioError
from robocar.sim.movers import Mover, MovingObstacle
from robocar.sim.world import SOLID_BIT, build_world

FLOOR = OccupancyGrid(np.zeros((20, 20)), 1.0)


def drive(mover: Mover, time: float, prepare=lambda world: None) -> tuple[np.ndarray, mujoco.MjData, MovingObstacle]:
    """Poses (n, 3) every 10 ms."""
    world = build_world(FLOOR, movers=[mover])
    prepare(world)
    model = world.compile()
    data = mujoco.MjData(model)
    obstacle = MovingObstacle(mover)
    poses = []
    for _ in range(round(time / 0.01)):
        obstacle.drive(data)
        mujoco.mj_step(model, data, 2)
        poses.append(obstacle.pose(data).as_array())
    return np.array(poses), data, obstacle


def test_it_starts_where_it_is_put() -> None:
    mover = Mover("m", "box", (0.4, 0.2, 0.3), SE2(3, 4, 0.7))
    poses, data, _ = drive(mover, 0.5)
    np.testing.assert_allclose(poses, np.tile([3, 4, 0.7], (50, 1)), atol=1e-9)
    world_from_box = data.geom("mover/m").xmat.reshape(3, 3)
    assert math.atan2(world_from_box[1, 0], world_from_box[0, 0]) == pytest.approx(0.7)


@settings(max_examples=10, deadline=None)
@given(angle=st.floats(-math.pi, math.pi), speed=st.floats(0.05, 1.0))
def test_constant_speed_along_a_straight_line(angle: float, speed: float) -> None:
    goal = [10 + 8 * math.cos(angle), 10 + 8 * math.sin(angle)]
    poses, _, _ = drive(Mover("m", "cylinder", (0.2, 0.5), SE2(10, 10), np.array([goal]), speed=speed, max_force=1e3), 3.0)
    along = (poses[:, :2] - 10) @ [math.cos(angle), math.sin(angle)]
    across = (poses[:, :2] - 10) @ [-math.sin(angle), math.cos(angle)]
    assert np.diff(along)[100:] == pytest.approx(np.full(199, 0.01 * speed), rel=1e-3)
    assert np.abs(across).max() < 1e-6
    assert along[-1] == pytest.approx(3.0 * speed, abs=0.1 * speed)  # less the start-up lag


def test_it_goes_round_its_waypoints_again_and_again() -> None:
    square = np.array([[6.0, 5.0], [6.0, 6.0], [5.0, 6.0], [5.0, 5.0]])
    poses, _, _ = drive(Mover("m", "box", (0.3, 0.3, 0.3), SE2(5, 5, 0.2), square, speed=0.5), 19.0)  # 2.4 rounds
    near = np.linalg.norm(poses[:, None, :2] - square, axis=2) < 0.05
    visits = np.sum(np.diff(near.astype(int), axis=0) == 1, axis=0)
    assert visits.tolist() == [3, 2, 2, 2]
    outside = np.maximum(poses[:, :2] - 6, 5 - poses[:, :2]).max()
    assert outside < 0.03
    np.testing.assert_allclose(poses[:, 2], 0.2, atol=1e-6)


def test_it_stops_at_a_single_waypoint() -> None:
    poses, data, _ = drive(Mover("m", "cylinder", (0.2, 0.5), SE2(5, 5), np.array([[5.5, 5.0]]), speed=0.5), 4.0)
    assert poses[-1] == pytest.approx([5.5, 5.0, 0.0], abs=1e-3)
    assert poses[:, 0].max() < 5.5 + 1e-3
    assert np.abs(data.qvel).max() < 1e-3


def crate(world: mujoco.MjSpec, friction: float, mass: float) -> None:
    """A crate on the floor, its near face 1 m ahead of x = 5."""
    body = world.worldbody.add_body(name="crate", pos=[6.2, 5, 0.2])
    body.add_freejoint()
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.2, 0.2, 0.2],
        mass=mass,
        contype=SOLID_BIT | 1,
        conaffinity=SOLID_BIT | 1,
        priority=1,
        friction=[friction, 0.005, 0.0001],
    )


@pytest.mark.parametrize(("mass", "moves"), [(1.0, True), (20.0, False)])
def test_it_pushes_what_its_force_can_push(mass: float, moves: bool) -> None:
    """Coulomb friction: 20 N move a crate with friction 0.5 if its mass is below 20 / (0.5 * 9.81) = 4.1 kg."""
    mover = Mover("m", "box", (0.4, 0.4, 0.4), SE2(5, 5), np.array([[8.0, 5.0]]), speed=0.4, max_force=20.0)
    poses, data, _ = drive(mover, 6.0, lambda world: crate(world, 0.5, mass))
    pushed = data.body("crate").xpos[0] - 6.2
    assert (pushed > 0.5) == moves
    assert poses[-1, 0] < data.body("crate").xpos[0] - 0.39  # nothing passes through anything


def test_a_push_moves_it_and_it_comes_back() -> None:
    mover = Mover("m", "box", (0.4, 0.2, 0.3), SE2(5, 5), np.array([[5.0, 5.0]]), mass=5.0, max_force=10.0)
    world = build_world(FLOOR, movers=[mover])
    model = world.compile()
    data = mujoco.MjData(model)
    obstacle = MovingObstacle(mover)
    body = model.body("mover/m").id
    data.xfrc_applied[body, :2] = 25.0, 0.0  # 15 N more than it can hold: 3 m/s^2
    for _ in range(50):
        obstacle.drive(data)
        mujoco.mj_step(model, data, 2)
    assert obstacle.pose(data).x - 5 == pytest.approx(0.5 * 3.0 * 0.5**2, rel=0.05)
    data.xfrc_applied[body] = 0.0
    data.xfrc_applied[body, 5] = 2.0
    mujoco.mj_step(model, data, 40)
    assert abs(obstacle.pose(data).theta) > 0.05
    data.xfrc_applied[body] = 0.0
    for _ in range(1000):
        obstacle.drive(data)
        mujoco.mj_step(model, data, 2)
    np.testing.assert_allclose(obstacle.pose(data).as_array(), [5, 5, 0], atol=2e-3)


@pytest.mark.parametrize(
    ("shape", "size", "expected"),
    [("box", (2.0, 1.0, 0.3), 1.5), ("cylinder", (0.75, 0.3), 1.25)],
)
def test_distance_to_a_footprint(shape: str, size: tuple[float, ...], expected: float) -> None:
    """A square that ends at x = 2 beside a mover at (4, 5): turned by 90 degrees, the box begins at x = 3.5."""
    mover = Mover("m", shape, size, SE2(4, 5, math.pi / 2))  # type: ignore[arg-type]
    data = mujoco.MjData(build_world(FLOOR, movers=[mover]).compile())
    square = np.array([[1.0, 4.5], [2.0, 4.5], [2.0, 5.5], [1.0, 5.5]])
    obstacle = MovingObstacle(mover)
    assert obstacle.distance(data, square) == pytest.approx(expected)
    assert obstacle.distance(data, square + np.array([expected + 0.01, 0.0])) == 0.0


def test_new_data_is_a_new_run() -> None:
    mover = Mover("m", "cylinder", (0.2, 0.5), SE2(5, 5), np.array([[6.0, 5.0], [6.0, 7.0]]), speed=0.5)
    model = build_world(FLOOR, movers=[mover]).compile()
    obstacle = MovingObstacle(mover)
    runs = []
    for _ in range(2):
        data = mujoco.MjData(model)
        for _ in range(400):
            obstacle.drive(data)
            mujoco.mj_step(model, data, 2)
        runs.append(data.qpos.copy())
    np.testing.assert_array_equal(runs[0], runs[1])
    assert runs[0][1] > 0.5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"shape": "sphere"}, "neither box nor cylinder"),
        ({"size": (0.1, 0.2)}, "3 positive sizes"),
        ({"size": (0.1, 0.2, 0.0)}, "3 positive sizes"),
        ({"size": (0.1, 0.2, math.nan)}, "3 positive sizes"),
        ({"waypoints": np.array([1.0, 2.0])}, "waypoints"),
        ({"waypoints": np.array([[1.0, math.inf]])}, "waypoints"),
        ({"speed": -0.1}, "speed -0.1"),
        ({"mass": 0.0}, "mass 0.0"),
        ({"max_force": math.inf}, "max_force inf"),
    ],
)
def test_bad_movers_are_refused(arguments: dict, message: str) -> None:
    good = {"name": "m", "shape": "box", "size": (0.1, 0.2, 0.3), "start": SE2()}
    with pytest.raises(ScenarioError, match=message):
        Mover(**(good | arguments))
