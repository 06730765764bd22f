"""The pose oracle: several papers assume a known pose. It alone carries ground truth into the loop, and the metrics name it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robocar.core import Belief, Command, Context, Observation
from robocar.core.truth import GroundTruth


class PoseOracle:
    """`truth`: an adapter of the simulator in the estimator's place; `run` connects it to its simulation."""

    def __init__(self) -> None:
        self._truth: Callable[[], GroundTruth] | None = None

    def connect(self, truth: Callable[[], GroundTruth]) -> None:
        """Where the truth comes from."""
        self._truth = truth

    def reset(self, rng: np.random.Generator) -> None:
        pass

    def update(self, observation: Observation, command: Command) -> Belief:
        if self._truth is None:
            raise RuntimeError("the pose oracle is not connected to a simulation")
        truth = self._truth()
        return Belief(truth.pose, np.zeros((3, 3)), truth.twist)


def build(context: Context) -> PoseOracle:
    """`truth`"""
    return PoseOracle()
