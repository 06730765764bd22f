"""Any map file as a scenario."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from robocar.core import ScenarioError
from robocar.formats import file_kind, load_text_grid

_SCENARIO_KEYS = {"map", "start", "goal", "defaults", "robot"}


def is_map(name: str) -> bool:
    """Whether a file is a map and not a scenario (a name without a file is a scenario's)."""
    path = Path(name)
    return path.is_file() and not is_scenario(path)


def is_scenario(path: Path) -> bool:
    if path.suffix.lower() not in (".yaml", ".yml"):
        return False
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return False
    return isinstance(content, dict) and "image" not in content and bool(_SCENARIO_KEYS & set(content))


def map_scenario(
    name: str, resolution: float | None, start: str | None, goal: str | None, goal_needed: bool = True
) -> dict[str, Any]:
    """The scenario of driving on a map file from `start` to `goal` ("x,y[,theta]"); a text grid may hold both.

    Without `goal_needed` the goal may be missing: an exploration has none.

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
    distance = 10.0 if goal_pose is None else math.dist(start_pose[:2], goal_pose[:2])
    return {
        "name": path.stem,
        "map": str(path.resolve()),
        "resolution": resolution,
        "start": start_pose,
        "goal": goal_pose,
        # Far longer than a straight drive takes: ways through mazes are long.
        "time_limit": round(120.0 + 30.0 * distance),
    }


def _numbers(text: str, what: str) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not all(math.isfinite(value) for value in values):
        raise ScenarioError(f"--{what} takes X,Y or X,Y,THETA in metres and radians, not {text!r}")
    return values
