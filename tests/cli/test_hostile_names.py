"""One hostile name through everything that writes texts. Oracle: parsers of HTML, XML, CSV, YAML, JSON; what a terminal gets."""

from __future__ import annotations

import csv
import json
import xml.etree.ElementTree as xml
from dataclasses import replace
from pathlib import Path

import yaml

from robocar.recording import read_trajectory
from robocar.recording.about import page
from robocar.regression.report import write_report
from robocar.regression.tables import write_junit
from robocar.reporting.report import Report
from tests.cli.command_line import SHORT, Call
from tests.regression.rows import row, write_run

HOSTILE = "=cmd|' /C calc'!A1 [/x] [bold]$x_{ <script>alert(1)</script> &amp; | `~*_ \x1b[31m \x07\x9b \r\n ../../x --"


def test_a_hostile_name_stays_a_name(call: Call, tmp_path: Path) -> None:
    words = {"name": HOSTILE, "description": HOSTILE}
    (tmp_path / "hostile.yaml").write_text(yaml.safe_dump(SHORT | words | {"time_limit": 0.3}))
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump(words | {"runs": [{"scenarios": ["hostile.yaml"]}]}))
    said = [*call("check", "hostile.yaml")[1:]]
    status, out, err = call("run", "hostile.yaml", "--json", "--out", "o")
    assert (status, json.loads(out)["scenario"]) == (1, HOSTILE)
    (run,) = (tmp_path / "o").iterdir()
    assert len(read_trajectory(run / "run.rrd")[0]) > 1
    assert yaml.safe_load((run / "config.yaml").read_text())["scenario"]["name"] == HOSTILE
    said += [out, err, *call("replay", run, "--out", "p")[1:]]
    said += call("sweep", "suite.yaml", "--jobs", 1, "--out", "s", "--junit", "j.xml")[1:]
    said += call("results", "s", "--by", "scenario", "--csv", "r.csv", "--baseline", "b.json")[1:]
    said += call("compare", "b.json", "s", "--junit", "k.xml")[1:]
    said += call("report", "s")[1:]
    assert not [c for text in said for c in text if not (c.isprintable() or c in "\n\t")]
    assert not [text for text in said if "Traceback" in text or "error:" in text]
    for file in ("j.xml", "k.xml"):
        assert HOSTILE[:40] in (xml.parse(tmp_path / file).getroot()[0][0].get("classname") or "")
    with (tmp_path / "r.csv").open(newline="") as file:
        cells = [cell for line in csv.reader(file) for cell in line]
    assert any(HOSTILE[:40] in cell for cell in cells)
    assert not [cell for cell in cells if cell.startswith(("=", "@", "+"))]
    html = (tmp_path / "s" / "report.html").read_text()
    assert "<script>" not in html
    assert "&lt;script&gt;" in html
    assert not [c for c in html if not (c.isprintable() or c in "\n\t")]


def test_pages_in_markdown(tmp_path: Path) -> None:
    report = Report(tmp_path, "title")
    report.table(["a", HOSTILE], [[HOSTILE, 1.0]])
    table = report.write().read_text().partition("\n\n")[2]
    assert len(table.splitlines()) == 3
    assert [line.replace(r"\|", "").count("|") for line in table.splitlines()] == [3, 3, 3]
    assert "<script>" not in table
    metrics = {HOSTILE: {"value": 1.0, "unit": HOSTILE}}
    text = page({"scenario": HOSTILE}, {"metrics": metrics})
    (row,) = [line for line in text.splitlines() if line.startswith("| =") or line.startswith(r"| \=")]
    assert row.replace(r"\|", "").count("|") == 3
    assert r"\<script\>" in row
    assert "\x1b" not in text


def test_a_report_of_somebody_elses_metrics(tmp_path: Path) -> None:
    """Their names and units, in tables and in figures."""
    one = row(scenario=HOSTILE, navigator=HOSTILE)
    for name in ("one", "two"):
        write_run(tmp_path / "runs", replace(one, name=name))
    metrics = json.loads((tmp_path / "runs" / "one" / "metrics.json").read_text())
    metrics["metrics"]["duration"]["unit"] = HOSTILE
    for name in ("one", "two"):
        (tmp_path / "runs" / name / "metrics.json").write_text(json.dumps(metrics))
    html = write_report(tmp_path / "runs").read_text()
    assert "<script>" not in html
    assert html.count("&lt;script&gt;") >= 6
    assert "<svg" in html
    assert HOSTILE[:20] in write_junit_text(tmp_path, HOSTILE)


def write_junit_text(folder: Path, text: str) -> str:
    """The text of a case named so, after a parser."""
    write_junit(folder / "j.xml", text, [(text, text, text)])
    (case,) = xml.parse(folder / "j.xml").getroot()[0]
    return case.get("name") or ""
