"""The task as a `dm_env.Environment`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import dm_env
import numpy as np
from dm_env import specs

from robocar.rl.task import DrivingTask, Reward
from robocar.scenario.model import Scenario


class RobocarEnv(dm_env.Environment):
    """See `robocar.rl.task.DrivingTask` for actions, observations, reward and ends, and for the arguments.

    It has no `physics`: dm_control 1.0.50 cannot open any model of MuJoCo 4 (`Physics` asks for a field that is gone), so its
    viewer cannot either.

    Args:
        seed: of the sequence of episodes: the k-th reset of environments with equal seeds gives equal episodes.
    """

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario = "u-trap",
        settings: Mapping[str, Any] | None = None,
        reward: Reward | None = None,
        pose: Literal["odometry", "truth"] = "odometry",
        seed: int = 0,
    ) -> None:
        self.task = DrivingTask(scenario, settings, reward, pose)
        self._rng = np.random.default_rng(seed)
        self._over = True

    def reset(self) -> dm_env.TimeStep:
        """A new episode."""
        self._over = False
        return dm_env.restart(self.task.reset(int(self._rng.integers(2**31))))

    def step(self, action: Any) -> dm_env.TimeStep:
        """One control period; after the last one, a new episode."""
        if self._over:
            return self.reset()
        outcome = self.task.step(action)
        self._over = outcome.terminated or outcome.truncated
        if outcome.terminated:
            return dm_env.termination(outcome.reward, outcome.observation)
        if outcome.truncated:  # the future would have had a value: the discount stays 1
            return dm_env.truncation(outcome.reward, outcome.observation)
        return dm_env.transition(outcome.reward, outcome.observation)

    def action_spec(self) -> specs.BoundedArray:  # type: ignore[override]
        """v [m/s], omega [rad/s]"""
        return specs.BoundedArray((2,), np.float32, self.task.low, self.task.high, name="twist")

    def observation_spec(self) -> dict[str, specs.BoundedArray]:  # type: ignore[override]
        """By name."""
        return {
            name: specs.BoundedArray(space.shape, space.dtype, space.low, space.high, name=name)
            for name, space in self.task.spaces.items()
        }

    def close(self) -> None:
        """Frees the renderer."""
        self.task.close()
