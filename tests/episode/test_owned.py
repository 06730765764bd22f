"""What a part is handed nobody can change: not the goal that is judged, not the map or the robot of the runs that follow.

Oracle: every array that can be reached from what a part sees, by a walk over attributes and containers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest

from robocar.core import STOP, Context
from robocar.episode.run import run
from tests.episode.runs import SHORT

FIT_OUTS: dict[str, dict[str, Any]] = {
    "sonars": {},
    "laser": {"robot.lidar": "hokuyo"},
    "camera": {"robot.camera": True, "robot.compass": True},
}
seen: list[tuple[str, np.ndarray]] = []


def arrays(value: Any, path: str, known: set[int]) -> Iterator[tuple[str, np.ndarray]]:
    """All arrays in `value`, with where they were found."""
    if id(value) in known:
        return
    known.add(id(value))
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from arrays(item, f"{path}[{name!r}]", known)
    elif isinstance(value, tuple | list):
        for k, item in enumerate(value):
            yield from arrays(item, f"{path}[{k}]", known)
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from arrays(getattr(value, field.name), f"{path}.{field.name}", known)


class Vandal:
    """Looks at all that it is handed, makes writable what it can, and moves the goal onto itself."""

    def __init__(self, context: Context) -> None:
        self._context, self._tick = context, 0

    def command(self, state: Any, observation: Any, goal: Any) -> Any:
        self._tick += 1
        known: set[int] = set()
        handed = {"context": self._context, "state": state, "observation": observation, "goal": goal}
        for path, array in [item for name, value in handed.items() for item in arrays(value, name, known)]:
            if self._tick == 1:
                seen.append((path, array))
            try:
                array.setflags(write=True)
                array[...] = 0
            except ValueError:
                pass
        if goal is not None:
            object.__setattr__(goal, "position", np.array(state.belief.pose.position))
            object.__setattr__(goal, "xy_goal_tolerance", 1e9)
        return STOP


@pytest.mark.parametrize(
    ("fit_out", "estimator"), [("sonars", "odometry"), ("laser", "truth"), ("camera", "particle-filter"), ("camera", "ekf")]
)
def test_no_array_that_a_part_sees_can_be_made_writable(fit_out: str, estimator: str) -> None:
    seen.clear()
    settings = FIT_OUTS[fit_out] | {"time_limit": 0.5}
    result = run("thesis-field", navigator=f"{__name__}:Vandal", estimator=estimator, settings=settings)
    assert result.status == "timeout", result.reason  # the goal that it moved is not the one that is judged
    assert len(seen) > 5
    shared = [(path, array) for path, array in seen if ".trace" not in path]  # a trace is for eyes, and for one tick
    assert [path for path, array in shared if _writable(array)] == []


def _writable(array: np.ndarray) -> bool:
    try:
        array.setflags(write=True)
    except ValueError:
        return False
    return True


def test_runs_that_follow_are_not_changed() -> None:
    before = run(SHORT, navigator="a-star", settings={"time_limit": 2.0})
    run(SHORT, navigator=f"{__name__}:Vandal", settings={"time_limit": 0.5})
    assert run(SHORT, navigator="a-star", settings={"time_limit": 2.0}).hash == before.hash
