"""Files that break readers, built here, and every reader that they are given to."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from robocar.cli.check import check
from robocar.core import RobocarError
from robocar.episode.tape import open_tape
from robocar.formats import check_file, load_barn_cylinders, load_barn_grids, load_barn_index, load_barn_paths
from robocar.formats.load_log import load_log
from robocar.formats.mrclam import load_mrclam
from robocar.regression.baseline import read_any
from robocar.regression.results import read_run
from robocar.regression.suite import load_suite
from robocar.scenario.load import load_scenario
from robocar.sim.robot_model import RobotModel

MODELS = Path(__file__).parents[2] / "models"


def _as_run(path: Path, name: str) -> Any:
    """The file as one of a run directory."""
    folder = path.parent / f"run-{name}"
    folder.mkdir(exist_ok=True)
    good = dict.fromkeys(("scenario", "navigator", "estimator", "mapper", "status", "reason", "hash", "fingerprint"), "x")
    (folder / "metrics.json").write_text(json.dumps(good | {"schema": 1, "seed": 0, "versions": {}, "metrics": {}}))
    (folder / "config.yaml").write_text("settings: {}\nseed: 0\n")
    (folder / "run.rrd").touch()
    (folder / name).write_bytes(path.read_bytes())
    read_run(folder)
    if name == "config.yaml":
        open_tape(folder)


def _as_data_set(path: Path, name: str) -> Any:
    """The file as one of an MRCLAM folder."""
    folder = path.parent / "mrclam"
    folder.mkdir(exist_ok=True)
    (folder / "Barcodes.dat").write_text("1 5\n6 72\n")
    (folder / "Landmark_Groundtruth.dat").write_text("6 1 2 0 0\n")
    (folder / "Robot1_Odometry.dat").write_text("0 0.1 0\n1 0.1 0\n")
    (folder / "Robot1_Measurement.dat").write_text("0.5 72 1 0\n")
    (folder / name).write_bytes(path.read_bytes())
    load_mrclam(folder)


def _as_robot(path: Path, name: str) -> Any:
    """The file as one of a robot's folder."""
    folder = path.parent / f"robot-{abs(hash(path.read_bytes()))}"
    folder.mkdir(exist_ok=True)
    for file in (MODELS / "robots" / "robocar").iterdir():
        if file.is_file():
            (folder / file.name).write_bytes(file.read_bytes())
    (folder / name).write_bytes(path.read_bytes())
    RobotModel.load(folder).calibration()


READERS: Mapping[str, Callable[[Path], Any]] = {
    "check": lambda path: check(path, None),
    "check_file": lambda path: check_file(path, 1.0),
    "scenario": load_scenario,
    "suite": load_suite,
    "results": read_any,
    "log": load_log,
    "barn cylinders": load_barn_cylinders,
    "barn grids": load_barn_grids,
    "barn paths": load_barn_paths,
    "barn index": load_barn_index,
    "config.yaml of a run": lambda path: _as_run(path, "config.yaml"),
    "metrics.json of a run": lambda path: _as_run(path, "metrics.json"),
    "Barcodes.dat": lambda path: _as_data_set(path, "Barcodes.dat"),
    "Robot1_Odometry.dat": lambda path: _as_data_set(path, "Robot1_Odometry.dat"),
    "robot.yaml": lambda path: _as_robot(path, "robot.yaml"),
    "calibration.yaml": lambda path: _as_robot(path, "calibration.yaml"),
}
"""Everything that reads a file from outside."""


def refusal(reader: str, path: Path) -> str | None:
    """The message with which a reader refuses a file, None where it takes it. Anything else than our own error is raised."""
    try:
        READERS[reader](path)
    except RobocarError as error:
        return str(error)
    return None


# -- files by name ----------------------------------------------------------------------------------------------------------


def _aliases(levels: int) -> str:
    lines = ["a0: &a0 [x,x,x,x,x,x,x,x,x,x]"]
    lines += [f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 10)}]" for k in range(1, levels)]
    return "\n".join(lines)


def _png(cols: int, rows: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", cols, rows, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 60)) + chunk(b"IEND", b"")


def _npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _huge_npz() -> bytes:
    """An array of 10^12 numbers, as its header says."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }".ljust(117) + b"\n"
    body = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("world_0.npy", body)
    return file.getvalue()


def world(*cylinders: tuple[str, str]) -> str:
    """A BARN world of cylinders (pose, radius)."""
    models = "".join(
        f'<model name="c"><pose>{pose} 0 0 0</pose><link name="l"><collision name="c"><geometry><cylinder><radius>{radius}'
        "</radius><length>1</length></cylinder></geometry></collision></link></model>"
        for pose, radius in cylinders
    )
    return f"<sdf><world>{models}</world></sdf>"


_ROS = "resolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
_TRAP = "map: maps/u_trap.yaml\nstart: [0.8, 3, 0]\ngoal: [5.2, 3.0]\n"
_OPEN = "map: maps/u_trap.yaml\ngoal: [5.2, 3.0]\nborder: open\n"

BAD: Mapping[str, tuple[bytes | str, str]] = {
    "date.yaml": ("image: 2020-13-45\n", "not YAML"),
    "date_scenario.yaml": ("map: u\nstart: 2020-13-45\n", "not YAML"),
    "digits.yaml": (f"map: u\nstart: [0.5, 1, {'9' * 5000}]\n", "line 2.*characters"),
    "digits_16.yaml": (f"map: u\nstart: [0.5, 1, 0x{'f' * 90}]\n", "line 2.*digits"),
    "digits_60.yaml": (f"map: u\nstart: [0.5, 1, {'1:' * 3000}1]\n", "line 2.*characters"),
    "deep.yaml": ("start: " + "[" * 20_000 + "]" * 20_000, "deeper"),
    "deep_mapping.yaml": ("map: " + "{a: " * 20_000 + "}" * 20_000, "deeper"),
    "loop.yaml": ("map: u\nstart: &a [0, *a]\n", "alias"),
    "aliases.yaml": (_aliases(9) + f"\n{_ROS}image: *a8\n", "aliases"),
    "aliases_scenario.yaml": (_aliases(9) + "\nmap: maps/u_trap.yaml\nstart: *a8\n", "aliases"),
    "aliases_merged.yaml": (
        "a0: &a0 {k: 1}\n"
        + "\n".join(f"a{k}: &a{k} {{<<: [{','.join([f'*a{k - 1}'] * 10)}]}}" for k in range(1, 9))
        + "\nmap: u\n",
        "aliases",
    ),
    "twice.yaml": ("map: maps/u_trap.yaml\nstart: [0.8, 3, 0]\nmap: maps/maze.yaml\n", "line 3.*'map' stands twice.*line 1"),
    "twice_robot.yaml": (
        _TRAP + "robot: {lidar: scan360}\nrobot: {compass: true}\n",
        "line 5.*'robot' stands twice.*line 4",
    ),
    "twice_inside.yaml": (_TRAP + "robot: {lidar: scan360, lidar: none}\n", "line 4.*'lidar' stands twice.*line 4"),
    "twice_ros.yaml": ("image: a.pgm\nimage: b.pgm\n" + _ROS, "line 2.*'image' stands twice.*line 1"),
    "start.yaml": (_OPEN + "start: [1.0e+300, 3, 0]\n", "start.*1e.300"),
    "radius.yaml": (_TRAP + "success_radius: 1.0e+300\nxy_goal_tolerance: 1.0e+300\n", "xy_goal_tolerance.*1e.300"),
    "radius_5.yaml": (_TRAP + "success_radius: 4.4\n", "success_radius.*4.4"),
    "wall.yaml": (_TRAP + "wall_height: 1.0e+300\n", "wall_height.*1e.300"),
    "timestep.yaml": (_TRAP + "robot: {physics: {timestep: 1.0e-12}}\n", "timestep.*1e-12"),
    "period.yaml": (_TRAP + "robot: {physics: {control_period: 1.0e+9}}\n", "control_period.*1000000000"),
    "resolution.yaml": (_TRAP + "resolution: 1.0e-9\n", "resolution.*1e-09"),
    "beams.yaml": (_TRAP + "robot: {lidar: scan360, sensors: {lidar: {beams: 1000000000}}}\n", "beams.*1000000000"),
    "time.yaml": (_TRAP + "time_limit: 1.0e+300\n", "time_limit.*1e.300"),
    "box.yaml": (_TRAP + "unknown_obstacles: [{box: [1.0e+300, 1, 1], pose: [1, 1, 0]}]\n", "box.*1e.300"),
    "nul.yaml": ('map: "a\\0b"\nstart: [0, 0, 0]\n', "a.x00b|null|no file"),
    "surrogate.yaml": ('map: "a\\ud800b"\nstart: [0, 0, 0]\n', "ud800|not YAML|invalid"),
    "tag.yaml": ("map: !!timestamp x\nstart: [0, 0, 0]\n", "not YAML"),
    "python.yaml": ("map: !!python/object/apply:os.system [true]\nstart: [0, 0, 0]\n", "not YAML"),
    "tall.yaml": (_TRAP + "description: " + "x" * (5 << 20), "bytes"),
    "deep.json": ("[" * 200_000 + "]" * 200_000, "nested too deep"),
    "infinity.json": ('{"schema": 1, "kind": "robocar-baseline", "runs": {"a": {"seed": Infinity}}}', "Infinity"),
    "large.json": ('{"schema": 1, "kind": "robocar-baseline", "runs": {"a": {"seed": 1e999}}}', "1e999"),
    "negative.json": (
        '{"schema": 1, "kind": "robocar-baseline", "versions": [], "units": {}, "runs": {"a": {"seed": -5, "settings": {}, '
        '"scenario": "a", "navigator": "a", "estimator": "a", "mapper": "a", "status": "a", "hash": null, "fingerprint": null, '
        '"metrics": {}}}}',
        "seed must be a non-negative integer, not -5",
    ),
    "digits.json": ('{"schema": 1, "seed": ' + "9" * 100_000 + "}", "digits"),
    "twice.json": ('{"kind": "robocar-baseline", "kind": "x"}', "stands twice"),
    "times.tum": ("0 1e308 1e308 0 0 0 0 1\n1 -1e308 -1e308 0 0 0 0 1\n1e308 0 0 0 0 0 0 1\n", "line 1.*1e308"),
    "poses.log": ("FLASER 2 1 2 1e308 1e308 0 1e308 0 0 1 h 1\n", "1e308"),
    "nan.csv": ("0,nan\n1,nan\n", "no line holds"),
    "gyro.csv": ("time,gyro_z\n0,0.1\n0.1,0.2\n", "time,gyro_z.*angle, range"),
    "gyro_quoted.csv": ('"t [s]";"omega"\n0;0.1\n', "not of laser beams"),
    "one.world": (world(("1e300 1e300 0", "1")), "1e.300|within"),
    "far.world": (world(("1e300 0 0", "1"), ("-1e300 0 0", "1")), "within"),
    "wide.world": (world(*[("0 0 0", "600")] * 8), "cells"),
    "wider.world": (world(("0 0 0", "60000")), "cells"),
    "elements.world.gz": (gzip.compress(b"<sdf><world>" + b"<a/>" * (10 << 20) + b"</world></sdf>", 1), "unpacks to more"),
    "bomb.log.gz": (gzip.compress(b"\0" * (300 << 20), 1), "unpacks to more"),
    "cut.log.gz": (gzip.compress(b"FLASER")[:-4], "gzip"),
    "large.png": (_png(60_000, 60_000), "60000 x 60000 cells"),
    "large.gif": (b"GIF89a" + struct.pack("<HH", 65535, 65535) + b"\0" * 20, "65535 x 65535 cells"),
    "large.ppm": (b"P6 99999 99999 255\n", "99999 x 99999 cells"),
    "large.tif": (
        b"II*\0\x08\0\0\0\x02\0" + b"".join(struct.pack("<HHII", tag, 4, 1, 1 << 20) for tag in (256, 257)) + b"\0\0\0\0",
        "1048576 x 1048576 cells",
    ),
    "loop.tif": (b"II*\0\x08\0\0\0\xff\xff", "header cannot be read"),
    "photo.jpg": (b"\xff\xd8\xff\xe0" + b"\0" * 40, "JPEG.*PNG"),
    "lossy.webp": (b"RIFF\x24\0\0\0WEBPVP8 " + b"\0" * 24, "WebP.*PNG"),
    "bool.npz": (_npz(world_0=np.zeros((2, 3), bool)), "world_0"),
    "object.npz": (_npz(world_0=np.array([{}], dtype=object)), "not plain numbers"),
    "text.npz": (_npz(world_0=np.array(["a"])), "not plain numbers"),
    "nan.npz": (_npz(world_0=np.full((2, 3), np.nan)), "finite"),
    "huge.npz": (_huge_npz(), "has no room"),
    "name.npz": (_npz(**{f"world_{'9' * 5000}": np.zeros((2, 3))}), "world"),
}
"""What the file holds, and what the message of `check` says."""
