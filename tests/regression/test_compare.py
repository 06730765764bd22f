"""Comparisons: what is called the same, better and worse.

Oracle: made-up runs whose difference is known, and a sweep of real ones.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import LogFormatError
from robocar.metrics import Tolerance
from robocar.regression.compare import compare
from robocar.regression.judgement import tolerances
from robocar.regression.results import read_results
from robocar.regression.sweep import sweep
from robocar.regression.tables import comparison_json, comparison_text, junit_of_comparison
from tests.regression.conftest import suite_of
from tests.regression.rows import results, row

SEEDS = range(6)


def changed(one, **more):
    """The same run with another behaviour."""
    return replace(one, hash=f"{one.hash}!", metrics={**one.metrics, **more})


def test_the_same_is_the_same() -> None:
    base = results(*(row(seed=seed) for seed in SEEDS), exact=True)
    found = compare(base, base)
    assert found.failures == ()
    assert all(pair.identical for pair in found.pairs)
    assert {change.verdict for change in found.metrics} == {"unchanged"}
    assert comparison_text(found).endswith("no regression")


@pytest.mark.parametrize(
    ("metric", "change", "verdict"),
    [
        ("duration", 1.0, "worse"),
        ("duration", -1.0, "better"),
        ("duration", 0.4, "unchanged"),  # tolerance: 0.5 s or 5 %
        ("spl", 0.05, "better"),
        ("spl", -0.05, "worse"),
        ("spl", -0.01, "unchanged"),
        ("min_clearance", -0.05, "worse"),
        ("contacts", 1.0, "worse"),
    ],
)
@pytest.mark.parametrize("seeds", [1, 6])
def test_a_metric_beyond_its_tolerance(metric: str, change: float, verdict: str, seeds: int) -> None:
    base = [row(seed=seed) for seed in range(seeds)]
    new = [changed(one, **{metric: one.metrics[metric] + change}) for one in base]
    found = compare(results(*base), results(*new))
    verdicts = {c.metric: c.verdict for c in found.metrics}
    assert verdicts.pop(metric) == verdict
    assert set(verdicts.values()) == {"unchanged"}
    assert bool(found.failures) == (verdict == "worse")
    assert len(found.changed) == seeds


def test_noise_among_the_seeds_is_no_regression_and_a_common_shift_is() -> None:
    """Equal mean changes of +1 s: once all seeds alike, once four of six better and two much worse."""
    base = [row(seed=seed) for seed in SEEDS]
    noise = [changed(one, duration=10.0 + d) for one, d in zip(base, (-2, -2, -2, -2, 7, 7), strict=True)]
    shift = [changed(one, duration=10.0 + d) for one, d in zip(base, (0.8, 1.2, 0.9, 1.1, 0.7, 1.3), strict=True)]
    assert compare(results(*base), results(*noise)).failures == ()
    (line,) = compare(results(*base), results(*shift)).failures
    assert line.startswith("room, a-star, truth, none: duration 10 s +1 [+0.8")


def test_one_scenario_that_got_worse_is_not_hidden_by_the_others() -> None:
    base = [row(scenario=f"room{k}", seed=seed) for k in range(20) for seed in (0, 1)]
    new = [changed(one, duration=13.0) if one.scenario == "room7" else one for one in base]
    (line,) = compare(results(*base), results(*new)).failures
    assert line.startswith("room7")


@pytest.mark.parametrize(
    ("before", "after", "verdict"),
    [
        ("success", "collision", "worse"),
        ("timeout", "success", "better"),
        ("timeout", "collision", "unchanged"),
        ("timeout", "error", "worse"),
        ("diverged", "stuck", "better"),
        ("error", "diverged", "unchanged"),
    ],
)
def test_outcomes(before: str, after: str, verdict: str) -> None:
    base, new = row(status=before), replace(row(status=after), hash="other")
    found = compare(results(base), results(new))
    assert [pair.verdict for pair in found.outcomes] == [verdict]
    assert bool(found.failures) == (verdict == "worse")
    assert f"{before} became {after}: {verdict}" in comparison_text(found)


def test_hashes_are_compared_where_the_fingerprints_agree_only() -> None:
    base = [row(seed=0), row(seed=1), row(seed=2), row(seed=3)]
    new = [
        changed(base[0]),
        replace(changed(base[1]), fingerprint="there", versions={"python": "3.11", "numpy": "3.0"}),
        replace(changed(base[2]), fingerprint="there"),
        replace(base[3], hash=None, fingerprint=None, status="error"),
    ]
    found = compare(results(*base), results(*new), exact=True)
    assert [pair.new.seed for pair in found.changed] == [0]
    assert sorted(found.why_not_hashes) == [
        "1 of 4: another processor or renderer",
        "1 of 4: other versions: numpy 2.4.6 is now 3.0",
        "1 of 4: the run was lost",
    ]
    assert len(found.failures) == 2  # the hash of seed 0, the outcome of seed 3
    assert compare(results(*base[:3]), results(*new[:3])).failures == ()  # no metric changed


def test_missing_and_new_runs() -> None:
    base, new = results(row(seed=0), row(seed=1)), results(row(seed=1), row(seed=2))
    found = compare(base, new)
    assert (found.missing, found.added) == (("room--a-star--truth--none--s0",), ("room--a-star--truth--none--s2",))
    assert found.failures == ("room--a-star--truth--none--s0: is missing",)
    assert compare(base, new, subset=True).failures == ()
    with pytest.raises(LogFormatError, match="have no run in common"):
        compare(results(row()), results(row(navigator="other")))


def test_settings_pair_runs_where_they_tell_them_apart() -> None:
    plain, tuned = row(), row(settings='{"a": 1}')
    found = compare(results(plain, tuned), results(tuned, plain))
    assert [(pair.base.settings, pair.new.settings) for pair in found.pairs] == [('{"a": 1}', '{"a": 1}'), ("{}", "{}")]
    found = compare(results(plain), results(changed(tuned)))  # the settings are what is compared
    assert len(found.pairs) == 1
    assert 'settings: {} became {"a": 1}' in comparison_text(found)


def test_failures_are_failed_tests_of_junit() -> None:
    base = [row(seed=seed) for seed in SEEDS]
    new = [changed(one, duration=20.0) for one in base[:-1]]
    found = compare(results(*base), results(*new), exact=True)
    cases = junit_of_comparison(found)
    assert (
        sum(problem is not None for *_, problem in cases) == len(found.failures) == len(comparison_json(found)["failures"]) == 7
    )


@given(base=st.floats(-1e3, 1e3), absolute=st.floats(0, 10), relative=st.floats(0, 1))
def test_a_margin_is_the_larger_of_both(base: float, absolute: float, relative: float) -> None:
    assert Tolerance("lower", absolute, relative).margin(base) == max(absolute, relative * abs(base))


@pytest.mark.parametrize(
    "changes", [{"spl": {"better": "big"}}, {"spl": {"absolute": -1}}, {"spl": {"relative": float("nan")}}, {"spl": {"x": 1}}]
)
def test_bad_tolerances(changes) -> None:
    with pytest.raises(ValueError, match=r"better must be|finite number|unknown field"):
        tolerances(changes)


def test_one_changed_parameter_is_found_and_an_untouched_tree_gives_no_difference(far: str, tmp_path: Path) -> None:
    """Real runs: the same suite twice, with one and with two workers, and once with another speed."""
    same = suite_of(far, seeds=[0, 1], exact=True)
    for out, jobs in (("base", 1), ("again", 2)):
        sweep(same, tmp_path / out, jobs=jobs)
    tuned = suite_of(far, seeds=[0, 1], exact=True, settings={"navigator.controller.desired_linear_vel": 0.15})
    sweep(tuned, tmp_path / "tuned", jobs=2)
    base, again, slow = (read_results(tmp_path / name) for name in ("base", "again", "tuned"))
    found = compare(base, again)
    assert (found.failures, found.changed, found.of("better"), found.of("worse")) == ((), (), (), ())
    assert all(pair.identical for pair in found.pairs)
    found = compare(base, slow)
    assert len(found.changed) == 2
    assert "duration" in {change.metric for change in found.of("worse")}
