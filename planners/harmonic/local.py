"""Drives down the gradient of a harmonic potential, without a path to keep to.

Connolly, Burns and Weiss 1990: the gradient of the potential commands the robot wherever it is, so being pushed off its way
costs nothing. Here the streamline is drawn anew from the car at every tick, as far as it looks ahead.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from robocar.core import (
    INSCRIBED,
    SE2,
    Context,
    Costmap,
    Drive,
    GiveUp,
    Goal,
    Lines,
    NoPathFound,
    Observation,
    OutsideMap,
    Path,
    PlanningError,
    State,
    Text,
    Trace,
)
from robocar.core.trace import PLAN_COLOR, Drawable, LazyTrace, merged
from robocar.planners.controllers import pure_pursuit
from robocar.planners.controllers.pure_pursuit import PurePursuit
from robocar.planners.geometry.polyline import blocked_ahead
from robocar.planners.harmonic import planner as harmonic
from robocar.planners.harmonic.laplace.solver import Potential
from robocar.planners.harmonic.planner import Harmonic
from robocar.planners.harmonic.streamline import streamline
from robocar.planners.navigators.plan_and_follow import PlanAndFollow, plan_and_follow
from robocar.planners.search.grid_search import nearest_free


@dataclass(frozen=True, slots=True)
class HarmonicLocalParameters:
    """
    Args:
        horizon: how far down the gradient the car looks; what is seen there and blocks the way has the potential solved anew [m].
    """

    horizon: float = 1.0

    def __post_init__(self) -> None:
        if not 0.1 <= self.horizon < math.inf:
            raise ValueError(f"horizon must be at least 0.1 m, not {self.horizon}")


class HarmonicLocal:
    """Controller: down the gradient of the potential of `planner`.

    The streamline from the car is driven with pure pursuit's care for turns, clearance and the outline; at the next tick it is
    another one, from where the car is then. Where what has been seen since blocks it, the potential is solved again, starting
    from the last one. The path that a `PlanAndFollow` gives is not followed: it is where that one looks for what blocks the way
    farther off, and a new path says that the potential has been solved again.

    Args:
        planner: the one that makes the paths, whose potential is shared.
        pursuit: steers along the streamline.
    """

    def __init__(self, planner: Harmonic, pursuit: PurePursuit, parameters: HarmonicLocalParameters | None = None) -> None:
        self.parameters = parameters or HarmonicLocalParameters()
        self.planner, self.pursuit = planner, pursuit
        self._potential: Potential | None = None
        self._known: tuple[Path | None, Goal, SE2, tuple[int, int]] | None = None

    def command(
        self, state: State, path: Path | None, costmap: Costmap | None, observation: Observation, goal: Goal
    ) -> Drive | GiveUp:
        """The twist for the next control period.

        Args:
            path: a new one has the potential looked up again. It is driven only where no streamline leads to the goal, or where
                there is no costmap.
        """
        if costmap is None:
            return self.pursuit.command(state, path, None, observation, goal)
        pose = state.belief.pose
        known, cycles = (path, goal, costmap.origin, costmap.shape), 0
        way = self._way(costmap, pose, goal) if known == self._known else None
        if way is None:
            try:
                self._potential, cycles = self.planner.potential(costmap, costmap.cell_inside(goal.position, "goal"))
            except PlanningError:
                return self.pursuit.command(state, path, costmap, observation, goal)
            self._known = known
            way = self._way(costmap, pose, goal)
        if way is None:
            return self.pursuit.command(state, path, costmap, observation, goal)
        command = self.pursuit.command(state, way, costmap, observation, goal)
        return replace(
            command, trace=merged(command.trace, self._trace(costmap, way, cycles)), work={"cycles": cycles} if cycles else {}
        )

    def _way(self, costmap: Costmap, pose: SE2, goal: Goal) -> Path | None:
        """The streamline from the car up to the horizon, or to the goal; from the nearest free cell where the car stands in
        blocked ones. None where it runs into what the costmap shows by now, or there is none."""
        assert self._potential is not None
        start, horizon = pose.position, self.parameters.horizon / costmap.resolution
        try:
            if costmap.data[costmap.cell_inside(start, "car")] >= INSCRIBED:
                start = nearest_free(costmap, start)
            if start is None:
                return None
            line = streamline(self._potential, costmap.grid_from_world(start), self.planner.parameters.max_step, horizon)
        except (NoPathFound, OutsideMap):
            return None
        if blocked_ahead(costmap.data, line, 0):
            return None
        points = costmap.origin.transform(line * costmap.resolution)
        if costmap.cell_inside(points[-1]) == costmap.cell_inside(goal.position):
            points[-1] = goal.position
        return Path(np.concatenate([[pose.position], points]))

    def _trace(self, costmap: Costmap, way: Path, cycles: int) -> Trace:
        """The streamline ahead and, after a solution, the new potential."""
        makers: dict[str, Callable[[], Drawable]] = {"local": lambda: Lines((way.points,), color=PLAN_COLOR, radius=0.02)}
        if cycles:
            assert self._potential is not None
            makers |= harmonic.drawn(self._potential, costmap)
            makers["harmonic_local"] = lambda: Text(f"the way ahead is blocked: potential solved again in {cycles} cycles")
        return LazyTrace(makers)


def build(context: Context) -> PlanAndFollow:
    """The navigator: the harmonic planner and, on its potential, the local one."""
    planner = harmonic.build(context.part("planner"))

    def local(context: Context) -> HarmonicLocal:
        return HarmonicLocal(planner, pure_pursuit.build(context), context.parameters_of(HarmonicLocalParameters))

    return plan_and_follow(context, lambda _: planner, local)
