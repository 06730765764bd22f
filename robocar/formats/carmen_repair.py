"""What CARMEN logs leave out or have wrong: the range that the scanner was set to, and the order of the times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robocar.core import Array
from robocar.formats.files import MAX_TIME

NO_RETURN = (32.767, 50.0)
"""What drivers are known to write where nothing was seen, besides everything from `LONGEST` on [m]."""

LONGEST = 81.8
"""SICK scanners count up to 8191 centimetres, the last ones of which are error codes [m]."""

NOMINAL_PERIOD = 0.1
"""Between scans of a log without times [s]."""

_OFTEN = (5, 3)  # times as often as any range in the last 1 %, and in the upper half: walls scatter, the scale's end does not
_PAUSE = 60.0  # [s] that a clock falls back where it was set anew; less is a message that came late


def largest_range(ranges: Array, declared: Sequence[float] = ()) -> tuple[float, str]:
    """The range that a scanner was set to [m], and a note on how it was found, empty where the log says it.

    It is the largest value of all where drivers are known to write that, or where it is written `_OFTEN` times as often as
    others are; else what the messages declare, else `LONGEST`.

    Args:
        ranges: of all scans, (n,) [m].
        declared: ranges that the messages name [m], nan where one does not.
    """
    said = np.array(declared)
    said = said[np.isfinite(said) & (said > 0)]
    finite = ranges[np.isfinite(ranges) & (ranges > 0) & (ranges < LONGEST)]
    top = float(finite.max(initial=0.0))
    declared_range = min(float(said.max(initial=0.0)) or LONGEST, LONGEST)
    if top in NO_RETURN:
        return top, ""
    values, counts = np.unique(finite[finite > 0.5 * top], return_counts=True)
    often = int(counts[-1]) if counts.size else 0
    near = counts[:-1][values[:-1] > 0.99 * top].max(initial=1)
    stands_out = often >= max(_OFTEN[0] * near, _OFTEN[1] * counts[:-1].max(initial=1))
    if stands_out and finite.size > often and top < declared_range:
        return top, f"{often} ranges are exactly {top:g} m, the largest: taken for beams that saw nothing"
    return declared_range, ""


def repaired_times(stamps: Sequence[tuple[float, float]]) -> tuple[list[float], list[int], str]:
    """Times of scans, strictly ascending from 0 [s], the order of the scans that they belong to, and a note on what was done.

    The first of the two stamps that ascends is taken as it is. Else the first that ascends in most steps: where a clock was set
    back by more than `_PAUSE`, the rest is moved behind what was before; then scans are sorted; equal and missing stamps are
    spread evenly up to the next. Where neither ascends, scans are `NOMINAL_PERIOD` apart.

    Args:
        stamps: of the logger and of the message [s], nan where there is none.
    """
    columns = np.array(stamps, dtype=float).T
    columns[~(np.abs(columns) <= MAX_TIME)] = np.nan
    everyone = list(range(len(stamps)))
    for column in columns:
        if np.isfinite(column).all() and np.all(np.diff(column) > 0):
            return _ascending(column - column[0]), everyone, ""
    for column in columns:
        known = np.flatnonzero(np.isfinite(column))
        steps = np.diff(column[known])
        if known.size < 2 or 2 * np.count_nonzero(steps > 0) < len(stamps) - 1:
            continue
        set_back = steps < -_PAUSE
        usual = float(np.median(steps[steps > 0]))
        column[known[1:]] += np.cumsum(np.where(set_back, usual - steps, 0.0))
        late = np.count_nonzero((steps <= 0) & ~set_back)
        column = np.interp(np.arange(len(column)), known, column[known])
        order = np.argsort(column, kind="stable")
        times = _spread(column[order], usual)
        done = [
            f"{count} {what}"
            for count, what in (
                (np.count_nonzero(set_back), "times at which the clock was set back"),
                (late, "stamps that do not ascend"),
                (len(column) - known.size, "missing stamps"),
            )
            if count
        ]
        return _ascending(times - times[0]), order.tolist(), f"times put in order: {', '.join(done)}"
    times = [k * NOMINAL_PERIOD for k in everyone]
    return times, everyone, f"no stamps that ascend: scans are taken {NOMINAL_PERIOD:g} s apart" if len(times) > 1 else ""


def _ascending(times: Array) -> list[float]:
    """Times that differ by less than floats tell apart are moved apart."""
    if np.all(np.diff(times) > 0):
        return times.tolist()
    steps = 1e-6 * np.arange(len(times))
    return (np.maximum.accumulate(times - steps) + steps).tolist()


def _spread(times: Array, usual: float) -> Array:
    """Ascending times with runs of equal ones spread evenly up to the next, the last run in steps of `usual` at most."""
    values, first, counts = np.unique(times, return_index=True, return_counts=True)
    gaps = np.append(np.diff(values), usual * counts[-1])
    position = np.arange(len(times)) - np.repeat(first, counts)
    return times + position * np.repeat(np.minimum(gaps, usual * counts) / counts, counts)
