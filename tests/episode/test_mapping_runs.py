"""Mapping in physics: what a run with a mapper leaves, exploration, maps as worlds, logs as maps. Oracles: the world itself."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

import robocar
from robocar.core import SE2, STOP, Done, OccupancyGrid, ParameterError
from robocar.episode.exploration import EXPLORED
from robocar.episode.map_watch import decided
from robocar.episode.replay import replay
from robocar.episode.result import RunResult
from robocar.formats import load_map
from robocar.metrics.map import on_common_cells
from robocar.planners.exploration.explore import Explore
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel


@pytest.fixture(scope="module")
def explored(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """The tilted room, explored with a laser."""
    out = tmp_path_factory.mktemp("explored")
    return robocar.run("tilted", navigator="explore", mapper="laser", out=out, seed=3)


def test_an_exploration_is_complete_and_touches_nothing(explored: RunResult) -> None:
    """Oracle: targets of the project: 99 % of the reachable area known, no contact, F1 of 0.98; the goal was not asked for."""
    assert explored.success
    assert "no frontier" in explored.reason
    assert explored.value("contacts") == 0
    assert (explored.value("map/explored") or 0.0) >= 0.99
    assert (explored.value("map/reachable_f1") or 0.0) >= 0.98
    assert explored.value("map/path_blocked") == 0
    assert explored.value("shortest_path_length") is None


def test_what_a_run_with_a_mapper_leaves(explored: RunResult) -> None:
    """Oracle: the files of the design; the map's metrics in `metrics.json`; only free, occupied and unknown in the picture."""
    assert explored.directory is not None
    assert {"map.yaml", "map.pgm", "run.rrd", "metrics.json"} <= {f.name for f in explored.directory.iterdir()}
    metrics = json.loads((explored.directory / "metrics.json").read_text())["metrics"]
    names = {"accuracy", "precision", "recall", "f1", "iou", "unknown", "explored", "reachable_f1"}
    assert {f"map/{name}" for name in names} <= set(metrics)
    grid = load_map(explored.directory / "map.yaml")
    assert set(np.unique(grid.data)) == {-1, 0, 100}
    truth = Scene.load(load_scenario("tilted"), RobotModel.load().footprint).grid
    common = on_common_cells(grid, truth)
    assert common is not None
    drawn, true = common
    free = true.free & drawn.free
    assert np.count_nonzero(free) >= 0.95 * np.count_nonzero(true.free)
    assert np.count_nonzero(drawn.free & true.occupied) <= 0.02 * np.count_nonzero(free)


def test_the_recording_shows_how_good_the_map_is(explored: RunResult) -> None:
    """Oracle: about one value a second, of which the last is near the final metric, and a map that grows."""
    from rerun.chunk import RrdReader

    assert explored.recording is not None
    reader = RrdReader(explored.recording)

    def values(entity: str) -> list[float]:
        batches = [c.to_record_batch() for c in reader.stream().filter(content=entity, has_timeline="sim_time")]
        columns = [b.column(k) for b in batches for k, n in enumerate(b.schema.names) if "scalars" in n.lower()]
        return [float(v) for column in columns for row in column.to_pylist() if row for v in row]

    unknown, f1 = values("/signals/map/unknown"), values("/signals/map/f1")
    assert len(f1) == pytest.approx(explored.value("duration") or 0.0, abs=5)
    assert f1[-1] == pytest.approx(explored.value("map/f1") or 0.0, abs=0.02)
    assert unknown[-1] < 0.02


def test_an_explored_map_is_a_world_to_drive_in(explored: RunResult) -> None:
    """Oracle: the car reaches the scenario's own goal in the world built from the map, without contact."""
    assert explored.directory is not None
    original = load_scenario("tilted")
    world = {
        "name": "second-hand",
        "map": str(explored.directory / "map.yaml"),
        "start": list(original.start),
        "goal": list(original.goal or ()),
        "robot": {"lidar": "scan360"},
        "defaults": {"navigator": "a-star", "estimator": "truth"},
    }
    result = robocar.run(world, seed=1)
    assert result.success, result.reason
    assert result.value("contacts") == 0


def test_the_same_seed_draws_the_same_map(tmp_path: Path, explored: RunResult) -> None:
    """Oracle: bytes and hashes of two runs, one of them unrecorded."""
    again = robocar.run("tilted", navigator="explore", mapper="laser", out=tmp_path, seed=3, record=False)
    assert again.hash == explored.hash
    assert again.directory is not None
    assert explored.directory is not None
    assert (again.directory / "map.pgm").read_bytes() == (explored.directory / "map.pgm").read_bytes()


def test_side_sonars_explore_the_field_of_the_thesis() -> None:
    """Oracle: the project's target: F1 of at least 0.85 at 5 cm; nearly all of the reachable area is known."""
    result = robocar.run("thesis-field", navigator="explore", mapper="sonar", settings={"robot.sonars": "front+sides"})
    assert result.success, result.reason
    assert (result.value("map/f1") or 0.0) >= 0.85
    assert (result.value("map/explored") or 0.0) >= 0.95
    assert result.value("map/path_blocked") == 0


def test_a_laser_maps_the_rooms_of_the_thesis() -> None:
    """Oracle: the project's target: F1 of at least 0.98 at 5 cm, and nothing drawn where the car has driven."""
    result = robocar.run("thesis-rooms", mapper="laser")
    assert result.success
    assert (result.value("map/f1") or 0.0) >= 0.98
    assert result.value("map/path_blocked") == 0
    assert (result.value("map/unknown") or 1.0) <= 0.02


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"navigator": "explore"}, "--mapper laser or --mapper sonar"),
        ({"mapper": "laser", "settings": {"robot.lidar": "none"}}, r"robot\.lidar"),
        ({"mapper": "sonar", "settings": {"robot.sonars": "none"}}, r"robot\.sonars"),
        ({"mapper": "laser", "settings": {"mapper.resolution": 0}}, "resolution"),
        ({"mapper": "laser", "settings": {"mapper.resoluton": 0.1}}, "resolution"),
    ],
)
def test_combinations_that_make_no_sense(choice: dict, message: str) -> None:
    """Oracle: the message says what would."""
    with pytest.raises(ParameterError, match=message):
        robocar.run("tilted", **choice)


def test_a_map_that_outgrows_memory_ends_the_run() -> None:
    """Oracle: status and reason; nothing else breaks."""
    result = robocar.run("tilted", mapper="laser", settings={"mapper.resolution": 1e-5, "time_limit": 1.0})
    assert result.status == "error"
    assert "MapTooLarge" in result.reason
    assert "cells" in result.reason


def test_an_exploration_has_more_time_than_the_way_to_the_goal() -> None:
    """Oracle: by hand: four times the scenario's limit, unless the user sets one."""
    world = {"map": "maps/maze.yaml", "start": [0.35, 0.35, 0], "robot": {"lidar": "scan360"}, "time_limit": 2.0}
    longer = robocar.run(world, navigator="explore", estimator="truth", mapper="laser")
    assert (longer.status, longer.value("duration")) == ("timeout", pytest.approx(8.0, abs=0.06))
    asked = robocar.run(world, navigator="explore", estimator="truth", mapper="laser", settings={"time_limit": 3.0})
    assert (asked.status, asked.value("duration")) == ("timeout", pytest.approx(3.0, abs=0.06))


def test_decided() -> None:
    """Oracle: by hand: 65 % and above is occupied, below free."""
    grid = OccupancyGrid(np.array([[-1, 0, 35, 64, 65, 100]], dtype=np.int8), 0.1, SE2(1, 2, 0.3))
    assert decided(grid).data.tolist() == [[-1, 0, 0, 0, 100, 100]]
    assert decided(grid).origin == grid.origin


def flaser(ranges: np.ndarray, x: float, y: float, theta: float, stamp: float) -> str:
    return f"FLASER {len(ranges)} {' '.join(f'{r:.3f}' for r in ranges)} {x} {y} {theta} {x} {y} {theta} {stamp} host {stamp}"


def test_a_log_becomes_a_map(tmp_path: Path) -> None:
    """Oracle: a square room of 4 m, written as a log: its walls are where they should be; bad lines are counted and named."""
    lines = []
    for k, (x, y, theta) in enumerate([(-0.5, 0.2, 0.0), (0.3, -0.4, 2.0), (0.1, 0.5, -2.0)]):
        angles = theta + np.radians(np.arange(-90, 91))
        c, s = np.cos(angles), np.sin(angles)
        with np.errstate(divide="ignore"):
            ranges = np.minimum(np.where(c > 0, (2 - x) / c, (-2 - x) / c), np.where(s > 0, (2 - y) / s, (-2 - y) / s))
        lines.append(flaser(ranges, x, y, theta, 10.0 + k))
    lines.insert(1, "FLASER 3 rubbish")
    log = tmp_path / "room.log"
    log.write_text("\n".join(lines) + "\n")
    result = replay(log, mapper="laser", out=tmp_path / "out")
    assert result.success
    assert "1 lines skipped (line 2:" in result.reason
    assert result.directory is not None
    grid = load_map(result.directory / "map.yaml")
    walls = grid.world_from_cell(np.argwhere(grid.occupied))
    assert len(walls) > 150
    assert np.abs(np.abs(walls).max(axis=1) - 2.0).max() <= 0.06
    inside = grid.cell_from_world([(x, y) for x in np.arange(-1.5, 1.6, 0.25) for y in np.arange(-1.5, 1.6, 0.25)])
    assert np.mean(grid.free[inside[:, 0], inside[:, 1]]) >= 0.95


def test_the_building_of_the_orebro_log(tmp_path: Path, data_dir: Path) -> None:
    """Oracle: the laser's own end points at their poses: most occupied cells hold one; the robot's way is free."""
    result = replay(data_dir / "carmen" / "orebro-corrected.log.gz", mapper="laser", out=tmp_path, record=False)
    assert result.success
    assert result.directory is not None
    grid = load_map(result.directory / "map.yaml")
    way = grid.cell_from_world(result.estimate.poses[:, :2])
    assert grid.free[way[:, 0], way[:, 1]].all()
    assert 5000 < np.count_nonzero(grid.occupied) < 20000
    assert 200.0 < np.count_nonzero(grid.free) * grid.resolution**2 < 1500.0


def test_the_map_of_python_robotics_scan(tmp_path: Path, data_dir: Path) -> None:
    """Oracle: the file's own end points: each lies in an occupied cell or beside one."""
    file = data_dir / "references" / "lidar01.csv"
    result = replay(file, mapper="laser", out=tmp_path, record=False, settings={"mapper.resolution": 0.02})
    assert result.directory is not None
    grid = load_map(result.directory / "map.yaml")
    angles, ranges = np.loadtxt(file, delimiter=",").T
    cells = grid.cell_from_world(np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1))
    windows = np.array([grid.occupied[r - 1 : r + 2, c - 1 : c + 2].any() for r, c in cells])
    assert windows.all()
    assert math.isclose(grid.resolution, 0.02)


@pytest.mark.parametrize("lidar", ["scan360", "hokuyo"])
def test_an_exploration_whose_laser_is_dead_is_no_success(lidar: str) -> None:
    """All beams are lost: it stands, says so and gives up."""
    settings = {"robot.lidar": lidar, "robot.sensors.lidar.dropout": 1.0}
    result = robocar.run("tilted", navigator="explore", estimator="truth", mapper="laser", settings=settings)
    assert (result.status, result.reason) == ("stuck", "no reading of the laser, all are lost for 6 s")
    assert result.value("path_length") == pytest.approx(0.0, abs=0.02)


def test_an_exploration_that_stops_early_has_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The navigator says that it is done while a wall hides half of the room: `map/explored` decides."""
    monkeypatch.setattr(Explore, "command", lambda self, state, observation, goal: Done("I am tired") if state.map else STOP)
    result = robocar.run("thesis-rooms", navigator="explore", estimator="truth", mapper="laser")
    share = result.value("map/explored")
    assert share is not None
    assert share < EXPLORED
    assert (result.status, f"{share:.1%} of the area" in result.reason) == ("missed", True)


LONG = pytest.mark.skipif(not os.environ.get("ROBOCAR_LONG_TESTS"), reason="takes minutes: set ROBOCAR_LONG_TESTS=1")


def rooms(seed: int, pitch: int = 8, count: int = 8) -> str:
    """A text grid of rooms of 7 x 7 cells, each joined to others by doors of one cell; all are connected."""
    rng = np.random.default_rng(seed)
    wall = np.zeros((pitch * count, pitch * count), dtype=bool)
    wall[pitch - 1 :: pitch] = wall[:, pitch - 1 :: pitch] = True
    places = [(r, c) for r in range(count) for c in range(count)]
    joints = [((r, c), (r + dr, c + dc)) for r, c in places for dr, dc in ((0, 1), (1, 0)) if max(r + dr, c + dc) < count]
    group = {place: place for place in places}
    for k in rng.permutation(len(joints)):
        (r, c), there = joints[k]
        mine, other = group[r, c], group[there]
        if mine == other and rng.random() > 0.4:
            continue
        group = {place: mine if where == other else where for place, where in group.items()}
        along = int(rng.integers(pitch - 1))
        row, col = (r * pitch + along, c * pitch + pitch - 1) if there[0] == r else (r * pitch + pitch - 1, c * pitch + along)
        wall[row, col] = False
    return "\n".join("".join("#" if cell else "." for cell in row) for row in wall[::-1])


@LONG
@pytest.mark.parametrize("seed", range(4))
def test_rooms_with_narrow_doors_are_explored_without_contact(seed: int, tmp_path: Path) -> None:
    """Doors of 0.30 m, where the car is 0.18 m wide."""
    (tmp_path / "rooms.txt").write_text(rooms(seed))
    content = {"map": str(tmp_path / "rooms.txt"), "resolution": 0.3, "start": [1.05, 1.05, 0.0], "prior": "none",
               "robot": {"lidar": "scan360"}, "time_limit": 2000}  # fmt: skip
    settings = {"time_limit": 2000}  # for the exploration as it is, not four times as long
    result = robocar.run(content, navigator="explore", estimator="truth", mapper="laser", seed=seed, settings=settings)
    assert (result.value("contacts"), result.status) == (0, "success"), result.reason
