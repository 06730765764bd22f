"""Localization metrics. Oracles: cases computed by hand, and the mean of a chi-square distribution."""

import math

import numpy as np
import pytest

from robocar.metrics.localization import (
    after_convergence,
    converged_heading_rmse,
    converged_nees,
    converged_position_rmse,
    convergence_time,
    nees,
    recovery_time,
)

TIME = np.arange(0.0, 20.0, 0.5)
TRUTH = np.column_stack([TIME, np.zeros(40), np.full(40, 3.1)])


def estimate(*bad: tuple[float, float]) -> np.ndarray:
    """The truth, but 1 m off within these spans of time; headings on the other side of pi."""
    poses = TRUTH + np.array([0.05, 0.05, -2 * math.pi + 0.1])
    for begin, end in bad:
        poses[(begin <= TIME) & (end > TIME), 0] += 1.0
    return poses


def test_convergence_begins_where_two_good_seconds_begin() -> None:
    assert convergence_time(TIME, TRUTH, estimate()) == 0.0
    assert convergence_time(TIME, TRUTH, estimate((0, 3))) == 3.0
    assert convergence_time(TIME, TRUTH, estimate((0, 3), (4.5, 5))) == 5.0  # 3 to 4 s is too short
    assert convergence_time(TIME, TRUTH, estimate((0, 18.5))) is None
    assert convergence_time(TIME, TRUTH, estimate() + np.array([0, 0, 0.2])) is None  # 17 degrees


def test_recovery_is_counted_from_the_event_and_the_longest_counts() -> None:
    carried = np.isin(TIME, [5.0, 12.0])
    assert recovery_time(TIME, TRUTH, estimate((5, 6), (12, 15)), carried) == 3.0
    assert recovery_time(TIME, TRUTH, estimate((5, 12), (12, 15)), carried) is None
    assert recovery_time(TIME, TRUTH, estimate((5, 6), (12, 20)), carried) is None
    assert recovery_time(TIME, TRUTH, estimate(), np.zeros(40, dtype=bool)) is None
    assert recovery_time(TIME, TRUTH, estimate(), None) is None


def test_ticks_before_convergence_and_while_lost_do_not_count() -> None:
    carried = TIME == 10.0
    known = after_convergence(TIME, TRUTH, estimate((0, 2), (10, 13)), carried)
    assert TIME[known].tolist() == [*np.arange(2.0, 10.0, 0.5), *np.arange(13.0, 20.0, 0.5)]
    drive = TIME, TRUTH, estimate((0, 2), (10, 13))
    assert converged_position_rmse(*drive, carried) == pytest.approx(math.hypot(0.05, 0.05))
    assert converged_heading_rmse(*drive, carried) == pytest.approx(0.1)
    assert converged_nees(*drive, carried, np.tile(np.eye(3), (40, 1, 1))) == pytest.approx(2 * 0.05**2 + 0.1**2)
    assert convergence_time(*drive) == 2.0
    assert recovery_time(*drive, carried) == 3.0


def test_the_nees_of_errors_drawn_from_the_covariance_is_3() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3)) * 0.05
    covariance = root @ root.T
    errors = rng.multivariate_normal(np.zeros(3), covariance, 20_000)
    matrices = np.tile(covariance, (20_000, 1, 1))
    assert nees(np.zeros((20_000, 3)), errors, matrices) == pytest.approx(3.0, rel=0.03)
    assert nees(np.zeros((20_000, 3)), 2 * errors, matrices) == pytest.approx(12.0, rel=0.03)


def test_what_is_missing_does_not_count() -> None:
    covariances = np.array([np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan)])
    truth, guess = np.zeros((3, 3)), np.array([[1.0, 1.0, 0.5]] * 3)
    assert nees(truth, guess, covariances) == pytest.approx(2.25)
    assert nees(truth, guess, covariances[1:][:1].repeat(3, axis=0)) is None
    nothing = np.empty(0), np.empty((0, 3)), np.empty((0, 3))
    assert (convergence_time(*nothing), recovery_time(*nothing, None)) == (None, None)
    assert (converged_position_rmse(*nothing), converged_heading_rmse(*nothing)) == (None, None)
    assert converged_nees(*nothing, None, np.empty((0, 3, 3))) is None
    assert convergence_time(TIME, np.full_like(TRUTH, np.nan), estimate()) is None
