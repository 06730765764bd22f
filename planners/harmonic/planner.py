"""Paths along harmonic functions (Connolly, Burns and Weiss 1990; Saudi and Sulaiman, quarter-sweep SOR).

The potential of `robocar.planners.harmonic.laplace` has one minimum, the goal; its streamline from anywhere gets there, and
keeps away from absorbing walls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robocar.core import LETHAL, Array, Context, Costmap, Field, Lines, NoPathFound, Path, Plan, Scalar
from robocar.core.compiling import warm_up
from robocar.core.trace import Drawable, LazyTrace
from robocar.planners.harmonic.laplace.problem import LaplaceProblem, laplace_problem
from robocar.planners.harmonic.laplace.solver import REACHABLE, Potential, solve
from robocar.planners.harmonic.streamline import descend, streamline
from robocar.planners.search.grid_search import endpoints, no_path


@dataclass(frozen=True, slots=True)
class HarmonicParameters:
    """
    Args:
        wall_conductance: 1: walls absorb (Dirichlet, the paper's: paths down the middle); 0: they reflect (Neumann: shorter
            paths along the walls; Karnik, Dasgupta and Eswaran 2002), which needs a `leak`; in between: both.
        leak: loss in free space, in units of the conductance between two cells. It gives the potential a slope where walls do
            not: the larger, the more it falls like exp(-sqrt(leak) distance) and paths become shortest ones.
        tolerance: on |w - mean of its neighbours| / w in every cell.
        smooth: the path is a streamline; else it goes from cell to cell (the paper's gradient descent search).
        max_step: of the streamline, at most 0.5 [cells].
    """

    wall_conductance: float = 1.0
    leak: float = 0.0
    tolerance: float = 1e-11
    smooth: bool = True
    max_step: float = 0.5

    def __post_init__(self) -> None:
        if not 0.0 <= self.wall_conductance <= 1.0:
            raise ValueError(f"wall_conductance goes from 0 (Neumann) to 1 (Dirichlet), not {self.wall_conductance}")
        if not 0.0 <= self.leak <= 1.0:
            raise ValueError(f"leak goes from 0 to 1, not {self.leak}")
        if self.wall_conductance == 0.0 and self.leak < 1e-9:
            raise ValueError(
                "walls that only reflect (wall_conductance 0) need a leak of at least 1e-9: else nothing has a slope"
            )
        if not REACHABLE <= self.tolerance < 1e-3:
            raise ValueError(f"tolerance goes from {REACHABLE} (what doubles reach) to 1e-3, not {self.tolerance}")
        if not 0.01 <= self.max_step <= 0.5:
            raise ValueError(f"max_step goes from 0.01 to 0.5 cells, not {self.max_step}")


class Harmonic:
    """Global planner: streamlines of the harmonic potential on the costmap's free cells.

    The cost of its plans is the path's length [m]; its work counts the cycles of the solver. The potential belongs to a
    goal, not to a start: it is kept, used again for the next start, and is where the solver starts from when the map changes.
    """

    def __init__(self, parameters: HarmonicParameters | None = None) -> None:
        self.parameters = parameters or HarmonicParameters()
        self._potential: Potential | None = None
        self._blocked: NDArray[np.bool_] | None = None
        _warm_up()

    def plan(self, costmap: Costmap, start: Array, goal: Array) -> Plan:
        """Path from `start` to `goal`, both (2,) [m].

        Raises:
            OutsideMap, StartOccupied, GoalOccupied: an endpoint is not on the map or not free.
            NoPathFound: they are not connected by free cells that share sides.
        """
        start_cell, goal_cell = endpoints(costmap, start, goal)
        potential, cycles = self.potential(costmap, goal_cell)
        if start_cell == goal_cell:
            points = np.array([start, goal], dtype=float)
        else:
            try:
                points = self._way(potential, costmap, start_cell, np.asarray(start, dtype=float))
            except NoPathFound as error:
                raise no_path(start, goal, cycles) if "flat" not in str(error) else error from None
            points[-1] = goal  # its cell is convex with the one before
        path = Path(points)
        shown = drawn(potential, costmap) | {"harmonic/streamline": lambda: Lines((path.points,))}
        return Plan(path, path.length, {"cycles": cycles}, LazyTrace(shown))

    def potential(self, costmap: Costmap, goal_cell: tuple[int, int]) -> tuple[Potential, int]:
        """The potential of a goal's cell (row, col), and the cycles that finding it took now."""
        blocked = costmap.blocked
        last = self._potential
        same_goal = last is not None and last.problem.shape == costmap.shape and tuple(last.problem.goals[0]) == goal_cell
        if last is not None and same_goal and self._blocked is not None and np.array_equal(self._blocked, blocked):
            return last, 0
        problem: LaplaceProblem = laplace_problem(blocked, goal_cell, self.parameters.wall_conductance, self.parameters.leak)
        potential = solve(problem, self.parameters.tolerance, guess=last if same_goal else None)
        self._potential, self._blocked = potential, blocked
        return potential, len(potential.residuals)

    def _way(self, potential: Potential, costmap: Costmap, start_cell: tuple[int, int], start: Array) -> Array:
        if not self.parameters.smooth:
            points = costmap.world_from_cell(descend(potential, start_cell))
            points[0] = start
            return points
        line = streamline(potential, costmap.grid_from_world(start), self.parameters.max_step)
        return costmap.origin.transform(line * costmap.resolution)


def drawn(potential: Potential, costmap: Costmap) -> dict[str, Callable[[], Drawable]]:
    """What a potential on the costmap's cells shows, made when looked at: log10 w as a heat map, and the solver's numbers."""
    return {
        "harmonic/potential": lambda: Field(costmap.with_data(_decades(potential))),
        "harmonic/residual": lambda: Scalar(potential.residual),
        "harmonic/cycles": lambda: Scalar(len(potential.residuals)),
    }


def _decades(potential: Potential) -> Array:
    """log10 w, which falls evenly along corridors; nan where there is nothing to show, (rows, cols)."""
    decades = potential.log2 * np.log10(2.0)
    return np.where(np.isfinite(decades), decades, np.nan)


def build(context: Context) -> Harmonic:
    """The planner with the parameters of the context."""
    return Harmonic(context.parameters_of(HarmonicParameters))


@warm_up
def _warm_up() -> None:
    """A corridor is eliminated, a hall needs multigrid, then a warm start in a window."""
    corridor, hall, changed = np.zeros((2, 9)), np.zeros((80, 80)), np.zeros((80, 80))
    changed[20:23, 20:23] = LETHAL
    for smooth in (True, False):
        planner = Harmonic(HarmonicParameters(smooth=smooth))
        for costs in (corridor, hall, changed):
            planner.plan(Costmap(costs, 1.0), np.array([1.5, 1.5]), np.array([len(costs.T) - 1.5, len(costs) - 0.5]))
