"""Worlds of the BARN benchmark: fields of cylinders, as Gazebo worlds (SDF), grids, and reference paths.

Source: Perille, Truong, Xiao and Stone, "Benchmarking Metric Ground Navigation" (SSRR 2020) and the BARN challenge. Cylinders of
radius 0.075 m stand on a lattice of 0.15 m; x runs from -4.5 m to 0, y from 0 to 9.6 m: an open start corridor, then the field.
"""

from __future__ import annotations

import csv
import io
import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robocar.core import FREE, OCCUPIED, SE2, Array, MapFormatError, OccupancyGrid, OutputError, frozen_array
from robocar.core.text import shown
from robocar.formats.files import MAX_COORDINATE, check_cells, check_resolution
from robocar.reading import MAX_TEXT, PathLike, gunzip, is_packed, read_arrays, read_bytes, read_text

CELL_SIZE = 0.15
"""Lattice of the benchmark [m]."""

ORIGIN = SE2(-4.5, 0.0, 0.0)
"""world_from_grid of the benchmark's grids."""

START = SE2(-2.25, 3.0, 1.57)
GOAL = (-2.25, 13.0)
"""The challenge's task [m, rad]; the goal lies beyond the grid, where everything is free."""

FIELD_CORNER = (-4.425, 5.175)
"""Centre of cell (0, 0) of the field, the reference paths' own grid: rows run along x, columns along y [m]."""

MAX_CYLINDERS = 10_000
"""Of a world: each is a body in physics. Those of the benchmark have some hundreds."""

_HARMLESS_MODELS = ("ground_plane", "sun")


@dataclass(frozen=True, slots=True, eq=False)
class BarnWorld:
    """Upright cylinders.

    Args:
        cylinders: x, y, radius, (n, 3) [m].
    """

    cylinders: Array

    def __post_init__(self) -> None:
        cylinders = frozen_array(self.cylinders)
        if cylinders.ndim != 2 or cylinders.shape[1] != 3 or not np.all(np.isfinite(cylinders)):
            raise ValueError(f"a world needs finite cylinders (n, 3), not shape {cylinders.shape}")
        if np.any(cylinders[:, 2] <= 0):
            raise ValueError("the radius of a cylinder must be positive")
        if cylinders.size > 3 * MAX_CYLINDERS:
            raise ValueError(f"{len(cylinders)} cylinders, at most {MAX_CYLINDERS} are allowed")
        far = np.abs(cylinders).max(axis=1, initial=0.0)
        if np.any(far > MAX_COORDINATE):
            raise ValueError(f"cylinder {cylinders[far.argmax()].tolist()}: x, y and radius must be within {MAX_COORDINATE:g} m")
        object.__setattr__(self, "cylinders", cylinders)

    def grid(self, resolution: float = CELL_SIZE, bounds: tuple[float, float, float, float] | None = None) -> OccupancyGrid:
        """Cells that a cylinder covers in part or whole are occupied, all others free.

        Args:
            resolution: side of a cell [m].
            bounds: x0, y0, x1, y1 to be shown [m], by default the box around the cylinders; widened to multiples of `resolution`,
                so that a world of the benchmark gets the benchmark's own cells.

        Raises:
            ValueError: no cylinder and no bounds, or empty bounds.
            MapFormatError: the world is too large for the resolution.
            ParameterError: `resolution` is not a positive number.
        """
        resolution = check_resolution(resolution)
        x, y, radius = self.cylinders.T
        if bounds is None:
            if not radius.size:
                raise ValueError("a world without cylinders needs bounds")
            bounds = ((x - radius).min(), (y - radius).min(), (x + radius).max(), (y + radius).max())
        check_cells("BARN world", (bounds[3] - bounds[1]) / resolution, (bounds[2] - bounds[0]) / resolution)
        # Lattice numbers are rounded in the files (some are 32-bit): touching is not covering.
        slack = 1e-3
        low = [math.floor(edge / resolution + slack) for edge in bounds[:2]]
        high = [math.ceil(edge / resolution - slack) for edge in bounds[2:]]
        cols, rows = high[0] - low[0], high[1] - low[1]
        if rows < 1 or cols < 1:
            raise ValueError(f"empty bounds {bounds}")
        data = np.full((rows, cols), FREE, np.int8)
        covered = 0
        for centre_x, centre_y, r in self.cylinders / resolution - [*low, 0]:
            top, left = max(0, math.floor(centre_y - r)), max(0, math.floor(centre_x - r))
            window = data[top : max(0, math.ceil(centre_y + r)), left : max(0, math.ceil(centre_x + r))]
            covered += window.size
            check_cells("BARN world: all that its cylinders cover", 1, covered)
            dx = np.maximum(np.abs(left + np.arange(window.shape[1]) + 0.5 - centre_x) - 0.5, 0)
            for row, cells in enumerate(window):
                dy = max(abs(top + row + 0.5 - centre_y) - 0.5, 0)
                cells[np.hypot(dx, dy) < r - slack] = OCCUPIED
        return OccupancyGrid(data, resolution, SE2(low[0] * resolution, low[1] * resolution))


@dataclass(frozen=True, slots=True)
class BarnReference:
    """A line of `index.csv`.

    Args:
        cylinders: how many the world has.
        path_points: length of the reference path in cells.
        path_length: from start to goal [m].
        optimal_time: for that length at 2 m/s [s].
        clearance: the largest clearance that some way through keeps all along [m].
    """

    cylinders: int
    path_points: int
    path_length: float
    optimal_time: float
    clearance: float


def load_barn_world(path: PathLike) -> BarnWorld:
    """Read the cylinders of a Gazebo world, `.world` or `.world.gz`.

    Poses of model, link and collision are composed. Ground planes and the sun are skipped; a saved `<state>` is ignored.

    Raises:
        MapFormatError: no SDF, damaged, no cylinders, a shape that is no upright cylinder; the message names model and value.
    """
    data = read_bytes(path, limit=MAX_TEXT)
    if is_packed(data):
        data = gunzip(data, path, limit=MAX_TEXT)
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as failure:
        raise MapFormatError(f"{path}: no valid SDF, broken XML ({failure})") from failure
    world = root.find("world") if root.tag == "sdf" else None
    if world is None:
        raise MapFormatError(f"{path}: no SDF world, the file must hold <sdf><world>, its root is <{root.tag}>")
    for include in world.findall("include"):
        uri = (include.findtext("uri") or "").strip()
        if uri.removeprefix("model://") not in _HARMLESS_MODELS:
            raise MapFormatError(
                f"{path}: include {shown(uri)} cannot be resolved, only {' and '.join(_HARMLESS_MODELS)} may be included"
            )
    cylinders = [cylinder for model in world.findall("model") for cylinder in _model_cylinders(path, model)]
    if not cylinders:
        raise MapFormatError(f"{path}: the world holds no cylinder")
    try:
        return BarnWorld(np.array(cylinders))
    except ValueError as failure:
        raise MapFormatError(f"{path}: {failure}") from failure


def _model_cylinders(path: PathLike, model: ElementTree.Element) -> list[tuple[float, float, float]]:
    name = f"{path}: model {model.get('name', '')!r}"
    cylinders = []
    for link in model.findall("link"):
        for collision in link.findall("collision"):
            geometry = collision.find("geometry")
            shapes = [shape.tag for shape in geometry] if geometry is not None else []
            if shapes == ["plane"]:
                continue
            if geometry is None or shapes != ["cylinder"]:
                raise MapFormatError(
                    f"{name}: collision geometry must be a cylinder (or a ground plane), not {shapes or 'nothing'}"
                )
            (radius,) = _numbers(name, "radius", geometry.findtext("cylinder/radius"), 1)
            if radius <= 0:
                raise MapFormatError(f"{name}: radius must be positive, not {radius}")
            pose = _pose(name, model) @ _pose(name, link) @ _pose(name, collision)
            cylinders.append((pose.x, pose.y, radius))
    return cylinders


def _pose(name: str, element: ElementTree.Element) -> SE2:
    """The pose of an element in its parent, `x y z roll pitch yaw`; height does not matter to an upright cylinder."""
    pose = element.find("pose")
    if pose is None:
        return SE2()
    frame = pose.get("frame") or pose.get("relative_to")
    if frame:
        raise MapFormatError(f"{name}: pose relative to frame {shown(frame)} is not supported, only poses in the parent's frame")
    if not (pose.text or "").strip():
        return SE2()
    x, y, _, roll, pitch, yaw = _numbers(name, "pose", pose.text, 6)
    if abs(math.remainder(roll, math.pi)) > 1e-6 or abs(math.remainder(pitch, math.pi)) > 1e-6:
        raise MapFormatError(f"{name}: roll {roll} and pitch {pitch} must be 0, only upright cylinders are supported")
    return SE2(x, y, yaw)


def _numbers(name: str, field: str, text: str | None, count: int) -> list[float]:
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise MapFormatError(f"{name}: {field} must be {count} finite number{'s' * (count > 1)}, not {shown(text)}")
    return values


def load_barn_cylinders(path: PathLike) -> dict[int, BarnWorld]:
    """Worlds by number from an `.npz` file with arrays `world_<number>` of x, y, radius, (n, 3) [m]."""
    worlds = {}
    for number, array in _numbered(path, "world").items():
        try:
            worlds[number] = BarnWorld(array)
        except ValueError as failure:
            raise MapFormatError(f"{path}: world_{number}: {failure}") from failure
    return worlds


def load_barn_grids(path: PathLike) -> dict[int, OccupancyGrid]:
    """Grids by world number from an `.npz` file with `index` (n,) and `grids` (n, 30, 64) of 0 and 1, placed in the world.

    The file's rows run along x and its columns along y, so each is transposed.
    """
    arrays = read_arrays(path)
    for name in ("index", "grids"):
        if name not in arrays:
            raise MapFormatError(f"{path}: array {name} is missing, the file has {', '.join(sorted(arrays)) or 'none'}")
    index, grids = arrays["index"], arrays["grids"]
    if index.ndim != 1 or grids.ndim != 3 or len(index) != len(grids) or not grids.size:
        raise MapFormatError(f"{path}: index (n,) and grids (n, rows, cols) expected, not {index.shape} and {grids.shape}")
    if not (np.issubdtype(index.dtype, np.integer) and np.isin(grids, (0, 1)).all()):
        raise MapFormatError(f"{path}: index must hold integers and grids only 0 (free) and 1 (occupied)")
    return {
        int(number): OccupancyGrid(np.where(cells.T == 1, OCCUPIED, FREE).astype(np.int8), CELL_SIZE, ORIGIN)
        for number, cells in zip(index, grids, strict=True)
    }


def load_barn_paths(path: PathLike) -> dict[int, Array]:
    """Reference paths by world number, (n, 2) [m] in the world, from an `.npz` file with arrays `path_<number>` of (row, col)."""
    paths = {}
    for number, cells in _numbered(path, "path").items():
        if cells.ndim != 2 or cells.shape[1] != 2 or not len(cells):
            raise MapFormatError(f"{path}: path_{number} must hold cells (n, 2), not shape {cells.shape}")
        paths[number] = frozen_array(cells * CELL_SIZE + np.array(FIELD_CORNER))
    return paths


def load_barn_index(path: PathLike) -> dict[int, BarnReference]:
    """Reference lengths by world number from `index.csv`.

    Raises:
        MapFormatError: a column is missing or holds no number; the message names line, column and value.
    """
    columns = ("world", "n_cylinders", "path_points", "runpy_path_length_m", "optimal_time_s_at_2mps", "maximin_clearance_m")
    text = read_text(path)
    if (longest := max(map(len, text.splitlines()), default=0)) > csv.field_size_limit():
        raise MapFormatError(f"{path}: a line of {longest} characters, at most {csv.field_size_limit()} are read")
    reader = csv.DictReader(io.StringIO(text))
    missing = [name for name in columns if name not in (reader.fieldnames or ())]
    if missing:
        raise MapFormatError(f"{path}, line 1: column {missing[0]} is missing, needed are {', '.join(columns)}")
    references = {}
    for row in reader:
        where = f"{path}, line {reader.line_num}"
        values = [_numbers(where, name, row[name], 1)[0] for name in columns]
        for name, value in zip(columns[:3], values, strict=False):
            if value != int(value):
                raise MapFormatError(f"{where}: {name} must be an integer, not {shown(row[name])}")
        references[int(values[0])] = BarnReference(int(values[1]), int(values[2]), *values[3:])
    return references


def _numbered(path: PathLike, prefix: str) -> dict[int, NDArray]:
    """The arrays `<prefix>_<number>` by number."""
    arrays = read_arrays(path)
    for name, array in arrays.items():
        if not re.fullmatch(rf"{prefix}_\d{{1,9}}", name) or not np.issubdtype(array.dtype, np.number):
            raise MapFormatError(f"{path}: array {shown(name)} of type {array.dtype}; expected numbers named {prefix}_<number>")
    if not arrays:
        raise MapFormatError(f"{path}: holds no array {prefix}_<number>")
    return {int(name.removeprefix(f"{prefix}_")): array for name, array in arrays.items()}


def save_barn_world(path: PathLike, world: BarnWorld, height: float = 0.30) -> None:
    """Write the cylinders as a Gazebo world (SDF), which `load_barn_world` reads back number by number.

    Raises:
        OutputError: the file cannot be written.
    """
    sdf = ElementTree.Element("sdf", version="1.6")
    root = ElementTree.SubElement(sdf, "world", name="default")
    for model in _HARMLESS_MODELS:
        ElementTree.SubElement(ElementTree.SubElement(root, "include"), "uri").text = f"model://{model}"
    for k, (x, y, radius) in enumerate(world.cylinders.tolist()):
        model = ElementTree.SubElement(root, "model", name=f"cylinder_{k}")
        ElementTree.SubElement(model, "pose").text = f"{x!r} {y!r} {height / 2!r} 0 0 0"
        ElementTree.SubElement(model, "static").text = "true"
        link = ElementTree.SubElement(model, "link", name="link")
        for part in ("collision", "visual"):
            geometry = ElementTree.SubElement(ElementTree.SubElement(link, part, name=part), "geometry")
            cylinder = ElementTree.SubElement(geometry, "cylinder")
            ElementTree.SubElement(cylinder, "radius").text = repr(radius)
            ElementTree.SubElement(cylinder, "length").text = repr(height)
    ElementTree.indent(sdf, " ")
    try:
        ElementTree.ElementTree(sdf).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as failure:
        raise OutputError(f"{path}: cannot write: {failure.strerror or failure}") from failure
