"""`robot.yaml` with every kind of mistake: one line that names the file, the field and what was expected, and no half a robot."""

from __future__ import annotations

import copy
import math
import re
import shutil
from functools import reduce
from pathlib import Path
from typing import Any

import pytest
import yaml

from robocar.cli import main
from robocar.core import ScenarioError
from robocar.scenario.load import load_scenario
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_model import RobotModel

SOURCE = RobotModel.load().folder
CONTENT = yaml.safe_load((SOURCE / "robot.yaml").read_text())
SENSOR = {sensor["name"]: k for k, sensor in enumerate(CONTENT["sensors"])}
PSD = f"sensors.{SENSOR['psd']}"
OWN_CAMERA = "optional.camera."
FULL = FitOut("ring", "scan360", compass=True, camera=True)


def changed(path: str, value: Any) -> str:
    """The Robocar's own file, but for the field at this dotted path."""
    content = copy.deepcopy(CONTENT)
    *parents, last = (int(part) if part.isdigit() else part for part in path.split("."))
    reduce(lambda part, key: part[key], parents, content)[last] = value
    return yaml.safe_dump(content, sort_keys=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(shutil.copytree(SOURCE, tmp_path / "mine"))


def refusal(folder: Path, text: str | bytes) -> str:
    """What is said of a robot with this `robot.yaml`, which is one line."""
    (folder / "robot.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ScenarioError) as refused:
        RobotModel.load(folder).describe(FULL)
    message = str(refused.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 600
    return message


DRIVE = [
    ("drive.left.wheels", ["front_left_wheel"] * 2, r"drive\.left\.wheels: expected different names"),
    (
        "drive.left.wheels",
        ["front_left_wheel"],
        r"drive\.left: encoder: expected a wheel of this side, front_left_wheel, not 'rear_l",
    ),
    ("drive.left.wheels", [], r"drive\.left\.wheels: "),
    ("drive.left.wheels", ["rear_left_wheel", ""], r"drive\.left\.wheels\.1: expected a name, not ''"),
    ("drive.left.wheels", ["rear_left_wheel", "base\0"], r"drive\.left\.wheels\.1: expected a name, not 'base\\x00'"),
    (
        "drive.left.wheels",
        ["rear_left_wheel", "rear_right_wheel"],
        "wheels: expected others than on the left, not rear_right_wheel",
    ),
    (
        "drive.right",
        CONTENT["drive"]["left"],
        "right.wheels: expected others than on the left, not front_left_wheel, rear_left_wheel",
    ),
    ("drive.left.encoder", "rear_right_wheel", r"drive\.left: encoder: expected a wheel of this side"),
    ("drive.left.motors", ["pan", "tilt"], r"drive\.left\.motors: 'pan' is no dcmotor of a wheel of this side"),
    ("drive.left.motors", ["front_left_motor"] * 2, r"drive\.left\.motors: expected different names"),
    ("drive.left.motors", ["front_right_motor"], r"right\.motors: expected others than on the left"),
    ("drive.pulses_per_turn", 10**400, r"robot\.yaml, line \d+: a number of 401 characters"),
    ("drive.pulses_per_turn", True, r"drive\.pulses_per_turn: expected a number, not True"),
    ("pan.actuator", "front_left_motor", r"pan\.actuator: expected another one than the drive's motors"),
    ("base", "front_left_wheel", r"base: joint 'front_left_wheel' does not let body 'front_left_wheel' move freely"),
]
LIMITS = [
    ("limits.max_vel_x", math.nan, r"limits\.max_vel_x: "),
    ("limits.max_vel_x", math.inf, r"limits\.max_vel_x: "),
    ("limits.max_vel_x", -1, r"limits\.max_vel_x: .*greater than 0, not -1"),
    ("limits.max_vel_x", True, r"limits\.max_vel_x: expected a number, not True"),
    ("limits.max_vel_x", 10**400, r"robot\.yaml, line \d+: a number of 401 characters"),
    ("limits.min_vel_x", 0.9, r"limits\.min_vel_x: .*less than or equal to 0, not 0\.9"),
    ("limits.acc_lim_x", 0, r"limits\.acc_lim_x: .*greater than 0, not 0"),
    ("limits.acc_lim_theta", "fast", r"limits\.acc_lim_theta: .*'fast'"),
]
OPTIONAL = [
    (f"{OWN_CAMERA}bodies", ["nope"], r"optional\.camera\.bodies: robot\.xml has no body 'nope'"),
    (f"{OWN_CAMERA}bodies", ["pan", "pan"], r"optional\.camera\.bodies: expected different names"),
    (f"{OWN_CAMERA}bodies", ["base"], r"optional\.camera\.bodies: body 'base' is no part of the base 'base'"),
    (f"{OWN_CAMERA}bodies", ["world"], r"optional\.camera\.bodies: body 'world' is no part of the base 'base'"),
    (f"{OWN_CAMERA}bodies", ["rear_left_wheel"], r"drive\.left\.wheels: robot\.xml without what is optional has no body"),
    ("hull", "pan", r"hull: geom 'pan' is no box"),
    (f"{OWN_CAMERA}actuators", ["nope"], r"optional\.camera\.actuators: robot\.xml has no actuator 'nope'"),
    (f"{OWN_CAMERA}actuators", ["rear_left_motor"], r"drive\.left\.motors: robot\.xml without what is optional has no actuator"),
    ("optional", {"lidar": {"bodies": ["pan"]}}, r"pan\.actuator: robot\.xml without what is optional has no actuator 'pan'"),
]
SENSORS = [
    *[
        (f"{PSD}.name", name, r"sensors\.1\.name: expected words")
        for name in ("", "a\0b", "/a", "a/", "a//b", "a:b", "a b", "a\n")
    ],
    *[
        (f"{PSD}.name", name, rf"sensors\.1\.name: expected another name than .*, not '{name}'")
        for name in ("scans", "time", "readings", "wheel_angles", "image", "sonars", "serial", "landmarks")
    ],
    (f"{PSD}.name", "compass", "sensor 'compass': expected one of this type, not of type psd"),
    ("sensors.0.name", "enc", "sensor 'enc': expected the name 'encoder', by which algorithms find the encoder"),
    ("firmware.compass", "accelerometer", r"firmware\.compass: .*not 'accelerometer' of type accelerometer"),
    ("firmware.bumper", "psd", r"firmware\.bumper: .*not 'psd' of type psd"),
    (f"sensors.{SENSOR['accelerometer']}.element", "bumper", "sensor 'accelerometer': element: .*accelerometer.*, not 'bumper'"),
    (f"sensors.{SENSOR['bumper']}.element", "accelerometer", "sensor 'bumper': element: .*touch.*, not 'accelerometer'"),
    (f"sensors.{SENSOR['bumper']}.element", None, "sensor 'bumper': element: robot.xml has no sensor ''"),
    (f"{PSD}.parameters", {"period": True}, r"psd\.period: expected a number, not True"),
    ("sensors.4.parameters", {"beams": 10**400}, r"robot\.yaml, line \d+: a number of 401 characters"),
    (f"sensors.{SENSOR['sonar/ring']}.ring.count", 10**9, r"ring\.count: .*1000"),
]
OTHERS = [
    ("mjcf", ".", r"mjcf: there is no file '\.' beside it"),
    ("mjcf", "README.md", r"README\.md: not a model that MuJoCo reads: "),
    ("calibration.file", "none.yaml", r"none\.yaml: no such file"),
    (
        "calibration.fitted.camera",
        "none",
        r"calibration\.yaml: robot mine needs the entry 'none'; there are with_camera, without_camera",
    ),
]


@pytest.mark.parametrize(("path", "value", "message"), [*DRIVE, *LIMITS, *OPTIONAL, *SENSORS, *OTHERS])
def test_a_wrong_value_is_named_in_one_line(folder: Path, path: str, value: object, message: str) -> None:
    assert re.search(message, refusal(folder, changed(path, value)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"\0\1", "robot.yaml: not YAML: "),
        (b"\xff\xfe\xff", "robot.yaml, line 1: byte 0xff is not UTF-8 text"),
        ("mjcf: [1\nbase: 2", "robot.yaml, line 2: not YAML: "),
        ("mjcf: 2020-13-45", "robot.yaml: not YAML: "),
        (f"mjcf: {'[' * 5000}", "robot.yaml, line 1: brackets or indents nested deeper than "),
        (f"mjcf: {'9' * 5000}", "robot.yaml, line 1: a number of 5000 characters"),
        ("mjcf: a\nbase: b\nmjcf: c", "robot.yaml, line 3: not YAML: the key 'mjcf' stands twice"),
        ("drive: {left: {wheels: [a], wheels: [b]}}", "robot.yaml, line 1: not YAML: the key 'wheels' stands twice"),
    ],
)
def test_what_is_no_yaml_is_refused_in_one_line(folder: Path, text: str | bytes, message: str) -> None:
    assert message in refusal(folder, text)


def test_a_merged_mapping_may_be_overridden(folder: Path) -> None:
    """`<<` brings keys in that may be set anew: no key stands twice there."""
    text = changed("limits", CONTENT["limits"]).replace("solver:\n", "solver:\n  <<: {impratio: 0.5}\n")
    (folder / "robot.yaml").write_text(text)
    assert "<<" in text
    assert RobotModel.load(folder).impratio == CONTENT["solver"]["impratio"]


def test_broken_mjcf_is_refused_in_one_line(folder: Path) -> None:
    for broken in ("<mujoco><worldbody>", "\0", "<mujoco/>", (SOURCE / "robot.xml").read_text()[:200]):
        (folder / "robot.xml").write_text(broken)
        assert "robot.xml" in refusal(folder, (SOURCE / "robot.yaml").read_text())


def test_the_left_wheels_lie_on_the_left(folder: Path) -> None:
    left, right = CONTENT["drive"]["left"], CONTENT["drive"]["right"]
    swapped = changed("drive", CONTENT["drive"] | {"left": right, "right": left})
    assert "drive: the wheels of the left side lie right of" in refusal(folder, swapped)


@pytest.mark.parametrize("side", ["left", "right"])
def test_motors_turn_the_wheels_of_their_side(tmp_path: Path, side: str) -> None:
    other = {"left": "right", "right": "left"}[side]
    sides = CONTENT["drive"][side], CONTENT["drive"][other]
    crossed = CONTENT["drive"] | {
        side: sides[0] | {"motors": sides[1]["motors"]},
        other: sides[1] | {"motors": sides[0]["motors"]},
    }
    mine = Path(shutil.copytree(SOURCE, tmp_path / "mine"))
    assert "drive.left.motors: 'front_right_motor' is no dcmotor of a wheel of this side" in refusal(
        mine, changed("drive", crossed)
    )


def test_the_sites_of_a_ring_are_its_own(folder: Path) -> None:
    ring = {"name": "q", "type": "sonar", "site": "q", "ring": {"count": 2, "radius": 0.1, "height": 0.1}}
    (folder / "robot.xml").write_text((SOURCE / "robot.xml").read_text().replace('"imu"', '"q_01"'))
    text = changed("sensors", [*CONTENT["sensors"], ring])
    assert "sensor 'q': ring: there is a site 'q_01' already" in refusal(folder, text)


def test_parts_of_an_optional_body_may_be_named_too(folder: Path) -> None:
    """The tilt sits on the pan, and goes with it."""
    (folder / "robot.yaml").write_text(changed("optional.camera.bodies", ["pan", "tilt"]))
    assert RobotModel.load(folder).describe(FitOut()).sensors == RobotModel.load().describe().sensors


def test_a_second_sensor_of_a_type_has_a_name_of_its_own(folder: Path) -> None:
    second = {"name": "psd/rear", "type": "psd", "site": "psd"}
    (folder / "robot.yaml").write_text(changed("sensors", [*CONTENT["sensors"], second]))
    assert "psd/rear" in RobotModel.load(folder).describe().sensors


@pytest.mark.parametrize(
    "text",
    [
        changed("limits.max_vel_x", math.nan),
        changed("optional.camera.bodies", ["nope"]),
        changed("drive.left.motors", ["pan", "tilt"]),
        "a: 1\na: 2",
        "\0",
    ],
)
def test_the_command_line_says_one_line_and_status_2(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    (folder / "robot.yaml").write_text(text)
    with pytest.raises(SystemExit) as ended:
        main(["run", "thesis-field", "--set", f"robot.model={folder}", "--out", str(tmp_path / "runs")])
    captured = capsys.readouterr()
    assert (ended.value.code, captured.out) == (2, "")
    assert captured.err.startswith((f"error: {folder}/robot.yaml: ", f"error: {folder}/robot.yaml, line "))
    assert captured.err.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_a_scenario_says_every_key_once(tmp_path: Path) -> None:
    path = tmp_path / "twice.yaml"
    path.write_text("map: maps/thesis_field.yaml\nstart: [0.3, 0.3, 0]\ntime_limit: 5\ntime_limit: 50\n")
    with pytest.raises(ScenarioError, match=r"twice\.yaml, line 4: not YAML: the key 'time_limit' stands twice"):
        load_scenario(path)


def test_the_hull_is_there_in_every_fit_out(folder: Path) -> None:
    content = changed("hull", "tilt")  # a box, but on the head of the camera
    assert "hull: robot.xml without what is optional has no geom 'tilt'" in refusal(folder, content)
