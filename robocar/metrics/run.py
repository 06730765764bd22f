"""What a run is judged by: one function per metric, on plain arrays.

A value that a run does not have (no goal, no plan, no obstacle, too few ticks) is None, never 0 and never NaN. Time is
simulated, except in `plan_time_*` and `wall_time`. Rows with a number that is not finite (no belief yet, a diverged simulation)
do not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core import SE2, Array, Footprint, Goal, OccupancyGrid, frozen_array, wrap_angles
from robocar.core.discs import disc_geodesic
from robocar.core.geodesic import geodesic_distance


class Metric(TypedDict):
    """A value, None where the run has none, and its unit ("1" for ratios and counts)."""

    value: float | int | None
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class RunLog:
    """What the loop collects, one row per control tick.

    Args:
        time: simulated, strictly ascending, (n,) [s].
        truth_poses: (n, 3) x, y [m], theta [rad] in the map frame; estimate_poses, odometry_poses alike, nan where there is none.
        truth_twists: (n, 2) v [m/s], omega [rad/s].
        clearance: footprint to the nearest wall or mover, (n,) [m]; 0 in contact, inf where there is nothing.
        contact: whether the car touches a wall or a mover, (n,) bool.
        standing: whether the car stands still, (n,) bool.
        plan_time: wall time of the navigator, (n,) [s]; nan where it was not asked.
        replans: how often the global plan was made anew.
        status: how the run ended, `success` where the goal was reached.
        grid: the true map.
        footprint: the car's.
        start: the true pose before the first tick.
        goal: or None, for tasks without one.
        wall_time: of the loop, without building the world [s], or None.
        carried: whether an event moved the car since the tick before (`kidnap`), (n,) bool, or None where there is none.
        discs: x, y and radius of all obstacles, (k, 3) [m], where they are round and stand on an open plane; else None.
    """

    time: Array
    truth_poses: Array
    truth_twists: Array
    estimate_poses: Array
    odometry_poses: Array
    clearance: Array
    contact: NDArray[np.bool_]
    standing: NDArray[np.bool_]
    plan_time: Array
    replans: int
    status: str
    grid: OccupancyGrid
    footprint: Footprint
    start: SE2
    goal: Goal | None = None
    wall_time: float | None = None
    carried: NDArray[np.bool_] | None = None
    discs: Array | None = None

    def __post_init__(self) -> None:
        n = np.size(self.time)
        object.__setattr__(self, "carried", np.zeros(n, dtype=bool) if self.carried is None else self.carried)
        shapes = {"time": (n,), "truth_poses": (n, 3), "truth_twists": (n, 2), "estimate_poses": (n, 3)}
        shapes |= {"odometry_poses": (n, 3), "clearance": (n,), "contact": (n,), "standing": (n,), "plan_time": (n,)}
        shapes |= {"carried": (n,)}
        for name, shape in shapes.items():
            array = frozen_array(getattr(self, name), bool if name in ("contact", "standing", "carried") else float)
            if n == 0 and array.size == 0:
                array = frozen_array(array.reshape(shape), array.dtype)
            if array.shape != shape:
                raise ValueError(f"{name} of shape {array.shape} where {n} ticks need {shape}")
            object.__setattr__(self, name, array)
        if not np.all(np.diff(self.time) > 0):
            raise ValueError("the times of a run must ascend strictly")


def summarize(log: RunLog) -> dict[str, Metric]:
    """All metrics that every run has, in the order of `metrics.json`."""
    truth, twists = log.truth_poses, log.truth_twists
    seconds, length = duration(log.time), path_length(truth, log.carried)
    shortest = shortest_path_length(log.grid, log.footprint, log.start, log.goal, log.discs)
    moving, standing = contacts(log.contact, log.standing)
    values: dict[str, tuple[float | int | None, str]] = {
        "duration": (seconds, "s"),
        "path_length": (length, "m"),
        "shortest_path_length": (shortest, "m"),
        "spl": (spl(log.status == "success", shortest, length), "1"),
        "min_clearance": (min_clearance(log.clearance), "m"),
        "mean_clearance": (mean_clearance(log.clearance), "m"),
        "contacts": (moving, "1"),
        "contacts_standing": (standing, "1"),
        "replans": (log.replans, "1"),
        "plan_time_mean": (plan_time_mean(log.plan_time), "s"),
        "plan_time_max": (plan_time_max(log.plan_time), "s"),
        "position_rmse": (position_rmse(truth, log.estimate_poses), "m"),
        "heading_rmse": (heading_rmse(truth, log.estimate_poses), "rad"),
        "final_position_error": (final_position_error(truth, log.estimate_poses), "m"),
        "odometry_position_rmse": (odometry_position_rmse(truth, log.odometry_poses), "m"),
        "angle_over_length": (angle_over_length(truth, log.carried), "rad/m"),
        "jerk_rms": (jerk_rms(log.time, twists[:, 0]), "m/s^3"),
        "wall_time": (log.wall_time, "s"),
        "real_time_factor": (real_time_factor(seconds, log.wall_time), "1"),
    }
    return {name: Metric(value=_finite(value), unit=unit) for name, (value, unit) in values.items()}


def duration(time: ArrayLike) -> float | None:
    """Simulated time from the first to the last tick: t_n - t_1 [s]; 0 for a single tick, None for none."""
    time = np.asarray(time, dtype=float)
    return float(time[-1] - time[0]) if time.size else None


def path_length(poses: ArrayLike, carried: ArrayLike | None = None) -> float | None:
    """Way that the car's origin really went: sum of |p_k - p_(k-1)| over the true positions [m]; None without a tick.

    Steps over which the car was `carried` (n,) do not count. Anderson et al., On Evaluation of Embodied Navigation Agents (2018),
    section 3: the length p_i that SPL compares.
    """
    if not len(_finite_rows(poses)):
        return None
    return float(np.linalg.norm(_steps(poses, carried)[:, :2], axis=1).sum())


def shortest_path_length(
    grid: OccupancyGrid, footprint: Footprint, start: SE2, goal: Goal | None, discs: Array | None = None
) -> float | None:
    """Geodesic distance from start to goal on the true map for the disc of the footprint's inscribed radius [m].

    The footprint contains this disc, so no collision-free run to the goal's position is shorter. None without a goal, or where
    the disc does not fit at an end or finds no way. Anderson et al. (2018), section 3: the length l_i; `robocar.core.geodesic`.
    Among round obstacles alone, `discs` (k, 3), it is exact and the grid no matter (`robocar.core.discs`).
    """
    if goal is None:
        return None
    if discs is not None:
        return _finite(disc_geodesic(discs, start.position, goal.position, footprint.inscribed_radius))
    length = geodesic_distance(grid, grid.occupied, start.position, goal.position, footprint.inscribed_radius)
    return _finite(length)


def spl(success: bool, shortest: float | None, length: float | None) -> float | None:
    """Success weighted by path length of one run: S l / max(p, l), in [0, 1]; a suite averages it over its runs.

    Anderson et al. (2018), section 3, with S success (0 or 1), l the shortest and p the real path length; S itself where the
    run starts at its goal and stays (l = p = 0). None without a shortest path.
    """
    if shortest is None or length is None:
        return None
    if not success:
        return 0.0
    longest = max(shortest, length)
    return shortest / longest if longest > 0 else 1.0


def min_clearance(clearance: ArrayLike) -> float | None:
    """Smallest distance of the footprint to an obstacle, walls and movers: min_k d_k [m]; None where there never was one."""
    return _reduce(clearance, np.min)


def mean_clearance(clearance: ArrayLike) -> float | None:
    """Mean over the ticks of the distance of the footprint to the nearest obstacle: (1/n) sum d_k [m].

    Ticks without any obstacle (inf) do not count; None where all are such.
    """
    return _reduce(clearance, np.mean)


def contacts(contact: ArrayLike, standing: ArrayLike) -> tuple[int, int] | tuple[None, None]:
    """Numbers of contact episodes: begun while the car moved, and begun while it stood still (a mover ran into it).

    An episode is a longest sequence of ticks with contact. It began standing if the car stood still at its first tick and at the
    tick before: a car that a wall has just stopped did not stand. None without a tick.
    """
    contact, standing = np.asarray(contact, dtype=bool), np.asarray(standing, dtype=bool)
    if contact.size == 0:
        return None, None
    began = contact & ~np.concatenate([[False], contact[:-1]])
    stood = standing & np.concatenate([[True], standing[:-1]])
    return int(np.count_nonzero(began & ~stood)), int(np.count_nonzero(began & stood))


def plan_time_mean(plan_time: ArrayLike) -> float | None:
    """Mean wall time of the navigator over the ticks at which it was asked [s]; nan marks the others."""
    return _reduce(plan_time, np.mean)


def plan_time_max(plan_time: ArrayLike) -> float | None:
    """Longest wall time of the navigator in one tick [s]; nan marks the ticks at which it was not asked."""
    return _reduce(plan_time, np.max)


def position_rmse(truth: ArrayLike, estimate: ArrayLike) -> float | None:
    """Root mean square of |p_k - q_k| over the ticks with an estimate [m].

    Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems (2012), eq. 2: absolute trajectory error of the
    translation, without alignment, as both are in the map frame.
    """
    truth, estimate = _finite_pairs(truth, estimate)
    return _rms(np.linalg.norm(truth[:, :2] - estimate[:, :2], axis=1))


def heading_rmse(truth: ArrayLike, estimate: ArrayLike) -> float | None:
    """Root mean square of the heading errors, each taken the short way round the circle, over the ticks with an estimate [rad].

    As `position_rmse`, for the rotation: the angle of R_truth^-1 R_estimate, which in the plane is the wrapped difference.
    """
    truth, estimate = _finite_pairs(truth, estimate)
    return _rms(wrap_angles(truth[:, 2] - estimate[:, 2]))


def final_position_error(truth: ArrayLike, estimate: ArrayLike) -> float | None:
    """Distance |p_n - q_n| of the true and the estimated position at the last tick [m]; None where either is missing."""
    truth, estimate = _finite_pairs(np.atleast_2d(truth)[-1:], np.atleast_2d(estimate)[-1:])
    return float(np.linalg.norm(truth[0, :2] - estimate[0, :2])) if len(truth) else None


def odometry_position_rmse(truth: ArrayLike, odometry: ArrayLike) -> float | None:
    """`position_rmse` of dead reckoning alone, from the pose the robot was told [m]: what the estimator has to beat."""
    return position_rmse(truth, odometry)


def angle_over_length(poses: ArrayLike, carried: ArrayLike | None = None) -> float | None:
    """Turning per way: sum of |wrap(theta_k - theta_(k-1))| over `path_length` [rad/m]; None where the car did not move.

    Heiden et al., Bench-MR (2021), section on metrics (AOL). For a circle it is the curvature.
    """
    length = path_length(poses, carried)
    if not length:
        return None
    return float(np.abs(wrap_angles(_steps(poses, carried)[:, 2])).sum()) / length


def jerk_rms(time: ArrayLike, speed: ArrayLike) -> float | None:
    """Root mean square of the second time derivative of the forward speed [m/s^3]; None for fewer than three ticks.

    Hogan and Sternad, Sensitivity of Smoothness Measures to Movement Duration, Amplitude, and Arrests (2009): the root mean
    squared jerk, here by second divided differences, which are exact for quadratic speeds at any ticks.
    """
    rows = _finite_rows(np.stack([np.asarray(time, dtype=float), np.asarray(speed, dtype=float)], axis=1))
    t, v = rows[:, 0], rows[:, 1]
    if len(t) < 3:
        return None
    slopes = np.diff(v) / np.diff(t)
    return _rms(2.0 * np.diff(slopes) / (t[2:] - t[:-2]))


def real_time_factor(simulated: float | None, wall: float | None) -> float | None:
    """Simulated over wall time [1]: above 1 is faster than reality; None where either is missing or no wall time passed."""
    return simulated / wall if simulated is not None and wall else None


def _finite(value: float | int | None) -> float | int | None:
    return value if value is not None and np.isfinite(value) else None


def _finite_rows(rows: ArrayLike) -> Array:
    rows = np.asarray(rows, dtype=float)
    return rows[np.isfinite(rows).all(axis=1)] if rows.size else rows.reshape(0, 3)


def _steps(poses: ArrayLike, carried: ArrayLike | None) -> Array:
    """Differences of consecutive poses (n, 3), without those over which the car was carried."""
    poses = np.asarray(poses, dtype=float)
    finite = np.isfinite(poses).all(axis=1)
    # Counting the carries makes one that falls on a dropped row cut the step across that row.
    carries = np.cumsum(np.zeros(len(poses)) if carried is None else np.asarray(carried, dtype=float))[finite]
    return np.diff(poses[finite], axis=0)[np.diff(carries) == 0]


def _finite_pairs(a: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
    """The rows that are finite in both, with the same index."""
    both = np.concatenate([np.asarray(a, dtype=float).reshape(-1, 3), np.asarray(b, dtype=float).reshape(-1, 3)], axis=1)
    both = both[np.isfinite(both).all(axis=1)]
    return both[:, :3], both[:, 3:]


def _reduce(values: ArrayLike, reduction) -> float | None:
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    return float(reduction(values)) if values.size else None


def _rms(errors: Array) -> float | None:
    return float(np.sqrt(np.mean(errors**2))) if errors.size else None
