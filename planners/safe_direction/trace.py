"""What the recording shows of a decision of safe-direction navigation."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robocar.core import Array, Arrows, Field, Lines, Points, Scalar
from robocar.core.trace import PLAN_COLOR, Drawable
from robocar.planners.safe_direction.method import Decision

_GREEN, _BLUE = (0, 158, 115), (0, 114, 178)


def pictures(decision: Decision, here: Array, target: Array | None, grids: bool) -> dict[str, Callable[[], Drawable]]:
    """Makers of what is drawn: the fan coloured by N, p_SF, p_D, the local target, alpha in force.

    Args:
        decision: with a choice.
        here, target: the robot and its local target, (2,) [m].
        grids: whether both local grids are drawn too, with the clearance and the way to the goal in metres.
    """
    choice, found, grid = decision.choice, decision.fan, decision.seen.grid
    assert choice is not None

    def arrow(heading: float, color: tuple[int, int, int]) -> Arrows:
        return Arrows(here[None], 0.6 * np.array([[math.cos(heading), math.sin(heading)]]), color)

    def rays() -> Lines:
        ends = here + found.lengths[:, None] * np.stack([np.cos(found.headings), np.sin(found.headings)], axis=1)
        return Lines(tuple(np.stack([here, end]) for end in ends), values=found.totals, radius=0.003)

    def field(values: Array, known: NDArray[np.bool_]) -> Field:
        return Field(grid.with_data(np.where(known, values * grid.resolution, np.nan).astype(np.float32)))

    shown: dict[str, Callable[[], Drawable]] = {
        "safe_direction/fan": rays,
        "safe_direction/safe": lambda: arrow(choice.safe, _GREEN),
        "safe_direction/shortest": lambda: arrow(choice.shortest, _BLUE),
        "safe_direction/target": lambda: Points((here if target is None else target)[None], color=PLAN_COLOR, radius=0.04),
        "safe_direction/alpha": lambda: Scalar(0.0 if choice.turn else choice.alpha),
    }
    if grids:
        shown["safe_direction/pessimistic"] = lambda: field(decision.clearance, decision.clearance > 0.0)
        shown["safe_direction/optimistic"] = lambda: field(decision.distance, np.isfinite(decision.distance))
    return shown
