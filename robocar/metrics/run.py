"""What a run is judged by: one function per metric, on plain arrays.

A value that a run does not have (no goal, no plan, no obstacle, too few ticks) is None, never 0 and never NaN. Time is
simulated, except in `plan_time_*` and `wall_time`. Rows with a number that is not finite (no belief yet, a diverged simulation)
do not count.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core import SE2, Array, Footprint, Goal, OccupancyGrid, wrap_angles
from robocar.core.discs import disc_geodesic
from robocar.core.geodesic import geodesic_distance
from robocar.core.way import length_over
from robocar.metrics.declaration import Tolerance, metric


@metric("duration", unit="s", tolerance=Tolerance("lower", absolute=0.5, relative=0.05), needs=("time",))
def duration(time: ArrayLike) -> float | None:
    """Simulated time from the first to the last tick: t_n - t_1 [s]; 0 for a single tick, None for none."""
    time = np.asarray(time, dtype=float)
    return float(time[-1] - time[0]) if time.size else None


@metric("path_length", unit="m", tolerance=Tolerance("lower", absolute=0.02, relative=0.03), needs=("truth_poses", "carried"))
def path_length(poses: ArrayLike, carried: ArrayLike | None = None) -> float | None:
    """Way that the car's origin really went: sum of |p_k - p_(k-1)| over the true positions [m]; None without a tick.

    Steps over which the car was `carried` (n,) do not count. Anderson et al., On Evaluation of Embodied Navigation Agents (2018),
    section 3: the length p_i that SPL compares.
    """
    if not len(_finite_rows(poses)):
        return None
    return float(np.linalg.norm(_steps(poses, carried)[:, :2], axis=1).sum())


@metric(
    "shortest_path_length", unit="m", needs=("grid", "footprint", "start", "goal"), optional=("discs",)
)  # of the world, not of the robot: not judged
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
        length = disc_geodesic(discs, start.position, goal.position, footprint.inscribed_radius)
    else:
        length = geodesic_distance(grid, grid.occupied, start.position, goal.position, footprint.inscribed_radius)
    return length if np.isfinite(length) else None


@metric("unknown_length", unit="m", needs=("grid", "truth_poses"), optional=("carried",))  # of map and way: not judged
def unknown_length(grid: OccupancyGrid, poses: ArrayLike, carried: ArrayLike | None = None) -> float | None:
    """Part of `path_length` that leads over cells which the map does not know [m]: there the world is free floor by assumption.

    0 on a map without unknown cells; None without a tick.
    """
    rows = np.asarray(poses, dtype=float).reshape(-1, 3)
    finite = np.isfinite(rows).all(axis=1)
    if not finite.any():
        return None
    carries = None if carried is None else np.asarray(carried, dtype=bool)[finite]
    return length_over(grid, grid.unknown, rows[finite, :2], carries)


@metric("spl", unit="1", tolerance=Tolerance("higher", absolute=0.02), needs=("success", "shortest_path_length", "path_length"))
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


@metric("min_clearance", unit="m", tolerance=Tolerance("higher", absolute=0.01), needs=("clearance",))
def min_clearance(clearance: ArrayLike) -> float | None:
    """Smallest distance of the footprint to an obstacle, walls and movers: min_k d_k [m]; None where there never was one."""
    return _reduce(clearance, np.min)


@metric("mean_clearance", unit="m", tolerance=Tolerance("higher", absolute=0.02, relative=0.10), needs=("clearance",))
def mean_clearance(clearance: ArrayLike) -> float | None:
    """Mean over the ticks of the distance of the footprint to the nearest obstacle: (1/n) sum d_k [m].

    Ticks without any obstacle (inf) do not count; None where all are such.
    """
    return _reduce(clearance, np.mean)


@metric("contacts", unit="1", tolerance=Tolerance("lower"), needs=("contact", "standing"))
def contacts(contact: ArrayLike, standing: ArrayLike) -> int | None:
    """Number of contact episodes that began while the robot moved; None without a tick.

    An episode is a longest sequence of ticks with contact. It began standing if the robot stood still at its first tick and at
    the tick before: a robot that a wall has just stopped did not stand.
    """
    began, stood = _contact_episodes(contact, standing)
    return int(np.count_nonzero(began & ~stood)) if began.size else None


@metric("contacts_standing", unit="1", needs=("contact", "standing"))  # something ran into the robot: not judged
def contacts_standing(contact: ArrayLike, standing: ArrayLike) -> int | None:
    """Number of contact episodes that began while the robot stood still, as when a mover runs into it; see `contacts`."""
    began, stood = _contact_episodes(contact, standing)
    return int(np.count_nonzero(began & stood)) if began.size else None


@metric("replans", unit="1", needs=("work",))  # more of them may be caution or confusion: not judged
def replans(work: Mapping[str, int]) -> int:
    """How often the global plan was made again: the unit `replans` of the commands' work."""
    return work.get("replans", 0)


@metric("plan_time_mean", unit="s", needs=("plan_time",), wall_clock=True)  # a busy machine is no regression: not judged
def plan_time_mean(plan_time: ArrayLike) -> float | None:
    """Mean wall time of the navigator over the ticks at which it was asked [s]; nan marks the others."""
    return _reduce(plan_time, np.mean)


@metric("plan_time_max", unit="s", needs=("plan_time",), wall_clock=True)
def plan_time_max(plan_time: ArrayLike) -> float | None:
    """Longest wall time of the navigator in one tick [s]; nan marks the ticks at which it was not asked."""
    return _reduce(plan_time, np.max)


@metric(
    "position_rmse",
    unit="m",
    tolerance=Tolerance("lower", absolute=0.005, relative=0.10),
    needs=("truth_poses", "estimate_poses"),
)
def position_rmse(truth: ArrayLike, estimate: ArrayLike) -> float | None:
    """Root mean square of |p_k - q_k| over the ticks with an estimate [m].

    Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems (2012), eq. 2: absolute trajectory error of the
    translation, without alignment, as both are in the map frame.
    """
    truth, estimate = _finite_pairs(truth, estimate)
    return _rms(np.linalg.norm(truth[:, :2] - estimate[:, :2], axis=1))


@metric(
    "heading_rmse",
    unit="rad",
    tolerance=Tolerance("lower", absolute=0.01, relative=0.10),
    needs=("truth_poses", "estimate_poses"),
)
def heading_rmse(truth: ArrayLike, estimate: ArrayLike) -> float | None:
    """Root mean square of the heading errors, each taken the short way round the circle, over the ticks with an estimate [rad].

    As `position_rmse`, for the rotation: the angle of R_truth^-1 R_estimate, which in the plane is the wrapped difference.
    """
    truth, estimate = _finite_pairs(truth, estimate)
    return _rms(wrap_angles(truth[:, 2] - estimate[:, 2]))


@metric(
    "final_position_error",
    unit="m",
    tolerance=Tolerance("lower", absolute=0.02, relative=0.10),
    needs=("truth_poses", "estimate_poses"),
)
def final_position_error(truth: ArrayLike, estimate: ArrayLike) -> float | None:
    """Distance |p_n - q_n| of the true and the estimated position at the last tick [m]; None where either is missing."""
    truth, estimate = _finite_pairs(np.atleast_2d(truth)[-1:], np.atleast_2d(estimate)[-1:])
    return float(np.linalg.norm(truth[0, :2] - estimate[0, :2])) if len(truth) else None


@metric(
    "odometry_position_rmse", unit="m", needs=("truth_poses", "odometry_poses")
)  # of the robot and its way, not of the estimator: not judged
def odometry_position_rmse(truth: ArrayLike, odometry: ArrayLike) -> float | None:
    """`position_rmse` of dead reckoning alone, from the pose the robot was told [m]: what the estimator has to beat."""
    return position_rmse(truth, odometry)


@metric(
    "angle_over_length",
    unit="rad/m",
    tolerance=Tolerance("lower", absolute=0.05, relative=0.10),
    needs=("truth_poses", "carried"),
)
def angle_over_length(poses: ArrayLike, carried: ArrayLike | None = None) -> float | None:
    """Turning per way: sum of |wrap(theta_k - theta_(k-1))| over `path_length` [rad/m]; None where the car did not move.

    Heiden et al., Bench-MR (2021), section on metrics (AOL). For a circle it is the curvature.
    """
    length = path_length(poses, carried)
    if not length:
        return None
    return float(np.abs(wrap_angles(_steps(poses, carried)[:, 2])).sum()) / length


@metric("jerk_rms", unit="m/s^3", tolerance=Tolerance("lower", relative=0.10), needs=("time", "truth_twists"))
def jerk_rms(time: ArrayLike, twists: ArrayLike) -> float | None:
    """Root mean square of the second time derivative of the forward speed [m/s^3]; None for fewer than three ticks.

    Hogan and Sternad, Sensitivity of Smoothness Measures to Movement Duration, Amplitude, and Arrests (2009): the root mean
    squared jerk, here by second divided differences, which are exact for quadratic speeds at any ticks.
    """
    speed = np.asarray(twists, dtype=float).reshape(-1, 2)[:, 0]
    rows = _finite_rows(np.stack([np.asarray(time, dtype=float), speed], axis=1))
    t, v = rows[:, 0], rows[:, 1]
    if len(t) < 3:
        return None
    slopes = np.diff(v) / np.diff(t)
    return _rms(2.0 * np.diff(slopes) / (t[2:] - t[:-2]))


@metric("wall_time", unit="s", needs=("wall_time",), wall_clock=True)
def wall_time(seconds: float) -> float:
    """Wall time of the loop, without building the world [s]."""
    return seconds


@metric("real_time_factor", unit="1", needs=("duration", "wall_time"), wall_clock=True)
def real_time_factor(simulated: float | None, wall: float | None) -> float | None:
    """Simulated over wall time [1]: above 1 is faster than reality; None where either is missing or no wall time passed."""
    return simulated / wall if simulated is not None and wall else None


def _contact_episodes(contact: ArrayLike, standing: ArrayLike) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether an episode of contact began at each tick, and whether the robot stood then, (n,) each; see `contacts`."""
    contact, standing = np.asarray(contact, dtype=bool), np.asarray(standing, dtype=bool)
    began = contact & ~np.concatenate([[False], contact])[: contact.size]
    return began, standing & np.concatenate([[True], standing])[: standing.size]


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
