"""The navigator that reacts to each scan: a local planner alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from robocar.core import STOP, Belief, Command, GiveUp, Goal, Hold, LocalPlanner, Mapper, Observation, Serial
from robocar.planners.costmap import layered as layered


class Reactive:
    """A local planner alone: asked when a new scan has come, its command repeated in between.

    Without any scan for `scan_timeout` [s] the car stops.
    """

    def __init__(self, local_planner: LocalPlanner, scan_timeout: float = 0.5) -> None:
        self.local_planner, self.scan_timeout = local_planner, scan_timeout
        self._forget()

    def reset(self, rng: np.random.Generator) -> None:
        """A new episode."""
        self.local_planner.reset(rng)
        self._forget()

    def _forget(self) -> None:
        self._last: Command = STOP
        self._last_scan = -math.inf

    def command(self, belief: Belief, mapper: Mapper, observation: Observation, goal: Goal | None) -> Command:
        """Next command; `mapper` is not needed."""
        if goal is None:
            return GiveUp("a reactive navigator needs a goal")
        if observation.scans:
            self._last_scan = observation.time
            command = self.local_planner.command(belief, None, None, observation, goal)
            # What is repeated is the motion: a serial line must not be sent twice, and the trace has been shown.
            self._last = Hold() if isinstance(command, Serial) else replace(command, trace={})
            return command
        if observation.time - self._last_scan > self.scan_timeout:
            return STOP
        return self._last
