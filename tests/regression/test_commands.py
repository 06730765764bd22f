"""The commands as scripts meet them. Oracles: exit status, what JSON's, XML's and CSV's parsers read, the files that are left."""

from __future__ import annotations

import json
import xml.etree.ElementTree as xml
from dataclasses import replace
from pathlib import Path

import pytest

from robocar.cli import main
from tests.regression.rows import row, write_run


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    for name, duration in (("base", 10.0), ("slow", 12.0)):
        for seed in (0, 1):
            one = row(seed=seed, duration=duration)
            write_run(tmp_path / name, one if name == "base" else replace(one, hash="other"))

    def run(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(list(words))
        said = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, said.out, said.err

    return run


def test_results_go_where_they_are_wanted(call, tmp_path: Path) -> None:
    (tmp_path / "base" / "mine.txt").write_text("")
    status, out, err = call("results", "base", "--csv", "a.csv", "--junit", "a.xml", "--baseline", "a.json")
    assert status == 0
    assert "a-star" in out
    assert "1.00 [0.34, 1.00]" in out  # Wilson, 2 of 2
    assert "skipped: mine.txt: not a run directory" in err
    assert "1 entries of base are no runs" in err
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 3
    assert xml.parse(tmp_path / "a.xml").getroot()[0].get("tests") == "2"
    status, out, _ = call("results", "a.json", "--json")
    assert [run["seed"] for run in json.loads(out)["runs"]] == [0, 1]


def test_compare_says_by_its_exit_status_whether_something_got_worse(call, tmp_path: Path) -> None:
    assert call("compare", "base", "base")[0] == 0
    status, out, err = call("compare", "base", "slow", "--json", "--junit", "c.xml")
    assert status == 1
    assert "duration 10 s +2 [+2, +2] (tolerance 0.5): worse" in err
    assert len(json.loads(out)["failures"]) == 1
    assert xml.parse(tmp_path / "c.xml").getroot()[0].get("failures") == "1"
    assert call("compare", "slow", "base")[0] == 0
    assert call("compare", "slow", "base", "--exact")[0] == 1  # better, and not the same


def test_a_report_says_where_it_is(call, tmp_path: Path) -> None:
    status, out, _ = call("report", "base")
    assert (status, out) == (0, "base/report.html\n")
    assert (tmp_path / "base" / "report.html").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("sweep quik", "unknown suite 'quik' (did you mean 'quick'?)"),
        ("sweep quick --jobs 0", "--jobs takes a positive integer"),
        ("sweep quick --navigator a-stir", "unknown navigator 'a-stir' (did you mean 'a-star'?)"),
        ("sweep quick --seed -1", "a seed must be a non-negative integer"),
        ("results nowhere", "nowhere: no such file or folder"),
        ("compare base nowhere", "nowhere: no such file or folder"),
        ("report nowhere", "nowhere: no such folder"),
    ],
)
def test_bad_input_is_one_line_and_status_2(call, words: str, message: str) -> None:
    status, out, err = call(*words.split())
    assert (status, out) == (2, "")
    assert err.startswith("error: ")
    assert message in err
    assert err.count("\n") == 1
