"""What the searches on a costmap's cells share: the cost of a step, the open list, checked endpoints, paths and traces.

A step between neighbouring cells a and b costs its length times 1 + (c_a + c_b) / 2 / 252 [m]: 1 in free space, 2 at the highest
cost that is not blocked. That is the line integral of 1 + c / 252 along the step, so costs of grid steps and of straight
segments across many cells (`robocar.planners.geometry.line_of_sight`) compare. Blocked cells (253 and above) are not entered, and
a diagonal step needs both cells beside it free.

Costs are whole numbers: ties are then exact, results do not depend on the order of additions, and an incremental search can be
compared with one from scratch bit by bit. 8119 / 5741 is a convergent of the square root of two, relative error 1.1e-8.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core import INSCRIBED, LETHAL, NO_INFORMATION, Array, Costmap, Field, Path
from robocar.core.errors import GoalOccupied, NoPathFound, OutsideMap, PlanningError, StartOccupied
from robocar.core.trace import LazyTrace

STRAIGHT, DIAGONAL = 5741, 8119
"""Lengths of the two steps of a grid in its whole-number measure."""

CELL_SCALE = 504
"""Twice 252: a step's cost is its length times CELL_SCALE + c_a + c_b, to be divided by CELL_SCALE."""

INFINITE = 1 << 60

Integer: TypeAlias = int | np.signedinteger[Any]
"""What a compiled function takes and returns for a whole number."""

# Neighbours in the order of the direction codes 0..7: along the axes first, then the diagonals. The diagonal 4 + k lies between
# the axes k and (k + 1) % 4.
ROW_STEPS = np.array([0, 1, 0, -1, 1, 1, -1, -1], dtype=np.int64)
COL_STEPS = np.array([1, 0, -1, 0, 1, -1, -1, 1], dtype=np.int64)
STEP_LENGTHS = np.hypot(ROW_STEPS, COL_STEPS)  # [cells]


def padded(costmap: Costmap) -> NDArray[np.uint8]:
    """The costs inside a frame of blocked cells, (rows + 2, cols + 2): neighbours of map cells need no bounds check."""
    return np.pad(costmap.data, 1, constant_values=NO_INFORMATION)


@njit(cache=True)
def doubled(array: NDArray) -> NDArray:
    """A copy with room for twice as many entries."""
    bigger = np.empty(2 * len(array), dtype=array.dtype)
    bigger[: len(array)] = array
    return bigger


def endpoints(costmap: Costmap, start: ArrayLike, goal: ArrayLike) -> tuple[tuple[int, int], tuple[int, int]]:
    """The cells (row, col) of start and goal, both (2,) [m].

    Raises:
        OutsideMap: one of them is no point of the map.
        StartOccupied, GoalOccupied: the robot does not fit there; the message says why and where the nearest free cell is.
    """
    (x0, y0), (x1, y1) = _two_numbers(start, "start"), _two_numbers(goal, "goal")
    (r0, c0), (r1, c1) = costmap.cell_from_world(np.array([[x0, y0], [x1, y1]])).tolist()
    _check_free(costmap, (r0, c0), (x0, y0), "start", StartOccupied)
    _check_free(costmap, (r1, c1), (x1, y1), "goal", GoalOccupied)
    return (r0, c0), (r1, c1)


def _check_free(
    costmap: Costmap, cell: tuple[int, int], point: tuple[float, float], what: str, error: type[PlanningError]
) -> None:
    rows, cols = costmap.shape
    if not (0 <= cell[0] < rows and 0 <= cell[1] < cols):
        costmap.cell_inside(point, what)  # raises OutsideMap
    cost = int(costmap.data[cell])
    if cost < INSCRIBED:
        return
    reason = {
        INSCRIBED: "an obstacle is nearer than the robot's inscribed radius",
        LETHAL: "it lies in an obstacle",
        NO_INFORMATION: "it lies in unknown space",
    }[cost]
    nearest = nearest_free(costmap, point)
    advice = "no cell of the map is free"
    if nearest is not None:
        advice = f"the nearest free cell is at ({nearest[0]:.3f}, {nearest[1]:.3f}), {math.dist(point, nearest):.3f} m away"
    raise error(f"the robot does not fit at the {what} ({point[0]:.3f}, {point[1]:.3f}): {reason} (cost {cost}); {advice}")


def _two_numbers(point: ArrayLike, what: str) -> tuple[float, float]:
    values = np.asarray(point, dtype=float)
    if values.shape == (2,):
        x, y = values.tolist()
        if math.isfinite(x) and math.isfinite(y):
            return x, y
    raise OutsideMap(f"the {what} {values.tolist()} is no point of the map: it takes two finite numbers [m]")


def nearest_free(costmap: Costmap, point: ArrayLike) -> Array | None:
    """Centre (2,) [m] of the free cell nearest to a world point (2,) [m], or None where every cell is blocked."""
    rows, cols = np.nonzero(~costmap.blocked)
    if len(rows) == 0:
        return None
    x, y = costmap.grid_from_world(point)
    best = np.argmin((cols + 0.5 - x) ** 2 + (rows + 0.5 - y) ** 2)
    return costmap.world_from_cell((rows[best], cols[best]))


def no_path(start: ArrayLike, goal: ArrayLike, expanded: int) -> NoPathFound:
    """The error of a complete search that ended without a path."""
    (x0, y0), (x1, y1) = np.asarray(start), np.asarray(goal)
    return NoPathFound(
        f"no way from ({x0:.3f}, {y0:.3f}) to ({x1:.3f}, {y1:.3f}) that is wide enough for the robot; cells searched: {expanded}"
    )


def path_through(costmap: Costmap, cells: NDArray, start: ArrayLike, goal: ArrayLike) -> Path:
    """Path from the exact start through the centres of the cells to the exact goal.

    The first and the last centre give way to `start` and `goal`: a cell and its neighbour are convex together (and so are the
    four free cells around a diagonal step), so the segments from there stay in free cells.

    Args:
        cells: (n, 2) as (row, col), neighbours in sequence, from the start's to the goal's.
    """
    points = np.empty((max(2, len(cells)), 2))
    points[1:-1] = costmap.world_from_cell(cells[1:-1])
    points[0], points[-1] = start, goal
    points.flags.writeable = False  # so that the path need not copy it
    return Path(points)


def search_trace(costmap: Costmap, cells: NDArray[np.signedinteger[Any]], order: NDArray[np.signedinteger[Any]]) -> LazyTrace:
    """The heat map `search`: closed cells by the order of their (last) expansion, open cells at the highest value.

    Args:
        cells: that were generated, (n,), as flat indices of the padded grid; the last entry counts where a cell is there twice.
        order: of their expansions, (n,), negative for cells that were not expanded.
    """

    def field() -> Field:
        rows, cols = costmap.shape
        heat = np.full((rows + 2) * (cols + 2), np.nan, dtype=np.float32)
        heat[cells] = np.where(order >= 0, order, order.max(initial=-1) + 1)
        return Field(costmap.with_data(heat.reshape(rows + 2, cols + 2)[1:-1, 1:-1]))

    return LazyTrace({"search": field})
