"""How well an estimator knew where the robot was: `localization/*` of `metrics.json`."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core import Array, wrap_angles
from robocar.metrics.declaration import Tolerance, metric
from robocar.metrics.run import heading_rmse, position_rmse

POSITION_TOLERANCE, HEADING_TOLERANCE, HOLD = 0.10, math.radians(10.0), 2.0
"""An estimate has converged when it stays within these [m], [rad] for this time [s]."""


@metric(
    "localization/convergence_time",
    unit="s",
    tolerance=Tolerance("lower", absolute=0.5, relative=0.10),
    needs=("time", "truth_poses", "estimate_poses"),
    where="localized",
)
def convergence_time(time: ArrayLike, truth: ArrayLike, estimate: ArrayLike) -> float | None:
    """Time from the first tick until the estimate begins to stay within 10 cm and 10 degrees of the truth for 2 s [s].

    None where it never does. The numbers are `POSITION_TOLERANCE`, `HEADING_TOLERANCE` and `HOLD`.
    """
    time = np.asarray(time, dtype=float)
    k = _first_hold(time, _good(truth, estimate), 0)
    return None if k is None else float(time[k] - time[0])


@metric(
    "localization/recovery_time",
    unit="s",
    tolerance=Tolerance("lower", absolute=0.5, relative=0.10),
    needs=("time", "truth_poses", "estimate_poses", "carried"),
    where="localized",
)
def recovery_time(time: ArrayLike, truth: ArrayLike, estimate: ArrayLike, carried: ArrayLike | None) -> float | None:
    """The longest that the estimate took to converge again after the robot was carried away [s].

    None where it was not, or where the estimate did not recover before the next time or the end.
    """
    time = np.asarray(time, dtype=float)
    events = [] if carried is None else np.flatnonzero(np.asarray(carried, dtype=bool)).tolist()
    good = _good(truth, estimate)
    longest = None
    for event, following in pairwise([*events, len(time)]):
        k = _first_hold(time[:following], good[:following], event)
        if k is None:
            return None
        longest = max(longest or 0.0, float(time[k] - time[event]))
    return longest


def after_convergence(
    time: ArrayLike, truth: ArrayLike, estimate: ArrayLike, carried: ArrayLike | None = None
) -> NDArray[np.bool_]:
    """Ticks (n,) from the first convergence on; after the robot was carried away, from the next one on."""
    time = np.asarray(time, dtype=float)
    good = _good(truth, estimate)
    events = [] if carried is None else np.flatnonzero(np.asarray(carried, dtype=bool)).tolist()
    result = np.zeros(len(time), dtype=bool)
    for begin, end in pairwise([0, *events, len(time)]):
        k = _first_hold(time[:end], good[:end], begin)
        if k is not None:
            result[k:end] = True
    return result


_NEEDS = ("time", "truth_poses", "estimate_poses", "carried")


@metric(
    "localization/position_rmse",
    unit="m",
    tolerance=Tolerance("lower", absolute=0.005, relative=0.10),
    needs=_NEEDS,
    where="localized",
)
def converged_position_rmse(
    time: ArrayLike, truth: ArrayLike, estimate: ArrayLike, carried: ArrayLike | None = None
) -> float | None:
    """Root mean square of the position errors [m], over the ticks `after_convergence`."""
    known = after_convergence(time, truth, estimate, carried)
    return position_rmse(np.asarray(truth)[known], np.asarray(estimate)[known])


@metric(
    "localization/heading_rmse",
    unit="rad",
    tolerance=Tolerance("lower", absolute=0.01, relative=0.10),
    needs=_NEEDS,
    where="localized",
)
def converged_heading_rmse(
    time: ArrayLike, truth: ArrayLike, estimate: ArrayLike, carried: ArrayLike | None = None
) -> float | None:
    """Root mean square of the heading errors [rad], over the ticks `after_convergence`."""
    known = after_convergence(time, truth, estimate, carried)
    return heading_rmse(np.asarray(truth)[known], np.asarray(estimate)[known])


# Too large and too small are both bad: not judged.
@metric("localization/nees", unit="1", needs=(*_NEEDS, "covariances"), where="localized")
def converged_nees(
    time: ArrayLike, truth: ArrayLike, estimate: ArrayLike, carried: ArrayLike | None, covariances: ArrayLike
) -> float | None:
    """Normalized estimation error squared, over the ticks `after_convergence`: 3 for a consistent filter. See `nees`."""
    known = after_convergence(time, truth, estimate, carried)
    return nees(np.asarray(truth)[known], np.asarray(estimate)[known], np.asarray(covariances)[known])


def nees(truth: ArrayLike, estimate: ArrayLike, covariances: ArrayLike) -> float | None:
    """Normalized estimation error squared, mean of e^T P^-1 e: 3 for a consistent filter of three numbers, more if it is too
    sure.

    Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2. Ticks whose
    covariance is singular or missing do not count.

    Args:
        truth, estimate: (n, 3); covariances: (n, 3, 3).
    """
    errors = _errors(truth, estimate)
    matrices = np.asarray(covariances, dtype=float).reshape(-1, 3, 3)
    finite = np.flatnonzero(np.isfinite(errors).all(axis=1) & np.isfinite(matrices).all(axis=(1, 2)))
    chosen = finite[np.linalg.det(matrices[finite]) > 1e-24]
    if len(chosen) == 0:
        return None
    errors, matrices = errors[chosen], matrices[chosen]
    return float(np.mean(np.einsum("ni,ni->n", errors, np.linalg.solve(matrices, errors[..., None])[..., 0])))


def _errors(truth: ArrayLike, estimate: ArrayLike) -> Array:
    errors = np.asarray(estimate, dtype=float).reshape(-1, 3) - np.asarray(truth, dtype=float).reshape(-1, 3)
    finite = np.isfinite(errors[:, 2])
    errors[finite, 2] = wrap_angles(errors[finite, 2])
    return errors


def _good(truth: ArrayLike, estimate: ArrayLike) -> NDArray[np.bool_]:
    errors = _errors(truth, estimate)
    return (np.hypot(errors[:, 0], errors[:, 1]) < POSITION_TOLERANCE) & (np.abs(errors[:, 2]) < HEADING_TOLERANCE)


def _first_hold(time: Array, good: NDArray[np.bool_], begin: int) -> int | None:
    """The first tick from `begin` on from which all are good for `HOLD`."""
    start = None
    for k in range(begin, len(time)):
        if not good[k]:
            start = None
            continue
        start = k if start is None else start
        if time[k] - time[start] >= HOLD - 1e-9:
            return start
    return None
