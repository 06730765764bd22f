"""The camera above the field. Oracles: the simulator's poses and true grid, and pixel <-> floor round trips."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import robocar
from robocar.core import SE2, STOP, Belief, Image, Landmark, Observation, OccupancyGrid, Reading, ScenarioError
from robocar.core.solids import Box, Cylinder
from robocar.estimation.landmarks import top_camera
from robocar.estimation.landmarks.top_camera import find_car, floor_points, pixels_of
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.sensors.offscreen import OffscreenCamera
from robocar.sim.world import World
from robocar.sim.world_spec import LIGHTING, add_top_camera, build_world
from tests.estimation.landmarks.localization import context

FIELD = OccupancyGrid(np.zeros((50, 70), dtype=np.int8), 0.05)
SOLIDS = (Box((0.3, 0.3, 0.2), SE2(1.0, 0.7, 0.3)), Cylinder(0.15, 0.3, SE2(2.6, 1.8)), Box((0.1, 0.8, 0.25), SE2(2.4, 0.8)))
INTRINSICS = np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]])
DOWN = np.array([[1.0, 0, 0, 1.7], [0, -1, 0, 1.2], [0, 0, -1, 3.6], [0, 0, 0, 1]])


def stage(lighting: str = "default", camera: bool = True, solids=SOLIDS, landmarks: tuple[Landmark, ...] = ()) -> World:
    world = build_world(FIELD, lighting=lighting, solids=solids, landmarks=landmarks)
    add_top_camera(world, FIELD)
    return World(world, [RobotSetup(SE2(0.4, 0.4), fit_out=FitOut(camera=camera))], seed=0)


def pictures(simulation: World, poses: list[SE2]) -> list[Image]:
    camera = OffscreenCamera(simulation.model, simulation.data, "top", (640, 480))
    taken = []
    for pose in poses:
        simulation.robot.kidnap(pose)
        image = camera.read(0.0, None, None)
        taken.append(replace(image, pixels=image.pixels.copy()))
    camera.close()
    simulation.close()
    return taken


def somewhere(count: int) -> list[SE2]:
    rng = np.random.default_rng(4)
    return [SE2(*rng.uniform((0.2, 0.2, -math.pi), (3.3, 2.3, math.pi))) for _ in range(count)]


@pytest.mark.parametrize("lighting", sorted(LIGHTING))
@pytest.mark.parametrize("camera", [False, True])
def test_the_car_is_found_to_2_cm_and_2_degrees_wherever_it_stands(lighting: str, camera: bool) -> None:
    """With its camera fitted, the head hides a part of the front marker."""
    poses = somewhere(60)
    found = [find_car(image) for image in pictures(stage(lighting, camera, solids=()), poses)]
    assert all(pose is not None for pose in found)
    off = np.array(
        [(a.distance_to(b), math.remainder(a.theta - b.theta, math.tau)) for a, b in zip(found, poses, strict=True) if a]
    )
    assert len(off) == 60
    assert off[:, 0].max() < 0.01
    assert np.degrees(np.abs(off[:, 1]).max()) < 2.0


def test_balls_of_the_markers_colours_are_not_taken_for_them() -> None:
    marks = tuple(Landmark(c, c, np.array([x, 1.25, 0.4]), 0.1) for c, x in (("cyan", 0.5), ("magenta", 0.9)))
    poses = [SE2(1.8, 0.6, 1.0), SE2(2.5, 2.0, -2.0)]
    found = [find_car(image) for image in pictures(stage(solids=(), landmarks=marks), poses)]
    assert [pose is not None and pose.distance_to(true) < 0.01 for pose, true in zip(found, poses, strict=True)] == [True, True]


def test_no_car_in_a_picture_without_one() -> None:
    world = build_world(FIELD, solids=SOLIDS)
    add_top_camera(world, FIELD)
    model = world.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = OffscreenCamera(model, data, "top", (640, 480))
    image = camera.read(0.0, None, None)
    camera.close()
    assert find_car(image) is None


@given(st.floats(0, 639), st.floats(0, 479), st.floats(0, 0.5))
def test_pixels_and_floor_points_are_inverse(u: float, v: float, height: float) -> None:
    image = Image(0.0, np.zeros((480, 640, 3), dtype=np.uint8), INTRINSICS, DOWN)
    points = floor_points(image, np.array([[u, v]]), height)
    np.testing.assert_allclose(pixels_of(image, points, height), [[u, v]], atol=1e-6)


@pytest.mark.parametrize("lighting", sorted(LIGHTING))
def test_obstacles_are_mapped_where_they_stand(lighting: str) -> None:
    """Oracle: cells whose middle lies in a solid. What is found stands within 10 cm of one; none is missed."""
    pose = SE2(0.4, 0.4, 0.3)
    (image,) = pictures(stage(lighting), [pose])
    mapper = top_camera.build_mapper(top_context(FIELD))
    mapper.update(Belief(pose), Observation(0.0, top_image=image))
    grid = mapper.grid()
    assert grid is not None
    assert grid.same_place(FIELD)
    centres = grid.world_from_cell(np.argwhere(np.ones(grid.shape, dtype=bool))).reshape(*grid.shape, 2)
    distance = np.min([outside(solid, centres) for solid in SOLIDS], axis=0)
    assert grid.occupied[distance < -0.03].mean() > 0.97
    assert distance[grid.occupied].max() < 0.10
    assert not grid.occupied[np.hypot(*(centres - pose.position).transpose(2, 0, 1)) < 0.2].any()


def outside(solid: Box | Cylinder, points: np.ndarray) -> np.ndarray:
    """Signed distance of points (..., 2) to a solid's outline [m], negative inside."""
    local = solid.pose.inverse().transform(points)
    if isinstance(solid, Cylinder):
        return np.hypot(local[..., 0], local[..., 1]) - solid.radius
    over = np.abs(local) - np.array(solid.size[:2]) / 2
    return np.hypot(*np.maximum(over, 0).transpose(2, 0, 1)) + np.minimum(over.max(axis=-1), 0)


def top_context(prior: OccupancyGrid | None, start: SE2 | None = None):
    given = context(start)
    return replace(given, prior=prior, robot=replace(given.robot, top_camera=True))


def test_without_a_prior_the_map_covers_the_picture() -> None:
    (image,) = pictures(stage(), [SE2(0.4, 0.4, 0.0)])
    mapper = top_camera.build_mapper(top_context(None))
    assert mapper.grid() is None
    mapper.update(Belief(SE2(0.4, 0.4)), Observation(0.0))
    assert mapper.grid() is None
    mapper.update(Belief(SE2(0.4, 0.4)), Observation(0.0, top_image=image))
    grid = mapper.grid()
    assert grid is not None
    corners = grid.corners()
    assert np.all(corners.min(axis=0) <= 0.0)
    assert np.all(corners.max(axis=0) >= (3.5, 2.5))
    assert [bool(grid.occupied[grid.cell_inside(solid.pose.position)]) for solid in SOLIDS] == [True] * 3


def test_between_pictures_the_pose_follows_the_odometry_also_for_late_pictures() -> None:
    poses = [SE2(1.0, 0.5 + 0.1 * k, 1.2) for k in range(4)]
    images = pictures(stage(solids=()), poses)
    estimator = top_camera.build(top_context(None))
    last = None
    for k, pose in enumerate(poses):
        late = replace(images[k - 1], time=float(k - 1)) if k > 0 else None
        last = estimator.update(Observation(float(k), odom_pose=Reading(float(k), pose), top_image=late), STOP)
    assert last is not None
    assert last.pose.distance_to(poses[3]) < 0.01
    assert last.covariance[0, 0] < 0.01**2


def test_without_the_camera_it_is_refused() -> None:
    for build in (top_camera.build, top_camera.build_mapper):
        with pytest.raises(ScenarioError, match=r"robot\.top_camera=true"):
            build(context(None))


def test_the_markers_are_where_the_model_has_them() -> None:
    """Oracle: the compiled MJCF."""
    simulation = stage()
    model = simulation.model
    for name, x in (("front", top_camera.FRONT), ("rear", top_camera.REAR)):
        geom = model.geom(f"robocar/marker_{name}")
        assert geom.pos[0] == pytest.approx(x)
        assert geom.pos[2] + geom.size[1] == pytest.approx(top_camera.DECK)
        assert geom.size[0] == pytest.approx(top_camera.MARKER_RADIUS)
    simulation.close()


def test_dynamic_a_star_reaches_the_goal_on_this_pose_and_map_alone() -> None:
    """No sonar is fitted: the unknown obstacles are known from above only."""
    result = robocar.run(
        "thesis-field",
        navigator="dynamic-a-star",
        estimator="top-camera",
        mapper="top-camera",
        seed=3,
        settings={"robot.top_camera": True, "robot.sonars": "none"},
    )
    assert (result.status, result.reason) == ("success", result.reason)
    assert result.value("contacts") == 0
    error = result.value("position_rmse")
    assert error is not None
    assert error < 0.02
