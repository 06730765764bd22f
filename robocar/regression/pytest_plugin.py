"""Physics runs in anybody's tests: fixtures `physics_run` and `assert_no_regression`.

Baselines are small text files in the user's repository, one per run; `pytest --robocar-update` writes them anew. Recordings of
runs whose test failed are kept and their paths printed. Nothing of Robocar is imported before a test asks for a run.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pytest

if TYPE_CHECKING:
    from robocar.episode.result import RunResult
    from robocar.regression.results import Row

UPDATE, RECORDINGS, BASELINES = "--robocar-update", "--robocar-recordings", "robocar_baselines"
KEPT = "robocar-recordings"
"""Folder of the kept recordings, in the root of the tests."""
_USED = pytest.StashKey[list[Path]]()
_NOTES = pytest.StashKey[list[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("robocar", "physics runs")
    group.addoption(UPDATE, action="store_true", help="write the baselines of assert_no_regression anew")
    group.addoption(
        RECORDINGS,
        choices=("failed", "all", "none"),
        default="failed",
        help="whose .rrd files to keep: of runs used by failed tests (default), of all, of none",
    )
    parser.addini(BASELINES, "folder of the baselines, from the root directory of the tests", default="robocar-baselines")


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(_Notes(), "robocar-notes")


class _Notes:
    """What the tests have to say, at the end. It comes with their reports, as what workers of xdist have to say does."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._lines += getattr(report, "robocar_notes", [])

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        if self._lines:
            terminalreporter.section("robocar")
            from robocar.core.text import printable

            for line in dict.fromkeys(self._lines):
                terminalreporter.line(printable(line))


class PhysicsRun(Protocol):
    """Fixture `physics_run`: one episode, run when first asked for and then remembered for the session."""

    def __call__(
        self,
        scenario: str | Path | Mapping[str, Any],
        navigator: str | Callable[..., Any] | None = None,
        estimator: str | Callable[..., Any] | None = None,
        mapper: str | Callable[..., Any] | None = None,
        seed: int = 0,
        settings: Mapping[str, Any] | None = None,
    ) -> RunResult:
        """
        Args:
            scenario: name, file or mapping, as for `robocar.run`.
            navigator, estimator, mapper: registered name, `package.module:factory`, or the class or factory itself.
            settings: as `robocar run --set`.
        """
        ...


class AssertNoRegression(Protocol):
    """Fixture `assert_no_regression`: fails the test where a run got worse than its baseline."""

    def __call__(
        self, run: RunResult, *, exact: bool = True, tolerances: Mapping[str, Mapping[str, object]] | None = None
    ) -> None:
        """
        Args:
            exact: where the fingerprint is the baseline's, another hash fails too: the behaviour has changed.
            tolerances: what differs from the defaults, e.g. `{"duration": {"relative": 0.2}}`.
        """
        ...


@pytest.fixture(scope="session")
def _robocar_runs(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> Iterator[_Runs]:
    folder = tmp_path_factory.mktemp("robocar")
    yield _Runs(folder, record=pytestconfig.getoption(RECORDINGS) != "none")
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def physics_run(_robocar_runs: _Runs, request: pytest.FixtureRequest) -> PhysicsRun:
    """Runs an episode: `physics_run(scenario, navigator=..., estimator=..., seed=...)` returns its `RunResult`."""
    used = request.node.stash.setdefault(_USED, [])

    def run(
        scenario: str | Path | Mapping[str, Any],
        navigator: str | Callable[..., Any] | None = None,
        estimator: str | Callable[..., Any] | None = None,
        mapper: str | Callable[..., Any] | None = None,
        seed: int = 0,
        settings: Mapping[str, Any] | None = None,
    ) -> RunResult:
        parts = {"navigator": navigator, "estimator": estimator, "mapper": mapper}
        result = _robocar_runs.run(scenario, parts, seed, settings or {})
        if result.recording is not None and result.recording not in used:
            used.append(result.recording)
        return result

    return run


@pytest.fixture
def assert_no_regression(pytestconfig: pytest.Config, request: pytest.FixtureRequest) -> AssertNoRegression:
    """Compares a run with its baseline in the repository; `pytest --robocar-update` writes the baselines."""
    folder = pytestconfig.rootpath / str(pytestconfig.getini(BASELINES))
    notes = request.node.stash.setdefault(_NOTES, [])

    def check(run: RunResult, *, exact: bool = True, tolerances: Mapping[str, Mapping[str, object]] | None = None) -> None:
        __tracebackhide__ = True
        from robocar.core import RobocarError
        from robocar.core.text import printable
        from robocar.regression import judgement
        from robocar.regression.baseline import read_baseline, write_baseline
        from robocar.regression.compare import compare
        from robocar.regression.results import Results
        from robocar.regression.tables import comparison_text

        row = _row(run)
        path = folder / f"{row.name}.json"
        units = {name: str(metric["unit"]) for name, metric in run.metrics.items()}
        if pytestconfig.getoption(UPDATE):
            before = path.read_bytes() if path.is_file() else b""
            path.parent.mkdir(parents=True, exist_ok=True)
            write_baseline([row], units, path)
            state = "unchanged" if path.read_bytes() == before else "rewritten" if before else "new"
            notes.append(f"baseline {state}: {_short(path, pytestconfig)}")
            return
        if not path.is_file():
            pytest.fail(f"no baseline {_short(path, pytestconfig)}; pytest {UPDATE} writes it from this run", pytrace=False)
        try:
            table = judgement.tolerances(tolerances)
            found = compare(read_baseline(path), Results(path, (row,), units), table, exact=exact)
        except RobocarError as error:
            pytest.fail(printable(str(error)), pytrace=False)
        if found.failures:
            text = printable(f"{row.name} is not what its baseline says\n{comparison_text(found)}")
            pytest.fail(f"{text}\nif this is meant: pytest {UPDATE}, and commit {_short(path, pytestconfig)}", pytrace=False)

    return check


class _Runs:
    """The runs of a session, by their names: no two different ones share one."""

    def __init__(self, folder: Path, record: bool) -> None:
        self._folder, self._record = folder, record
        self._known: dict[str, RunResult] = {}

    def run(self, scenario: Any, parts: Mapping[str, Any], seed: int, settings: Mapping[str, Any]) -> RunResult:
        from robocar.episode.run import run
        from robocar.episode.spec import RunSpec

        options: Any = {**parts, "seed": seed, "settings": settings}
        which = RunSpec.of(scenario, **options).recording_id
        if which not in self._known:
            # A scenario that comes with Robocar may be edited during a session, and keeps its name.
            out = self._folder / str(len(self._known))
            self._known[which] = run(scenario, **options, out=out, record=self._record)
        return self._known[which]


def _row(run: RunResult) -> Row:
    from robocar.episode.fingerprint import fingerprint, versions
    from robocar.regression.results import Row, read_run, settings_text

    if run.directory is not None:
        return read_run(run.directory)
    if not run.name:
        pytest.fail(f"{run.navigator} has no name that a baseline could be kept under; write files (out=...) to be told why")
    metrics = {name: None if metric["value"] is None else float(metric["value"]) for name, metric in run.metrics.items()}
    parts = {"navigator": run.navigator, "estimator": run.estimator, "mapper": run.mapper}
    facts = {"status": run.status, "reason": run.reason, "hash": run.hash, "fingerprint": fingerprint(), "versions": versions()}
    text = settings_text(run.settings)
    return Row(run.name, run.scenario, seed=run.seed, settings=text, metrics=metrics, **parts, **facts)  # type: ignore[arg-type]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    report = yield
    keep = item.config.getoption(RECORDINGS)
    used = item.stash.get(_USED, [])
    # Before the session's folder is removed, after the test has said all that it has to say.
    if used and (report.when == "call" or report.failed) and (keep == "all" or (keep == "failed" and report.failed)):
        lines = [_short(_keep(path, item.config.rootpath), item.config) for path in used if path.is_file()]
        if lines and report.failed:
            report.sections.append(("recordings of this test (open with: robocar view FILE)", "\n".join(lines)))
        elif lines:
            item.stash.setdefault(_NOTES, []).extend(f"recording: {line}" for line in lines)
    if notes := item.stash.get(_NOTES, []):
        report.robocar_notes = list(notes)
        notes.clear()
    return report  # type: ignore[return-value]


def _keep(recording: Path, root: Path) -> Path:
    """A copy under the run's own name, whole at any time."""
    kept = root / KEPT / f"{recording.parent.name}.rrd"
    kept.parent.mkdir(parents=True, exist_ok=True)
    beside = kept.with_name(f".{kept.name}.{os.getpid()}")
    shutil.copyfile(recording, beside)
    os.replace(beside, kept)
    return kept


def _short(path: Path, config: pytest.Config) -> str:
    return str(path.relative_to(config.rootpath)) if path.is_relative_to(config.rootpath) else str(path)
