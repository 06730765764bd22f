"""What `robocar check` says about a file from outside."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robocar.core import MapFormatError, OccupancyGrid
from robocar.formats.barn import load_barn_cylinders, load_barn_grids, load_barn_paths
from robocar.formats.load import MAP_KINDS, file_kind, load_map
from robocar.formats.load_log import LOG_KINDS, is_log, load_log, refuse_subject
from robocar.formats.movingai import ScenarioLine, load_movingai_map, load_scenarios
from robocar.formats.ros_map import read_ros_yaml
from robocar.formats.text_grid import load_text_grid
from robocar.formats.tum import read_tum
from robocar.reading import PathLike


@dataclass(frozen=True, slots=True)
class FileReport:
    """What a readable file holds. The map fields are None for files that hold no single map.

    Args:
        kind: see `file_kind`.
        shape: rows, cols.
        resolution: side of a cell [m].
        size: extent along x and y [m].
        occupied, free, unknown: shares of the cells in [0, 1].
        details: further facts, one sentence each.
        warnings: what is legal but probably not meant.
    """

    path: Path
    kind: str
    shape: tuple[int, int] | None = None
    resolution: float | None = None
    size: tuple[float, float] | None = None
    occupied: float | None = None
    free: float | None = None
    unknown: float | None = None
    details: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        """One line for the facts, one for each warning."""
        facts = [self.kind.replace("_", " ")]
        if self.shape is not None and self.size is not None:
            rows, cols = self.shape
            facts.append(f"{cols} x {rows} cells of {self.resolution:g} m ({self.size[0]:g} x {self.size[1]:g} m)")
            facts.append(f"{self.occupied:.1%} occupied, {self.free:.1%} free, {self.unknown:.1%} unknown")
        return "\n".join(
            [f"{self.path}: " + ", ".join([*facts, *self.details]), *(f"  warning: {text}" for text in self.warnings)]
        )


def check_file(path: PathLike, resolution: float | None = None, subject: int | None = None) -> FileReport:
    """Read a file from outside as a whole and say what it holds.

    Args:
        path: a map of any kind that `load_map` reads, MovingAI `.scen`, BARN `.npz`, TUM trajectory, or a log that `load_log`
            reads. A `.scen` file is also checked against its map where that lies in the same folder.
        resolution: see `load_map`; an image alone is checked with 1 m if none is given, and the report says so.
        subject: see `load_log`.

    Raises:
        MapFormatError, LogFormatError: the file cannot be used; the message names the file and what is wrong.
    """
    path = Path(path)
    if is_log(path):
        return _check_log(path, subject)
    refuse_subject(path, subject)
    kind = file_kind(path)
    if kind == "movingai_scenarios":
        return _check_scenarios(path)
    if kind == "barn_archive":
        return _check_archive(path)
    if kind == "tum":
        return _check_trajectory(path)
    details: list[str] = []
    remarks: list[str] = []
    if kind == "unknown":
        raise MapFormatError(
            f"{path}: unknown kind of file; known are {MAP_KINDS}, MovingAI .scen, BARN .npz, trajectory .tum, {LOG_KINDS}"
        )
    if kind == "image" and resolution is None:
        resolution = 1.0
        remarks.append("an image alone has no resolution, 1 m is assumed")
    if kind == "ros_map":
        fields = read_ros_yaml(path)
        details.append(f"mode {fields.mode}")
    if kind == "text_grid":
        drawn = load_text_grid(path, 1.0 if resolution is None else resolution)
        grid = drawn.grid
        for name, point in (("start", drawn.start), ("goal", drawn.goal)):
            if point is not None:
                details.append(f"{name} at ({point[0]:g}, {point[1]:g})")
    else:
        grid = load_map(path, resolution, remarks)
    return _map_report(path, kind, grid, details, remarks)


def _map_report(path: Path, kind: str, grid: OccupancyGrid, details: list[str], remarks: list[str]) -> FileReport:
    occupied, free, unknown = (float(np.mean(cells)) for cells in (grid.occupied, grid.free, grid.unknown))
    if free == 0:
        remarks.append("no cell is free")
    if occupied == 0:
        remarks.append("no cell is occupied")
    if unknown > 0:
        remarks.append(f"{unknown:.1%} of the cells are unknown: robots take them for free floor, unless allow_unknown is false")
    origin = grid.origin
    if origin.x or origin.y or origin.theta:
        details.append(f"origin ({origin.x:g}, {origin.y:g}, {origin.theta:g} rad)")
    return FileReport(path, kind, grid.shape, grid.resolution, grid.size, occupied, free, unknown, tuple(details), tuple(remarks))


def _check_scenarios(path: Path) -> FileReport:
    scenarios = load_scenarios(path)
    details = [f"{len(scenarios)} queries"]
    remarks = [] if scenarios else ["the file holds no query"]
    for name in sorted({line.map_name for line in scenarios}):
        map_path = path.parent / Path(name.replace("\\", "/")).name
        if os.path.isfile(map_path):
            details.append(f"checked against {map_path.name}")
            remarks += _contradictions([line for line in scenarios if line.map_name == name], load_movingai_map(map_path))
        else:
            details.append(f"map {name} is not in the same folder")
    return FileReport(path, "movingai_scenarios", details=tuple(details), warnings=tuple(remarks))


def _contradictions(scenarios: list[ScenarioLine], grid: OccupancyGrid) -> list[str]:
    """What a map says against queries about it."""
    rows, cols = grid.shape
    sizes = {(line.width, line.height) for line in scenarios} - {(cols, rows)}
    if sizes:
        width, height = min(sizes)
        return [f"queries for a map of {width} x {height} cells, but the map has {cols} x {rows}"]
    blocked = sum(bool(grid.occupied[cell]) for line in scenarios for cell in (line.start_cell, line.goal_cell))
    return [f"{blocked} starts and goals lie in blocked cells"] if blocked else []


def _check_archive(path: Path) -> FileReport:
    failures = []
    for load, what in ((load_barn_grids, "grids"), (load_barn_cylinders, "worlds of cylinders"), (load_barn_paths, "paths")):
        try:
            return FileReport(path, "barn_archive", details=(f"{len(load(path))} {what}",))
        except MapFormatError as failure:
            failures.append(str(failure).removeprefix(f"{path}: "))
    raise MapFormatError(f"{path}: neither BARN grids, worlds nor paths: {'; '.join(dict.fromkeys(failures))}")


def _check_trajectory(path: Path) -> FileReport:
    trajectory = read_tum(path)
    if not trajectory.times.size:
        return FileReport(path, "tum", details=("0 poses",), warnings=("the file holds no pose",))
    duration = trajectory.times[-1] - trajectory.times[0]
    length = np.hypot(*np.diff(trajectory.poses[:, :2], axis=0).T).sum()
    return FileReport(path, "tum", details=(f"{trajectory.times.size} poses", f"{duration:.3f} s", f"{length:.3f} m"))


def _check_log(path: Path, subject: int | None) -> FileReport:
    log = load_log(path, subject)
    first, last = log.observations[0].time, log.observations[-1].time
    scans = sum(len(observation.scans) for observation in log.observations)
    sightings = sum(len(observation.landmarks) for observation in log.observations)
    details = [
        f"{len(log.observations)} observations in {last - first:.1f} s",
        f"{scans} scans",
        f"{sightings} landmarks seen",
    ]
    if log.truth is not None:
        details.append("with ground truth")
    remarks = [*log.notes, *(f"skipped {problem}" for problem in log.skipped[:_MOST_SKIPPED])]
    if len(log.skipped) > _MOST_SKIPPED:
        remarks.append(f"... and {len(log.skipped) - _MOST_SKIPPED} more")
    return FileReport(path, f"{log.kind} log", details=tuple(details), warnings=tuple(remarks))


_MOST_SKIPPED = 5  # problems of a log that are shown
