"""Paths, goals, scans, commands and the parameters that a context hands out."""

import math
from dataclasses import FrozenInstanceError, dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import (
    SE2,
    STOP,
    Command,
    Context,
    Detection,
    Done,
    Drive,
    Footprint,
    GiveUp,
    Goal,
    Hold,
    Observation,
    ParameterError,
    Path,
    Reading,
    RobocarError,
    Robot,
    Scan,
    Serial,
    Twist,
)


@given(st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10)), min_size=1, max_size=20))
def test_path_length(points: list[tuple[float, float]]) -> None:
    """Oracle: hypot, step by step."""
    expected = sum(math.dist(p, q) for p, q in pairwise(points))
    assert Path(np.array(points)).length == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("points", [np.zeros((0, 2)), np.zeros((3, 3)), np.zeros(2), [[0, math.nan]], [[math.inf, 0]]])
def test_paths_that_are_none(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="path"):
        Path(points)


@pytest.mark.parametrize(
    ("pose", "heading", "expected"),
    [
        (SE2(1.099, 2, 3), None, True),
        (SE2(1.101, 2, 3), None, False),
        (SE2(1.08, 2.08, 0), None, False),
        (SE2(1, 2, math.pi - 0.1), -math.pi + 0.1, True),
        (SE2(1, 2, 0.26), 0.0, False),
        (SE2(1, 2, -0.24), 0.0, True),
        (SE2(1, 2, -0.24), math.tau, True),
        (SE2(2, 2, 0), 0.0, False),
    ],
)
def test_goal_checker(pose: SE2, heading: float | None, expected: bool) -> None:
    """Oracle: by hand: a circle of 0.10 m, and 0.25 rad the short way round."""
    assert Goal(np.array([1.0, 2.0]), heading).reached(pose) is expected


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"position": [1, 2, 3]}, "position"),
        ({"position": [1, math.nan]}, "position"),
        ({"position": [1, 2], "heading": math.inf}, "heading"),
        ({"position": [1, 2], "xy_goal_tolerance": -0.1}, "xy_goal_tolerance"),
        ({"position": [1, 2], "yaw_goal_tolerance": math.nan}, "yaw_goal_tolerance"),
    ],
)
def test_goals_that_are_none(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Goal(**arguments)


def test_scans_are_checked_and_read_only() -> None:
    scan = Scan(0.5, [1.0, math.inf, math.nan], [-0.1, 0.0, 0.1], 4.0)
    with pytest.raises(ValueError, match="read-only"):
        scan.ranges[0] = 2
    with pytest.raises(ValueError, match="ranges"):
        Scan(0, [1.0], [0.0, 0.1], 4.0)
    with pytest.raises(ValueError, match="ranges"):
        Scan(0, [[1.0]], [[0.0]], 4.0)
    for bad in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="max_range"):
            Scan(0, [1.0], [0.0], bad)


def test_laser_comes_first() -> None:
    """Oracle: the order that `Observation.scans` promises."""
    sonars = tuple(Scan(0, [1.0], [0.0], 4.0, 0.3, name=name) for name in "ab")
    laser = Scan(0, [1.0], [0.0], 4.0, name="laser")
    assert [scan.name for scan in Observation(0, sonars=sonars, lidar=laser).scans] == ["laser", "a", "b"]
    assert [scan.name for scan in Observation(0, sonars=sonars).scans] == ["a", "b"]
    assert Observation(0).scans == ()


@pytest.mark.parametrize(
    ("time", "readings", "error", "message"),
    [
        (math.nan, {}, ValueError, "an observation needs a finite time, not nan"),
        (math.inf, {}, ValueError, "an observation needs a finite time, not inf"),
        ("now", {}, TypeError, "real number"),
        (0.0, {"gps": 3}, TypeError, "gps: expected a Reading, a Scan.*, not 3"),
        (0.0, {"gps": [1.0, 2.0]}, TypeError, r"gps: expected a Reading, .* not \[1\.0, 2\.0\]"),
        (0.0, {"landmarks": (1, 2)}, TypeError, r"landmarks: .*tuple of Detection or of lines, not \(1, 2\)"),
        (0.0, {"serial": "OK"}, TypeError, "serial: .*, not 'OK'"),
        (0.0, {"sonars": None}, TypeError, "sonars: expected a tuple of Scan, not None"),
        (0.0, {"sonars": (None,)}, TypeError, r"sonars: expected a tuple of Scan, not \(None,\)"),
        (0.0, {"gps": Reading(math.nan, 1.0)}, ValueError, "gps: a reading needs a finite time, not nan"),
        (
            0.0,
            {"lidar": Scan(math.inf, np.ones(1), np.zeros(1), 2.0)},
            ValueError,
            "lidar: a reading needs a finite time, not inf",
        ),
        (0.0, {"landmarks": (Detection(math.nan, "a", 0.0, 1.0, np.eye(2)),)}, ValueError, "landmarks: a reading needs a finite"),
    ],
)
def test_what_is_no_reading_is_no_observation(time, readings, error, message):
    """By either way of giving it; what is fine stays fine."""
    with pytest.raises(error, match=message):
        Observation(time, **readings)
    if "sonars" not in readings:
        with pytest.raises(error, match=message):
            Observation(time, readings)
    assert Observation(0.0, gps=None, landmarks=(), serial=("OK", "")).serial == ("OK", "")


def test_commands() -> None:
    assert STOP.twist == Twist(0, 0)
    assert Drive(Twist(1, 0)) != STOP
    assert GiveUp("wall").status == "stuck"
    with pytest.raises(ValueError, match="no_path or stuck"):
        GiveUp("wall", status="success")
    with pytest.raises(FrozenInstanceError):
        STOP.pan = 1.0  # type: ignore[misc]


@dataclass(frozen=True)
class Parameters:
    gain: float = 1.5
    samples: int = 10
    smooth: bool = True
    method: str = "fast"

    def __post_init__(self) -> None:
        if self.samples <= 0:
            raise ValueError(f"samples must be positive, not {self.samples}")


def context(**parameters: object) -> Context:
    # Only `parameters` is looked at, so a robot without limits will do.
    robot = Robot(Footprint.circle(0.1), None, None, 1)  # type: ignore[arg-type]
    return Context(robot, None, None, (), parameters, np.random.default_rng(0), 0.05)


def test_parameters_are_picked_by_name() -> None:
    """Oracle: the dataclass's own defaults; names of other components are left alone."""
    assert context().parameters_of(Parameters) == Parameters()
    chosen = context(gain=2, samples=3, smooth=False, method="slow", other=7).parameters_of(Parameters)
    assert chosen == Parameters(2.0, 3, False, "slow")
    assert type(chosen.gain) is float


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gain", "high"),
        ("gain", True),
        ("gain", None),
        ("samples", 2.5),
        ("samples", 2.0),
        ("samples", True),
        ("smooth", 1),
        ("smooth", "yes"),
        ("method", 3),
    ],
)
def test_wrong_types_name_the_parameter(name: str, value: object) -> None:
    with pytest.raises(ParameterError, match=name):
        context(**{name: value}).parameters_of(Parameters)


def test_values_out_of_range_become_parameter_errors() -> None:
    with pytest.raises(ParameterError, match="samples must be positive, not 0") as error:
        context(samples=0).parameters_of(Parameters)
    assert isinstance(error.value, RobocarError)


@pytest.mark.parametrize("command", [Drive(Twist(), pan=1), Serial("M2", pan=1), Hold(pan=1), Done("", pan=1), GiveUp("", pan=1)])
def test_the_pan_of_every_command_is_a_float(command: Command) -> None:
    assert type(command.pan) is float
    with pytest.raises(TypeError, match="a command's pan is a number, not 'left'"):
        replace(command, pan="left")
