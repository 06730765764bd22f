"""Paths on the lattice of cells whose legs, from each centre to the next, can be driven too."""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from robocar.core import Array, Plan
from robocar.planners.search.a_star import AStar
from robocar.planners.search.car_lattice import CarLattice
from robocar.planners.search.obstacle_memory import ObstacleMemory

Cell: TypeAlias = tuple[int, int]


def search_clear_legs(
    search: AStar,
    lattice: CarLattice,
    memory: ObstacleMemory,
    half_width: float,
    blocked: NDArray[np.bool_],
    ends: tuple[Cell, Cell],
) -> tuple[Plan, list[Array]]:
    """The path between two cells on which the car can also drive from each centre to the next, and its points.

    Cells are free where the car can turn; what stands between two of them shows up only when a path uses both. The cell
    behind such a leg is then taken as blocked, and the search repeated.

    Args:
        half_width: of the strip that must be free [m].
        blocked: cells (rows, cols).
        ends: of the path, as (row, col).

    Raises:
        PlanningError: there is none.
    """
    blocked, (start, end) = blocked.copy(), ends
    while True:
        costmap = lattice.costmap(blocked)
        plan = search.plan(costmap, costmap.world_from_cell(start), costmap.world_from_cell(end))
        points, obstructed = _legs(lattice, memory, half_width, plan.path.points)
        if obstructed is None:
            return plan, points
        blocked[obstructed if obstructed != end else lattice.cell(points[-1])] = True


def _legs(lattice: CarLattice, memory: ObstacleMemory, half_width: float, points: Array) -> tuple[list[Array], Cell | None]:
    """The points of a path up to the first leg that is obstructed, and the cell that this leg leads to.

    A diagonal leg between whose cells something stands is driven around the corner where that is clear.
    """
    way = [points[0]]
    for here, there in pairwise(points):
        if memory.way_blocked(here, there, half_width, 0.0):
            (r0, c0), (r1, c1) = lattice.cell(here), lattice.cell(there)
            corners = [np.array(lattice.centre(cell)) for cell in ((r0, c1), (r1, c0)) if r0 != r1 and c0 != c1]
            for corner in corners:
                legs = ((here, corner), (corner, there))
                if not any(memory.way_blocked(a, b, half_width, 0.0) for a, b in legs):
                    way.append(corner)
                    break
            else:
                return way, (r1, c1)
        way.append(there)
    return way, None
