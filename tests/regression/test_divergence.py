"""Where two runs part.

Oracles: a navigator that is made to differ at a known tick; the recording, read back by Rerun's own reader.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from robocar.core import LogFormatError
from robocar.episode.run import run
from robocar.formats import read_tum
from robocar.recording import read_trajectory
from robocar.regression.divergence import describe, find_divergence, to_json

SCENE = {"name": "floor", "map": "maps/thesis_field.yaml", "start": [0.5, 1.2, 0], "goal": [3.2, 1.2], "time_limit": 3.0}
KNEE = 23
PERIOD = 0.05


def drive(out: Path, settings: dict, seed: int = 0, record: bool = True) -> Path:
    result = run(SCENE, navigator="bad_parts:knee", estimator="odometry", seed=seed, settings=settings, out=out, record=record)
    assert result.directory is not None
    return result.directory


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    out = tmp_path_factory.mktemp("runs")
    settings = {"straight": {}, "turns": {"navigator.after": KNEE}, "short": {"time_limit": 1.0}}
    found = {name: drive(out, given) for name, given in settings.items()}
    found["again"] = drive(out / "again", {})
    found["noisy"] = drive(out, {}, seed=1)
    return found


def test_the_tick_the_time_and_the_quantity(runs: dict[str, Path], tmp_path: Path) -> None:
    """The command of tick 23 is the first thing that differs; what it does to the car shows a tick later."""
    found = find_divergence(runs["straight"], runs["turns"], tmp_path / "both.rrd")
    assert found.first is not None
    assert (found.first.quantity, found.first.tick) == ("command/values", KNEE)
    assert found.first.time == pytest.approx(KNEE * PERIOD)
    assert (found.first.base, found.first.new) == ("(0.2, 0)", "(0.2, 0.5)")
    ticks = {difference.quantity: difference.tick for difference in found.differences}
    assert ticks["truth"] == KNEE + 1
    assert min(tick for name, tick in ticks.items() if not name.startswith("command")) == KNEE + 1
    assert [d.tick for d in found.differences] == sorted(d.tick for d in found.differences)
    assert f"the runs part at tick {KNEE}, {KNEE * PERIOD:.3f} s: command/values" in describe(found)
    assert json.loads(json.dumps(to_json(found)))["first"]["tick"] == KNEE
    truths = [read_tum(runs[name] / "truth.tum").poses[:, :2] for name in ("straight", "turns")]
    assert found.farthest == pytest.approx(np.hypot(*(truths[0] - truths[1]).T).max())


def test_without_recordings_the_trajectories_are_compared_and_it_says_so(runs: dict[str, Path], tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(runs["turns"], bare)
    (bare / "run.rrd").unlink()
    found = find_divergence(runs["straight"], bare)
    assert found.first is not None
    assert (found.first.quantity, found.first.tick, found.recording) == ("truth", KNEE + 1, None)
    assert "trajectories only" in describe(found)


def test_equal_runs_do_not_part(runs: dict[str, Path], tmp_path: Path) -> None:
    found = find_divergence(runs["straight"], runs["again"], tmp_path / "both.rrd")
    assert (found.first, found.recording, found.farthest) == (None, None, 0.0)
    assert found.ticks == 61
    assert not (tmp_path / "both.rrd").exists()


def test_a_run_that_only_ends_earlier_parts_at_its_end(runs: dict[str, Path], tmp_path: Path) -> None:
    found = find_divergence(runs["straight"], runs["short"], tmp_path / "both.rrd")
    assert found.first is not None
    assert (found.first.quantity, found.first.tick) == ("truth", 21)
    assert (found.first.base, found.first.new) == ("timeout after 61 ticks", "timeout after 21 ticks")
    assert found.recording is not None


def test_another_seed_parts_at_the_first_reading(runs: dict[str, Path]) -> None:
    found = find_divergence(runs["straight"], runs["noisy"])
    assert found.first is not None
    assert found.first.tick <= 1


def test_the_recording_holds_both_and_begins_where_they_part(runs: dict[str, Path], tmp_path: Path) -> None:
    path = find_divergence(runs["straight"], runs["turns"], tmp_path / "deep" / "both.rrd").recording
    assert path is not None
    for name, side in (("straight", "base"), ("turns", "new")):
        times, poses = read_trajectory(path, f"world/{side}")
        truth = read_tum(runs[name] / "truth.tum")
        assert np.abs(times - truth.times).max() < 1e-8
        assert np.abs(poses - truth.poses).max() < 1e-12
    since = [
        chunk.to_record_batch()
        for chunk in RrdReader(str(path)).stream().filter(content="/world/new", has_timeline="since_divergence")
    ]
    ticks = np.concatenate([batch["tick"].to_numpy() for batch in since])
    starts = np.concatenate([batch["since_divergence"].cast("int64").to_numpy() for batch in since])
    assert ticks.min() == KNEE
    assert starts.min() == 0  # where a viewer opens it


@pytest.mark.parametrize("lacks", ["metrics.json", "truth.tum"])
def test_what_is_no_run_is_refused(runs: dict[str, Path], tmp_path: Path, lacks: str) -> None:
    shutil.copytree(runs["straight"], tmp_path / "run")
    (tmp_path / "run" / lacks).unlink()
    with pytest.raises(LogFormatError, match=lacks):
        find_divergence(runs["straight"], tmp_path / "run")
