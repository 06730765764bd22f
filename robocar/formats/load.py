"""One door for map files of every kind."""

from __future__ import annotations

import re
from pathlib import Path

from robocar.core import MapFormatError, OccupancyGrid
from robocar.formats.barn import CELL_SIZE, load_barn_world
from robocar.formats.image import IMAGE_KINDS
from robocar.formats.image_headers import image_kind
from robocar.formats.movingai import load_movingai_map
from robocar.formats.ros_map import load_map_image, load_ros_map
from robocar.formats.text_grid import load_text_grid
from robocar.reading import PathLike, read_start

_KIND_OF_SUFFIX = {
    ".yaml": "ros_map",
    ".yml": "ros_map",
    ".map": "movingai_map",
    ".scen": "movingai_scenarios",
    ".world": "barn_world",
    ".world.gz": "barn_world",
    ".sdf": "barn_world",
    ".npz": "barn_archive",
    ".txt": "text_grid",
    ".pgm": "image",
    ".png": "image",
    ".bmp": "image",
    ".ppm": "image",
    ".pbm": "image",
    ".gif": "image",
    ".tif": "image",
    ".tiff": "image",
    ".webp": "image",
    ".jpg": "image",
    ".jpeg": "image",
    ".tum": "tum",
}
MAP_KINDS = (
    f"map_server .yaml, MovingAI .map, BARN .world or .world.gz, text grid .txt, or an image ({IMAGE_KINDS}) with a resolution"
)


def file_kind(path: PathLike) -> str:
    """What kind of file this is, by its ending, else by its first bytes.

    Returns:
        `ros_map`, `movingai_map`, `movingai_scenarios`, `barn_world`, `barn_archive`, `text_grid`, `image`, `tum` or `unknown`.
    """
    name = Path(path).name.lower()
    start = read_start(path).removeprefix(b"\xef\xbb\xbf")
    if name.endswith(".txt") and _is_trajectory(start):
        return "tum"  # evo and the benchmark itself call them so
    for suffix, kind in _KIND_OF_SUFFIX.items():
        if name.endswith(suffix):
            return kind
    if image_kind(start) is not None:
        return "image"
    if start.startswith(b"type octile"):
        return "movingai_map"
    if start.startswith(b"version 1"):
        return "movingai_scenarios"
    if start.lstrip().startswith((b"<sdf", b"<?xml")):
        return "barn_world"
    if start and not start.strip(b"#. ?SG\r\n"):
        return "text_grid"
    return "tum" if _is_trajectory(start) else "unknown"


def _is_trajectory(start: bytes) -> bool:
    """Whether the first line that is no comment holds the eight numbers of the TUM format; no drawn grid has digits."""
    lines = (line for line in start.split(b"\n") if line.strip() and not line.lstrip().startswith(b"# "))
    words = next(lines, b"").split()
    return len(words) == 8 and all(_NUMBER.fullmatch(word) for word in words)


_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)


def load_map(path: PathLike, resolution: float | None = None, notes: list[str] | None = None) -> OccupancyGrid:
    """Load a map of any kind.

    Args:
        path: a map_server YAML file, MovingAI `.map`, BARN `.world` or `.world.gz`, text grid, or an image.
        resolution: side of a cell [m]. It replaces that of a map_server map, a bare image must have it; MovingAI maps and text
            grids default to 1 m, BARN worlds to 0.15 m.
        notes: what is legal but probably not meant is added to this, a sentence each.

    Raises:
        MapFormatError: the file is no map or a broken one; the message names the file and what is wrong.
        ParameterError: `resolution` is not a positive number.
    """
    kind = file_kind(path)
    if kind == "ros_map":
        return load_ros_map(path, resolution, notes)
    if kind == "movingai_map":
        return load_movingai_map(path, 1.0 if resolution is None else resolution)
    if kind == "barn_world":
        world = load_barn_world(path)
        try:
            return world.grid(CELL_SIZE if resolution is None else resolution)
        except MapFormatError as failure:
            raise MapFormatError(f"{path}: {failure}") from failure
    if kind == "text_grid":
        return load_text_grid(path, 1.0 if resolution is None else resolution).grid
    if kind == "image":
        if resolution is None:
            raise MapFormatError(f"{path}: an image alone has no resolution; give one, or name its map_server .yaml")
        return load_map_image(path, resolution, notes)
    raise MapFormatError(f"{path}: not a map; maps are {MAP_KINDS}")
