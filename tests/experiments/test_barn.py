"""Worlds of cylinders: physics, sensors, clearance and shortest paths meet round obstacles. Oracle: geometry by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from robocar import run
from robocar.core import SE2, STOP, GoalOccupied
from robocar.core.distance import polygon_distance
from robocar.episode.run import simulate
from robocar.experiments.barn import courses, score, write_course
from robocar.formats import BarnWorld, save_barn_world
from robocar.scenario.load import load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

POSTS = np.array([[1.0, 0.0, 0.20], [1.6, 0.9, 0.10], [-0.7, -0.6, 0.30], [0.2, 1.1, 0.15]])
FEET = RobotModel.load().footprint


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    path = tmp_path_factory.mktemp("barn") / "posts.world"
    save_barn_world(path, BarnWorld(POSTS))
    content = {"map": str(path), "border": "open", "prior": "none", "start": [0, 0, 0.0], "goal": [2.5, 0.0]}
    return load_scenario(content | {"robot": {"lidar": "scan360"}, "defaults": {"navigator": "a-star", "estimator": "truth"}})


def circle_hit(x: float, y: float, bearing: float) -> float:
    """Range of a beam to the nearest post, by the quadratic formula; inf where it misses all."""
    best = math.inf
    for cx, cy, r in POSTS:
        along = (cx - x) * math.cos(bearing) + (cy - y) * math.sin(bearing)
        across = (cx - x) * math.sin(bearing) - (cy - y) * math.cos(bearing)
        if along > 0 and abs(across) < r:
            best = min(best, along - math.sqrt(r * r - across * across))
    return best


def test_the_laser_sees_circles(scenario: Scenario) -> None:
    quiet = {"robot.sensors.lidar.range_std": 0.0, "robot.sensors.lidar.dropout": 0.0}
    world = simulate(scenario, settings=quiet)
    scan = world.robot.sense().lidar
    assert scan is not None
    sensor = world.ground_truth().pose @ scan.robot_from_sensor
    expected = np.array([circle_hit(sensor.x, sensor.y, sensor.theta + b) for b in scan.bearings])
    # A beam that grazes a post may hit or miss by the car's tilt on its tyres.
    nudged = [np.array([circle_hit(sensor.x, sensor.y, sensor.theta + b + e) for b in scan.bearings]) for e in (-0.01, 0.01)]
    sure = np.isfinite(expected) == np.isfinite(nudged[0])
    sure &= np.isfinite(expected) == np.isfinite(nudged[1])
    assert 60 < np.isfinite(expected[sure]).sum() < 300
    np.testing.assert_array_equal(np.isfinite(scan.ranges[sure]), np.isfinite(expected[sure]))
    seen = sure & np.isfinite(expected)
    np.testing.assert_allclose(scan.ranges[seen], expected[seen], atol=0.01)
    world.close()


def test_clearance_is_that_of_circles(scenario: Scenario) -> None:
    scene = Scene.load(scenario, FEET)
    for pose in (SE2(), SE2(0.5, 0.3, 0.7), SE2(1.3, 0.5, -2.0)):
        corners = FEET.at(pose)
        expected = min(polygon_distance(corners, [[x, y]]) - r for x, y, r in POSTS)
        assert scene.clearance(corners) == pytest.approx(expected)
    assert scene.clearance(FEET.at(SE2(0.75, 0.0))) == 0.0


def test_the_shortest_path_goes_round_the_circle(scenario: Scenario) -> None:
    """The post at (1, 0) grown by the inscribed radius of 0.09 m; the others are out of the way."""
    grown = 0.20 + FEET.inscribed_radius
    length = math.sqrt(1 - grown**2) + math.sqrt(1.5**2 - grown**2)
    length += grown * (math.pi - math.acos(grown) - math.acos(grown / 1.5))
    result = run(scenario)
    assert result.status == "success"
    assert result.value("contacts") == 0
    assert result.value("shortest_path_length") == pytest.approx(length, rel=1e-9)


def test_a_prior_map_of_truth_shows_the_cylinders(scenario: Scenario) -> None:
    scene = Scene.load(scenario.model_copy(update={"prior": "truth"}), FEET)
    assert scene.prior is not None
    inside = scene.prior.cell_from_world(POSTS[:, :2])
    assert scene.prior.occupied[inside[:, 0], inside[:, 1]].all()
    covered = scene.prior.occupied.sum() * scene.prior.resolution**2
    area = math.pi * (POSTS[:, 2] ** 2).sum()
    rim = math.tau * POSTS[:, 2].sum() * math.sqrt(2) * scene.prior.resolution
    assert area < covered < area + rim
    assert not scene.grid.occupied.any()  # physics is built from the cylinders
    with pytest.raises(GoalOccupied):
        Scene.load(scenario.model_copy(update={"goal": (1.1, 0.1)}), FEET)


def test_a_collision_is_with_the_cylinder_itself(scenario: Scenario) -> None:
    """Driving straight, the front, 0.10 m ahead of the origin, meets the post's rim at x = 0.8."""
    result = run(scenario, navigator="broken_parts:straight", estimator="truth", settings={"robot.lidar": "none"})
    assert result.status == "collision"
    assert result.truth.poses[-1, 0] == pytest.approx(0.8 - 0.10, abs=0.02)
    assert result.value("min_clearance") == pytest.approx(0.0, abs=2e-3)


def test_standing_among_cylinders_is_no_contact(scenario: Scenario) -> None:
    world = simulate(scenario)
    for _ in range(10):
        world.robot.sense()
        world.robot.act(STOP)
        world.step()
    assert not world.ground_truth().contact
    assert world.diverged() is None
    world.close()


@pytest.mark.parametrize(
    ("success", "time", "expected"),
    [(True, 20.0, 0.25), (True, 5.0, 0.5), (True, 90.0, 0.125), (True, 10.0, 0.5), (False, 20.0, 0.0), (False, None, 0.0)],
)
def test_score_by_hand(success: bool, time: float | None, expected: float) -> None:
    """OT = 5 s: 5 / 20; never above 1/2, never below 1/8; nothing for a failure."""
    assert score(success, time, 5.0) == pytest.approx(expected)


def test_a_course_is_the_challenges_task(tmp_path: Path) -> None:
    path = write_course(tmp_path, "posts", BarnWorld(np.array([[-1.0, 6.0, 0.075]])))
    scene = Scene.load(load_scenario(path), FEET)
    assert scene.start == SE2(-2.25, 3.0, 1.57)
    assert scene.goal is not None
    assert scene.goal.position.tolist() == [-2.25, 13.0]
    assert scene.goal.xy_goal_tolerance == 1.0
    assert (scene.scenario.time_limit, scene.scenario.success_radius, scene.prior) == (100.0, 1.0, None)


def test_without_the_data_worlds_are_made_and_the_report_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOCAR_DATA", str(tmp_path / "nowhere"))
    fields, origin = courses(tmp_path / "worlds", quick=True)
    assert [field.name for field in fields] == ["generated-0", "generated-10", "generated-20", "generated-30", "generated-40"]
    assert "not in ROBOCAR_DATA" in origin
    for field in fields:
        assert Scene.load(load_scenario(field.scenario), FEET).only_discs is not None
        assert field.reference.path_length >= 10.0


def test_with_the_data_they_are_the_challenges(tmp_path: Path, data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOCAR_DATA", str(data_dir))
    fields, origin = courses(tmp_path, quick=True)
    assert [(field.name, field.reference.cylinders) for field in fields][:2] == [("barn-0", 209), ("barn-60", 192)]
    assert origin == "every tenth of the challenge's 50 test worlds"
