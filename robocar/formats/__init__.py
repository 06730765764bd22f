"""Files from outside: ROS map_server maps, MovingAI and BARN benchmarks, text grids, TUM trajectories.

The one vertical flip between files, which store the top row first, and grids, whose row 0 has the lowest y, happens here.
OpenCV and PyYAML are imported only when a file needs them.
"""

from robocar.formats.barn import (
    BarnReference,
    BarnWorld,
    load_barn_cylinders,
    load_barn_grids,
    load_barn_index,
    load_barn_paths,
    load_barn_world,
    save_barn_world,
)
from robocar.formats.check import FileReport, check_file
from robocar.formats.load import file_kind, load_map
from robocar.formats.movingai import ScenarioLine, load_movingai_map, load_scenarios
from robocar.formats.ros_map import RosMapYaml, load_map_image, load_ros_map, read_ros_yaml, save_ros_map
from robocar.formats.text_grid import TextGrid, load_text_grid, parse_text_grid
from robocar.formats.tum import Trajectory, read_tum, write_tum

__all__ = [
    "BarnReference",
    "BarnWorld",
    "FileReport",
    "RosMapYaml",
    "ScenarioLine",
    "TextGrid",
    "Trajectory",
    "check_file",
    "file_kind",
    "load_barn_cylinders",
    "load_barn_grids",
    "load_barn_index",
    "load_barn_paths",
    "load_barn_world",
    "load_map",
    "load_map_image",
    "load_movingai_map",
    "load_ros_map",
    "load_scenarios",
    "load_text_grid",
    "parse_text_grid",
    "read_ros_yaml",
    "read_tum",
    "save_barn_world",
    "save_ros_map",
    "write_tum",
]
