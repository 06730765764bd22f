"""Results: read, kept and summed up without losing or inventing anything.

Oracles: what was written; pyarrow's, csv's, json's and XML's own readers; Wilson's formula; scipy's bootstrap; Student's
interval.
"""

from __future__ import annotations

import csv
import json
import math
import xml.etree.ElementTree as xml
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import LogFormatError
from robocar.regression.baseline import read_any, read_baseline, write_baseline
from robocar.regression.results import read_parquet, read_results, write_csv, write_parquet
from robocar.regression.statistics import mean, share
from robocar.regression.tables import interval, junit_of_results, results_json, results_table, summary, write_junit
from tests.regression.rows import UNITS, row, write_run


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_run(tmp_path, row(seed=0))
    write_run(tmp_path, row(seed=1, status="collision", spl=0.0, duration=3.5))
    write_run(tmp_path, row(navigator="harmonic", min_clearance=None, settings='{"a.b": 1}'))
    return tmp_path


def test_foreign_and_damaged_files_are_named_skipped_and_counted(folder: Path) -> None:
    good = read_results(folder)
    (folder / "notes.txt").write_text("mine")
    (folder / "photos").mkdir()
    torn = write_run(folder, row(seed=7)) / "metrics.json"
    torn.write_text(torn.read_text()[:120])
    write_run(folder, row(seed=8), schema=2)
    write_run(folder, row(seed=9), metrics={"spl": {"value": "high", "unit": "1"}})
    write_run(folder, row(seed=10), metrics={"spl": {"value": math.nan, "unit": "1"}})
    write_run(folder, row(seed=11), metrics=[])
    (write_run(folder, row(seed=12)) / "metrics.json").write_text("[1]")
    (folder / ".hidden").mkdir()
    found = read_results(folder)
    assert found.rows == good.rows
    reasons = dict(text.split(": ", 1) for text in found.skipped)
    assert {name: reasons[name] for name in ("notes.txt", "photos", "room--a-star--truth--none--s8")} == {
        "notes.txt": "not a run directory",
        "photos": "not a run directory (no metrics.json)",
        "room--a-star--truth--none--s8": "metrics.json of schema 2, this is 1",
    }
    damaged = {name for name, reason in reasons.items() if reason.startswith("metrics.json is damaged")}
    assert damaged == {f"room--a-star--truth--none--s{seed}" for seed in (7, 9, 10, 11, 12)}
    assert len(found.skipped) == 8


@pytest.mark.parametrize("kind", ["none", "empty", "foreign"])
def test_a_folder_without_runs_is_an_error(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / kind
    if kind != "none":
        folder.mkdir()
    if kind == "foreign":
        (folder / "thing").write_text("")
    with pytest.raises(
        LogFormatError, match={"none": "no such folder", "empty": "no run in here", "foreign": "thing: not a run"}[kind]
    ):
        read_results(folder)


def test_parquet_holds_a_row_per_run_with_units(folder: Path, tmp_path: Path) -> None:
    found = read_results(folder)
    path = write_parquet(found, tmp_path / "results.parquet")
    table = pq.read_table(path)
    assert table.num_rows == 3
    assert {name: table.schema.field(name).metadata[b"unit"].decode() for name in UNITS} == UNITS
    assert table["duration"].to_pylist() == [10.0, 3.5, 10.0]
    assert table["min_clearance"].to_pylist() == [0.2, 0.2, None]
    assert table["seed"].to_pylist() == [0, 1, 0]
    again = read_parquet(path)
    assert again.rows == found.rows
    assert dict(again.units) == dict(found.units)


def test_parquet_of_somebody_else_is_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({"x": [1]}), tmp_path / "a.parquet")
    with pytest.raises(LogFormatError, match="results of schema none, this is 1"):
        read_any(tmp_path / "a.parquet")
    (tmp_path / "b.parquet").write_bytes(b"PAR1 nothing")
    with pytest.raises(LogFormatError, match="not a Parquet file that can be read"):
        read_any(tmp_path / "b.parquet")


def test_csv_has_units_in_its_head(folder: Path, tmp_path: Path) -> None:
    path = write_csv(read_results(folder), tmp_path / "out.csv")
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["duration [s]"] for line in lines] == ["10.0", "3.5", "10.0"]
    assert [line["min_clearance [m]"] for line in lines] == ["0.2", "0.2", ""]
    assert [line["settings"] for line in lines] == ["{}", "{}", '{"a.b": 1}']


def test_the_table_sums_up_per_navigator(folder: Path) -> None:
    star, harmonic = summary(read_results(folder).rows)
    assert (star.group, star.runs, star.success.value, star.errors) == (("a-star",), 2, 0.5, 0)
    assert star.metrics["spl"] is not None
    assert star.metrics["spl"].value == pytest.approx(0.45)  # over all runs
    assert star.metrics["duration"] is not None
    assert star.metrics["duration"].value == 10.0  # over those that arrived
    assert harmonic.metrics["min_clearance"] is None
    text = json.dumps(results_json(read_results(folder)))
    assert json.loads(text)["groups"][0]["metrics"]["duration"]["value"] == 10.0
    assert results_table(read_results(folder)).row_count == 2


def test_junit_is_what_ci_systems_read(folder: Path, tmp_path: Path) -> None:
    found = read_results(folder)
    odd = replace(found.rows[0], name="odd", status="error", reason="a \x1b[31m<red> & \x00 sign")
    path = tmp_path / "deep" / "junit.xml"
    write_junit(path, "mine", junit_of_results(replace(found, rows=(*found.rows, odd))))
    (suite,) = xml.parse(path).getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("4", "2")
    failed = {case.get("name"): case[0].get("message") for case in suite if len(case)}
    assert failed == {"room--a-star--truth--none--s1": "collision: because", "odd": "error: a ?[31m<red> & ? sign"}


@given(successes=st.integers(0, 60), more=st.integers(0, 60))
def test_wilson(successes: int, more: int) -> None:
    """Wilson (1927): the roots of (p - k/n)^2 = z^2 p (1 - p) / n."""
    n = successes + more
    if n == 0:
        with pytest.raises(ValueError, match="n"):
            share(0, 0)
        return
    found = share(successes, n)
    z, p = scipy.stats.norm.ppf(0.975), successes / n
    roots = np.roots([1 + z**2 / n, -(2 * p + z**2 / n), p**2])
    assert (found.low, found.high) == pytest.approx((roots.min(), roots.max()), abs=1e-9)


def test_bootstrap_is_scipys_and_near_students() -> None:
    values = np.random.default_rng(3).gamma(2.0, size=60)
    found = mean(values.tolist())
    assert found is not None
    theirs = scipy.stats.bootstrap((values,), np.mean, method="percentile", n_resamples=20000, rng=np.random.default_rng(5))
    assert (found.low, found.high) == pytest.approx(tuple(theirs.confidence_interval), abs=0.03)
    student = scipy.stats.t.interval(0.95, 59, values.mean(), scipy.stats.sem(values))
    assert (found.low, found.high) == pytest.approx(student, abs=0.06)
    assert mean(values.tolist()) == found  # equal values, equal interval


@given(st.lists(st.one_of(st.none(), st.floats(-1e6, 1e6)), max_size=12))
def test_the_mean_lies_in_its_interval(values: list[float | None]) -> None:
    known = [value for value in values if value is not None]
    found = mean(values)
    assert (found is None) == (not known)
    estimates = [found] if found is not None and found.low is not None and found.high is not None else []
    assert all(min(known) - 1e-3 <= e.low <= e.value <= e.high <= max(known) + 1e-3 for e in estimates)  # type: ignore[operator]
    assert bool(estimates) == (len(known) > 1)
    assert interval(None) == "–"


class TestBaselines:
    def test_what_is_read_is_what_was_written_to_six_digits(self, tmp_path: Path) -> None:
        rows = [
            row(duration=math.pi),
            row(seed=1, status="error", hash=None, fingerprint=None, versions={}),
            row(navigator="b", spl=None),
        ]
        path = write_baseline(rows, UNITS, tmp_path / "base.json", {"suite": "mine", "exact": True})
        found = read_baseline(path)
        assert dict(found.sweep) == {"suite": "mine", "exact": True}
        kept = {r.name: r for r in found.rows}
        assert {name: (r.status, r.hash, r.fingerprint, r.seed) for name, r in kept.items()} == {
            r.name: (r.status, r.hash, r.fingerprint, r.seed) for r in rows
        }
        assert kept[rows[0].name].metrics == {"duration": 3.14159, "spl": 0.9, "min_clearance": 0.2, "contacts": 0.0}
        assert kept[rows[2].name].metrics["spl"] is None
        assert dict(kept[rows[0].name].versions) == dict(rows[0].versions)

    def test_versions_of_mixed_machines_are_kept_apart(self, tmp_path: Path) -> None:
        rows = [row(versions={"numpy": "1"}), row(seed=1, versions={"numpy": "2"})]
        found = read_baseline(write_baseline(rows, UNITS, tmp_path / "base.json"))
        assert [dict(r.versions) for r in found.rows] == [{"numpy": "1"}, {"numpy": "2"}]

    def test_one_changed_run_is_one_changed_block_of_text(self, tmp_path: Path) -> None:
        rows = [row(seed=seed) for seed in range(5)]
        before = write_baseline(rows, UNITS, tmp_path / "a.json").read_text().splitlines()
        rows[2] = replace(rows[2], metrics={**rows[2].metrics, "duration": 11.0})
        after = write_baseline(rows, UNITS, tmp_path / "b.json").read_text().splitlines()
        changed = [line for line, other in zip(before, after, strict=True) if line != other]
        assert len(changed) == 1
        assert '"duration": 10' in changed[0]

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "not JSON that can be read"),
            ("[1]", "no baseline"),
            ('{"schema": 1}', "no baseline"),
            ('{"kind": "robocar-baseline", "schema": 2}', "a baseline of schema 2, this robocar knows 1"),
            ('{"kind": "robocar-baseline"}', "a baseline of schema None"),
            ('{"kind": "robocar-baseline", "schema": 1}', "a damaged baseline"),
            ('{"kind": "robocar-baseline", "schema": 1, "versions": [], "units": {}, "runs": {"a": 5}}', "a damaged baseline"),
        ],
    )
    def test_bad_ones_are_refused_with_their_reason(self, tmp_path: Path, text: str, words: str) -> None:
        path = tmp_path / "base.json"
        path.write_text(text)
        with pytest.raises(LogFormatError, match=words):
            read_any(path)

    def test_nothing_there(self, tmp_path: Path) -> None:
        with pytest.raises(LogFormatError, match="no such file or folder"):
            read_any(tmp_path / "nothing.json")
