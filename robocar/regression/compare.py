"""Two sets of runs against each other: what is the same, what got better, what got worse."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from robocar.core import LogFormatError
from robocar.metrics import Tolerance
from robocar.regression.judgement import tolerances
from robocar.regression.results import Results, Row
from robocar.regression.statistics import IntervalEstimate, mean

Verdict = Literal["better", "worse", "unchanged"]
Key = tuple[str, str, str, str]
"""Scenario, navigator, estimator, mapper: runs that differ by their seeds only."""


@dataclass(frozen=True, slots=True)
class Pair:
    """The same run before and now."""

    base: Row
    new: Row

    @property
    def comparable(self) -> bool:
        """Whether equal behaviour promises equal hashes: both ran to their end, under the same fingerprint."""
        return self.base.hash is not None and self.new.hash is not None and self.base.fingerprint == self.new.fingerprint

    @property
    def identical(self) -> bool:
        return self.base.hash is not None and self.base.hash == self.new.hash

    @property
    def verdict(self) -> Verdict:
        """Of the outcome. One failure instead of another is neither better nor worse, unless it is now an error."""
        if self.base.success != self.new.success:
            return "better" if self.new.success else "worse"
        broken = ("error", "diverged")
        if self.base.status != self.new.status and (self.base.status in broken) != (self.new.status in broken):
            return "worse" if self.new.status in broken else "better"
        return "unchanged"


@dataclass(frozen=True, slots=True)
class MetricChange:
    """One metric over the seeds of one scenario and navigator, where both runs reached the goal.

    Args:
        base: its mean before; change: mean of the paired differences, with its interval.
        margin: how large a change is let pass, in the metric's unit.
    """

    key: Key
    metric: str
    unit: str
    base: float
    change: IntervalEstimate
    margin: float
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class Comparison:
    """What `compare` found.

    Args:
        pairs: runs that are on both sides; missing: names of those that are only in the base, added: only in the new.
        metrics: every judged metric of every group, unchanged ones included.
        why_not_hashes: why the hashes of some pairs tell nothing, a line per reason.
        exact: whether a run that is not identical where it could be is a failure.
        subset: whether missing runs are none.
    """

    pairs: tuple[Pair, ...]
    missing: tuple[str, ...]
    added: tuple[str, ...]
    metrics: tuple[MetricChange, ...]
    why_not_hashes: tuple[str, ...]
    exact: bool
    subset: bool

    @property
    def outcomes(self) -> tuple[Pair, ...]:
        """Pairs that ended in another way than before."""
        return tuple(pair for pair in self.pairs if pair.base.status != pair.new.status)

    @property
    def changed(self) -> tuple[Pair, ...]:
        """Pairs whose hashes could be equal, and are not."""
        return tuple(pair for pair in self.pairs if pair.comparable and not pair.identical)

    def of(self, verdict: Verdict) -> tuple[MetricChange, ...]:
        return tuple(change for change in self.metrics if change.verdict == verdict)

    @property
    def failures(self) -> tuple[str, ...]:
        """What got worse, a line each; empty means: no regression."""
        found = [
            f"{pair.new.name}: {pair.base.status} became {pair.new.status}" for pair in self.outcomes if pair.verdict == "worse"
        ]
        found += [describe(change) for change in self.of("worse")]
        if self.exact:
            found += [f"{pair.new.name}: behaves differently (another hash)" for pair in self.changed]
        if not self.subset:
            found += [f"{name}: is missing" for name in self.missing]
        return tuple(found)


def describe(change: MetricChange) -> str:
    """One line, e.g. `office, a-star, truth, none: duration 41.2 s +3.1 [+2.8, +3.5] (tolerance 2.06): worse`."""
    unit = "" if change.unit in ("1", "") else f" {change.unit}"
    spread = "" if change.change.low is None else f" [{change.change.low:+.3g}, {change.change.high:+.3g}]"
    values = f"{change.base:.4g}{unit} {change.change.value:+.3g}{spread}"
    return f"{', '.join(change.key)}: {change.metric} {values} (tolerance {change.margin:.3g}): {change.verdict}"


def compare(
    base: Results,
    new: Results,
    table: Mapping[str, Tolerance] | None = None,
    *,
    exact: bool | None = None,
    subset: bool = False,
) -> Comparison:
    """Pair the runs by scenario, navigator, estimator, mapper and seed, and judge each pair.

    A metric got worse where the mean of the paired differences over the seeds of one scenario exceeds its tolerance and, with
    more than one seed, their 95 % bootstrap interval lies on the worse side of zero. Only pairs that both reached the goal are
    measured: the rest differ by their outcome.

    Args:
        table: tolerances by metric; by default the sweep's own, else the project's.
        exact: whether another hash is a failure by itself; by default what the sweep's suite says.
        subset: runs that are only in the base are no failure.

    Raises:
        LogFormatError: the two have no run in common, or a sweep whose tolerances cannot be read.
    """
    about = {**base.sweep, **new.sweep}
    if table is None:
        try:
            table = tolerances(about.get("tolerances"))
        except (ValueError, TypeError, AttributeError) as error:
            raise LogFormatError(f"{new.source}: tolerances of the sweep cannot be read: {error}") from error
    pairs, missing, added = _pair(base.rows, new.rows)
    if not pairs:
        raise LogFormatError(
            f"{base.source} and {new.source} have no run in common: a scenario, navigator, estimator, mapper and seed"
        )
    groups: dict[tuple[Key, str], list[Pair]] = {}
    for pair in pairs:
        row = pair.new
        groups.setdefault(((row.scenario, row.navigator, row.estimator, row.mapper), row.settings), []).append(pair)
    units = {**base.units, **new.units}
    metrics = tuple(change for (key, _), group in groups.items() for change in _judge(key, group, table, units))
    return Comparison(
        tuple(pairs),
        tuple(row.name for row in missing),
        tuple(row.name for row in added),
        metrics,
        _why_not(pairs),
        bool(about.get("exact")) if exact is None else exact,
        subset,
    )


def _judge(key: Key, pairs: Sequence[Pair], table: Mapping[str, Tolerance], units: Mapping[str, str]) -> list[MetricChange]:
    both = [pair for pair in pairs if pair.base.success and pair.new.success]
    found = []
    for metric, tolerance in table.items():
        if tolerance.better == "neither":
            continue
        values = [(pair.base.metrics.get(metric), pair.new.metrics.get(metric), pair.identical) for pair in both]
        known = [(old, new, same) for old, new, same in values if old is not None and new is not None]
        if not known:
            continue
        # A baseline's numbers are rounded: equal hashes are equal metrics.
        change = mean([0.0 if same else new - old for old, new, same in known])
        before = mean([old for old, _, _ in known])
        assert change is not None and before is not None
        margin = tolerance.margin(before.value)
        found.append(
            MetricChange(key, metric, units.get(metric, ""), before.value, change, margin, _verdict(tolerance, change, margin))
        )
    return found


def _verdict(tolerance: Tolerance, change: IntervalEstimate, margin: float) -> Verdict:
    ends = [change.value] if change.low is None or change.high is None else [change.low, change.high]
    directions: tuple[tuple[Verdict, float], ...] = (("worse", 1.0), ("better", -1.0))
    for verdict, sign in directions:
        if sign * tolerance.worsening(change.value) > margin and all(sign * tolerance.worsening(end) > 0 for end in ends):
            return verdict
    return "unchanged"


def _pair(base: Sequence[Row], new: Sequence[Row]) -> tuple[list[Pair], list[Row], list[Row]]:
    """Pairs, and what is left on either side. Runs that differ by their settings only are paired by them where that helps."""

    def by_key(rows: Sequence[Row]) -> dict[tuple[object, ...], list[Row]]:
        table: dict[tuple[object, ...], list[Row]] = {}
        for row in rows:
            table.setdefault((row.scenario, row.navigator, row.estimator, row.mapper, row.seed), []).append(row)
        return table

    old, now = by_key(base), by_key(new)
    pairs, missing, added = [], [], []
    for key in sorted(old.keys() | now.keys(), key=str):
        before, after = list(old.get(key, [])), list(now.get(key, []))
        for row in list(after):
            alike = [one for one in before if one.settings == row.settings]
            same = next((one for one in alike if one.name == row.name), alike[0] if alike else None)
            if same is not None:
                pairs.append(Pair(same, row))
                before.remove(same)
                after.remove(row)
        if len(before) == len(after) == 1:  # the settings themselves are what is compared
            pairs.append(Pair(before.pop(), after.pop()))
        missing += before
        added += after
    return pairs, missing, added


def _why_not(pairs: Sequence[Pair]) -> tuple[str, ...]:
    """Reasons for which hashes are not compared, with the number of pairs."""
    reasons: dict[str, int] = {}
    for pair in pairs:
        if not pair.comparable:
            reason = _reason(pair.base, pair.new)
            reasons[reason] = reasons.get(reason, 0) + 1
    return tuple(f"{count} of {len(pairs)}: {reason}" for reason, count in reasons.items())


def _reason(base: Row, new: Row) -> str:
    for row in (base, new):
        if row.hash is None:
            return "the run was lost"
    packages = sorted(base.versions.keys() | new.versions.keys())
    other = [(name, base.versions.get(name, "none"), new.versions.get(name, "none")) for name in packages]
    changed = [f"{name} {old} is now {now}" for name, old, now in other if old != now]
    return "other versions: " + ", ".join(changed) if changed else "another processor or renderer"


def settings_note(pairs: Sequence[Pair]) -> str:
    """What the two sides were run with, where that is not the same; empty where it is."""
    notes = {
        f"{pair.base.settings} became {pair.new.settings}"
        for pair in pairs
        if json.loads(pair.base.settings) != json.loads(pair.new.settings)
    }
    return "; ".join(sorted(notes))
