"""CARMEN logs, scans as tables, and the thesis' pictures: published files, hand-written lines, malformed ones of every kind."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import SE2, LogFormatError, OccupancyGrid, OutputError
from robocar.formats.carmen import load_carmen
from robocar.formats.lidar_csv import load_lidar_csv
from robocar.formats.thesis_picture import save_thesis_picture, thesis_picture


def flaser(ranges: list[float], laser: tuple = (1, 2, 0.5), odometry: tuple = (3, 4, 0.6), stamps: tuple = (10.0, 11.0)) -> str:
    poses = " ".join(f"{v}" for v in (*laser, *odometry))
    return f"FLASER {len(ranges)} {' '.join(map(str, ranges))} {poses} {stamps[0]} host {stamps[1]}"


def write(folder: Path, *lines: str, name: str = "some.log") -> Path:
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_orebro_log(data_dir: Path) -> None:
    """Oracle: the data's description: 237 scans of 181 beams, no-return 32.767 m; numbers of its first lines."""
    log = load_carmen(data_dir / "carmen" / "orebro-corrected.log.gz")
    scans = [o.lidar for o in log.observations if o.lidar is not None]
    assert len(scans) == len(log.observations) == 237
    assert {scan.ranges.shape for scan in scans} == {(181,)}
    assert log.kind == "carmen"
    assert log.skipped == ()
    assert scans[0].ranges[:3].tolist() == [3.46, 3.382, 3.319]
    assert scans[0].bearings[[0, 90, 180]] == pytest.approx([-math.pi / 2, 0.0, math.pi / 2])
    assert {scan.max_range for scan in scans} == {32.767}
    assert not np.any(np.concatenate([scan.ranges for scan in scans]) == 32.767)
    assert log.start == SE2(0.255856, 0.0163473, 0.618883)
    times = [o.time for o in log.observations]
    assert np.diff(times) == pytest.approx(0.1)  # its timestamps are useless


@pytest.mark.parametrize(
    ("beams", "first", "last"),
    [(180, -90.0, 89.0), (181, -90.0, 90.0), (360, -90.0, 89.5), (361, -90.0, 90.0), (5, -90.0, 90.0), (1, 0.0, 0.0)],
)
def test_bearings(tmp_path: Path, beams: int, first: float, last: float) -> None:
    """Oracle: the data's description; other numbers of beams fill the half circle."""
    (observation,) = load_carmen(write(tmp_path, flaser([2.0] * beams))).observations
    assert observation.lidar is not None
    assert np.degrees(observation.lidar.bearings[[0, -1]]) == pytest.approx([first, last])


@pytest.mark.parametrize(
    ("nothing", "max_range"), [(32.767, 32.767), (50.0, 50.0), (81.9, 81.8), (81.91, 81.8), (math.inf, 81.8)]
)
def test_what_stands_for_nothing(tmp_path: Path, nothing: float, max_range: float) -> None:
    """Oracle: the data's description of no-return values; zero and negative readings are none at all."""
    (observation,) = load_carmen(write(tmp_path, flaser([1.5, nothing, 0.0, -1.0, math.nan]))).observations
    assert observation.lidar is not None
    np.testing.assert_equal(observation.lidar.ranges, [1.5, math.inf, math.nan, math.nan, math.nan])
    assert observation.lidar.max_range == max_range


def test_both_poses(tmp_path: Path) -> None:
    """Oracle: the numbers of the lines; a laser that never moves has no pose of its own."""
    path = write(tmp_path, flaser([1.0], (1, 2, 0.5), (3, 4, 0.6)), flaser([1.0], (1.5, 2, 0.5), (3.4, 4, 0.6)))
    first = [o.odom_pose.value for o in load_carmen(path).observations if o.odom_pose]
    assert first == [SE2(1, 2, 0.5), SE2(1.5, 2, 0.5)]
    second = load_carmen(path, pose="odometry")
    assert [o.odom_pose.value for o in second.observations if o.odom_pose] == [SE2(3, 4, 0.6), SE2(3.4, 4, 0.6)]
    assert second.start == SE2(3, 4, 0.6)
    still = write(tmp_path, flaser([1.0], (0, 0, 0), (3, 4, 0)), flaser([1.0], (0, 0, 0), (5, 4, 0)), name="still.log")
    assert [o.odom_pose.value.x for o in load_carmen(still).observations if o.odom_pose] == [3, 5]


@pytest.mark.parametrize(
    ("stamps", "times"),
    [
        ([(100.0, 1.0), (101.0, 1.5), (102.0, 4.0)], [0.0, 0.5, 3.0]),  # the logger's
        ([(100.0, 0.0), (101.0, 0.0), (103.0, 0.0)], [0.0, 1.0, 3.0]),  # the messages'
        ([(0.0, 0.0), (0.0, 0.0), (0.0, 0.0)], [0.0, 0.1, 0.2]),
        ([(5.0, 3.0), (4.0, 2.0), (3.0, 1.0)], [0.0, 0.1, 0.2]),
    ],
)
def test_times(tmp_path: Path, stamps: list[tuple], times: list[float]) -> None:
    """Oracle: by hand: what ascends is believed, the logger's first."""
    log = load_carmen(write(tmp_path, *(flaser([1.0], stamps=pair) for pair in stamps)))
    assert [o.time for o in log.observations] == pytest.approx(times)
    assert [o.lidar.time for o in log.observations if o.lidar] == pytest.approx(times)


BAD = {
    "FLASER": "number of beams",
    "FLASER x 1 2": "number of beams",
    "FLASER -3 1 2": "number of beams",
    "FLASER 0 0 0 0 0 0 0": "number of beams",
    "FLASER 181 1.0 2.0": "needs 189 words",
    "FLASER 1 one 0 0 0 0 0 0": "a range must be a number",
    "FLASER 1 1.0 0 0 zero 0 0 0": "a pose must be a number",
    "FLASER 1 1.0 0 0 nan 0 0 0": "a pose must be finite",
    "FLASER 99999999999999999999 1.0": "needs",
    "ROBOTLASER1 0 -1.5 3.1": "number of beams",
    "ROBOTLASER1 0 x 3.1 0.1 80 0 0 1 5.0 0 0 0 0 0 0 0 0 0 0": "an angle",
    "ROBOTLASER1 0 0 3.1 0.1 80 0 0 1 5.0 9 0 0 0 0 0 0 0 0 0": "remission values",
    "LASER_READING 3 1 2": "needs 8 words",
    "hello world": "unknown message",
    '{"json": 1}': "unknown message",
}


@pytest.mark.parametrize("line", BAD)
def test_a_bad_line_is_named_and_the_rest_read(tmp_path: Path, line: str) -> None:
    """Oracle: the line's number and what is wrong with it; both good scans are there."""
    log = load_carmen(write(tmp_path, "# a comment", flaser([1.0]), line, "", flaser([2.0])))
    assert len(log.observations) == 2
    assert len(log.skipped) == 1
    assert log.skipped[0].startswith("line 3: ")
    assert BAD[line] in log.skipped[0]


def test_other_messages_are_left_aside(tmp_path: Path) -> None:
    """Oracle: by hand: nothing is skipped, as nothing is wrong."""
    lines = ["PARAM robot_length 1", "ODOM 0 0 0 0 0 0 0 host 0", "NEFF 60", "SYNC x", "# FLASER 3", flaser([1.0])]
    log = load_carmen(write(tmp_path, *lines))
    assert len(log.observations) == 1
    assert log.skipped == ()


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    """Oracle: the line's number."""
    path = tmp_path / "raw.log"
    path.write_bytes(flaser([1.0]).encode() + b"\nFLASER 1 \xff\xfe 0 0 0 0 0 0\n")
    log = load_carmen(path)
    assert len(log.observations) == 1
    assert log.skipped[0].startswith("line 2: ")


@pytest.mark.parametrize(
    "content", [b"", b"\n\n", b"# nothing\n", b"ODOM 0 0 0 0 0 0 0 host 0\n", b"FLASER 5 1\n", b"\x1f\x8bbroken"]
)
def test_files_without_a_scan(tmp_path: Path, content: bytes) -> None:
    """Oracle: the error names the file."""
    path = tmp_path / "empty.log"
    path.write_bytes(content)
    with pytest.raises(LogFormatError, match=r"empty\.log"):
        load_carmen(path)


def test_missing_and_packed_files(tmp_path: Path) -> None:
    """Oracle: the same log, packed."""
    with pytest.raises(LogFormatError, match="no such file"):
        load_carmen(tmp_path / "none.log")
    path = tmp_path / "packed.log.gz"
    path.write_bytes(gzip.compress((flaser([1.0, 2.0]) + "\n").encode()))
    (observation,) = load_carmen(path).observations
    assert observation.lidar is not None
    assert observation.lidar.ranges.tolist() == [1.0, 2.0]


@given(st.text(max_size=200))
def test_any_text_gives_a_log_or_a_clear_error(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    """Property: nothing but `LogFormatError` comes out, also behind a good line."""
    path = tmp_path_factory.mktemp("carmen") / "any.log"
    path.write_text("\n".join([flaser([1.0]), "FLASER " + text, text]), encoding="utf-8", errors="replace")
    assert len(load_carmen(path).observations) >= 1


# -- a scan as a table ----------------------------------------------------------------------------------------------------


def test_the_scan_of_python_robotics(data_dir: Path) -> None:
    """Oracle: the file's numbers: 154 lines of which none is a header, the first and the last."""
    log = load_lidar_csv(data_dir / "references" / "lidar01.csv")
    (observation,) = log.observations
    assert observation.lidar is not None
    assert len(observation.lidar.ranges) == 154
    assert (observation.lidar.bearings[0], observation.lidar.ranges[0]) == (0.008450416037156572, 0.5335)
    assert observation.lidar.bearings[-1] == pytest.approx(6.252911230438118 - math.tau)
    assert observation.lidar.max_range == observation.lidar.ranges.max()
    assert log.skipped == ()


def test_bad_lines_of_a_table(tmp_path: Path) -> None:
    """Oracle: their numbers; inf and nan are beams."""
    path = write(tmp_path, "angle,range", "0.1,1.0", "0.2", "0.3,1,2", "nan,1.0", "0.4,-1", "0.5;inf", "0.6 nan", name="a.csv")
    log = load_lidar_csv(path)
    assert [text.partition(":")[0] for text in log.skipped] == ["line 1", "line 3", "line 4", "line 5", "line 6"]
    assert log.observations[0].lidar is not None
    np.testing.assert_equal(log.observations[0].lidar.ranges, [1.0, math.inf, math.nan])
    assert log.observations[0].lidar.max_range == 1.0


@pytest.mark.parametrize("content", ["", "a,b\n", "1,-1\n"])
def test_tables_without_a_beam(tmp_path: Path, content: str) -> None:
    """Oracle: the error names the file."""
    path = tmp_path / "none.csv"
    path.write_text(content)
    with pytest.raises(LogFormatError, match=r"none\.csv"):
        load_lidar_csv(path)
    with pytest.raises(LogFormatError, match="no such file"):
        load_lidar_csv(tmp_path / "missing.csv")


# -- the thesis' picture ----------------------------------------------------------------------------------------------------


def test_the_thesis_picture(tmp_path: Path) -> None:
    """Oracle: the thesis' grey levels (Figs 4.15 to 4.17), the largest y on top; OpenCV reads back what was written."""
    grid = OccupancyGrid(np.array([[-1, 0, 100], [64, 65, 30]], dtype=np.int8), 0.1)
    expected = [[64, 255, 64], [0, 64, 255]]
    assert thesis_picture(grid).tolist() == expected
    for name in ("map.png", "map.pgm"):
        path = save_thesis_picture(grid, tmp_path / name)
        assert cv2.imread(str(path), cv2.IMREAD_UNCHANGED).tolist() == expected  # type: ignore[union-attr]
    with pytest.raises(OutputError, match=r"\.png or \.pgm"):
        save_thesis_picture(grid, tmp_path / "map.jpg")
    with pytest.raises(OutputError, match="cannot be written"):
        save_thesis_picture(grid, tmp_path / "nowhere" / "map.png")
