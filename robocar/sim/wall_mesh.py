"""One mesh of all walls, for cameras only.

A software renderer pays for each geom it draws, so a map of ten thousand boxes takes 50 ms a picture; one mesh of the same
surfaces takes 7 ms. Contacts and rays keep to the boxes, which are cheaper there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robocar.core import Array
from robocar.sim.cover import Rectangles


def outline(blocked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Straight pieces of the border between blocked cells and the rest, the blocked side on the left.

    Args:
        blocked: (rows, cols); beyond the grid nothing is blocked.

    Returns:
        (n, 2, 2): start and end as (x, y) = (column, row) of cell corners; pieces end where the border turns.
    """
    padded = np.pad(blocked, 1).astype(np.int8)
    pieces = []
    for axis in (0, 1):
        steps = np.diff(padded, axis=axis)  # +1: blocked above (right of) the line, -1: blocked below (left of) it
        lines = steps if axis == 0 else steps.T  # one line of cell borders per row; its ends are 0, so no run goes on to the next
        flat = lines.ravel()
        bounds = np.flatnonzero(np.diff(flat)) + 1
        start, end = bounds[:-1], bounds[1:]
        run = flat[start] != 0
        start, end = start[run], end[run]
        line, width = start // lines.shape[1], lines.shape[1]
        along = np.stack([start % width - 1, start % width - 1 + end - start], axis=1)  # less the padding
        across = np.stack([line, line], axis=1)
        piece = np.stack([along, across] if axis == 0 else [across, along], axis=-1)
        backwards = (flat[start] > 0) == (axis == 1)
        piece[backwards] = piece[backwards, ::-1]
        pieces.append(piece)
    return np.concatenate(pieces).astype(np.int64)


def wall_mesh(
    blocked: NDArray[np.bool_], rectangles: Rectangles, resolution: float, height: float
) -> tuple[Array, NDArray[np.int64]]:
    """Upright sides along the outline and the tops of the rectangles, as triangles in the grid's frame.

    Args:
        blocked: (rows, cols).
        rectangles: their cover, (n, 4).
        resolution, height: of a cell and of the walls [m].

    Returns:
        Vertices (v, 3) [m] and triangles (t, 3), counter-clockwise seen from outside.
    """
    sides = outline(blocked) * resolution
    quads = np.zeros((len(sides) + len(rectangles), 4, 3))
    quads[: len(sides), :, :2] = sides[:, [0, 1, 1, 0]]
    quads[: len(sides), 2:, 2] = height
    r0, c0, r1, c1 = rectangles.T * resolution
    quads[len(sides) :, :, 0] = np.stack([c0, c1, c1, c0], axis=1)
    quads[len(sides) :, :, 1] = np.stack([r0, r0, r1, r1], axis=1)
    quads[len(sides) :, :, 2] = height
    corner = 4 * np.arange(len(quads))[:, None]
    return quads.reshape(-1, 3), np.concatenate([corner + np.array([0, 1, 2]), corner + np.array([0, 2, 3])])
