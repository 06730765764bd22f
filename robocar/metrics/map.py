"""How good a map is: one function per question, on grids of any place, rotation and resolution.

Everything is judged on the cells of the map that was drawn, made large enough to hold the true map: what the true map says about
such a cell is what it says at the cell's centre. A value that does not exist (nothing occupied, nothing in scope) is None.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core import SE2, UNKNOWN, Array, Footprint, OccupancyGrid
from robocar.core.distance import ClearanceField, obstacle_distance
from robocar.core.rays import advance, start_ray
from robocar.metrics.declaration import Declaration, Tolerance, metrics
from robocar.metrics.run_log import DrawnMap

Cells = NDArray[np.bool_]
MAX_CELLS = 1 << 25
"""Larger maps are not judged: 290 m x 290 m at 5 cm."""

_RAY_SPACING = 0.6  # [cells] between neighbouring rays where they end


@dataclass(frozen=True, slots=True, eq=False)
class MapScore:
    """See `score`."""

    accuracy: float | None
    precision: float | None
    recall: float | None
    f1: float | None
    iou: float | None
    unknown: float | None


@njit(cache=True)
def _sample(source: NDArray, target: NDArray, x: float, y: float, c: float, s: float, scale: float) -> None:
    """Fills `target` with what `source` holds at its cells' centres; source_from_target in cells: x, y, cos, sin, scale."""
    for row in range(target.shape[0]):
        for col in range(target.shape[1]):
            u, v = (col + 0.5) * scale, (row + 0.5) * scale
            i, j = math.floor(y + s * u + c * v), math.floor(x + c * u - s * v)
            if 0 <= i < source.shape[0] and 0 <= j < source.shape[1]:
                target[row, col] = source[i, j]


def on_common_cells(drawn: OccupancyGrid, truth: OccupancyGrid) -> tuple[OccupancyGrid, OccupancyGrid] | None:
    """Both maps on the cells of `drawn`, enlarged by unknown cells until they hold all of `truth`.

    None where that would take more than `MAX_CELLS` cells.
    """
    corners = drawn.grid_from_world(truth.corners())
    low = np.floor(np.minimum(corners.min(axis=0), 0.0) + 1e-9).astype(int)
    high = np.ceil(np.maximum(corners.max(axis=0), np.array(drawn.shape[::-1], dtype=float)) - 1e-9).astype(int)
    cols, rows = (int(n) for n in high - low)
    if rows * cols > MAX_CELLS:
        return None
    data = np.full((rows, cols), UNKNOWN, dtype=np.int8)
    data[-low[1] : -low[1] + drawn.shape[0], -low[0] : -low[0] + drawn.shape[1]] = drawn.data
    origin = drawn.origin @ SE2(low[0] * drawn.resolution, low[1] * drawn.resolution)
    true = np.full((rows, cols), UNKNOWN, dtype=np.int8)
    at = truth.origin.inverse() @ origin
    size = truth.resolution
    turn = math.cos(at.theta), math.sin(at.theta)
    _sample(truth.data, true, at.x / size, at.y / size, *turn, drawn.resolution / size)
    return OccupancyGrid(data, drawn.resolution, origin), OccupancyGrid(true, drawn.resolution, origin)


@njit(cache=True)
def _see(occupied: Cells, seen: Cells, places: Array, reach: float, opening: float, rays: int) -> None:
    """Marks in `seen` all cells along rays from the poses (n, 3) [cells, cells, rad], up to and with the first occupied one."""
    rows, cols = occupied.shape
    for p in range(len(places)):
        for k in range(rays):
            angle = places[p, 2] + opening * ((k + 0.5) / rays - 0.5)
            ray = start_ray(places[p, 0], places[p, 1], math.cos(angle), math.sin(angle))
            while ray.entered <= reach and 0 <= ray.row < rows and 0 <= ray.col < cols:
                seen[ray.row, ray.col] = True
                if occupied[ray.row, ray.col]:
                    break
                ray = advance(ray)


def visible_cells(truth: OccupancyGrid, poses: ArrayLike, reach: float, opening: float = math.tau) -> Cells:
    """Cells that a perfect eye sees from any of the poses: free ones, and the faces of obstacles.

    Args:
        poses: (n, 3) x, y [m], theta [rad]; of those in one cell that look the same way, within 5 degrees, one is looked from.
        reach: of the eye [m]; opening: of its field of view around the robot's x axis, 2 pi for all around [rad].

    Returns:
        (rows, cols)
    """
    poses = np.asarray(poses, dtype=float).reshape(-1, 3)
    headings = poses[:, 2] - truth.origin.theta if opening < math.tau else np.zeros(len(poses))
    local = np.column_stack([truth.grid_from_world(poses[:, :2]), headings])
    alike = np.floor(local / np.array([1.0, 1.0, math.radians(5.0)])).astype(np.int64)
    local = np.ascontiguousarray(local[np.unique(alike, axis=0, return_index=True)[1]]) if len(local) else local
    seen = np.zeros(truth.shape, dtype=bool)
    cells = reach / truth.resolution
    _see(truth.occupied, seen, local, cells, opening, max(8, math.ceil(opening * cells / _RAY_SPACING)))
    return seen


def _near(cells: Cells, tolerance: int) -> Cells:
    """Cells at most `tolerance` rows and columns away from one of these."""
    rows, cols = cells.shape
    padded = np.pad(cells, tolerance)
    result = np.zeros_like(cells)
    for i in range(2 * tolerance + 1):
        for j in range(2 * tolerance + 1):
            result |= padded[i : i + rows, j : j + cols]
    return result


def score(drawn: OccupancyGrid, truth: OccupancyGrid, scope: ArrayLike, tolerance: int = 1) -> MapScore:
    """Compares a map with the truth over the cells in `scope`; both on the same cells (`on_common_cells`).

    With O and O* the cells drawn and truly occupied, K the known ones of the scope, and N(.) all cells at most `tolerance` rows
    and columns away from a set:
    precision |O n N(O*)| / |O|, recall |O* n N(O)| / |O*|, f1 their harmonic mean, over the scope;
    iou |O n O*| / |O u O*| without tolerance; unknown the share of the scope that is not known;
    accuracy the share of K that is right: in O and N(O*), or drawn free and either truly free or in N(O).

    Args:
        scope: (rows, cols) bool; where the truth itself is unknown nothing is compared.
        tolerance: [cells].
    """
    scope = np.asarray(scope, dtype=bool) & ~truth.unknown
    occupied, true = drawn.occupied, truth.occupied
    near_true, near_drawn = _near(true, tolerance), _near(occupied, tolerance)
    precision = _share(occupied & near_true, occupied & scope)
    recall = _share(true & near_drawn, true & scope)
    f1 = None
    if precision is not None and recall is not None:
        f1 = 2.0 * precision * recall / (precision + recall) if precision + recall > 0.0 else 0.0
    elif recall is not None:
        f1 = 0.0  # there is something, and the map shows nothing
    known = scope & ~drawn.unknown
    right = (occupied & near_true) | (drawn.free & (truth.free | near_drawn))
    return MapScore(
        accuracy=_share(right, known),
        precision=precision,
        recall=recall,
        f1=f1,
        iou=_share(occupied & true, (occupied | true) & scope),
        unknown=_share(drawn.unknown, scope),
    )


def _share(cells: Cells, of: Cells) -> float | None:
    count = int(np.count_nonzero(of))
    return int(np.count_nonzero(cells & of)) / count if count else None


def reachable_cells(truth: OccupancyGrid, start: ArrayLike, radius: float) -> tuple[Cells, Cells]:
    """Where a disc of `radius` [m] can come to from `start` (2,) [m] through known free cells, and what it covers on the way.

    Returns:
        Cells of its centre, and all cells whose centre it covers in one of these, (rows, cols) each; empty where it does not fit.
    """
    free = ~truth.occupied & ~truth.unknown & (obstacle_distance(~truth.free, truth.resolution) >= radius)
    centres = np.zeros(truth.shape, dtype=bool)
    start = np.asarray(start, dtype=float)
    row, col = (int(i) for i in truth.cell_from_world(start))
    if truth.contains((row, col)):
        _fill(free, centres, row, col)
        if not centres.any() and ClearanceField(truth, ~truth.free).points(start[None])[0] >= radius:
            # Beside a wall the disc fits where it is, and not at the centre of the cell.
            for beside in product(range(max(0, row - 1), row + 2), range(max(0, col - 1), col + 2)):
                if truth.contains(beside):
                    _fill(free, centres, *beside)
    if not centres.any():
        return centres, centres.copy()
    covered = np.zeros(truth.shape, dtype=bool)
    _cover(covered, np.array(np.argwhere(centres)[:, ::-1] + 0.5, dtype=float, order="C"), radius / truth.resolution)
    return centres, covered


def explored_share(drawn: OccupancyGrid, truth: OccupancyGrid, start: ArrayLike, radius: float) -> float | None:
    """The metric `map/explored` of a map: the measure of an exploration. None where the disc has no room, or maps are too large.

    Args:
        start: where the robot began (2,) [m].
        radius: of its inscribed circle [m].
    """
    common = on_common_cells(drawn, truth)
    if common is None:
        return None
    return _share(~common[0].unknown, reachable_cells(common[1], start, radius)[1])


@njit(cache=True)
def _cover(covered: Cells, places: Array, radius: float) -> None:
    """Marks the cells whose centres lie within `radius` of one of the places (n, 2); lengths in cells."""
    rows, cols = covered.shape
    for p in range(len(places)):
        x, y = places[p]
        for row in range(max(0, math.floor(y - radius)), min(rows, math.floor(y + radius) + 1)):
            for col in range(max(0, math.floor(x - radius)), min(cols, math.floor(x + radius) + 1)):
                if math.hypot(col + 0.5 - x, row + 0.5 - y) <= radius:
                    covered[row, col] = True


@njit(cache=True)
def _fill(free: Cells, filled: Cells, row: int, col: int) -> None:
    """Marks the free cells that are connected by sides with (row, col)."""
    if not free[row, col]:
        return
    rows, cols = free.shape
    stack = [(row, col)]
    filled[row, col] = True
    while len(stack):
        r, c = stack.pop()
        for dr, dc in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            i, j = r + dr, c + dc
            if 0 <= i < rows and 0 <= j < cols and free[i, j] and not filled[i, j]:
                filled[i, j] = True
                stack.append((i, j))


_SHARE, _UNKNOWN = Tolerance("higher", absolute=0.02), Tolerance("lower", absolute=0.02)
_SCORES = {
    "accuracy": (_SHARE, "Share of the known cells that are right"),
    "precision": (_SHARE, "Share of the cells drawn occupied that truly are"),
    "recall": (_SHARE, "Share of the truly occupied cells that are drawn so"),
    "f1": (_SHARE, "Harmonic mean of precision and recall"),
    "iou": (_SHARE, "Occupied in both maps over occupied in either, without tolerance"),
    "unknown": (_UNKNOWN, "Share of the cells that the map does not know"),
}
_SCOPES = {
    "": "over the cells that came into the robot's view",
    "around_": "over all cells in sight of the driven path, whichever way the robot looked",
    "reachable_": "over all that is in sight of where the robot can come to; explorations only",
}


def _scores_of(scope: str) -> list[Declaration]:
    return [
        Declaration(f"map/{scope}{name}", "1", tolerance, f"{text}, {_SCOPES[scope]}.")
        for name, (tolerance, text) in _SCORES.items()
    ]


@metrics(
    [
        *_scores_of(""),
        *_scores_of("around_"),
        Declaration("map/path_blocked", "1", Tolerance("lower"), "Cells that the robot drove over and the map calls occupied."),
        Declaration(
            "map/explored",
            "1",
            Tolerance("higher", absolute=0.01),
            "Share that the map knows of the area that the disc of the robot's inscribed radius can cover from its start.",
        ),
        Declaration("map/known_area", "m^2", summary="Area of all known cells."),
        *_scores_of("reachable_"),
    ],
    needs=("drawn", "truth_poses", "footprint"),
    where="drawn",
)
def map_scores(drawn: DrawnMap, poses: ArrayLike, footprint: Footprint) -> dict[str, float | int | None]:
    """The metrics `map/*` of a run by name; see `score`.

    Args:
        poses: true ones, (n, 3) x, y [m], theta [rad].

    Returns:
        Without `map/reachable_*` where the task was another than to draw the whole map; nothing where the maps are too large
        (`on_common_cells`).
    """
    common = on_common_cells(drawn.grid, drawn.truth)
    if common is None:
        return {}
    grid, truth = common
    radius = footprint.inscribed_radius
    path = np.asarray(poses, dtype=float).reshape(-1, 3)
    path = path[np.isfinite(path).all(axis=1)]
    values: dict[str, float | int | None] = {}

    def add(scope: str, places: ArrayLike, opening: float) -> None:
        found = score(grid, truth, visible_cells(truth, places, drawn.eye.reach, opening))
        values.update({f"map/{scope}{name}": getattr(found, name) for name in _SCORES})

    add("", path, drawn.eye.opening)
    add("around_", path, math.tau)
    driven = np.zeros(grid.shape, dtype=bool)
    _cover(driven, np.array(grid.grid_from_world(path[:, :2]), order="C"), radius / grid.resolution)
    values["map/path_blocked"] = int(np.count_nonzero(driven & grid.occupied))
    centres, area = reachable_cells(truth, path[0, :2], radius) if len(path) else (np.zeros(truth.shape, dtype=bool),) * 2
    values["map/explored"] = _share(~grid.unknown, area)
    values["map/known_area"] = int(np.count_nonzero(~grid.unknown)) * grid.resolution**2
    if drawn.explored:
        places = truth.world_from_cell(_thinned(centres))
        add("reachable_", np.column_stack([places, np.zeros(len(places))]), math.tau)
    return values


def _thinned(cells: Cells, every: int = 4) -> NDArray[np.intp]:
    """One of these cells per square of `every` x `every`, (n, 2) as (row, col)."""
    at = np.argwhere(cells)
    return at[np.unique(at // every, axis=0, return_index=True)[1]] if len(at) else at
