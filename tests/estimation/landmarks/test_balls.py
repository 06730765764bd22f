"""Balls in rendered pictures. Oracle: where the simulator has put them, and which of them the geometry of the view shows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest

from robocar.core import SE2, Array, Detection, Image, Landmark, OccupancyGrid, wrap_angle
from robocar.core.solids import Box
from robocar.estimation.landmarks.balls import HUES, BallDetector
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.sensors.base_pose import base_pose
from robocar.sim.sensors.offscreen import OffscreenCamera
from robocar.sim.world import World
from robocar.sim.world_spec import LIGHTING, build_world

CORNERS = tuple(
    Landmark(color, color, np.array([x, y, 0.4]), 0.1)
    for color, x, y in (("blue", 3.5, 0.0), ("green", 3.5, 2.5), ("orange", 0.0, 2.5), ("red", 0.0, 0.0))
)
FIELD = OccupancyGrid(np.zeros((25, 35), dtype=np.int8), 0.1)


@dataclass
class Studio:
    """A car with a camera that can be put anywhere."""

    simulation: World
    camera: OffscreenCamera

    def picture(self, pose: SE2) -> Image:
        self.simulation.robot.kidnap(pose)
        base = base_pose(self.simulation.data.qpos[:7])
        return self.camera.read(0.0, base.position, base.rotation)


@contextmanager
def studio(
    landmarks: tuple[Landmark, ...], lighting: str = "default", size: tuple[int, int] = (160, 120), **world
) -> Iterator[Studio]:
    tint = world.pop("tint", None)
    spec = build_world(FIELD, landmarks=landmarks, lighting=lighting, **world)
    if tint is not None:
        spec.material("wall").rgba = [*tint, 1.0]
    simulation = World(spec, [RobotSetup(SE2(1.75, 1.25), fit_out=FitOut(camera=True))], seed=0)
    camera = OffscreenCamera(simulation.model, simulation.data, "robocar/camera", size)
    try:
        yield Studio(simulation, camera)
    finally:
        camera.close()
        simulation.close()


def views(landmark: Landmark, pose: SE2, image: Image) -> tuple[float, float, bool, bool]:
    """True bearing and range, whether all of the ball is inside the picture, and whether any of it is."""
    x, y = pose.inverse_apply(float(landmark.position[0]), float(landmark.position[1]))
    transform = image.robot_from_camera
    seen = transform[:3, :3].T @ (np.array([x, y, landmark.position[2]]) - transform[:3, 3])
    height, width = image.pixels.shape[:2]
    if seen[2] <= landmark.radius:
        return math.atan2(y, x), math.hypot(x, y), False, False
    u, v = (image.intrinsics @ (seen / seen[2]))[:2]
    # The image of a sphere is an ellipse: this radius holds its longer axis.
    radius = (
        image.intrinsics[0, 0] * landmark.radius / math.sqrt(seen[2] ** 2 - landmark.radius**2) * np.linalg.norm(seen) / seen[2]
    )
    whole = radius < u < width - radius and radius < v < height - radius
    some = -radius < u < width + radius and -radius < v < height + radius
    return math.atan2(y, x), math.hypot(x, y), bool(whole), bool(some)


def grid_of_poses() -> list[SE2]:
    """Over the field, the car never nearer than 0.5 m to a corner ball."""
    places = [(x, y) for x in np.linspace(0.25, 3.25, 7) for y in np.linspace(0.25, 2.25, 5)]
    return [
        SE2(x, y, heading + 0.1 * k)
        for k, (x, y) in enumerate(places)
        for heading in np.linspace(-math.pi, math.pi, 8, endpoint=False)
    ]


def errors(stage: Studio, landmarks: tuple[Landmark, ...], most: float = 4.0) -> tuple[Array, int]:
    """(bearing, relative range, squared normalized) errors of balls seen whole within `most` metres; how many were missed."""
    detector = BallDetector(landmarks)
    rows, missed = [], 0
    for pose in grid_of_poses():
        image = stage.picture(pose)
        found = {d.landmark: d for d in detector.detect(image)}
        for landmark in landmarks:
            bearing, distance, whole, some = views(landmark, pose, image)
            assert some or landmark.color not in found, f"{landmark.color} seen from {pose}, where it is not in the picture"
            if not whole or not 0.6 < distance < most:
                continue
            if landmark.color not in found:
                missed += 1
                continue
            seen = found[landmark.color]
            off = np.array([wrap_angle(seen.bearing - bearing), seen.range - distance])
            rows.append((off[0], off[1] / distance, off @ np.linalg.solve(seen.covariance, off)))
    return np.array(rows), missed


@pytest.mark.parametrize("lighting", sorted(LIGHTING))
def test_balls_seen_whole_are_measured_to_a_degree_and_5_percent(lighting: str) -> None:
    with studio(CORNERS, lighting) as stage:
        off, missed = errors(stage, CORNERS)
    assert len(off) > 100
    assert missed == 0
    assert np.degrees(np.percentile(abs(off[:, 0]), 95)) < 0.2
    assert np.percentile(abs(off[:, 1]), 95) < 0.03
    assert np.median(off[:, 2]) < 4.0  # chi-square with two degrees of freedom: the median is 1.4


@pytest.mark.parametrize("colors", [("yellow", "magenta", "cyan", "red"), ("orange", "yellow", "green", "cyan")])
def test_all_colours_of_scenarios_are_told_apart(colors: tuple[str, ...]) -> None:
    marks = tuple(Landmark(color, color, mark.position, mark.radius) for color, mark in zip(colors, CORNERS, strict=True))
    with studio(marks, "bright") as stage:
        off, missed = errors(stage, marks)
    assert missed == 0
    assert np.percentile(abs(off[:, 1]), 95) < 0.03


def test_other_picture_sizes() -> None:
    with studio(CORNERS, size=(320, 200)) as stage:
        off, missed = errors(stage, CORNERS, most=5.0)
    assert missed == 0
    assert np.percentile(abs(off[:, 1]), 95) < 0.02


def test_no_ball_is_seen_in_500_views_without_balls() -> None:
    """Boxes stand in the field; all colours are looked for."""
    known = tuple(Landmark(color, color, np.array([1.0, 1.0, 0.4]), 0.1) for color in HUES)
    solids = (Box((0.3, 0.3, 0.5), SE2(1.0, 1.0, 0.4)), Box((0.2, 0.5, 0.3), SE2(2.5, 1.5, 1.0)))
    detector = BallDetector(known)
    rng = np.random.default_rng(11)
    seen = []
    with studio((), solids=solids) as stage:
        for _ in range(500):
            pose = SE2(rng.uniform(0.2, 3.3), rng.uniform(0.2, 2.3), rng.uniform(-math.pi, math.pi))
            seen += detector.detect(stage.picture(pose))
    assert seen == []


@pytest.mark.parametrize("color", ["red", "orange"])
def test_walls_of_a_balls_colour_are_no_balls(color: str) -> None:
    """The walls and boxes have the hue of the ball, which is not there; then it is, and may be missed but not seen elsewhere."""
    tint = {"red": (0.85, 0.10, 0.08), "orange": (0.95, 0.45, 0.05)}[color]
    mark = Landmark(color, color, np.array([3.5, 0.0, 0.4]), 0.1)
    detector = BallDetector((mark,))
    solids = (Box((0.3, 0.3, 0.35), SE2(1.0, 1.0, 0.4)),)
    poses = grid_of_poses()[::2]
    with studio((), tint=tint, solids=solids) as stage:
        false = [d for pose in poses for d in detector.detect(stage.picture(pose))]
    with studio((mark,), tint=tint, solids=solids) as stage:
        off = []
        for pose in poses:
            image = stage.picture(pose)
            bearing, distance, _, _ = views(mark, pose, image)
            off += [(wrap_angle(d.bearing - bearing), d.range / distance - 1) for d in detector.detect(image)]
    assert false == []
    assert np.abs(np.array(off).reshape(-1, 2)).max(initial=0.0) < 0.35


def partial_errors(stage: Studio, mark: Landmark, poses: list[SE2]) -> Array:
    """(bearing, relative range) errors in standard deviations of all detections."""
    rows = []
    for pose in poses:
        image = stage.picture(pose)
        bearing, distance, _, _ = views(mark, pose, image)
        for d in BallDetector((mark,)).detect(image):
            std = np.sqrt(np.diag(d.covariance))
            rows.append((wrap_angle(d.bearing - bearing) / std[0], (d.range - distance) / std[1], std[1] / distance))
    return np.array(rows).reshape(-1, 3)


def test_a_ball_cut_by_the_border_is_measured_with_more_uncertainty() -> None:
    """The car turns so that the ball leaves the picture at its side."""
    mark = CORNERS[0]
    edge = 0.5 * 2 * math.atan(80 / (60 / math.tan(math.radians(22.5))))
    poses = [
        SE2(2.3, 0.9, math.atan2(-0.9, 1.2) + side * (edge + turn)) for side in (1, -1) for turn in np.linspace(-0.06, 0.03, 12)
    ]
    with studio(CORNERS) as stage:
        off = partial_errors(stage, mark, poses)
        middle = partial_errors(stage, mark, [SE2(2.3, 0.9, math.atan2(-0.9, 1.2))])
    assert len(off) >= 10
    assert np.abs(off[:, :2]).max() < 4.0
    assert off[:, 2].max() > 2 * middle[0, 2]


def test_a_ball_half_hidden_behind_a_box_is_measured_with_more_uncertainty() -> None:
    mark = CORNERS[0]
    box = Box((0.1, 0.4, 0.36), SE2(3.0, 0.55, 0.0))
    poses = [SE2(2.0, y, math.atan2(-y, 1.5)) for y in np.linspace(0.7, 1.3, 25)]
    with studio(CORNERS, solids=(box,)) as stage:
        off = partial_errors(stage, mark, poses)
    assert len(off) >= 8
    assert np.abs(off[:, 0]).max() < 5.0
    assert np.percentile(np.abs(off[:, 1]), 80) < 3.0


def test_two_balls_of_one_colour_are_both_found() -> None:
    """Side by side, and one partly before the other."""
    pair = (
        Landmark("near", "green", np.array([3.0, 1.25, 0.4]), 0.1),
        Landmark("far", "green", np.array([3.5, 1.35, 0.4]), 0.1),
    )
    with studio(pair) as stage:
        apart = BallDetector(pair).detect(stage.picture(SE2(1.5, 2.0, -0.5)))
        overlapping = BallDetector(pair).detect(stage.picture(SE2(1.0, 1.15, 0.05)))
    for seen, pose in ((apart, SE2(1.5, 2.0, -0.5)), (overlapping, SE2(1.0, 1.15, 0.05))):
        expected = sorted(math.hypot(*pose.inverse_apply(*mark.position[:2])) for mark in pair)
        assert sorted(d.range for d in seen) == pytest.approx(expected, rel=0.08)
        assert {d.landmark for d in seen} == {"green"}


def test_a_far_ball_of_few_pixels() -> None:
    """At 7 m it has a radius of 2 pixels."""
    mark = Landmark("red", "red", np.array([8.5, 1.25, 0.4]), 0.1)
    with studio((mark,), border="open") as stage:
        found = [d for y in np.linspace(0.8, 1.7, 15) for d in BallDetector((mark,)).detect(stage.picture(SE2(1.5, y, 0.0)))]
    assert len(found) == 15
    assert np.std([d.range - 7.0 for d in found]) < 0.05 * 7
    assert all(abs(d.range - 7.0) < 4 * math.sqrt(d.covariance[1, 1]) for d in found)


def test_the_detector_sees_whatever_the_pan_servo_does() -> None:
    """A panned camera: the same ball at the same bearing in the robot's frame."""
    mark, pose = CORNERS[1], SE2(1.5, 1.0, -0.6)
    with studio(CORNERS) as stage:
        joint = stage.simulation.model.joint("robocar/pan").qposadr[0]
        stage.simulation.data.qpos[joint] = 1.2
        image = stage.picture(pose)
        seen = [d for d in BallDetector(CORNERS).detect(image) if d.landmark == "green"]
    bearing, distance, _, _ = views(mark, pose, image)
    assert [(d.bearing, d.range) for d in seen] == [(pytest.approx(bearing, abs=0.01), pytest.approx(distance, rel=0.04))]


def test_colours_without_a_landmark_are_not_looked_for() -> None:
    with studio(CORNERS) as stage:
        image = stage.picture(SE2(1.0, 1.25, 0.0))
        names = {d.landmark for d in BallDetector(CORNERS[:1]).detect(image)}
    assert names <= {"blue"}


@pytest.mark.parametrize("shape", [(120, 160, 3), (1, 1, 3), (2, 300, 3)])
def test_noise_gives_hardly_any_ball(shape: tuple[int, int, int]) -> None:
    """Twenty pictures of random colours, which hold some fifty regions of a ball's colour each."""
    rng = np.random.default_rng(3)
    focal = 144.9
    intrinsics = np.array([[focal, 0, shape[1] / 2], [0, focal, shape[0] / 2], [0, 0, 1]])
    camera = np.array([[0, 0, 1, 0.07], [-1, 0, 0, 0], [0, -1, 0, 0.144], [0, 0, 0, 1]])
    found: list[Detection] = []
    for _ in range(20):
        pixels = rng.integers(0, 256, shape, dtype=np.uint8)
        found += BallDetector(CORNERS).detect(Image(0.0, pixels, intrinsics, camera))
    assert len(found) <= 2


def test_mujoco_is_not_needed_by_the_detector() -> None:
    """A disc drawn by hand: a sphere on the axis at distance d has the image radius f tan(asin(r / d))."""
    assert mujoco.__version__  # the tests use it, the module under test does not
    focal, distance = 200.0, 2.0
    rows, cols = np.mgrid[0:240, 0:320] + 0.5
    radius = focal * math.tan(math.asin(0.1 / distance))
    pixels = np.zeros((240, 320, 3), dtype=np.uint8)
    pixels[(rows - 120) ** 2 + (cols - 160) ** 2 < radius**2] = (200, 20, 20)
    intrinsics = np.array([[focal, 0, 160], [0, focal, 120], [0, 0, 1]])
    camera = np.array([[0, 0, 1, 0.0], [-1, 0, 0, 0], [0, -1, 0, 0.4], [0, 0, 0, 1]])
    (seen,) = BallDetector(CORNERS).detect(Image(1.5, pixels, intrinsics, camera))
    assert (seen.time, seen.landmark) == (1.5, "red")
    assert abs(seen.bearing) < 1e-9
    assert seen.range == pytest.approx(distance, rel=0.01)
