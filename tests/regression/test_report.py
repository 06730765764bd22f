"""The page on a sweep. Oracles: a real browser without a network (headless Chromium), and Python's own HTML parser."""

from __future__ import annotations

import os
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlparse

import cv2
import numpy as np
import pytest

from robocar.core import LogFormatError, OutputError
from robocar.regression.report import write_report
from robocar.regression.results import read_results
from robocar.regression.sweep import sweep
from tests.regression.conftest import SHORT, suite_of
from tests.regression.rows import row, write_run

BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four runs, two of which reach their goal."""
    home = tmp_path_factory.mktemp("report")
    (home / "far.yaml").write_text(SHORT.format(20) + "unknown_obstacles: [{box: [0.3, 0.3, 0.2], pose: [2.5, 1.5, 0.4]}]\n")
    (home / "near.yaml").write_text(SHORT.format(0.5))
    for name, record in (("far", True), ("near", False)):
        suite = suite_of(str(home / f"{name}.yaml"), seeds=[0, 1], record=record)
        sweep(suite, home / "out", jobs=1, resume=True)
    return home / "out"


class Page(HTMLParser):
    """Links, pictures, scripts and the cells of the tables."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.scripts = 0
        self.rows: dict[str, list[list[str]]] = {}
        self._table, self._cell = "", False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.targets += [value for key in ("href", "src", "xlink:href") if (value := found.get(key))]
        self.scripts += tag in ("script", "link", "iframe", "object")
        if tag == "table":
            self._table = found.get("id") or ""
            self.rows[self._table] = []
        elif tag == "tr":
            self.rows[self._table].append([])
        elif tag in ("td", "th"):
            self._cell = True
            self.rows[self._table][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self._cell = self._cell and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        if self._cell:
            self.rows[self._table][-1][-1] += data


def test_the_page_needs_nothing_else_and_its_links_lead_to_files(folder: Path) -> None:
    path = write_report(folder)
    page = Page(path.read_text())
    assert page.scripts == 0
    inside = [target for target in page.targets if target.startswith(("data:", "#"))]
    links = [target for target in page.targets if target not in inside]
    assert len(links) == 2  # the recordings of two runs
    assert [urlparse(link).scheme for link in links] == ["", ""]
    assert all((path.parent / unquote(link)).is_file() for link in links)


def test_the_tables_say_what_the_runs_say(folder: Path, tmp_path: Path) -> None:
    page = Page(write_report(folder, tmp_path / "page.html").read_text())
    results = {one.name: one for one in read_results(folder).rows}
    head, *body = page.rows["runs"]
    assert {cells[0]: cells[1] for cells in body} == {name: one.status for name, one in results.items()}
    column = head.index("path_length")
    assert {cells[0]: float(cells[column]) for cells in body} == pytest.approx(
        {name: one.metrics["path_length"] for name, one in results.items()}, rel=1e-3
    )
    assert [cells[:2] for cells in page.rows["by-navigator"][1:]] == [["a-star", "4"]]
    assert page.rows["by-navigator"][1][2].startswith("0.50 [")
    assert len(page.rows["by-scenario-navigator"]) == 3


@pytest.mark.skipif(BROWSER is None, reason="no Chromium (Debian: chromium)")
def test_a_browser_without_a_network_shows_it(folder: Path, tmp_path: Path) -> None:
    """The pictures are there (colours of the heat map, of the ways and of the obstacles), and nothing is asked of the network."""
    path = write_report(folder)
    picture, log = tmp_path / "page.png", tmp_path / "net.json"
    options = ["--headless", "--disable-gpu", "--no-sandbox", "--window-size=1250,3000", "--hide-scrollbars"]
    options += ["--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={tmp_path / 'profile'}", f"--log-net-log={log}"]
    command = [str(BROWSER), *options, f"--screenshot={picture}", path.resolve().as_uri()]
    environment = {**os.environ, "HOME": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, env=environment)
    assert picture.is_file(), done.stderr
    image = cv2.imread(str(picture))
    assert image is not None
    rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB).astype(int)

    def share(color: tuple[int, int, int], tolerance: int = 10) -> int:
        return int((np.abs(rgb - np.array(color)).max(axis=2) <= tolerance).sum())

    assert share((31, 119, 180)) > 100  # a way, in matplotlib's first colour
    assert share((102, 163, 137), 25) > 500  # a cell of the heat map: all succeeded
    assert share((191, 191, 191), 2) > 200  # the obstacle
    assert (rgb.min(axis=2) > 250).mean() > 0.5  # a white page
    dom = subprocess.run(
        [*command[:-2], "--dump-dom", command[-1]], capture_output=True, text=True, check=False, timeout=120, env=environment
    )
    assert dom.stdout.count("<svg") == path.read_text().count("<svg") > 3
    assert "by-navigator" in dom.stdout


def test_names_and_reasons_of_strangers_are_only_text(tmp_path: Path) -> None:
    write_run(tmp_path, row(scenario="<script>alert(1)</script>".replace("/", "_")), reason="<img src=x onerror=alert(1)>")
    (tmp_path / "<b>.txt").write_text("")
    text = write_report(tmp_path).read_text()
    page = Page(text)
    assert page.scripts == 0
    assert "x" not in page.targets
    assert "&lt;b&gt;.txt: not a run directory" in text


def test_nothing_to_report_and_nowhere_to_write(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="no run in here"):
        write_report(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        write_report(folder, tmp_path / "file" / "page.html")
