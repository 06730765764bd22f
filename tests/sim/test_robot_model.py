"""Robots as data, and a sensor that nobody here has heard of. Oracles: what the files say, and the compiled model."""

from __future__ import annotations

import importlib.metadata
import shutil
from pathlib import Path

import numpy as np
import pytest

import robocar
from robocar.core import SE2, Hold, OccupancyGrid, Reading, ScenarioError, UnknownNameError
from robocar.recording import read_observations
from robocar.scenario.load import load_scenario
from robocar.sim import sensors
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.robot_model import RobotModel, robot_names
from robocar.sim.sensors.types import loaded
from robocar.sim.world import World
from robocar.sim.world_spec import build_world

THERMOMETER = '''
"""How warm the floor is: its x [m] as degrees, for a test."""
from dataclasses import dataclass
from robocar.core import Reading
from robocar.sim.sensors.sensor import SensorType

@dataclass(frozen=True)
class ThermometerParameters:
    period: float = 0.1
    delay: float = 0.0
    offset: float = 0.0
    std: float = 0.0

def reader(fitting, parameters):
    place = fitting.mount.robot_from_sensor
    def read(time):
        x = float(fitting.base_pose().position[0]) + place.x
        return Reading(time, x + parameters.offset + parameters.std * fitting.rng.standard_normal())
    return read

SENSOR = SensorType(ThermometerParameters, reader)
'''


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A robot of one's own: the Robocar under another name, to be changed."""
    return Path(shutil.copytree(RobotModel.load().folder, tmp_path / "mine"))


@pytest.fixture
def warm(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same with a thermometer, whose file lies elsewhere. Nothing but these two files knows of it."""
    plugins = tmp_path / "plugins"
    plugins.mkdir()
    (plugins / "thermometer.py").write_text(THERMOMETER)
    monkeypatch.setattr(sensors, "__path__", [*sensors.__path__, str(plugins)])
    entry = "  - {name: floor/temperature, type: thermometer, site: psd, parameters: {offset: 20.0}}\n"
    with (folder / "robot.yaml").open("a") as file:
        file.write(entry)
    return folder


def world_of(folder: Path, **kwargs) -> World:
    grid = OccupancyGrid(np.zeros((40, 40), dtype=np.int8), 0.1)
    return World(build_world(grid), [RobotSetup(SE2(2.0, 2.0), model=folder, **kwargs)], seed=0)


# -- a sensor from outside ---------------------------------------------------------------------------------------------


def test_a_new_sensor_is_one_file_and_one_line(warm: Path) -> None:
    """Oracle: the thermometer's own rule; the psd's site lies 0.10 m ahead of the base."""
    world = world_of(warm)
    first = world.robot.sense()
    assert isinstance(first.readings["floor/temperature"], Reading)
    assert first.readings["floor/temperature"].value == pytest.approx(22.1, abs=0.002)
    assert "floor/temperature" in world.robot.robot.sensors
    world.robot.act(Hold())
    world.step()
    assert "floor/temperature" not in world.robot.sense().readings  # its period is two ticks


def test_its_noise_is_its_own(warm: Path) -> None:
    loud, quiet = world_of(warm, sensors={"thermometer": {"std": 1.0}}), world_of(warm)
    a, b = loud.robot.sense(), quiet.robot.sense()
    assert abs(a.readings["floor/temperature"].value - b.readings["floor/temperature"].value) > 1e-3
    assert [float(scan.ranges[0]) for scan in a.sonars] == [float(scan.ranges[0]) for scan in b.sonars]


def test_it_goes_through_a_run_and_a_recording_and_back(warm: Path, tmp_path: Path) -> None:
    """Oracle: the true poses; the hash of the run without the thermometer: looking changes nothing."""
    settings = {"robot.model": str(warm), "robot.sensors.thermometer.offset": 5.0, "time_limit": 1.0}
    result = robocar.run("thesis-field", settings=settings, out=tmp_path / "runs")
    assert result.directory is not None
    read = [o.readings.get("floor/temperature") for o, _ in read_observations(result.directory / "run.rrd")]
    times, poses = result.truth.times, result.truth.poses
    assert [r.time for r in read[::2]] == pytest.approx(times[::2].tolist())
    assert [r.value for r in read[::2]] == pytest.approx([x + 5.1 for x in poses[::2, 0]], abs=0.01)
    assert len(read) > 10
    assert read[1::2] == [None] * len(read[1::2])
    assert result.hash == robocar.run("thesis-field", settings={"time_limit": 1.0}).hash


@pytest.mark.parametrize("record", [False, True])
def test_a_sensor_that_gives_no_reading_ends_its_run(warm: Path, tmp_path: Path, record: bool) -> None:
    """As an error of any other part does; before, only the recording minded."""
    (tmp_path / "plugins" / "bare.py").write_text(THERMOMETER.replace("return Reading(time, x", "return (x"))
    path = warm / "robot.yaml"
    path.write_text(path.read_text().replace("type: thermometer", "type: bare"))
    settings = {"robot.model": str(warm), "time_limit": 1.0}
    result = robocar.run("thesis-field", settings=settings, out=tmp_path / "runs" if record else None)
    assert result.status == "error"
    assert "floor/temperature: expected a Reading" in result.reason


def test_its_parameters_are_checked_like_any_other_s(warm: Path) -> None:
    def load(**parameters: object) -> None:
        load_scenario("thesis-field", {f"robot.sensors.thermometer.{key}": value for key, value in parameters.items()})

    load(offset=3, std=0.5)
    with pytest.raises(ScenarioError, match=r"robot\.sensors\.thermometer\.ofset' \(did you mean 'offset'\?\)"):
        load(ofset=3)
    with pytest.raises(ScenarioError, match=r"thermometer\.std.*not 'cold'"):
        load(std="cold")
    with pytest.raises(ScenarioError, match=r"thermometer\.period: .*above 0"):
        load(period=0.0)


# -- folders -----------------------------------------------------------------------------------------------------------


def test_robots_are_found_by_name_and_by_path(folder: Path) -> None:
    assert robot_names() == ["robocar"]
    assert RobotModel.load("robocar") is RobotModel.load()
    assert RobotModel.load(folder).name == "mine"
    assert RobotModel.load(folder / "robot.yaml") is RobotModel.load(folder)
    with pytest.raises(ScenarioError, match=r"unknown robot 'robocr' \(did you mean 'robocar'\?\); known: robocar"):
        RobotModel.load("robocr")
    with pytest.raises(ScenarioError, match="unknown robot 'turtle'"):
        robocar.run("thesis-field", settings={"robot.model": "turtle"})


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("supply: 11.1", "supply: -1", r"drive\.motor\.supply: .*greater than 0, not -1"),
        ("kind: skid-steer", "kind: hover", r"drive\.kind: .*'skid-steer'"),
        (
            "pulses_per_turn: 200",
            "pulses_per_trun: 200",
            r"unknown key 'drive\.pulses_per_trun' \(did you mean 'pulses_per_turn'",
        ),
        ("mjcf: robot.xml\n", "", "missing key 'mjcf'"),
        ("type: psd,", "type: pds,", r"unknown type of sensor 'pds' \(did you mean 'psd'\?\)"),
        ("beams: 570", "beans: 570", "sensor 'lidar': parameters.beans: "),
        ("fitted: {lidar: [hokuyo]}", "fitted: {ladar: [hokuyo]}", "there is no choice 'ladar'"),
        ("optional:\n  camera:", "optional:\n  kamera:", "optional: there is no choice 'kamera'"),
        ("bumper: bumper}", "bumper: horn}", "firmware.bumper: there is no sensor 'horn'"),
        ("name: sonar/right,", "name: sonar/left,", "sensors need names of their own, not sonar/left"),
        ("hull: hull", "hull: hall", "robot.xml has no geom 'hall'"),
        ("site: psd", "site: dsp", "robot.xml has no site 'dsp'"),
        ("wheels: [front_left_wheel", "wheels: [front_left", "robot.xml has no body 'front_left'"),
    ],
)
def test_a_wrong_file_is_named_with_the_field(folder: Path, old: str, new: str, message: str) -> None:
    """A mistake of every kind, made in a copy of the Robocar's own file."""
    path = folder / "robot.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ScenarioError, match=rf"robot\.yaml: .*{message}"):
        RobotModel.load(folder).describe(FitOut(sonars="front+sides"))


def test_an_element_that_the_mjcf_lacks_is_named(folder: Path) -> None:
    path = folder / "robot.yaml"
    path.write_text(path.read_text().replace("element: camera", "element: horn"))
    with pytest.raises(ScenarioError, match=r"robot robocar: sensor 'camera': .*horn.*Valid names.*camera"):
        world_of(folder, fit_out=FitOut(camera=True))


def test_a_robot_says_what_it_cannot_be_fitted_with(folder: Path) -> None:
    path = folder / "robot.yaml"
    path.write_text(path.read_text().replace("fitted: {lidar: [hokuyo]}", "fitted: {lidar: [scan360], compass: [true]}"))
    with pytest.raises(ScenarioError, match="robot mine: it cannot be fitted with lidar: hokuyo; its choices are scan360"):
        RobotModel.load(folder).describe(FitOut(lidar="hokuyo"))


@pytest.mark.parametrize(
    "fit_out", [FitOut(), FitOut("ring", "scan360", camera=True), FitOut("front+sides", "hokuyo", compass=True)]
)
def test_a_robot_is_described_without_a_world_as_it_is_in_one(fit_out: FitOut) -> None:
    """Oracle: the sites of the compiled world, in the frame of the base."""
    world = world_of(RobotModel.load().folder, fit_out=fit_out)
    try:
        described = RobotModel.load().describe(fit_out)
        assert described.sensors == world.robot.robot.sensors
        for sensor in described.sonars:
            site = world.model.site(f"robocar/sonar_{sensor.name}")
            assert (sensor.robot_from_sensor.x, sensor.robot_from_sensor.y) == (site.pos[0], site.pos[1])
        assert [s.robot_from_sensor for s in described.sonars] == [s.robot_from_sensor for s in world.robot.robot.sonars]
    finally:
        world.close()


def test_a_laser_s_geometry_is_a_parameter() -> None:
    lidar = RobotModel.load().describe(FitOut(lidar="hokuyo"), {"lidar": {"beams": 5, "opening": 90.0, "max_range": 2.0}}).lidar
    assert lidar is not None
    np.testing.assert_allclose(np.degrees(lidar.bearings), [-45.0, -22.5, 0.0, 22.5, 45.0])
    assert lidar.max_range == 2.0


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("no_such_module:SENSOR", "cannot be imported: ModuleNotFoundError: No module named 'no_such_module'"),
        ("math:SENSOR", "cannot be imported: AttributeError"),
        ("math:pi", "must be a SensorType, not float"),
    ],
)
def test_a_sensor_of_a_package_that_is_none_is_one_line(value: str, message: str) -> None:
    point = importlib.metadata.EntryPoint("theirs", value, "robocar.sensors")
    with pytest.raises(UnknownNameError, match=rf"sensor 'theirs' = {value} of a package {message}"):
        loaded(point)
