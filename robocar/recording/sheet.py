"""The numbers of every tick in one table: poses, paths and time series, split into their entities when they are sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robocar.core import SE2, Array, Belief, Command, Drive
from robocar.core.truth import GroundTruth
from robocar.recording import columns, drawing, palette
from robocar.recording.streams import Streams

PATH_STEP = 0.01
"""Paths are drawn in pieces of at least this length [m]."""

POSES = ("truth", "odometry", "estimate")
SERIES = {
    "speed/truth": palette.TRUTH,
    "turn_rate/truth": palette.TRUTH,
    "clearance": palette.TRUTH,
    "voltage/left": palette.LEFT,
    "voltage/right": palette.RIGHT,
    "error/position/estimate": palette.ESTIMATE,
    "error/heading/estimate": palette.ESTIMATE_PALE,
    "error/position/odometry": palette.ODOMETRY,
    "error/heading/odometry": palette.ODOMETRY_PALE,
    "speed/estimate": palette.ESTIMATE,
    "turn_rate/estimate": palette.ESTIMATE,
    "speed/command": palette.COMMAND,
    "turn_rate/command": palette.COMMAND,
    "planning_time": palette.PLAN,
}
"""Time series `signals/<name>` and their colours."""

_MISSING = (math.nan, math.nan, math.nan)


def _errors(pose: SE2, truth: SE2) -> tuple[float, float]:
    return pose.distance_to(truth), abs(math.remainder(pose.theta - truth.theta, math.tau))


@dataclass
class _PathEnd:
    """Where a path was left at the last flush."""

    position: Array  # (2,) [m], at the last tick
    drawn: Array  # (2,) [m], end of the last piece
    travelled: float = 0.0  # since that end [m]


class Sheet:
    """Rows since the last flush; a number that a tick does not have is NaN and is not sent."""

    def __init__(self) -> None:
        self._ticks: list[int] = []
        self._times: list[float] = []
        self._rows: list[tuple[float, ...]] = []
        self._paths: dict[str, _PathEnd] = {}

    def append(self, tick: int, time: float, facts: tuple[Belief, Command, GroundTruth | None, SE2 | None, float | None]) -> None:
        """A row: belief, command, truth, dead reckoning, and planning time [s]."""
        belief, command, truth, odometry, planning_time = facts
        pose, twist = belief.pose, belief.twist
        row = [*_MISSING] if truth is None else [truth.pose.x, truth.pose.y, truth.pose.theta]
        row += _MISSING if odometry is None else (odometry.x, odometry.y, odometry.theta)
        row += (pose.x, pose.y, pose.theta)
        if truth is None:
            row += [math.nan] * 9
        else:
            row += (truth.twist.v, truth.twist.omega, truth.clearance, *truth.voltages)
            row += _errors(pose, truth.pose)
            row += (math.nan, math.nan) if odometry is None else _errors(odometry, truth.pose)
        row += (twist.v, twist.omega)
        row += (command.twist.v, command.twist.omega) if isinstance(command, Drive) else (math.nan, math.nan)
        row.append(math.nan if planning_time is None else planning_time)
        self._ticks.append(tick)
        self._times.append(time)
        self._rows.append(tuple(row))

    def send(self, stream: Streams) -> None:
        """Send and forget the rows."""
        if not self._rows:
            return
        rows, ticks, times = self._rows, np.array(self._ticks), np.array(self._times)
        self._ticks, self._times, self._rows = [], [], []  # also where they cannot be sent
        table = np.array(rows, dtype=np.float64)  # (ticks, 3 numbers of each pose, then the series)
        everything = columns.indexes(ticks, times)
        for k, name in enumerate(POSES):
            pose = table[:, 3 * k : 3 * k + 3]
            known = np.isfinite(pose[:, 0])
            if known.any():
                index = everything if known.all() else columns.indexes(ticks[known], times[known])
                stream.send_columns(f"world/{name}", index, columns.poses(pose[known]))
                self._send_path(stream, name, ticks[known], times[known], pose[known, :2])
        for k, name in enumerate(SERIES, start=3 * len(POSES)):
            series = table[:, k]
            known = ~np.isnan(series)
            if known.any():
                index = everything if known.all() else columns.indexes(ticks[known], times[known])
                stream.send_columns(f"signals/{name}", index, columns.scalars(series[known]))

    def _send_path(self, stream: Streams, name: str, ticks: Array, times: Array, positions: Array) -> None:
        """Pieces of the path between the ticks at which another `PATH_STEP` has been travelled."""
        end = self._paths.setdefault(name, _PathEnd(positions[0], positions[0]))
        steps = np.linalg.norm(np.diff(np.concatenate([end.position[None], positions]), axis=0), axis=1)
        travelled = end.travelled + np.cumsum(steps)
        marks = np.floor(travelled / PATH_STEP)
        kept = np.flatnonzero(np.diff(marks, prepend=0.0) > 0)
        end.position, end.travelled = positions[-1], float(travelled[-1] - PATH_STEP * marks[-1])
        if kept.size:
            corners = np.concatenate([end.drawn[None], positions[kept]])
            end.drawn = corners[-1]
            pieces = drawing.raised(corners, drawing.PATH_LAYER[name])
            index = columns.indexes(ticks[kept], times[kept])
            stream.send_columns(f"world/{name}/path", index, columns.segments(np.hstack([pieces[:-1], pieces[1:]])))
