"""How well an estimator knew where the robot was: `localization/*` of `metrics.json`."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robocar.core import Array, wrap_angles
from robocar.metrics.run import Metric, heading_rmse, position_rmse

POSITION_TOLERANCE, HEADING_TOLERANCE, HOLD = 0.10, math.radians(10.0), 2.0
"""An estimate has converged when it stays within these [m], [rad] for this time [s]."""


def summarize_localization(
    time: ArrayLike, truth: ArrayLike, estimate: ArrayLike, covariances: ArrayLike | None = None, carried: ArrayLike | None = None
) -> dict[str, Metric]:
    """All of them.

    Args:
        time: ascending, (n,) [s].
        truth, estimate: (n, 3) x, y [m], theta [rad], nan where there is none.
        covariances: of the estimate, (n, 3, 3), nan where there is none; None: nobody stated any.
        carried: whether somebody moved the robot since the tick before, (n,) bool.
    """
    time, truth, estimate = (np.asarray(a, dtype=float) for a in (time, truth, estimate))
    n = len(time)
    known = after_convergence(time, truth, estimate, carried)
    values: dict[str, tuple[float | None, str]] = {
        "convergence_time": (convergence_time(time, truth, estimate), "s"),
        "recovery_time": (recovery_time(time, truth, estimate, carried), "s"),
        "position_rmse": (position_rmse(truth[known], estimate[known]) if n else None, "m"),
        "heading_rmse": (heading_rmse(truth[known], estimate[known]) if n else None, "rad"),
        "nees": (
            nees(truth[known], estimate[known], np.asarray(covariances)[known]) if covariances is not None and n else None,
            "1",
        ),
    }
    return {f"localization/{name}": Metric(value=value, unit=unit) for name, (value, unit) in values.items()}


def convergence_time(time: ArrayLike, truth: ArrayLike, estimate: ArrayLike) -> float | None:
    """From the first tick until the estimate begins to stay within `POSITION_TOLERANCE` and `HEADING_TOLERANCE` for `HOLD` [s].

    None where it never does.
    """
    time = np.asarray(time, dtype=float)
    k = _first_hold(time, _good(truth, estimate), 0)
    return None if k is None else float(time[k] - time[0])


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
