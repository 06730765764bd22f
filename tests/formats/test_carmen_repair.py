"""What CARMEN logs leave out: a simulated corridor of which the truth is known, and stamps by hand."""

from __future__ import annotations

import gzip
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import LogFormatError
from robocar.formats import check_file
from robocar.formats.carmen import load_carmen
from robocar.formats.carmen_repair import LONGEST, largest_range, repaired_times
from robocar.formats.lidar_csv import load_lidar_csv

BEAMS = 180


def corridor(lost: float, scans: int = 60, digits: int = 2, noise: float = 0.01, length: float = 60.0) -> np.ndarray:
    """Ranges (scans, beams) in a corridor 2 m wide, written with `digits` digits; what is farther than `lost` reads `lost`."""
    rng = np.random.default_rng(7)
    bearings = np.radians(-90.0 + np.arange(BEAMS))
    rows = []
    for k in range(scans):
        x = 0.2 * k
        with np.errstate(divide="ignore"):
            sides = np.abs(1.0 / np.sin(bearings))
            end = np.where(np.cos(bearings) > 0, (length - x) / np.cos(bearings), np.inf)
        true = np.minimum(sides, end)
        rows.append(np.where(true >= lost, lost, np.round(true + noise * rng.standard_normal(BEAMS), digits)))
    return np.array(rows)


def line(ranges: np.ndarray, k: int, kind: str = "FLASER", stamp: float | None = None, largest: float = 81.83) -> str:
    text = " ".join(f"{r:g}" for r in ranges)
    pose, time = f"{0.2 * k} 0 0", 0.2 * k if stamp is None else stamp
    if kind == "FLASER":
        return f"FLASER {len(ranges)} {text} {pose} {pose} {time} host {time}"
    if kind == "ROBOTLASER1":
        head = f"ROBOTLASER1 0 {-math.pi / 2} {math.pi} {math.pi / 180} {largest} 0.01 0"
        return f"{head} {len(ranges)} {text} 2 7 7 {pose} {pose} 0 0 0.2 0.2 1 {time} host {time}"
    return f"LASER_READING {len(ranges)} {text} {pose} {time}"


def written(path: Path, ranges: np.ndarray, kind: str = "FLASER", **more: float) -> Path:
    text = "\n".join(line(row, k, kind, **more) for k, row in enumerate(ranges)) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


@pytest.mark.parametrize("digits", [2, 3])
@pytest.mark.parametrize("lost", [3.2, 5.6, 8.0, 12.345, 20.0, 25.0, 29.99, 30.0, 32.767, 40.9, 50.0, 81.83])
def test_lost_beams_are_no_walls(lost: float, digits: int, tmp_path: Path) -> None:
    """Oracle: which beams reach no wall within the range."""
    ranges = corridor(lost, digits=digits, length=200.0)
    log = load_carmen(written(tmp_path / "a.log", ranges))
    read = np.array([o.lidar.ranges for o in log.observations if o.lidar is not None])
    np.testing.assert_array_equal(np.isinf(read), ranges == lost)
    assert {o.lidar.max_range for o in log.observations if o.lidar is not None} == {min(lost, LONGEST)}
    assert len(log.notes) == (lost not in (32.767, 50.0, 81.83))


def test_the_note_is_shown_by_check(tmp_path: Path) -> None:
    report = str(check_file(written(tmp_path / "a.log", corridor(8.0))))
    assert "warning: " in report
    assert "exactly 8 m" in report


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("moves", [True, False])
def test_walls_are_no_lost_beams(noise: float, moves: bool) -> None:
    """Oracle: a room in which every beam meets a wall, seen with and without noise, by a robot that moves or stands."""
    ranges = corridor(1e3, length=9.0 if not moves else 30.0, noise=noise)
    ranges = ranges if moves else np.repeat(ranges[:1], 60, axis=0)
    assert largest_range(ranges[ranges < 1e3].ravel()) == (LONGEST, "")


def test_what_messages_declare() -> None:
    """Oracle: by hand: the scale's end is believed where it shows, else what is declared."""
    assert largest_range(np.array([1.0, 2.0, 3.0]), [math.nan, 20.0]) == (20.0, "")
    assert largest_range(np.array([1.0, 2.0, 3.0]), [1e9]) == (LONGEST, "")
    assert largest_range(np.array([1.0] + [8.0] * 9), [20.0])[0] == 8.0
    assert largest_range(np.array([math.nan, math.inf, -1.0])) == (LONGEST, "")


@pytest.mark.parametrize("kind", ["FLASER", "ROBOTLASER1", "LASER_READING"])
@pytest.mark.parametrize("ending", ["log", "clf", "gfs", "log.gz", "clf.gz", "gfs.gz"])
def test_every_kind_of_scan_and_every_ending(kind: str, ending: str, tmp_path: Path) -> None:
    """Oracle: the same corridor, the same poses and times."""
    ranges = corridor(8.0, scans=4)
    path = written(tmp_path / f"a.{ending}", ranges, kind)
    assert check_file(path).kind == "carmen log"
    log = load_carmen(path)
    assert log.skipped == ()
    assert [o.time for o in log.observations] == pytest.approx([0.0, 0.2, 0.4, 0.6])
    for k, o in enumerate(log.observations):
        assert o.lidar is not None
        assert o.odom_pose is not None
        np.testing.assert_allclose(o.lidar.ranges, np.where(ranges[k] == 8.0, np.inf, ranges[k]))
        np.testing.assert_allclose(np.degrees(o.lidar.bearings), -90.0 + np.arange(BEAMS), atol=1e-9)
        assert o.odom_pose.value.x == pytest.approx(0.2 * k)


def test_scans_written_twice_are_read_once(tmp_path: Path) -> None:
    """FLASER and ROBOTLASER1 of the same scans: the range is the latter's."""
    ranges = corridor(1e3, scans=3, length=10.0)
    path = tmp_path / "a.log"
    path.write_text(
        "\n".join(line(row, k, kind, largest=25.0) for k, row in enumerate(ranges) for kind in ("ROBOTLASER1", "FLASER"))
    )
    log = load_carmen(path)
    assert len(log.observations) == 3
    assert {o.lidar.max_range for o in log.observations if o.lidar is not None} == {25.0}


# -- times ------------------------------------------------------------------------------------------------------------------


def times_of(stamps: list[float]) -> tuple[list[float], list[int], str]:
    return repaired_times([(stamp, math.nan) for stamp in stamps])


def test_one_late_stamp_costs_no_time() -> None:
    """Oracle: by hand: 2651 s stay 2651 s, and the scans lie in the order of their stamps."""
    stamps = np.arange(910) * 2651.0 / 909
    stamps[[400, 401]] = stamps[[401, 400]]
    times, order, note = times_of(stamps.tolist())
    assert times[-1] == pytest.approx(2651.0)
    assert order[399:403] == [399, 401, 400, 402]
    np.testing.assert_allclose(times, np.arange(910) * 2651.0 / 909)
    assert "1 stamps that do not ascend" in note


@pytest.mark.parametrize(
    ("stamps", "times", "note"),
    [
        ([0.0, 1.0, 1.0, 2.0], [0.0, 1.0, 1.5, 2.0], "1 stamps that do not ascend"),
        ([0.0, 1.0, 2.0, 2.0], [0.0, 1.0, 2.0, 3.0], "1 stamps that do not ascend"),
        ([0.0, 1.0, math.nan, 3.0], [0.0, 1.0, 2.0, 3.0], "1 missing"),
        ([1000.0, 1001.0, 0.0, 1.0], [0.0, 1.0, 2.0, 3.0], "1 times at which the clock was set back"),
        ([7.0], [0.0], ""),
        ([math.inf, 1e300], [0.0, 0.1], "0.1 s apart"),
    ],
)
def test_times_by_hand(stamps: list[float], times: list[float], note: str) -> None:
    assert times_of(stamps)[0] == pytest.approx(times)
    assert note in times_of(stamps)[2]


@given(st.lists(st.tuples(st.floats(), st.floats()), min_size=1, max_size=30))
def test_times_always_ascend_from_zero(stamps: list[tuple[float, float]]) -> None:
    """Property: for any stamps; each scan is there once; a note says it unless they ascended."""
    times, order, note = repaired_times(stamps)
    assert times[0] == 0.0
    assert all(b > a for a, b in pairwise(times))
    assert sorted(order) == list(range(len(stamps)))
    assert note or order == list(range(len(stamps)))


# -- other files ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("head", ["time,gyro_z", "t;omega", "range,angle", "angle,range,intensity", "x,y", "stamp\tyaw"])
def test_other_tables_are_no_scans(head: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{head}\n0,0.1\n0.1,0.2\n")
    with pytest.raises(LogFormatError, match="expected the columns angle, range"):
        load_lidar_csv(path)


@pytest.mark.parametrize("head", ["angle,range", "# t, z", "bearing [rad];distance [m]", "Theta, r", "0.0,1.5"])
def test_scans_are_scans(head: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{head}\n0,0.1\n0.1,0.2\n")
    assert load_lidar_csv(path).observations[0].lidar is not None


@pytest.mark.parametrize("name", ["groundtruth.txt", "a.tum", "trajectory", "poses.dat"])
def test_a_trajectory_is_known_by_its_content(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("# timestamp tx ty tz qx qy qz qw\n1.5 0 0 0 0 0 0 1\n2.5e0 1 0 0 0 0 0.0 -1\n")
    report = check_file(path)
    assert report.kind == "tum"
    assert "2 poses" in str(report)


@pytest.mark.parametrize("text", ["########\n#......#\n", "#\n", "# # # # \n", "........\n"])
def test_a_drawn_grid_stays_one(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(text)
    assert check_file(path).kind == "text_grid"
