"""Every metric on cases that can be computed by hand, against evo where it has the metric, and on runs of no or one tick."""

import json
import math

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PoseTrajectory3D
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Footprint, Goal, OccupancyGrid
from robocar.metrics import RunLog, summarize
from robocar.metrics import run as metrics

ALWAYS = {  # design, section 9
    "duration",
    "path_length",
    "unknown_length",
    "shortest_path_length",
    "spl",
    "min_clearance",
    "mean_clearance",
    "contacts",
    "replans",
    "plan_time_mean",
    "plan_time_max",
    "position_rmse",
    "heading_rmse",
    "final_position_error",
    "odometry_position_rmse",
    "angle_over_length",
    "jerk_rms",
    "wall_time",
    "real_time_factor",
}
UNITS = {"s", "m", "1", "rad", "rad/m", "m/s^3"}
NAN, INF = math.nan, math.inf


def circle(radius: float, turns: float, n: int) -> np.ndarray:
    """Poses along a circle, counter-clockwise, (n, 3)."""
    angle = np.linspace(0, turns * math.tau, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), angle + math.pi / 2], axis=1)


def test_duration() -> None:
    """Oracle: by hand."""
    assert metrics.duration([0.5, 1.0, 4.0]) == 3.5
    assert metrics.duration([2.0]) == 0.0
    assert metrics.duration([]) is None


def test_path_length() -> None:
    """Oracle: a 3-4-5 triangle and back; headings do not add to length; the perimeter of a polygon in a circle."""
    poses = [[0, 0, 0], [3, 4, 2], [3, 4, -2], [0, 0, 1]]
    assert metrics.path_length(poses) == 10.0
    assert metrics.path_length(circle(2.0, 1, 61)) == pytest.approx(60 * 2 * 2.0 * math.sin(math.pi / 60))
    assert metrics.path_length([[1, 2, 3]]) == 0.0
    assert metrics.path_length(np.zeros((0, 3))) is None
    assert metrics.path_length([[NAN, 0, 0]]) is None
    assert metrics.path_length([[0, 0, 0], [NAN, NAN, NAN], [3, 4, 0]]) == 5.0


def test_being_carried_is_no_way() -> None:
    """Oracle: by hand: 1 m, a kidnap of 50 m, 2 m; also where the kidnap falls on a row that is lost."""
    poses = np.array([[0, 0, 0], [1, 0, 0.5], [51, 0, 3], [53, 0, 2.5]])
    carried = [False, False, True, False]
    assert metrics.path_length(poses, carried) == 3.0
    assert metrics.angle_over_length(poses, carried) == pytest.approx(1.0 / 3.0)
    lost = np.insert(poses, 2, NAN, axis=0)
    assert metrics.path_length(lost, [False, False, True, False, False]) == 3.0


def wall_map() -> OccupancyGrid:
    """4 x 4 m at 0.1 m: a wall 0.1 m thick at x in [2, 2.1], from y = 0 to y = 2."""
    data = np.zeros((40, 40), dtype=np.int8)
    data[:20, 20] = 100
    data[30:, 30:] = -1
    return OccupancyGrid(data, 0.1)


def test_shortest_path_length() -> None:
    """Oracle: closed form of tangents and arcs around the wall's end for the inscribed disc; Euclid where nothing is between."""
    footprint = Footprint.rectangle(0.3, 0.25, 0.2)  # inscribed 0.2
    legs, arcs = 0.0, 0.0
    for dx, dy in ((1.0, 1.5), (1.4, 1.5)):
        legs += math.sqrt(dx**2 + dy**2 - 0.2**2)
        arcs += 0.2 * (math.atan2(dy, dx) + math.asin(0.2 / math.hypot(dx, dy)))
    start = SE2(1.0, 0.5, 2)
    around = metrics.shortest_path_length(wall_map(), footprint, start, Goal(np.array([3.5, 0.5])))
    assert around == pytest.approx(legs + arcs + 0.1, rel=5e-4)
    assert metrics.shortest_path_length(wall_map(), footprint, start, Goal(np.array([1.3, 0.9]))) == pytest.approx(0.5)


def test_shortest_path_length_that_is_missing() -> None:
    """Oracle: by hand: no goal, a goal in the wall, beside the map, behind a closed wall."""
    footprint, start = Footprint.circle(0.1), SE2(1.0, 0.5)
    closed = np.zeros((40, 40), dtype=np.int8)
    closed[:, 20] = 100
    assert metrics.shortest_path_length(wall_map(), footprint, start, None) is None
    assert metrics.shortest_path_length(wall_map(), footprint, start, Goal(np.array([2.05, 0.5]))) is None
    assert metrics.shortest_path_length(wall_map(), footprint, start, Goal(np.array([5.0, 0.5]))) is None
    assert metrics.shortest_path_length(OccupancyGrid(closed, 0.1), footprint, start, Goal(np.array([3.0, 0.5]))) is None


@pytest.mark.parametrize(
    ("success", "shortest", "length", "expected"),
    [
        (True, 2.0, 4.0, 0.5),
        (True, 2.0, 2.0, 1.0),
        (True, 2.0, 1.9, 1.0),  # stops within the tolerance, before the goal
        (False, 2.0, 2.0, 0.0),
        (True, 0.0, 0.0, 1.0),
        (True, 0.0, 1.0, 0.0),
        (True, None, 1.0, None),
        (True, 1.0, None, None),
    ],
)
def test_spl(success: bool, shortest: float | None, length: float | None, expected: float | None) -> None:
    """Oracle: Anderson et al. (2018), S l / max(p, l), by hand."""
    assert metrics.spl(success, shortest, length) == expected


def test_clearance() -> None:
    """Oracle: by hand; ticks with no obstacle anywhere and lost ones do not count."""
    assert metrics.min_clearance([0.5, 0.2, INF, NAN, 0.8]) == 0.2
    assert metrics.mean_clearance([0.5, 0.2, INF, NAN, 0.8]) == pytest.approx(0.5)
    assert metrics.min_clearance([0.0, 1.0]) == 0.0
    for nothing in ([], [INF, INF], [NAN]):
        assert metrics.min_clearance(nothing) is None
        assert metrics.mean_clearance(nothing) is None


@pytest.mark.parametrize(
    ("contact", "standing", "expected"),
    [
        ("000000", "000000", (0, 0)),
        ("011100", "000000", (1, 0)),
        ("101101", "000000", (3, 0)),  # also the first and the last tick
        ("001100", "111111", (0, 1)),
        ("001100", "001111", (1, 0)),  # the wall itself stopped it: it did not stand before
        ("001100", "110000", (1, 0)),  # it started and touched
        ("100000", "111111", (0, 1)),
        ("110011", "000111", (1, 1)),
    ],
)
def test_contacts(contact: str, standing: str, expected: tuple[int, int]) -> None:
    """Oracle: episodes counted by eye."""
    touched, stood = [c == "1" for c in contact], [c == "1" for c in standing]
    assert (metrics.contacts(touched, stood), metrics.contacts_standing(touched, stood)) == expected


def test_contacts_of_no_ticks() -> None:
    assert (metrics.contacts([], []), metrics.contacts_standing([], [])) == (None, None)


def test_plan_time() -> None:
    """Oracle: by hand; ticks without a plan are no zeros."""
    assert metrics.plan_time_mean([NAN, 0.1, 0.3, NAN]) == pytest.approx(0.2)
    assert metrics.plan_time_max([NAN, 0.1, 0.3, NAN]) == 0.3
    assert metrics.plan_time_mean([NAN]) is None
    assert metrics.plan_time_max([]) is None


def test_position_errors() -> None:
    """Oracle: by hand: errors 5 and 0 of two ticks that have an estimate: sqrt(25 / 2)."""
    truth = [[0, 0, 0], [1, 1, 0], [9, 9, 0]]
    estimate = [[3, 4, 1], [1, 1, 2], [NAN, NAN, NAN]]
    assert metrics.position_rmse(truth, estimate) == pytest.approx(math.sqrt(12.5))
    assert metrics.odometry_position_rmse(truth, estimate) == pytest.approx(math.sqrt(12.5))
    assert metrics.final_position_error(truth, estimate) is None
    assert metrics.final_position_error(truth[:1], estimate[:1]) == 5.0
    assert metrics.final_position_error(np.zeros((0, 3)), np.zeros((0, 3))) is None
    assert metrics.position_rmse(truth[2:], estimate[2:]) is None


def test_heading_errors_go_the_short_way_round() -> None:
    """Oracle: by hand: 0.2 rad across the seam and 0.1 rad: sqrt((0.04 + 0.01) / 2)."""
    truth = [[0, 0, math.pi - 0.1], [0, 0, 1.0]]
    estimate = [[5, 0, -math.pi + 0.1], [0, 5, 0.9]]
    assert metrics.heading_rmse(truth, estimate) == pytest.approx(math.sqrt(0.025))
    assert metrics.heading_rmse([], []) is None


def evo_trajectory(poses: np.ndarray) -> PoseTrajectory3D:
    half = poses[:, 2] / 2
    zeros = np.zeros(len(poses))
    return PoseTrajectory3D(
        positions_xyz=np.stack([poses[:, 0], poses[:, 1], zeros], axis=1),
        orientations_quat_wxyz=np.stack([np.cos(half), zeros, zeros, np.sin(half)], axis=1),
        timestamps=np.arange(len(poses), dtype=float),
    )


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(2, 50))
def test_trajectory_errors_against_evo(seed: int, n: int) -> None:
    """Oracle: evo's absolute pose error without alignment: RMSE of translation and of the rotation angle."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-4, 4, (n, 3))
    estimate = truth + rng.normal(0, [0.5, 0.5, 2.0], (n, 3))
    for relation, ours in (
        (evo_metrics.PoseRelation.translation_part, metrics.position_rmse),
        (evo_metrics.PoseRelation.rotation_angle_rad, metrics.heading_rmse),
    ):
        ape = evo_metrics.APE(relation)
        ape.process_data((evo_trajectory(truth), evo_trajectory(estimate)))
        assert ours(truth, estimate) == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.rmse), abs=1e-6)


def test_angle_over_length() -> None:
    """Oracle: a circle turns by its curvature: 2 pi over its perimeter; left and right do not cancel; the seam does not count."""
    assert metrics.angle_over_length(circle(2.0, 3, 6001)) == pytest.approx(0.5, rel=1e-5)
    assert metrics.angle_over_length([[0, 0, 0], [1, 0, 0.5], [2, 0, 0]]) == pytest.approx(0.5)
    assert metrics.angle_over_length([[0, 0, 3.1], [2, 0, -3.1]]) == pytest.approx((math.tau - 6.2) / 2)
    assert metrics.angle_over_length([[0, 0, 0], [0, 0, 1]]) is None
    assert metrics.angle_over_length(np.zeros((0, 3))) is None


@given(st.lists(st.floats(0.01, 1), min_size=3, max_size=30), st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_jerk_of_quadratic_speed(steps: list[float], a: float, b: float, c: float) -> None:
    """Oracle: the second derivative of a + b t + c t^2 is 2 c, at any ticks."""
    t = np.cumsum(steps)
    assert metrics.jerk_rms(t, np.column_stack([a + b * t + c * t**2, 3 * t])) == pytest.approx(abs(2 * c), abs=1e-6)


def test_jerk_of_a_sine() -> None:
    """Oracle: v = sin(w t): the jerk's RMS is w^2 / sqrt(2)."""
    t = np.linspace(0, 10 * math.tau, 20001)
    assert metrics.jerk_rms(t, np.column_stack([np.sin(1.5 * t), t])) == pytest.approx(1.5**2 / math.sqrt(2), rel=1e-3)
    assert metrics.jerk_rms([0, 1], [[0, 0], [1, 0]]) is None
    assert metrics.jerk_rms([], []) is None


def test_real_time_factor() -> None:
    """Oracle: by hand."""
    assert metrics.real_time_factor(30.0, 10.0) == 3.0
    assert metrics.real_time_factor(30.0, None) is None
    assert metrics.real_time_factor(None, 10.0) is None
    assert metrics.real_time_factor(30.0, 0.0) is None


def run_log(n: int, **changes: object) -> RunLog:
    """A drive straight ahead at 0.5 m/s on the free side of `wall_map`, ticks of 0.1 s, estimates 3 cm to the side."""
    time = 0.1 * np.arange(n)
    truth = np.stack([0.5 + 0.05 * np.arange(n), np.full(n, 3.0), np.zeros(n)], axis=1)
    values = {
        "time": time,
        "truth_poses": truth,
        "truth_twists": np.tile([0.5, 0.0], (n, 1)),
        "estimate_poses": np.add(truth, [0, 0.03, 0.02]),
        "odometry_poses": np.add(truth, [0.3, 0.4, 0]),
        "clearance": np.full(n, 0.4),
        "contact": np.zeros(n, dtype=bool),
        "standing": np.zeros(n, dtype=bool),
        "plan_time": np.where(np.arange(n) % 2 == 0, 0.002, np.nan),
        "work": {"replans": 4, "expansions": 800},
        "status": "success",
        "grid": wall_map(),
        "footprint": Footprint.circle(0.15),
        "start": SE2(0.5, 3.0),
        "goal": Goal(np.array([2.5, 3.0])),
        "wall_time": 2.0,
    }
    return RunLog(**{**values, **changes})  # type: ignore[arg-type]


def test_summary_of_a_straight_drive() -> None:
    """Oracle: by hand: 41 ticks, 4 s, 2 m."""
    summary = summarize(run_log(41))
    expected = {
        "duration": 4.0,
        "path_length": 2.0,
        "unknown_length": 0.0,
        "shortest_path_length": 2.0,
        "spl": 1.0,
        "min_clearance": 0.4,
        "mean_clearance": 0.4,
        "contacts": 0,
        "contacts_standing": 0,
        "replans": 4,
        "plan_time_mean": 0.002,
        "plan_time_max": 0.002,
        "position_rmse": 0.03,
        "heading_rmse": 0.02,
        "final_position_error": 0.03,
        "odometry_position_rmse": 0.5,
        "angle_over_length": 0.0,
        "jerk_rms": 0.0,
        "wall_time": 2.0,
        "real_time_factor": 2.0,
    }
    assert {name: metric["value"] for name, metric in summary.items()} == pytest.approx(expected, abs=1e-9)
    assert set(summary) >= ALWAYS
    assert {metric["unit"] for metric in summary.values()} == UNITS
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary


@pytest.mark.parametrize("n", [0, 1, 2])
def test_short_runs(n: int) -> None:
    """Oracle: by hand: what needs more ticks is None, never 0 and never NaN; what one tick has, is there."""
    summary = summarize(run_log(n, status="timeout", wall_time=None))
    values = {name: metric["value"] for name, metric in summary.items()}
    missing = {"wall_time", "real_time_factor", "jerk_rms"}
    missing |= {"angle_over_length"} if n < 2 else set()
    from_ticks = {
        "duration",
        "path_length",
        "unknown_length",
        "spl",
        "min_clearance",
        "mean_clearance",
        "contacts",
        "contacts_standing",
        "heading_rmse",
    }
    from_ticks |= {"plan_time_mean", "plan_time_max", "position_rmse", "final_position_error", "odometry_position_rmse"}
    missing |= from_ticks if n == 0 else set()
    assert {name for name, value in values.items() if value is None} == missing
    assert values["shortest_path_length"] == 2.0
    json.dumps(summary, allow_nan=False)


def test_a_run_that_has_nothing() -> None:
    """Oracle: no goal, no estimate, no plan, no obstacle, diverged: None everywhere that is not counted or timed."""
    n = 5
    lost = np.full((n, 3), NAN)
    log = run_log(
        n,
        truth_poses=lost,
        truth_twists=lost[:, :2],
        estimate_poses=lost,
        odometry_poses=lost,
        clearance=np.full(n, INF),
        plan_time=lost[:, 0],
        goal=None,
        status="diverged",
        wall_time=NAN,
    )
    present = {name: metric["value"] for name, metric in summarize(log).items() if metric["value"] is not None}
    assert present == {"duration": pytest.approx(0.4), "contacts": 0, "contacts_standing": 0, "replans": 4}


def test_logs_are_checked_and_frozen() -> None:
    with pytest.raises(ValueError, match=r"truth_poses of shape \(5, 2\) where 5 ticks need \(5, 3\)"):
        run_log(5, truth_poses=np.zeros((5, 2)))
    with pytest.raises(ValueError, match="contact"):
        run_log(5, contact=np.zeros(4, dtype=bool))
    with pytest.raises(ValueError, match="ascend"):
        run_log(3, time=[0.0, 0.1, 0.1])
    with pytest.raises(ValueError, match="ascend"):
        run_log(3, time=[0.0, NAN, 0.1])
    with pytest.raises(ValueError, match="read-only"):
        run_log(3).time[0] = 1.0


def test_unknown_length() -> None:
    """By hand: columns 4 to 6 of cells of 1 m are unknown, and are crossed twice; what is carried over them does not count."""
    data = np.zeros((10, 10), dtype=np.int8)
    data[:, 4:7] = -1
    grid = OccupancyGrid(data, 1.0)
    poses = [[1, 5, 0], [9, 5, 0], [NAN, 0, 0], [1, 5, 0]]
    assert metrics.unknown_length(grid, poses) == pytest.approx(6.0, abs=0.2)
    assert metrics.unknown_length(grid, poses, [False, False, False, True]) == pytest.approx(3.0, abs=0.1)
    assert metrics.unknown_length(OccupancyGrid(np.zeros((3, 3)), 1.0), [[1, 1, 0], [2, 1, 0]]) == 0.0
    assert metrics.unknown_length(grid, np.zeros((0, 3))) is None
