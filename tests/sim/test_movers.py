"""Moving obstacles: kinematics by hand, pushes by Newton."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, OccupancyGrid, ScenarioError
from robocar.core.distance import polygon_distance
from robocar.sim.movers import Mover, MovingObstacle
from robocar.sim.world_spec import SOLID_BIT, build_world

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


# -- stop, turn, go -------------------------------------------------------------------------------------------------------


def test_it_stops_turns_and_goes() -> None:
    """Timetable by hand: 1 m at 0.5 m/s, 1 s of rest, a quarter turn at 1 rad/s, 1 m, rest, a half turn, ..."""
    corners = np.array([[6.0, 5.0], [6.0, 6.0], [5.0, 5.0]])
    mover = Mover("m", "box", (0.4, 0.2, 0.3), SE2(5, 5), corners, speed=0.5, motion="stop-turn-go", pause=1.0, turn_speed=1.0)
    poses, _, _ = drive(mover, 14.0)
    speed = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) / 0.01
    standing = speed < 0.01
    heading = np.unwrap(poses[:, 2])
    # It moves only where it looks: while it turns it stands, and while it goes it faces its way.
    turning = np.abs(np.diff(heading)) / 0.01 > 0.5  # the last 0.02 rad it turns on the way
    assert speed[turning].max() < 0.02
    for leg, angle in (
        ((5.1, 5.9, 4.95, 5.05), 0.0),
        ((5.95, 6.05, 5.1, 5.9), math.pi / 2),
        ((5.1, 5.9, 5.1, 5.9), -3 * math.pi / 4),
    ):
        x0, x1, y0, y1 = leg
        inside = (poses[1:, 0] > x0) & (poses[1:, 0] < x1) & (poses[1:, 1] > y0) & (poses[1:, 1] < y1)
        assert speed[inside] == pytest.approx(np.full(inside.sum(), 0.5), rel=0.02)
        away = np.angle(np.exp(1j * (poses[1:, 2][inside] - angle)))
        assert np.abs(away).max() < 0.03
        assert inside.sum() * 0.01 == pytest.approx(math.dist((x0, y0), (x1, y1)) / 0.5 if angle < 0 else 0.8 / 0.5, abs=0.03)
    stops = [k for k in range(1, len(standing)) if standing[k] and not standing[k - 1]]
    goes = [k for k in range(1, len(standing)) if not standing[k] and standing[k - 1]]
    rests = [(g - s) * 0.01 for s, g in zip(stops, [g for g in goes if g > stops[0]], strict=False)]
    turns = [math.pi / 2, 3 * math.pi / 4]
    assert rests[:2] == pytest.approx([1.0 + turn for turn in turns], abs=0.35)  # and the lags of both controls
    np.testing.assert_allclose(poses[stops[:3], :2], corners, atol=2 * 0.01)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_what_it_sweeps_is_where_it_goes(seed: int) -> None:
    """The outline stays within the swept polygons at all times, whatever the way points and the kind of motion."""
    rng = np.random.default_rng(seed)
    start = SE2(rng.uniform(9, 11), rng.uniform(9, 11), rng.uniform(-3, 3))
    motion = ("constant", "stop-turn-go")[seed % 2]
    mover = Mover("m", "box", (0.6, 0.2, 0.3), start, rng.uniform(9, 11, (3, 2)), 0.9, motion=motion, pause=0.1, turn_speed=4.0)
    poses, _, _ = drive(mover, 12.0)
    swept = list(mover.sweeps())
    for pose in poses[::7]:
        corners = mover.outline(SE2(*pose))
        # At a corner the outline may lie half in one, half in the other: each of its corners has to lie in one of them.
        gaps = [min(polygon_distance(corner[None], sweep.polygon) for sweep in swept) for corner in corners]
        assert max(gaps) < 0.05


# -- random walks ---------------------------------------------------------------------------------------------------------


def room(polygon: np.ndarray) -> float:
    """A wall x >= 10.5 and a post of 0.3 m at (9, 10)."""
    wall = 10.5 - polygon[:, 0].max()
    return max(min(wall, polygon_distance(polygon, np.array([[9.0, 10.0]])) - 0.3), 0.0)


WALKER = Mover("m", "box", (0.4, 0.2, 0.3), SE2(10, 10), speed=0.8, motion="random-walk", pause=0.1, turn_speed=4.0, roam=1.5)


def walk(seed: int, time: float = 30.0, mover: Mover = WALKER) -> np.ndarray:
    model = build_world(FLOOR, movers=[mover]).compile()
    data = mujoco.MjData(model)
    obstacle = MovingObstacle(mover, np.random.default_rng(seed), room)
    poses = []
    for _ in range(round(time / 0.02)):
        obstacle.drive(data)
        mujoco.mj_step(model, data, 4)
        poses.append(obstacle.pose(data).as_array())
    return np.array(poses)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_a_random_walk_keeps_off_walls_and_near_its_start(seed: int) -> None:
    poses = walk(seed)
    outlines = [WALKER.outline(SE2(*pose)) for pose in poses[::5]]
    assert min(room(outline) for outline in outlines) > 0.0
    assert np.linalg.norm(poses[:, :2] - 10.0, axis=1).max() < 1.5 + 0.02
    assert np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum() > 8.0  # of at most 24 m: it does not stand about


def test_equal_seeds_walk_alike_and_others_do_not() -> None:
    np.testing.assert_array_equal(walk(1, 10.0), walk(1, 10.0))
    assert np.abs(walk(1, 10.0) - walk(2, 10.0)).max() > 0.5


def test_a_random_walk_is_the_same_again_in_new_data() -> None:
    model = build_world(FLOOR, movers=[WALKER]).compile()
    obstacle = MovingObstacle(WALKER, np.random.default_rng(4), room)
    runs = []
    for _ in range(2):
        data = mujoco.MjData(model)
        for _ in range(500):
            obstacle.drive(data)
            mujoco.mj_step(model, data, 4)
        runs.append(data.qpos.copy())
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.linalg.norm(runs[0][:2]) > 0.1


def test_where_something_stands_in_its_way_it_walks_elsewhere() -> None:
    """A ring of crates that it cannot push: within a minute it has tried ways to all sides, never getting through."""
    world = build_world(FLOOR, movers=[WALKER])
    for angle in np.arange(8) * math.pi / 4:
        world.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 0.32, 0.2], contype=SOLID_BIT, conaffinity=SOLID_BIT,
            pos=[10 + 0.75 * math.cos(angle), 10 + 0.75 * math.sin(angle), 0.2],
            quat=[math.cos(angle / 2), 0, 0, math.sin(angle / 2)],
        )  # fmt: skip
    model = world.compile()
    data = mujoco.MjData(model)
    obstacle = MovingObstacle(WALKER, np.random.default_rng(0), lambda polygon: math.inf)
    places = []
    for _ in range(3000):
        obstacle.drive(data)
        mujoco.mj_step(model, data, 4)
        places.append(obstacle.pose(data).position - 10)
    places = np.array(places)
    assert np.linalg.norm(places, axis=1).max() < 0.75
    angles = np.arctan2(places[:, 1], places[:, 0])[np.linalg.norm(places, axis=1) > 0.3]
    assert len({int(a // (math.pi / 2)) for a in angles}) == 4


def test_a_random_walk_without_generator_is_refused() -> None:
    with pytest.raises(ScenarioError, match="random generator"):
        MovingObstacle(WALKER)


def test_velocity_is_what_the_poses_change_by() -> None:
    """Finite differences of the poses."""
    mover = Mover("m", "box", (0.4, 0.2, 0.3), SE2(5, 5), np.array([[6.0, 5.0], [6.0, 6.0]]), 0.5, motion="stop-turn-go")
    model = build_world(FLOOR, movers=[mover]).compile()
    data = mujoco.MjData(model)
    obstacle = MovingObstacle(mover)
    poses, velocities = [], []
    for _ in range(1300):
        obstacle.drive(data)
        mujoco.mj_step(model, data)
        poses.append(obstacle.pose(data).as_array())
        velocities.append(obstacle.velocity(data))
    slopes = np.diff(np.unwrap(poses, axis=0), axis=0) / model.opt.timestep
    np.testing.assert_allclose(velocities[1:], slopes, atol=1e-6)
    assert np.abs(velocities).max(axis=0) == pytest.approx([0.5, 0.5, 1.0], rel=0.05)


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
        ({"motion": "jump"}, "motion 'jump' is none of constant, stop-turn-go, random-walk"),
        ({"motion": "stop-turn-go", "speed": 0.0}, "speed 0 leads nowhere"),
        ({"motion": "random-walk", "waypoints": np.ones((2, 2))}, "no way point but its start"),
        ({"pause": -1.0}, "pause -1.0"),
        ({"turn_speed": 0.0}, "turn_speed 0.0"),
        ({"roam": math.nan}, "roam nan"),
    ],
)
def test_bad_movers_are_refused(arguments: dict, message: str) -> None:
    good = {"name": "m", "shape": "box", "size": (0.1, 0.2, 0.3), "start": SE2()}
    with pytest.raises(ScenarioError, match=message):
        Mover(**(good | arguments))
