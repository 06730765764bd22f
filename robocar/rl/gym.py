"""The task as a `gymnasium.Env`, and its registered ids."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces

from robocar.rl.task import DrivingTask, Reward
from robocar.scenario.load import load_scenario, scenario_names
from robocar.scenario.model import Scenario

Array = np.ndarray[Any, Any]


class RobocarGymEnv(gymnasium.Env[dict[str, Array], Array]):
    """See `robocar.rl.task.DrivingTask` for actions, observations, reward and ends, and for the arguments.

    `reset(seed=...)` makes the episode of that seed; without one the next seed is drawn from `np_random`. `info` of the last step
    has the `reason`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (gymnasium's own way)

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario = "u-trap",
        settings: Mapping[str, Any] | None = None,
        reward: Reward | None = None,
        pose: Literal["odometry", "truth"] = "odometry",
        render_mode: None = None,
    ) -> None:
        self.render_mode = render_mode
        self.task = DrivingTask(scenario, settings, reward, pose)
        self.action_space = spaces.Box(self.task.low, self.task.high, dtype=np.float32)
        self.observation_space = spaces.Dict(
            {name: spaces.Box(s.low, s.high, s.shape, s.dtype) for name, s in self.task.spaces.items()}  # type: ignore[arg-type]
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Array], dict[str, Any]]:
        """A new episode."""
        super().reset(seed=seed)
        episode = int(self.np_random.integers(2**31)) if seed is None else seed
        return self.task.reset(episode), {"seed": episode}

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """One control period."""
        outcome = self.task.step(action)
        info = {"reason": outcome.reason} if outcome.reason else {}
        return outcome.observation, outcome.reward, outcome.terminated, outcome.truncated, info

    def close(self) -> None:
        """Frees the renderer."""
        self.task.close()


def _suits(name: str) -> bool:
    scenario = load_scenario(name)
    return scenario.goal is not None and not scenario.events


for _name in scenario_names():
    if _suits(_name):
        gymnasium.register(id=f"robocar/{_name}-v0", entry_point="robocar.rl.gym:RobocarGymEnv", kwargs={"scenario": _name})
