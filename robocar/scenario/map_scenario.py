"""Any map file as a scenario."""

from __future__ import annotations

import math
import os
import warnings
from pathlib import Path
from typing import Any

from robocar.core import Path as Way
from robocar.core import RobocarError, ScenarioError
from robocar.core.way import LARGEST, find_way
from robocar.formats import file_kind, load_map, load_text_grid
from robocar.reading import read_yaml
from robocar.sim.robot_model import RobotModel

_ROBOT = "robocar"
_LEAST_TIME = 120.0  # [s]
_PACE = 30.0  # [s/m] far slower than any navigator drives that does not turn around in each cell
_EXPLORING = 10.0  # [m] of way that an exploration is given time for, times `EXPLORATION_TIME`
_SCENARIO_KEYS = {"map", "start", "goal", "defaults", "robot"}


def is_map(name: str) -> bool:
    """Whether a file is a map and not a scenario (a name without a file is a scenario's)."""
    path = Path(name)
    return os.path.isfile(path) and not is_scenario(path)


def is_scenario(path: Path) -> bool:
    if path.suffix.lower() not in (".yaml", ".yml"):
        return False
    try:
        content = read_yaml(path, ScenarioError)
    except ScenarioError:  # whoever loads it says why
        return False
    return isinstance(content, dict) and "image" not in content and bool(_SCENARIO_KEYS & set(content))


def map_scenario(
    name: str, resolution: float | None, start: str | None, goal: str | None, goal_needed: bool = True
) -> dict[str, Any]:
    """The scenario of driving on a map file from `start` to `goal` ("x,y[,theta]"); a text grid may hold both.

    Without `goal_needed` the goal may be missing: an exploration has none. The time limit follows the length of the shortest way
    on the map; where there is none, that of the straight line, with a warning.

    Raises:
        ScenarioError: start or goal is missing or malformed.
    """
    path = Path(name)
    points: dict[str, Any] = {"start": start, "goal": goal}
    if file_kind(path) == "text_grid":
        drawn = load_text_grid(path, 1.0 if resolution is None else resolution)
        points["start"] = points["start"] or drawn.start
        points["goal"] = points["goal"] or drawn.goal
    numbers: dict[str, list[float]] = {}
    for what, value in points.items():
        if value is None and what == "goal" and not goal_needed:
            continue
        if value is None:
            raise ScenarioError(f"{name}: a map needs --{what} X,Y")
        numbers[what] = _numbers(value, what) if isinstance(value, str) else [float(v) for v in value]
    start_pose = [*numbers["start"], 0.0][:3]
    goal_pose = numbers.get("goal")
    return {
        "name": path.stem,
        "map": str(path.resolve()),
        "resolution": resolution,
        "start": start_pose,
        "goal": goal_pose,
        "time_limit": round(_LEAST_TIME + _PACE * _way_length(path, resolution, start_pose, goal_pose)),
    }


def _way_length(path: Path, resolution: float | None, start: list[float], goal: list[float] | None) -> float:
    """Of the shortest way for the robot's inscribed circle through what the map does not call occupied [m]."""
    if goal is None:
        return _EXPLORING
    straight = math.dist(start[:2], goal[:2])
    try:
        grid = load_map(path, resolution)
    except RobocarError:
        return straight  # what is wrong is said by who loads the scenario
    if grid.data.size > LARGEST:
        warnings.warn(f"{path}: too large to look for a way: the time limit is that of the straight line", stacklevel=4)
        return straight
    radius = RobotModel.load(_ROBOT).footprint.inscribed_radius

    def way(a: list[float], b: list[float]) -> Way | None:
        return find_way(grid, grid.occupied, a[:2], b[:2], radius)

    if (found := way(start, goal)) is not None:
        return found.length
    if way(start, start) is not None and way(goal, goal) is not None:  # else the scenario is refused anyway
        warnings.warn(
            f"{path}: no way from start to goal is wide enough for the robot: the time limit is that of the straight line, "
            f"{straight:.1f} m",
            stacklevel=4,
        )
    return straight


def _numbers(text: str, what: str) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not all(math.isfinite(value) for value in values):
        raise ScenarioError(f"--{what} takes X,Y or X,Y,THETA in metres and radians, not {text!r}")
    return values
