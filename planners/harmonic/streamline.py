"""From a harmonic potential to a path: gradient descent on cells, and streamlines between them.

Both climb w, which is the same as descending the paper's u = 1 - w.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from robocar.core import Array, NoPathFound
from robocar.planners.harmonic.laplace.solver import Potential

_NO_EXPONENT = np.zeros((1, 1), np.int32)


def descend(potential: Potential, start: tuple[int, int]) -> NDArray[np.intp]:
    """Cells from `start` to the goal by gradient descent search (Saudi and Sulaiman, section "Algoritma perancangan laluan").

    Each step goes to the neighbour of the eight with the largest w; diagonally only where both cells beside the step are free.
    A mean is below its largest term, so there always is a better neighbour, unless the potential is flat: the error says so
    instead of going round in circles.

    Args:
        start: (row, col).

    Returns:
        (n, 2) as (row, col), n >= 1.

    Raises:
        OutsideMap: `start` is not on the grid.
        NoPathFound: `start` is not connected to the goal, or the potential is flat there to the last digit.
    """
    potential.problem.require_connected(start)
    mantissa, exponent = _fields(potential)
    cells, arrived = _descend(mantissa, exponent, potential.problem.inverse_degree, start[0] + 1, start[1] + 1)
    if not arrived:
        raise NoPathFound(
            f"the potential is flat at cell ({cells[-1, 0] - 1}, {cells[-1, 1] - 1}): no neighbour lies lower; "
            "a smaller tolerance, or walls that absorb, tells them apart"
        )
    return cells - 1


def streamline(potential: Potential, start: ArrayLike, max_step: float = 0.5, max_length: float = math.inf) -> Array:
    """The way of steepest descent through the potential interpolated between cells.

    The gradient, bilinear between the cells' central differences, is followed by the midpoint rule; the step is halved where
    the direction turns by more than 0.2 rad within it, and grows where it hardly turns. Every point lies on free floor, every
    segment crosses free cells only, and w rises from point to point. Where no such step is found (at corners of walls one cell
    thin), the line goes to the centre of the best neighbouring cell.

    Args:
        start: in grid coordinates, (2,) as (col, row) in cells; cell (0, 0) is the square from (0, 0) to (1, 1).
        max_step: longest step, at most 0.5 [cells].
        max_length: it ends with the step that goes beyond [cells].

    Returns:
        Points in grid coordinates, (n, 2), from `start` to the centre of the goal's cell, or as far as `max_length` goes.

    Raises:
        OutsideMap, NoPathFound: as `descend`.
    """
    x, y = (float(v) for v in np.asarray(start, dtype=float))
    cell = (math.floor(y), math.floor(x))
    potential.problem.require_connected(cell)
    mantissa, exponent = _fields(potential)
    reflecting = not potential.problem.plain
    inverse_degree = potential.problem.inverse_degree
    points, arrived = _streamline(
        mantissa, exponent, inverse_degree, reflecting, x + 1.0, y + 1.0, min(max_step, 0.5), max_length
    )
    line: Array = np.subtract(points, 1.0, dtype=float)
    if arrived:
        return line
    # what is left of the way on cells: the last point's cell and its neighbours are convex in pairs
    rest = descend(potential, (math.floor(line[-1, 1]), math.floor(line[-1, 0])))[1:]
    return np.concatenate([line, rest[:, ::-1] + 0.5], dtype=float)


def _fields(potential: Potential) -> tuple[Array, NDArray[np.int32]]:
    return potential.mantissa, _NO_EXPONENT if potential.exponent is None else potential.exponent


@njit(cache=True)
def _relative(mantissa, exponent, r, c, power):
    """w at a cell in units of 2^power."""
    if exponent.size == 1:
        return mantissa[r, c]
    if mantissa[r, c] == 0.0:
        return 0.0
    return math.ldexp(mantissa[r, c], exponent[r, c] - power)


@njit(cache=True)
def _is_free(mantissa, r, c):
    return mantissa[r, c] > 0.0


@njit(cache=True)
def _best_neighbour(mantissa, exponent, r, c):
    """The neighbour with the largest w and whether that is above the cell's own."""
    power = exponent[r, c] if exponent.size > 1 else 0
    best = _relative(mantissa, exponent, r, c, power)
    best_r, best_c = r, c
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            if dr != 0 and dc != 0 and not (_is_free(mantissa, r + dr, c) and _is_free(mantissa, r, c + dc)):
                continue
            value = _relative(mantissa, exponent, r + dr, c + dc, power)
            if value > best:
                best, best_r, best_c = value, r + dr, c + dc
    return best_r, best_c


@njit(cache=True)
def _descend(mantissa, exponent, inverse_degree, r, c):
    cells = [(r, c)]
    while inverse_degree[r, c] > 0.0:  # 0 at the goal
        r2, c2 = _best_neighbour(mantissa, exponent, r, c)
        if r2 == r and c2 == c:
            break
        r, c = r2, c2
        cells.append((r, c))
    out = np.empty((len(cells), 2), np.intp)
    for k in range(len(cells)):
        out[k, 0], out[k, 1] = cells[k]
    return out, inverse_degree[r, c] == 0.0


@njit(cache=True)
def _highest(exponent, mantissa, r, c):
    """Exponent of the largest w of four cells: others are taken relative to it."""
    if exponent.size == 1:
        return 0
    power = -(1 << 30)
    for k in range(4):
        r1, c1 = r + k // 2, c + k % 2
        if mantissa[r1, c1] > 0.0:
            power = max(power, exponent[r1, c1])
    return power


@njit(cache=True)
def _value(mantissa, exponent, x, y):
    """Bilinear w (0 in walls) in units of two to the power that is returned with it."""
    c, r = math.floor(x - 0.5), math.floor(y - 0.5)
    power = _highest(exponent, mantissa, r, c)
    s, t = x - 0.5 - c, y - 0.5 - r
    low = (1 - s) * _relative(mantissa, exponent, r, c, power) + s * _relative(mantissa, exponent, r, c + 1, power)
    high = (1 - s) * _relative(mantissa, exponent, r + 1, c, power) + s * _relative(mantissa, exponent, r + 1, c + 1, power)
    return (1 - t) * low + t * high, power


@njit(cache=True)
def _direction(mantissa, exponent, reflecting, x, y):
    """Unit vector along the gradient: central differences at the free cells around the point, interpolated bilinearly."""
    c, r = math.floor(x - 0.5), math.floor(y - 0.5)
    power = _highest(exponent, mantissa, r, c)
    s, t = x - 0.5 - c, y - 0.5 - r
    gx, gy = 0.0, 0.0
    for k in range(4):
        r1, c1 = r + k // 2, c + k % 2
        own = _relative(mantissa, exponent, r1, c1, power)
        weight = (t if k >= 2 else 1 - t) * (s if k % 2 == 1 else 1 - s)
        if own > 0.0:
            # absorbing walls hold 0; before reflecting ones the potential goes on as it is
            wall = own if reflecting else 0.0
            right = _relative(mantissa, exponent, r1, c1 + 1, power)
            left = _relative(mantissa, exponent, r1, c1 - 1, power)
            above = _relative(mantissa, exponent, r1 + 1, c1, power)
            below = _relative(mantissa, exponent, r1 - 1, c1, power)
            gx += weight * ((right if right > 0.0 else wall) - (left if left > 0.0 else wall))
            gy += weight * ((above if above > 0.0 else wall) - (below if below > 0.0 else wall))
    size = math.hypot(gx, gy)
    if size == 0.0:
        return 0.0, 0.0
    return gx / size, gy / size


@njit(cache=True)
def _clear(mantissa, x, y, x2, y2):
    """Whether a segment of at most half a cell keeps to free cells."""
    r, c, r2, c2 = math.floor(y), math.floor(x), math.floor(y2), math.floor(x2)
    if not _is_free(mantissa, r2, c2):
        return False
    return r == r2 or c == c2 or (_is_free(mantissa, r, c2) and _is_free(mantissa, r2, c))


@njit(cache=True)
def _rises(value, power, value2, power2):
    return value2 * 2.0 ** min(max(power2 - power, -1000), 1000) > value


@njit(cache=True)
def _streamline(mantissa, exponent, inverse_degree, reflecting, x, y, max_step, max_length):
    points = [(x, y)]
    step = 0.5 * max_step
    detours = 0
    length = 0.0
    while length < max_length:
        r, c = math.floor(y), math.floor(x)
        if inverse_degree[r, c] == 0.0:  # the goal's cell
            points.append((c + 0.5, r + 0.5))
            break
        dx, dy = _direction(mantissa, exponent, reflecting, x, y)
        value, power = _value(mantissa, exponent, x, y)
        moved = False
        while step > 1e-3 and (dx != 0.0 or dy != 0.0):
            x1, y1 = x + 0.5 * step * dx, y + 0.5 * step * dy
            if _clear(mantissa, x, y, x1, y1):
                mx, my = _direction(mantissa, exponent, reflecting, x1, y1)
                straightness = dx * mx + dy * my
                x2, y2 = x + step * mx, y + step * my
                if straightness > 0.98 and _clear(mantissa, x, y, x2, y2):
                    value2, power2 = _value(mantissa, exponent, x2, y2)
                    if _rises(value, power, value2, power2):
                        x, y = x2, y2
                        moved = True
                        if straightness > 0.999:
                            step = min(1.5 * step, max_step)
                        break
            step *= 0.5
        if not moved:
            detours += 1
            r2, c2 = _best_neighbour(mantissa, exponent, r, c)
            if (r2 == r and c2 == c) or detours > 1000:
                return _as_array(points), False
            x, y = c2 + 0.5, r2 + 0.5
            step = 0.5 * max_step
        length += math.hypot(x - points[-1][0], y - points[-1][1])
        points.append((x, y))
    return _as_array(points), True


@njit(cache=True)
def _as_array(points):
    out = np.empty((len(points), 2))
    for k in range(len(points)):
        out[k, 0], out[k, 1] = points[k]
    return out
