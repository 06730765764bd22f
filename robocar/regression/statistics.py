"""Means, shares and their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class IntervalEstimate:
    """A value with its interval of 95 % confidence; no interval where one run does not allow any."""

    value: float
    low: float | None = None
    high: float | None = None
    count: int = 1


def share(successes: int, count: int) -> IntervalEstimate:
    """A rate with Wilson's score interval. Wilson, Probable Inference, the Law of Succession, and Statistical Inference (1927).

    Raises:
        ValueError: no run.
    """
    from scipy.stats import binomtest

    interval = binomtest(successes, count).proportion_ci(CONFIDENCE, method="wilson")
    return IntervalEstimate(successes / count, float(interval.low), float(interval.high), count)


def mean(values: Sequence[float | None]) -> IntervalEstimate | None:
    """The mean of the values that there are, with its percentile-bootstrap interval; None where there is none.

    Efron and Tibshirani, An Introduction to the Bootstrap (1993), section 13.3. The resampling has a seed of its own: equal
    values, equal interval.
    """
    numbers = np.array([value for value in values if value is not None], dtype=float)
    if numbers.size == 0:
        return None
    value = float(numbers.mean())
    if numbers.size == 1:
        return IntervalEstimate(value)
    picks = np.random.default_rng(0).integers(0, numbers.size, (RESAMPLES, numbers.size))
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(numbers[picks].mean(axis=1), [tail, 1.0 - tail])
    # Summation in another order may put the mean of equal values a bit outside of them.
    return IntervalEstimate(value, min(float(low), value), max(float(high), value), int(numbers.size))
