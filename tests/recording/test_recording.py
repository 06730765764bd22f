"""Oracles: the synthetic run that was logged, Rerun's own verify and compare, the operating system's refusal to write."""

import math
import os
import shutil
import socket
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest
from rerun.chunk import RrdReader

from robocar.core import (
    SE2,
    Belief,
    Detection,
    GiveUp,
    Hold,
    Image,
    LogFormatError,
    Observation,
    OutputError,
    Scan,
    Serial,
    State,
)
from robocar.core.trace import Field, Lines, Scalar, Text
from robocar.core.truth import GroundTruth
from robocar.recording import (
    NullRecorder,
    Recorder,
    RerunRecorder,
    Scenery,
    read_observations,
    read_signal,
    read_trajectory,
)
from tests.recording.synthetic import DT, GrowingMap, car, drive, record, room, scenery

# Rerun only warns of arguments that it may have misunderstood.
pytestmark = pytest.mark.filterwarnings("error::rerun.error_utils.RerunWarning")

RESULT = {
    "scenario": "synthetic",
    "status": "success",
    "reason": None,
    "hash": "abc",
    "metrics": {
        "duration": {"value": 12.5, "unit": "s"},
        "spl": {"value": None, "unit": ""},
        "contacts": {"value": 0, "unit": ""},
    },
}


def write(path, run, *, mapper=None, result=None, **options):
    options = {"run_id": "test", "scenery": scenery()} | options
    recorder = RerunRecorder(path, **options)
    record(recorder, run, mapper)
    recorder.close(result)
    return path


def contents(path, entity):
    """Rows of an entity: list of (tick or None, {component: value})."""
    rows = []
    for chunk in RrdReader(str(path)).stream().filter(content=f"/{entity}"):
        batch = chunk.to_record_batch()
        ticks = batch["tick"].to_pylist() if "tick" in batch.schema.names else [None] * batch.num_rows
        names = [n for n in batch.schema.names if n not in ("tick", "sim_time", "rerun.controls.RowId")]
        rows += [(tick, {n: batch[n][k].as_py() for n in names}) for k, tick in enumerate(ticks)]
    return rows


def ticks_of(path, entity):
    return sorted({tick for tick, _ in contents(path, entity) if tick is not None})


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    run = drive(250)
    path = tmp_path_factory.mktemp("run") / "run.rrd"
    write(path, run, result=RESULT, properties={"navigator": "circle", "seed": 3}, flush_ticks=60)
    return path, run


def test_trajectories_read_back_exactly(recorded):
    path, run = recorded
    truth = [(t.truth.pose, t.odometry, t.belief.pose, t.truth.movers["cart"]) for t in run]
    entities = ("world/truth", "world/odometry", "world/estimate", "world/movers/cart")
    for k, entity in enumerate(entities):
        times, poses = read_trajectory(path, entity)
        np.testing.assert_array_equal(poses, [row[k].as_array() for row in truth])
        np.testing.assert_allclose(times, [t.observation.time for t in run], atol=1e-9)


def test_what_the_viewer_draws_is_the_pose_that_was_logged(recorded):
    """Translation and quaternion, float32, against the exact pose."""
    path, run = recorded
    rows = contents(path, "world/truth")
    drawn = {tick: row for tick, row in rows if tick is not None}
    for k in (0, 77, 249):
        (x, y, z), (qx, qy, qz, qw) = drawn[k]["Transform3D:translation"][0], drawn[k]["Transform3D:quaternion"][0]
        pose = run[k].truth.pose
        np.testing.assert_allclose([x, y, z], [pose.x, pose.y, 0.0], atol=1e-6)
        assert math.isclose(math.remainder(2 * math.atan2(qz, qw) - pose.theta, math.tau), 0.0, abs_tol=1e-6)
        assert (qx, qy) == (0.0, 0.0)


def test_signals_are_the_numbers_that_were_logged(recorded):
    path, run = recorded
    expected = {
        "clearance": [t.truth.clearance for t in run],
        "speed/truth": [t.truth.twist.v for t in run],
        "voltage/right": [t.truth.voltages[1] for t in run],
        "error/position/odometry": [math.hypot(t.odometry.x - t.truth.pose.x, t.odometry.y - t.truth.pose.y) for t in run],
        "error/heading/estimate": [0.05] * len(run),
        "lookahead": [0.3] * len(run),
    }
    for name, values in expected.items():
        times, read = read_signal(path, f"signals/{name}")
        np.testing.assert_allclose(read[: len(values)], values[: len(read)], rtol=0, atol=1e-12)
        assert len(times) == len(read) >= len(run) - 1  # the last command carries no trace


def test_commands_that_are_no_drive_leave_a_gap_in_the_speed(recorded):
    path, run = recorded
    assert len(read_signal(path, "signals/speed/command")[0]) == len(run) - 1


def test_paths_are_the_trajectories(recorded):
    """End to end the pieces make one line along the truth: its length is the arc's to a centimetre."""
    path, run = recorded
    rows = [row["LineStrips3D:strips"] for tick, row in contents(path, "world/truth/path") if tick is not None]
    pieces = np.array(rows)[:, 0]  # (n, 2, 3)
    np.testing.assert_array_equal(pieces[1:, 0], pieces[:-1, 1])
    np.testing.assert_allclose(pieces[0, 0, :2], run[0].truth.pose.position, atol=1e-6)
    length = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).sum()
    assert abs(length - 249 * DT * 0.25) < 0.02
    assert len(pieces) > 100


def test_every_entity_of_the_design_is_there(recorded):
    path, _ = recorded
    entities = {chunk.entity_path for chunk in RrdReader(str(path)).stream()}
    expected = (
        "map/truth map/estimate costmap/global landmarks movers/cart movers/cart/shape goal truth odometry estimate truth/path "
        "odometry/path estimate/path robot/body robot/wheels "
        " robot/sonar/front_left/cone plan/global plan/target estimate/covariance"
    )
    missing = {f"/world/{name}" for name in expected.split()} - entities
    assert missing == set()
    assert {"/log/status", "/log/serial", "/log/about", "/observation", "/command"} <= entities


def test_the_map_is_asked_for_and_written_at_most_twice_a_second(tmp_path):
    mapper = GrowingMap()
    path = write(tmp_path / "run.rrd", drive(101), mapper=mapper)
    assert mapper.asked == 11  # at 0, 0.5 ... 5 s
    # The map of the synthetic run grows until tick 43; afterwards there is nothing new.
    assert ticks_of(path, "world/map/estimate") == [0, 10, 20, 30, 40, 50]


def test_traces_are_written_when_they_change(recorded):
    """The synthetic run has a new plan every 40 ticks, and says so."""
    path, _ = recorded
    assert ticks_of(path, "world/plan/global") == [0, 40, 80, 120, 160, 200, 240]
    assert ticks_of(path, "world/costmap/global") == [0, 40, 80, 120, 160, 200, 240]
    messages = [row["TextLog:text"][0] for _, row in contents(path, "log/status")]
    assert messages == [*(f"new plan at {2 * k} s" for k in range(7)), "done: driven around"]


def test_a_trace_that_changes_at_every_tick_is_thinned_and_its_last_state_kept(tmp_path):
    run = drive(100)
    recorder = RerunRecorder(tmp_path / "run.rrd", run_id="thin", scenery=scenery())
    for k, tick in enumerate(run):
        lines = Lines((np.array([[0.0, 0.0], [1.0, float(k)]]),))
        big = Field(room())
        command = Hold(trace={"candidates": lines, "field": big})
        recorder.log(tick.observation, State.of(tick.belief, GrowingMap()), command, tick.truth)
    recorder.close()
    rows = [row for _, row in sorted(contents(tmp_path / "run.rrd", "world/plan/candidates"), key=lambda r: r[0])]
    assert 20 <= len(rows) <= 26  # five per second for five seconds, and the last
    assert rows[-1]["LineStrips3D:strips"][0][1][1] == 99.0


def test_sonar_cones_reach_as_far_as_was_heard(recorded):
    path, run = recorded
    scale = {
        t: r["Transform3D:scale"][0] for t, r in contents(path, "world/robot/sonar/front_left/cone") if r.get("Transform3D:scale")
    }
    heard = {k: next(s for s in t.observation.sonars if s.name == "front_left").ranges[0] for k, t in enumerate(run)}
    silent = [k for k, value in heard.items() if not np.isfinite(value)]
    assert silent
    expected = [value if np.isfinite(value) else 3.0 for value in heard.values()]
    np.testing.assert_allclose([scale[k][0] for k in range(len(run))], expected, rtol=1e-6)


def test_serial_lines_and_endings_are_in_the_log(tmp_path):
    recorder = RerunRecorder(tmp_path / "run.rrd", run_id="serial", scenery=Scenery())
    contact = GroundTruth(0.1, SE2(), contact=True)
    recorder.log(Observation(0.0), State.of(Belief(SE2()), GrowingMap()), Serial("M2"), None)
    recorder.log(Observation(0.1, serial=("OK", "ERR what")), State.of(Belief(SE2()), GrowingMap()), Hold(), contact)
    recorder.log(Observation(0.2), State.of(Belief(SE2()), GrowingMap()), GiveUp("walled in", "stuck"), contact)
    recorder.close()
    serial = [row["TextLog:text"][0] for _, row in contents(tmp_path / "run.rrd", "log/serial")]
    status = [row["TextLog:text"][0] for _, row in contents(tmp_path / "run.rrd", "log/status")]
    assert serial == ["> M2", "< OK", "< ERR what"]
    assert status == ["the car touches something", "stuck: walled in"]


def test_the_result_is_one_row_of_properties(recorded):
    path, _ = recorded
    rows = [row for _, row in contents(path, "__properties/run")]
    facts = {name.rpartition(":")[2]: value[0] for row in rows for name, value in row.items()}
    assert facts == {
        **{"navigator": "circle", "seed": 3, "scenario": "synthetic", "status": "success", "hash": "abc"},
        **{"duration": 12.5, "contacts": 0},
    }


def test_the_file_is_sound_for_rerun_itself(recorded):
    path, _ = recorded
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_equal_runs_make_equal_recordings_and_others_do_not(tmp_path):
    def same(a, b):
        command = [sys.executable, "-m", "rerun", "rrd", "compare", str(a), str(b)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120).returncode == 0

    first = write(tmp_path / "a.rrd", drive(50), result=RESULT)
    again = write(tmp_path / "b.rrd", drive(50), result=RESULT)
    other = write(tmp_path / "c.rrd", drive(50, seed=1), result=RESULT)
    assert same(first, again)
    assert not same(first, other)


def test_a_killed_run_is_readable_up_to_the_last_flush(tmp_path):
    code = f"""
import os, sys
sys.path.insert(0, {os.path.dirname(__file__)!r})
from tests.recording.synthetic import drive, record, scenery
from robocar.recording import RerunRecorder
record(RerunRecorder({str(tmp_path / "run.rrd")!r}, run_id="killed", scenery=scenery(), flush_ticks=20), drive(50))
os._exit(9)
"""
    assert subprocess.run([sys.executable, "-c", code], timeout=120).returncode == 9
    assert len(read_trajectory(tmp_path / "run.rrd")[0]) == 40
    assert len(list(read_observations(tmp_path / "run.rrd"))) == 40


def test_a_minute_without_camera_and_particles_takes_less_than_five_megabytes(tmp_path):
    assert write(tmp_path / "run.rrd", drive(1200), result=RESULT).stat().st_size < 5e6


def test_images_particles_lasers_and_detections_are_drawn(tmp_path):
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)
    intrinsics = np.array([[10.0, 0.0, 8.0], [0.0, 10.0, 6.0], [0.0, 0.0, 1.0]])
    image = Image(0.0, pixels, intrinsics, np.eye(4))
    lidar = Scan(0.0, np.array([1.0, 2.0, np.inf]), np.array([-1.0, 0.0, 1.0]), 5.6, name="laser")
    seen = (Detection(0.0, "blue_ball", 0.1, 1.5, np.eye(2)),)
    particles = np.column_stack([rng.normal(size=(1000, 3)), np.full(1000, 1e-3)])
    recorder = RerunRecorder(tmp_path / "run.rrd", run_id="rich", scenery=scenery())
    observation = Observation(0.0, lidar=lidar, image=image, top_image=image, landmarks=seen)
    recorder.log(observation, State.of(Belief(SE2(), particles=particles), GrowingMap()), Hold(), None)
    recorder.close()
    path = tmp_path / "run.rrd"
    assert len(next(r for t, r in contents(path, "world/estimate/particles") if t == 0)["Arrows3D:origins"]) == 200
    hits = [r["Points3D:positions"] for _, r in contents(path, "world/robot/lidar/hits") if r.get("Points3D:positions")]
    np.testing.assert_allclose(hits[0][1][:2], [2.0, 0.0], atol=1e-6)
    ends = next(r for t, r in contents(path, "world/robot/detections") if t == 0)["LineStrips3D:strips"][0]
    np.testing.assert_allclose(ends[1][:2], [1.5 * math.cos(0.1), 1.5 * math.sin(0.1)], rtol=1e-6)
    (read, _), *_ = read_observations(path)
    np.testing.assert_array_equal(read.image.pixels, pixels)
    np.testing.assert_array_equal(read.top_image.pixels, pixels)


def test_names_of_traces_and_movers_may_hold_any_sign(tmp_path):
    recorder = RerunRecorder(tmp_path / "run.rrd", run_id="names", scenery=Scenery(robot=car()))
    trace = {"A* search/open list": Lines((np.zeros((2, 2)),)), "f(n)": Scalar(1.5), "clearance": Scalar(2.5), "why": Text("so")}
    truth = GroundTruth(0.0, SE2(), clearance=9.0, movers={"cart no. 1/2": SE2(1.0)})
    recorder.log(Observation(0.0), State.of(Belief(SE2(), trace=trace), GrowingMap()), Hold(), truth)
    recorder.close()
    entities = {chunk.entity_path for chunk in RrdReader(str(tmp_path / "run.rrd")).stream()}
    assert {r"/world/plan/A\*\ search/open\ list", r"/world/movers/cart\ no.\ 1\/2"} <= entities
    assert read_signal(tmp_path / "run.rrd", r"signals/f\(n\)")[1].tolist() == [1.5]
    assert read_signal(tmp_path / "run.rrd", "signals/clearance")[1].tolist() == [9.0]
    assert read_signal(tmp_path / "run.rrd", "signals/trace/clearance")[1].tolist() == [2.5]


def test_closing_twice_is_closing_once_and_an_empty_run_is_a_recording(tmp_path):
    recorder = RerunRecorder(tmp_path / "run.rrd", run_id="empty", scenery=Scenery())
    recorder.close(RESULT)
    recorder.close()
    assert len(contents(tmp_path / "run.rrd", "log/about")) == 2


@pytest.mark.parametrize("value", [0, 0.5, True, 2**70])
def test_a_metric_may_be_of_another_type_in_the_next_recording_of_a_process(tmp_path, value):
    """Rerun remembers a type for each name. Oracle: the number, read back."""
    recorder = RerunRecorder(tmp_path / "run.rrd", run_id="types", scenery=Scenery())
    recorder.close({"metrics": {"odd": {"value": value, "unit": "1"}, "even": {"value": None, "unit": "1"}}})
    (row,) = [row for _, row in contents(tmp_path / "run.rrd", "__properties/run")]
    facts = {name.rpartition(":")[2]: found[0] for name, found in row.items()}
    assert facts == {"odd": float(value)}


def test_both_recorders_keep_the_protocol(tmp_path):
    recorder = RerunRecorder(tmp_path / "run.rrd", run_id="protocol", scenery=Scenery())
    assert isinstance(recorder, Recorder)
    assert isinstance(NullRecorder(), Recorder)
    mapper = record(NullRecorder(), drive(5))
    assert mapper.asked == 0
    recorder.close()


@pytest.mark.parametrize("path", ["missing/run.rrd", "."])
def test_a_file_that_cannot_be_opened_is_an_output_error(tmp_path, path):
    with pytest.raises(OutputError, match="cannot write the recording"):
        RerunRecorder(tmp_path / path, run_id="nowhere", scenery=Scenery())


def test_a_viewer_that_is_not_there_does_not_end_the_run(tmp_path, caplog):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"rerun+http://127.0.0.1:{probe.getsockname()[1]}/proxy"
    path = write(tmp_path / "run.rrd", drive(30), live=address)
    assert "the viewer is gone" in caplog.text
    assert len(list(read_observations(path))) == 30


@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("mount") is None, reason="needs root to make a disk that can be full")
@pytest.mark.parametrize("size", ["64k", "1100k", "1300k", "1500k"])
def test_a_full_disk_is_an_output_error(tmp_path, size):
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)], capture_output=True).returncode:
        pytest.skip("this machine does not let root mount a tmpfs")
    try:
        with pytest.raises(OutputError, match=r"run\.rrd.*the disk is full"):
            write(disk / "run.rrd", drive(1200), flush_ticks=50)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_file_that_lost_its_footer_is_an_output_error(tmp_path):
    """The same check without a special disk: the file shrinks behind the recorder's back."""
    path = tmp_path / "run.rrd"
    recorder = RerunRecorder(path, run_id="cut", scenery=Scenery())
    disconnect = recorder._stream._file.disconnect

    def cut():
        disconnect()
        os.truncate(path, path.stat().st_size // 2)

    recorder._stream._file.disconnect = cut  # type: ignore[method-assign]
    with pytest.raises(OutputError, match="incomplete"):
        recorder.close()


def test_reading_what_is_no_recording_is_a_format_error(tmp_path, recorded):
    text = tmp_path / "text.rrd"
    text.write_text("not a recording\n" * 10)
    with pytest.raises(LogFormatError, match=r"text\.rrd"):
        read_signal(text, "signals/clearance")
    with pytest.raises(LogFormatError, match="missing"):
        read_trajectory(tmp_path / "missing.rrd")
    with pytest.raises(LogFormatError, match="signals/speed/sideways"):
        read_signal(recorded[0], "signals/speed/sideways")
    (tmp_path / "empty.rrd").write_bytes(b"")
    with pytest.raises(LogFormatError, match=r"empty\.rrd"):
        list(read_observations(tmp_path / "empty.rrd"))


def test_a_recording_without_ticks_has_no_observations(tmp_path):
    RerunRecorder(tmp_path / "run.rrd", run_id="empty", scenery=Scenery()).close()
    with pytest.raises(LogFormatError, match="0 observations"):
        list(read_observations(tmp_path / "run.rrd"))


def test_importing_the_package_does_not_import_rerun():
    code = "import sys, robocar.recording, robocar.core.truth; sys.exit('rerun' in sys.modules or 'pyarrow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=120).returncode == 0


def test_seen_entities_do_not_depend_on_the_flush_interval(tmp_path):
    """The same rows, whatever the batches."""
    few, many = (write(tmp_path / f"{n}.rrd", drive(60), flush_ticks=n) for n in (7, 1000))
    counts = [defaultdict(int), defaultdict(int)]
    for path, count in zip((few, many), counts, strict=True):
        for chunk in RrdReader(str(path)).stream():
            count[chunk.entity_path] += chunk.num_rows
    assert counts[0] == counts[1]
    assert counts[0]["/observation"] == 60
