"""Worlds of the BARN family, made here: for who has no data, and for as many as one wants.

Source of the rules: Perille, Truong, Xiao and Stone, "Benchmarking Metric Ground Navigation" (SSRR 2020), section on the dataset:
a cellular automaton on 30 x 30 cells, 12 sets of parameters (fill and number of smoothings), 25 worlds of each; worlds without a
way are not used. How a reference length is measured: `reference`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate, label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from robocar.core import Array, ParameterError, frozen_array
from robocar.formats.barn import CELL_SIZE, GOAL, START, BarnReference, BarnWorld

FIELD = 30  # cells a side
CORRIDOR = 34  # cells between the back wall and the field
RADIUS = CELL_SIZE / 2  # of the cylinders [m]
ROOM = 0.30  # [m] clearance that some way through each world keeps all along
TOP_SPEED = 2.0  # [m/s] of the benchmark's robot, which the optimal time assumes
PARAMETER_SETS: tuple[tuple[float, int], ...] = tuple(itertools.product((0.15, 0.20, 0.25, 0.30), (2, 3, 4)))
"""Share of filled cells in the noise, and number of smoothings."""

_X0 = -FIELD * CELL_SIZE + RADIUS  # [m] of the first row of cells; rows run along x, columns along y
_Y0 = CORRIDOR * CELL_SIZE + RADIUS
_RASTER = 0.05  # [m] on which clearances are measured


@dataclass(frozen=True, slots=True, eq=False)
class GeneratedWorld:
    """A world, its reference path (n, 2) [m] from start to goal, and its reference numbers."""

    world: BarnWorld
    path: Array
    reference: BarnReference


def generate_barn_world(rng: np.random.Generator, fill: float, smoothings: int, tries: int = 1000) -> GeneratedWorld:
    """A world of the family.

    Cells are filled with the probability `fill`, the two sides wholly. In each smoothing a cell is filled if more than 4 of its 8
    neighbours are, emptied if fewer than 2 are; beyond the sides all counts as filled, beyond the two ends as empty. Blobs are
    hollow: a cell whose 8 neighbours are filled carries no cylinder. A corridor with a back wall leads to the field.

    Args:
        rng: decides everything that is random.
        fill: share of filled cells in the noise, in [0, 1).
        smoothings: rounds of the automaton.
        tries: worlds that are drawn until one has a way with `ROOM` to both sides.

    Raises:
        ParameterError: a number outside its range, or so much fill that no world had a way.
    """
    if not 0.0 <= fill < 1.0:
        raise ParameterError(f"fill {fill} must be a share of the cells, from 0 to below 1")
    if smoothings < 0 or tries < 1:
        raise ParameterError(f"smoothings {smoothings} must not be negative, and tries {tries} at least 1")
    for _ in range(tries):
        world = barn_cylinders(automaton(rng, fill, smoothings))
        made = reference(world)
        if made is not None:
            return GeneratedWorld(world, *made)
    raise ParameterError(f"no world with a way in {tries} tries: fill {fill} is too much with {smoothings} smoothings")


def automaton(rng: np.random.Generator, fill: float, smoothings: int) -> NDArray[np.bool_]:
    """The filled cells of a field, (FIELD, FIELD), row along x and column along y."""
    filled = rng.random((FIELD, FIELD)) < fill
    filled[[0, -1]] = True
    for _ in range(smoothings):
        padded = np.pad(np.pad(filled, ((0, 0), (1, 1))), ((1, 1), (0, 0)), constant_values=True)
        neighbours = correlate(padded.astype(int), np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]]), mode="constant")[1:-1, 1:-1]
        filled = (filled | (neighbours > 4)) & (neighbours >= 2)
    return filled


def barn_cylinders(filled: NDArray[np.bool_]) -> BarnWorld:
    """The cylinders of a field (FIELD, FIELD) and of the corridor before it."""
    if filled.shape != (FIELD, FIELD):
        raise ParameterError(f"a field has {FIELD} x {FIELD} cells, not {filled.shape}")
    inner = correlate(filled.astype(int), np.ones((3, 3), dtype=int), mode="constant") == 9
    field = np.argwhere(filled & ~inner) + np.array([0, CORRIDOR])
    sides = np.array([(row, col) for row in (0, FIELD - 1) for col in range(CORRIDOR)])
    back = np.array([(row, 0) for row in range(1, FIELD - 1)])
    cells = np.concatenate([field, sides, back])
    centres = cells * CELL_SIZE + np.array([_X0, RADIUS])
    return BarnWorld(np.column_stack([centres, np.full(len(cells), RADIUS)]))


def reference(world: BarnWorld) -> tuple[Array, BarnReference] | None:
    """Reference path and numbers, None where no way has `ROOM`.

    The path is the shortest from start to goal whose part in the field goes from cell to neighbouring cell, all with `ROOM` to
    the cylinders, from the first column to the last. The benchmark's own paths are such, not always shortest ones.
    """
    tree = KDTree(world.cylinders[:, :2])
    rows, cols = np.indices((FIELD, FIELD))
    centres = np.stack([_X0 + CELL_SIZE * rows, _Y0 + CELL_SIZE * cols], axis=-1)  # (FIELD, FIELD, 2)
    free = tree.query(centres)[0] - RADIUS >= ROOM
    number = np.arange(FIELD * FIELD).reshape(FIELD, FIELD)
    edges = []
    for step in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: FIELD - step[0], max(0, -step[1]) : FIELD - max(0, step[1])]
        there = np.s_[step[0] :, max(0, step[1]) : FIELD + min(0, step[1])]
        both = free[here] & free[there]
        edges.append((number[here][both], number[there][both], np.full(both.sum(), CELL_SIZE * math.hypot(*step))))
    first, last = (number[:, column][free[:, column]] for column in (0, -1))
    flat = centres.reshape(-1, 2)
    start, goal = FIELD * FIELD, FIELD * FIELD + 1
    edges.append((np.full(len(first), start), first, np.linalg.norm(flat[first] - START.position, axis=1)))
    edges.append((last, np.full(len(last), goal), np.linalg.norm(flat[last] - GOAL, axis=1)))
    a, b, length = (np.concatenate(part) for part in zip(*edges, strict=True))
    graph = coo_array((length, (a, b)), shape=(goal + 1, goal + 1)).tocsr()
    lengths, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    if not math.isfinite(lengths[goal]):
        return None
    cells = [int(before[goal])]
    while before[cells[-1]] != start:
        cells.append(int(before[cells[-1]]))
    path = np.concatenate([[START.position], flat[cells[::-1]], [GOAL]])
    total = float(lengths[goal])
    clearance = widest_clearance(world)
    return frozen_array(path), BarnReference(len(world.cylinders), len(cells), total, total / TOP_SPEED, clearance)


def widest_clearance(world: BarnWorld) -> float:
    """The largest clearance that some way from the corridor to beyond the field keeps all along [m].

    By bisection on a raster of 5 cm, whose points miss the middle of a gap by up to 2.5 cm.
    """
    x = np.arange(_X0, -RADIUS, _RASTER)
    y = np.arange(_Y0 - 1.0, _Y0 + FIELD * CELL_SIZE, _RASTER)
    room = KDTree(world.cylinders[:, :2]).query(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1))[0] - RADIUS
    low, high = 0.0, float(room.max())
    for _ in range(20):
        middle = 0.5 * (low + high)
        parts: NDArray[np.int32] = np.empty(room.shape, dtype=np.int32)
        label(room >= middle, structure=np.ones((3, 3)), output=parts)
        through = np.intersect1d(parts[:, 0], parts[:, -1])
        low, high = (middle, high) if np.any(through > 0) else (low, middle)
    return low
