"""The navigator that reacts to each scan: a controller alone."""

from __future__ import annotations

import math
from dataclasses import replace

from robocar.core import STOP, Command, Controller, GiveUp, Goal, Hold, Observation, Serial, State


class Reactive:
    """A controller alone: asked when a new scan has come, its command repeated in between.

    Without any scan for `scan_timeout` [s] the car stops.
    """

    def __init__(self, controller: Controller, scan_timeout: float = 0.5) -> None:
        self.controller, self.scan_timeout = controller, scan_timeout
        self._last: Command = STOP
        self._last_scan = -math.inf

    def command(self, state: State, observation: Observation, goal: Goal | None) -> Command:
        """Next command."""
        if goal is None:
            return GiveUp("a reactive navigator needs a goal")
        if observation.scans:
            self._last_scan = observation.time
            command = self.controller.command(state, None, None, observation, goal)
            # What is repeated is the motion: a serial line must not be sent twice, and its trace and its work are told.
            self._last = Hold() if isinstance(command, Serial) else replace(command, trace={}, work={})
            return command
        if observation.time - self._last_scan > self.scan_timeout:
            return STOP
        return self._last
