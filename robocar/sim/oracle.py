"""The pose oracle: several papers assume a known pose. It alone carries ground truth into the loop, and the metrics name it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robocar.core import Belief, Command, Context, Observation, declares
from robocar.core.truth import GroundTruth


class PoseOracle:
    """`truth`: the simulator in the estimator's place.

    Args:
        truth: where it comes from.
    """

    def __init__(self, truth: Callable[[], GroundTruth]) -> None:
        self._truth = truth

    def update(self, observation: Observation, command: Command) -> Belief:
        """The true pose of this tick."""
        truth = self._truth()
        return Belief(truth.pose, np.zeros((3, 3)), truth.twist)


@declares(oracle=True)
def build(context: Context) -> PoseOracle:
    """`truth`"""
    return PoseOracle(context.oracle)
