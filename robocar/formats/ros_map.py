"""ROS map_server maps: a YAML file that names an image.

Meaning of the fields and the modes: Nav2's `nav2_map_server` (thresholds inclusive; ROS 1 compares strictly).
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robocar.core import FREE, OCCUPIED, SE2, UNKNOWN, MapFormatError, OccupancyGrid, ParameterError
from robocar.core.text import shown
from robocar.formats.files import check_resolution, finite, write_atomically
from robocar.formats.image import GreyImage, read_image
from robocar.reading import PathLike, read_yaml

MODES = ("trinary", "scale", "raw")
_REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_FIELDS = (*_REQUIRED, "mode")
_WORLD = SE2()
_GREY_OF = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}  # map_saver's greys


@dataclass(frozen=True, slots=True)
class RosMapYaml:
    """The fields of a map_server YAML file.

    Args:
        image: path of the image.
        resolution: [m] per pixel.
        origin: world_from_grid, the pose of the image's lower left corner.
        negate: white is occupied, black is free.
        occupied_thresh, free_thresh: probabilities in [0, 1].
        mode: one of `MODES`.
        unknown_fields: keys that map_server does not know and ignores.
    """

    image: Path
    resolution: float
    origin: SE2 = _WORLD
    negate: bool = False
    occupied_thresh: float = 0.65
    free_thresh: float = 0.196
    mode: str = "trinary"
    unknown_fields: tuple[str, ...] = ()


def read_ros_yaml(path: PathLike) -> RosMapYaml:
    """Read and check the YAML file of a map_server map; the image is not opened.

    Raises:
        MapFormatError: no YAML mapping, a field is missing, or its value makes no sense.
    """
    fields = _yaml_mapping(path)
    unknown = tuple(str(name) for name in fields if name not in _FIELDS)
    for name in unknown:
        # A misspelt `mode` would otherwise be a map that silently means something else.
        missing = [known for known in _FIELDS if known not in fields]
        for meant in difflib.get_close_matches(name.lower(), missing, 1, cutoff=0.75):
            raise MapFormatError(f"{path}: unknown field {name}, meant {meant}? Known are {', '.join(_FIELDS)}")
    for name in _REQUIRED:
        if name not in fields:
            raise MapFormatError(f"{path}: field {name} is missing; a map needs {', '.join(_REQUIRED)}")
    image = fields["image"]
    if not isinstance(image, str) or not image:
        raise MapFormatError(f"{path}: image must be a file name, not {shown(image)}")
    resolution = finite(str(path), "resolution", fields["resolution"], MapFormatError)
    try:
        check_resolution(resolution)
    except ParameterError as failure:
        raise MapFormatError(f"{path}: {failure}") from failure
    origin = fields["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise MapFormatError(f"{path}: origin must be three numbers [x, y, yaw], not {shown(origin)}")
    x, y, yaw = (finite(str(path), f"origin[{i}]", value, MapFormatError) for i, value in enumerate(origin))
    negate = fields["negate"]
    if negate not in (0, 1) or isinstance(negate, float):  # True == 1
        raise MapFormatError(f"{path}: negate must be 0 or 1, not {shown(negate)}")
    occupied, free = (_probability(path, name, fields[name]) for name in ("occupied_thresh", "free_thresh"))
    if free > occupied:
        raise MapFormatError(f"{path}: free_thresh {free} must not be above occupied_thresh {occupied}")
    mode = fields.get("mode", "trinary")
    if mode not in MODES:
        raise MapFormatError(f"{path}: mode must be one of {', '.join(MODES)}, not {shown(mode)}")
    return RosMapYaml(
        image=Path(path).parent / (Path(image).expanduser() if image.startswith("~/") else image),
        resolution=resolution,
        origin=SE2(x, y, yaw),
        negate=bool(negate),
        occupied_thresh=occupied,
        free_thresh=free,
        mode=mode,
        unknown_fields=unknown,
    )


def load_ros_map(path: PathLike, resolution: float | None = None, notes: list[str] | None = None) -> OccupancyGrid:
    """Load a map_server map.

    Args:
        path: the YAML file; the image is looked for beside it.
        resolution: replaces the file's [m].
        notes: what is legal but probably not meant is added to this, a sentence each.

    Raises:
        MapFormatError: YAML or image cannot be used; the message names file, field and value.
        ParameterError: `resolution` is not a positive number.
    """
    fields = read_ros_yaml(path)
    notes = [] if notes is None else notes
    notes += [f"unknown field {name:.40} is ignored" for name in fields.unknown_fields]
    if fields.mode == "raw" and fields.negate:
        notes.append("negate has no effect in mode raw")
    try:
        image = read_image(fields.image)
    except MapFormatError as failure:
        raise MapFormatError(f"{path}: image: {failure}") from failure
    _note_transparency(image, notes)
    used = fields.resolution if resolution is None else check_resolution(resolution)
    return OccupancyGrid(occupancy_from_image(image, fields), used, fields.origin)


def load_map_image(path: PathLike, resolution: float, notes: list[str] | None = None) -> OccupancyGrid:
    """Load a bare image as map_server would with its default thresholds: dark is occupied, the lower left corner at (0, 0)."""
    fields = RosMapYaml(Path(path), check_resolution(resolution))
    image = read_image(path)
    _note_transparency(image, [] if notes is None else notes)
    return OccupancyGrid(occupancy_from_image(image, fields), fields.resolution)


def _note_transparency(image: GreyImage, notes: list[str]) -> None:
    """A drawing on transparent ground looks free to whoever drew it."""
    if image.transparent is not None and image.transparent.any():
        share = float(np.mean(image.transparent))
        notes.append(f"{share:.1%} of the pixels are not opaque and become unknown; draw on a white ground where they are free")


def occupancy_from_image(image: GreyImage, fields: RosMapYaml) -> NDArray[np.int8]:
    """Occupancy of the pixels, row 0 lowest, (rows, cols).

    With v in [0, 255] the pixel's grey, p = (255 - v) / 255, negated v / 255 (Nav2, `nav2_map_server/src/map_io.cpp`):
    trinary: 100 where p >= occupied_thresh, 0 where p <= free_thresh, unknown between;
    scale: the same, and between them 100 (p - free_thresh) / (occupied_thresh - free_thresh), rounded;
    raw: v itself (`negate` has no effect), above 100 unknown.
    Pixels that are not fully opaque are unknown.
    """
    table = _occupancy_of_level(image.white, fields)
    data = table[image.levels]
    if image.transparent is not None:
        data[image.transparent] = UNKNOWN
    return np.ascontiguousarray(data[::-1])


def _occupancy_of_level(white: int, fields: RosMapYaml) -> NDArray[np.int8]:
    """Occupancy of each grey level 0 ... white."""
    levels = np.arange(white + 1)
    if fields.mode == "raw":
        byte = np.rint(levels * 255 / white)
        return np.where(byte <= OCCUPIED, byte, UNKNOWN).astype(np.int8)
    # The integer difference first: (255 - 204) / 255 is exactly the 0.2 that a file says, 1 - 204 / 255 is not.
    p = (levels if fields.negate else white - levels) / white
    between = np.full(p.shape, float(UNKNOWN))
    if fields.mode == "scale" and fields.free_thresh < fields.occupied_thresh:
        between = np.rint(100 * (p - fields.free_thresh) / (fields.occupied_thresh - fields.free_thresh))
    below = np.where(p <= fields.free_thresh, FREE, between)
    return np.where(p >= fields.occupied_thresh, OCCUPIED, below).astype(np.int8)


def save_ros_map(grid: OccupancyGrid, path_stem: PathLike) -> Path:
    """Write `<path_stem>.yaml` and `<path_stem>.pgm`; `load_ros_map` gives back exactly this grid.

    Grids of free, occupied and unknown only are written as `trinary` (0.196 keeps map_saver's grey 205 unknown), others as `raw`.
    Each file is replaced as a whole, the YAML file last.

    Returns:
        The path of the YAML file.

    Raises:
        OutputError: the files cannot be written.
    """
    import yaml

    stem = Path(path_stem)
    if stem.suffix in (".yaml", ".yml", ".pgm"):
        stem = stem.with_suffix("")
    trinary = bool(np.isin(grid.data, list(_GREY_OF)).all())
    if trinary:
        table = np.zeros(256, np.uint8)
        for value, grey in _GREY_OF.items():
            table[value] = grey  # unknown is -1: the last entry, which no other value reaches
        pixels = table[grid.data]
    else:
        pixels = np.where(grid.data == UNKNOWN, 255, grid.data).astype(np.uint8)
    rows, cols = grid.shape
    image = stem.with_name(stem.name + ".pgm")
    path = stem.with_name(stem.name + ".yaml")
    fields = {
        "image": image.name,
        "mode": "trinary" if trinary else "raw",
        "resolution": float(grid.resolution),
        "origin": [float(grid.origin.x), float(grid.origin.y), float(grid.origin.theta)],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    write_atomically(image, b"P5\n%d %d\n255\n" % (cols, rows) + np.ascontiguousarray(pixels[::-1]).tobytes())
    write_atomically(path, yaml.safe_dump(fields, sort_keys=False, default_flow_style=None, allow_unicode=True).encode())
    return path


def _yaml_mapping(path: PathLike) -> dict[Any, Any]:
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise MapFormatError(f"{path}: must be a YAML mapping with {', '.join(_REQUIRED)}, not {type(content).__name__}")
    return content


def _probability(path: PathLike, field: str, value: object) -> float:
    number = finite(str(path), field, value, MapFormatError)
    if not 0 <= number <= 1:
        raise MapFormatError(f"{path}: {field} must lie in [0, 1], not {shown(value)}")
    return number
