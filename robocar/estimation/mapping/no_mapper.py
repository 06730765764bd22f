"""The mapper that draws no map."""

from __future__ import annotations

import numpy as np

from robocar.core import Belief, Context, Observation, OccupancyGrid


class NoMapper:
    """`none`"""

    def reset(self, rng: np.random.Generator) -> None:
        pass

    def update(self, belief: Belief, observation: Observation) -> None:
        pass

    def grid(self) -> OccupancyGrid | None:
        return None


def build(context: Context) -> NoMapper:
    """`none`"""
    return NoMapper()
