"""Cameras: rendered pictures against the pinhole projection of what stands where."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np
import pytest

from robocar.core import SE2, Array, Drive, Hold, Image, Landmark, Twist
from robocar.paths import MODELS
from robocar.sim.fit_out import FitOut
from robocar.sim.world import World
from tests.sim.rooms import drive, room

RADIUS = 0.08
WITH_CAMERA = FitOut(camera=True)


def ball(x: float, y: float, z: float, color: str = "blue") -> Landmark:
    return Landmark(color, color, np.array([x, y, z]), RADIUS)


def blob(pixels: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Pixels (n, 2) as column, row that are saturated and of this hue, at their centres: the top left one's is (0.5, 0.5)."""
    values = pixels.astype(float)
    on = values[..., [c > 0 for c in color]].min(axis=-1)
    off = values[..., [c == 0 for c in color]].max(axis=-1)
    rows, cols = np.nonzero(on > 1.8 * off + 20)
    return np.stack([cols, rows], axis=1) + 0.5


def project(image: Image, world_from_robot: SE2 | None, point: Array) -> tuple[Array, float]:
    """Pinhole projection (2,) [px] of a point (3,) in the world, and its depth [m]."""
    if world_from_robot is not None:  # the car stands level on the floor
        x, y = world_from_robot.inverse().transform(point[:2])
        point = np.array([x, y, point[2]])
    seen = np.linalg.inv(image.robot_from_camera) @ [*point, 1.0]
    u, v, depth = image.intrinsics @ seen[:3]
    return np.array([u / depth, v / depth]), float(depth)


def disc(image: Image, world_from_robot: SE2, point: Array, radius: float) -> tuple[Array, float]:
    """Centre (2,) [px] and area [px^2] of a sphere's picture, an ellipse, in closed form.

    The sphere's outline is a cone of half angle a around the direction at angle t off the axis, cut by the picture's plane:
    from tan(t - a) to tan(t + a) along the radius, and of the semi-axes ratio that a plane section of that cone has.
    """
    centre, depth = project(image, world_from_robot, point)
    focal, principal = image.intrinsics[0, 0], image.intrinsics[:2, 2]
    off_axis = math.atan(math.dist(centre, principal) / focal)
    half = math.asin(radius / (depth / math.cos(off_axis)))
    near, far = math.tan(off_axis - half), math.tan(off_axis + half)
    outward = (centre - principal) / max(math.dist(centre, principal), 1e-12)
    long = 0.5 * (far - near)
    short = math.sin(half) / math.sqrt(math.cos(off_axis) ** 2 - math.sin(half) ** 2)
    return principal + focal * 0.5 * (near + far) * outward, math.pi * focal * focal * long * short


def picture(simulation: World) -> tuple[Image, SE2]:
    """The next picture and the true pose it was taken from."""
    for _ in range(10):
        observation, pose = simulation.robot.sense(), simulation.ground_truth().pose
        if observation.image is not None:
            return observation.image, pose
        simulation.robot.act(Hold())
        simulation.step()
    raise AssertionError("no picture within ten ticks")


@pytest.fixture
def running() -> Iterator[list[World]]:
    """Simulations whose buffers are given back."""
    simulations: list[World] = []
    yield simulations
    for simulation in simulations:
        simulation.close()


# -- the car's camera --------------------------------------------------------------------------------------------------


def test_pictures_have_the_size_and_the_rate_they_should(running: list[World]) -> None:
    """Issue 2 and design 7: 160 x 120, every 100 ms, RGB."""
    simulation = room(fit_out=WITH_CAMERA)
    running.append(simulation)
    observations = drive(simulation, Hold(), 0.5)
    images = [o.image for o in observations if o.image is not None]
    assert [image.time for image in images] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert {image.pixels.shape for image in images} == {(120, 160, 3)}
    assert {image.pixels.dtype for image in images} == {np.dtype(np.uint8)}
    # 45 degrees from top to bottom (robot.xml), square pixels, principal point in the middle.
    focal = 60.0 / math.tan(math.radians(22.5))
    np.testing.assert_allclose(images[0].intrinsics, [[focal, 0, 80], [0, focal, 60], [0, 0, 1]])


def test_the_camera_looks_ahead_from_where_it_is_mounted(running: list[World]) -> None:
    """robot.xml: pan at (0.06, 0, 0.118), tilt 26 mm above, the lens 12 mm ahead. OpenCV: z ahead, x right, y down."""
    camera = ElementTree.parse(MODELS / "robots" / "robocar" / "robot.xml").find(".//camera[@name='camera']")
    assert camera is not None
    right, up = np.reshape([float(number) for number in camera.attrib["xyaxes"].split()], (2, 3))
    assert right.tolist() == [0, -1, 0]
    simulation = room(start=SE2(3, 3, 2.1), fit_out=WITH_CAMERA)
    running.append(simulation)
    image, _ = picture(simulation)
    np.testing.assert_allclose(image.robot_from_camera[:3, 3], [0.072, 0.0, 0.144], atol=0.002)
    expected = np.stack([right, -up, np.cross(right, -up)], axis=1)
    np.testing.assert_allclose(image.robot_from_camera[:3, :3], expected, atol=0.01)
    assert image.robot_from_camera[0, 2] > 0.9  # ahead
    np.testing.assert_array_equal(image.robot_from_camera[3], [0, 0, 0, 1])


@pytest.mark.parametrize("size", [(160, 120), (320, 200)])
@pytest.mark.parametrize("heading", [0.0, 2.5])
@pytest.mark.parametrize(("ahead", "left", "up"), [(1.0, 0.0, 0.15), (1.5, 0.45, 0.35), (0.8, -0.25, 0.30), (2.5, 0.8, 0.5)])
def test_a_ball_is_where_the_pinhole_says(
    running: list[World], size: tuple[int, int], heading: float, ahead: float, left: float, up: float
) -> None:
    """Centroid within half a pixel, area within 6 % or the pixels of half its outline."""
    start = SE2(4, 4, heading)
    x, y = start.transform([ahead, left])
    sensors = {"camera": {"width": size[0], "height": size[1]}}
    simulation = room(start=start, fit_out=WITH_CAMERA, landmarks=[ball(x, y, up)], sensors=sensors)
    running.append(simulation)
    image, pose = picture(simulation)
    assert image.pixels.shape == (size[1], size[0], 3)
    found = blob(image.pixels, (0, 0, 255))
    centre, area = disc(image, pose, np.array([x, y, up]), RADIUS)
    assert area > 50
    np.testing.assert_allclose(found.mean(axis=0), centre, atol=0.5)
    assert len(found) == pytest.approx(area, rel=0.06, abs=0.5 * math.sqrt(math.pi * area))


def test_what_is_left_of_the_car_is_left_in_the_picture_and_what_is_high_is_above(running: list[World]) -> None:
    balls = [ball(5.5, 4.4, 0.15, "red"), ball(5.5, 3.6, 0.15, "green"), ball(5.5, 4.0, 0.5, "blue")]
    simulation = room(fit_out=WITH_CAMERA, landmarks=balls)
    running.append(simulation)
    image, _ = picture(simulation)
    red, green, blue = (blob(image.pixels, c).mean(axis=0) for c in ((255, 0, 0), (0, 255, 0), (0, 0, 255)))
    assert red[0] < 70 < 90 < green[0]
    assert blue[1] < 50
    assert red[1] == pytest.approx(green[1], abs=1.0)


def test_panning_turns_the_camera_and_its_pose_says_so(running: list[World]) -> None:
    """A ball 0.6 rad to the left: out of the middle before, in the middle after; the projection holds in both."""
    spot = SE2(4, 4, 0.6).transform([1.5, 0.0])
    simulation = room(fit_out=WITH_CAMERA, landmarks=[ball(spot[0], spot[1], 0.15)])
    running.append(simulation)
    before, pose = picture(simulation)
    drive(simulation, Hold(pan=0.6), 1.0)
    after, pose_after = picture(simulation)
    axis = after.robot_from_camera[:3, 2]
    assert math.atan2(axis[1], axis[0]) == pytest.approx(0.6, abs=0.02)
    assert math.atan2(before.robot_from_camera[1, 2], before.robot_from_camera[0, 2]) == pytest.approx(0.0, abs=0.005)
    for image, truth in ((before, pose), (after, pose_after)):
        centre, _ = disc(image, truth, np.array([*spot, 0.15]), RADIUS)
        visible = blob(image.pixels, (0, 0, 255))
        assert len(visible) == 0 or np.abs(visible.mean(axis=0) - centre).max() < 0.5
    assert abs(blob(after.pixels, (0, 0, 255)).mean(axis=0)[0] - 80) < 10
    drive(simulation, Hold(), 0.5)  # without a pan it stays
    kept, _ = picture(simulation)
    np.testing.assert_allclose(kept.robot_from_camera, after.robot_from_camera, atol=0.01)


def test_panning_stops_at_ninety_degrees(running: list[World]) -> None:
    simulation = room(fit_out=WITH_CAMERA)
    running.append(simulation)
    drive(simulation, Hold(pan=-3.0), 1.5)
    image, _ = picture(simulation)
    axis = image.robot_from_camera[:3, 2]
    assert math.atan2(axis[1], axis[0]) == pytest.approx(-math.pi / 2, abs=0.05)


def test_the_picture_is_of_the_instant_it_says(running: list[World]) -> None:
    """While the car turns at 1 rad/s, one tick too late would be 7 pixels."""
    simulation = room(fit_out=WITH_CAMERA, landmarks=[ball(5.5, 4.0, 0.15)])
    running.append(simulation)
    errors = []
    for _ in range(8):
        observation, pose = simulation.robot.sense(), simulation.ground_truth().pose
        if observation.image is not None:
            found = blob(observation.image.pixels, (0, 0, 255)).mean(axis=0)
            centre, _ = disc(observation.image, pose, np.array([5.5, 4.0, 0.15]), RADIUS)
            errors.append(float(np.abs(found - centre)[0]))
        simulation.robot.act(Drive(Twist(0.0, 1.0)))
        simulation.step()
    assert len(errors) == 4
    assert max(errors) < 0.7


def test_equal_seeds_give_equal_pictures(running: list[World]) -> None:
    pictures = []
    for _ in range(2):
        simulation = room(seed=3, fit_out=WITH_CAMERA, landmarks=[ball(5.0, 4.2, 0.2)])
        running.append(simulation)
        observations = drive(simulation, Drive(Twist(0.2, 0.3)), 0.5)
        pictures.append(np.array([o.image.pixels for o in observations if o.image is not None]))
    assert pictures[0].shape == (5, 120, 160, 3)
    np.testing.assert_array_equal(*pictures)


# -- the camera above the field ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [SE2(1.0, 0.8, 0.0), SE2(2.6, 1.9, 2.2), SE2(3.0, 0.5, -1.2)])
def test_the_top_camera_sees_the_markers_where_they_are(running: list[World], start: SE2) -> None:
    """robot.xml: cyan 45 mm ahead, magenta 55 mm behind, 117 mm high. Thesis' field of 3.5 x 2.5 m."""
    simulation = room(3.5, 2.5, start=start, fit_out=FitOut(top_camera=True))
    running.append(simulation)
    image, pose = simulation.robot.sense().top_image, simulation.ground_truth().pose
    assert image is not None
    assert image.pixels.shape == (480, 640, 3)
    for color, x in {(0, 255, 255): 0.045, (255, 0, 255): -0.055}.items():
        spot = np.array([*pose.transform([x, 0.0]), 0.118])
        expected, _ = project(image, None, spot)  # its pose is world_from_camera
        np.testing.assert_allclose(blob(image.pixels, color).mean(axis=0), expected, atol=0.7)


def test_the_top_camera_shows_the_whole_field_x_to_the_right_and_y_up(running: list[World]) -> None:
    simulation = room(3.5, 2.5, fit_out=FitOut(top_camera=True))
    running.append(simulation)
    image = simulation.robot.sense().top_image
    assert image is not None
    corners = np.array([project(image, None, np.array([x, y, 0.0]))[0] for x, y in ((0, 0), (3.5, 0), (3.5, 2.5), (0, 2.5))])
    assert np.all((corners > 0) & (corners < [640, 480]))
    np.testing.assert_allclose(corners[:, 0], corners[[3, 2, 1, 0], 0], atol=1e-6)
    assert corners[0, 0] < corners[1, 0]
    assert corners[3, 1] < corners[0, 1]


def test_top_pictures_come_every_200_ms(running: list[World]) -> None:
    simulation = room(3.5, 2.5, fit_out=FitOut(top_camera=True))
    running.append(simulation)
    times = [o.top_image.time for o in drive(simulation, Hold(), 0.8) if o.top_image is not None]
    assert times == pytest.approx([0.0, 0.2, 0.4, 0.6])
