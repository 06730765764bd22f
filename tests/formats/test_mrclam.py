"""MRCLAM data sets. Oracles: numbers written by hand, the fixture's own statistics, and a malformed file of every kind."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from robocar.core import LogFormatError
from robocar.formats.check import check_file
from robocar.formats.load_log import load_log
from robocar.formats.mrclam import (
    BEARING_STD,
    CORRELATION_TIME,
    RANGE_STD_SHARE,
    SHORT_TAIL,
    is_mrclam,
    load_mrclam,
    robots,
)

FILES = {
    "Barcodes.dat": "# Subject # Barcode #\n 1 5\n 2 14\n 6 72\n 7 27\n",
    "Landmark_Groundtruth.dat": "6 1.0 -2.0 0.0001 0.0002\n7 3.0 4.0 0.1 0.1\n",
    "Robot1_Odometry.dat": "# v w\n10.0 0.1 0.2\n10.5 0.3 -0.1\n11.0 0.0 0.0\n",
    "Robot1_Measurement.dat": "9.0 72 1.0 0.1\n10.2 72 2.5 0.3\n10.2 14 1.0 0.0\n10.5 27 3.5 -0.2\n10.9 99 1.0 0.0\n",
    "Robot1_Groundtruth.dat": "9.5 1.0 2.0 3.1\n10.5 2.0 4.0 -3.1\n11.5 2.0 4.0 -3.0\n",
}


def write(folder: Path, **changed: str | None) -> Path:
    for name, text in (FILES | {name.replace("_dat", ".dat"): text for name, text in changed.items()}).items():
        if text is not None:
            (folder / name).write_text(text)
    return folder


def test_what_a_folder_holds(tmp_path: Path) -> None:
    log = load_mrclam(write(tmp_path))
    assert is_mrclam(tmp_path)
    assert log.kind == "mrclam"
    assert [(o.time, o.twist is not None, [d.landmark for d in o.landmarks]) for o in log.observations] == [
        (10.0, True, []),
        (10.2, False, ["6"]),
        (10.5, True, ["7"]),
        (11.0, True, []),
    ]
    twist = log.observations[2].twist
    assert twist is not None
    assert (twist.value.v, twist.value.omega) == (0.3, -0.1)
    seen = log.observations[1].landmarks[0]
    assert (seen.range, seen.bearing, seen.time) == (2.5, 0.3, 10.2)
    assert [(mark.name, *mark.position) for mark in log.landmarks] == [("6", 1.0, -2.0, 0.0), ("7", 3.0, 4.0, 0.0)]
    assert set(log.skipped) == {
        "1 measurements before the first line of odometry",
        "1 measurements of robot 2, which moves",
        "1 measurements of the unknown barcode 99",
    }


def test_what_a_sighting_says_of_itself(tmp_path: Path) -> None:
    """Noise grows with the range; all sightings of one landmark in the time in which errors stay alike say as much as one."""
    rows = [(10.0, 72, 2.0), (10.0, 27, 6.0), *((10.0 + 0.25 * k, 72, 2.0) for k in range(1, 13)), (20.0, 72, 2.0)]
    text = "".join(f"{time} {barcode} {distance} 0.0\n" for time, barcode, distance in rows)
    seen = [d for o in load_mrclam(write(tmp_path, Robot1_Measurement_dat=text)).observations for d in o.landmarks]
    near, far = seen[:2]
    assert math.sqrt(far.covariance[1, 1]) - math.sqrt(near.covariance[1, 1]) == pytest.approx(4.0 * RANGE_STD_SHARE)
    assert math.sqrt(near.covariance[0, 0]) == pytest.approx(BEARING_STD)
    assert {d.short_tail for d in seen} == {SHORT_TAIL}
    again = [d.covariance for d in seen[2:] if d.time <= 13.0]
    assert len(again) == 12
    assert sum(near.covariance[1, 1] / c[1, 1] for c in again) == pytest.approx(3.0 / CORRELATION_TIME)
    np.testing.assert_allclose(seen[-1].covariance, near.covariance)


def test_any_robot_of_a_folder(tmp_path: Path) -> None:
    others = {name.replace("Robot1", "Robot4").replace(".dat", "_dat"): text for name, text in FILES.items() if "Robot1" in name}
    others["Robot4_Odometry_dat"] = "20.0 0.1 0.2\n20.5 0.3 -0.1\n"
    write(tmp_path, **others)
    assert robots(tmp_path) == [1, 4]
    assert load_mrclam(tmp_path).observations[0].time == 10.0
    assert load_log(tmp_path, 1).observations[0].time == 10.0
    assert load_log(tmp_path, 4).observations[0].time == 20.0
    assert "2 observations" in str(check_file(tmp_path, subject=4))
    for bad in (2, 0, -1):
        with pytest.raises(LogFormatError, match=f"no robot {bad}; its robots are 1, 4"):
            load_log(tmp_path, bad)


def test_a_subject_goes_with_a_folder_of_several_robots(tmp_path: Path) -> None:
    (tmp_path / "grid.txt").write_text("...\n...\n")
    with pytest.raises(LogFormatError, match="subject 2 goes with an MRCLAM folder"):
        check_file(tmp_path / "grid.txt", 0.1, 2)


def test_the_start_lies_on_the_line_between_two_true_poses_the_short_way_round(tmp_path: Path) -> None:
    log = load_mrclam(write(tmp_path))
    assert log.start is not None
    assert (log.start.x, log.start.y) == pytest.approx((1.5, 3.0))
    assert math.cos(log.start.theta - math.pi) == pytest.approx(1.0)


def test_without_ground_truth_there_is_no_start(tmp_path: Path) -> None:
    log = load_mrclam(write(tmp_path, Robot1_Groundtruth_dat=None))
    assert log.truth is None
    assert log.start is None


def test_of_two_lines_of_one_time_the_last_counts(tmp_path: Path) -> None:
    log = load_mrclam(write(tmp_path, Robot1_Odometry_dat="10.0 0.1 0.2\n10.0 0.5 0.6\n"))
    twist = log.observations[0].twist
    assert twist is not None
    assert twist.value.v == 0.5
    assert "1 lines of odometry whose time comes again" in log.skipped


def test_no_measurement_at_all_is_a_log_too(tmp_path: Path) -> None:
    log = load_mrclam(write(tmp_path, Robot1_Measurement_dat="# nothing\r\n"))
    assert len(log.observations) == 3


BAD = {
    "a missing file": ({"Robot1_Measurement_dat": None}, "Robot1_Measurement.dat: no such file"),
    "no barcodes": ({"Barcodes_dat": None}, "Barcodes.dat: no such file"),
    "no landmarks": ({"Landmark_Groundtruth_dat": None}, "Landmark_Groundtruth.dat: no such file"),
    "no odometry": ({"Robot1_Odometry_dat": None}, "no Robot<number>_Odometry.dat"),
    "an empty file": ({"Robot1_Odometry_dat": "# only a comment\n"}, "no line of time, v, omega"),
    "a missing field": ({"Robot1_Odometry_dat": "10.0 0.1\n"}, "line 1: 2 fields, not the 3 of time, v, omega"),
    "nan": ({"Robot1_Odometry_dat": "10.0 0.1 0.1\n10.1 nan 0.1\n"}, "line 2: v must be a finite number, not 'nan'"),
    "inf": ({"Robot1_Measurement_dat": "10.0 72 inf 0.1\n"}, "line 1: range must be a finite number, not 'inf'"),
    "a word": ({"Robot1_Groundtruth_dat": "10.0 here 1.0 0.1\n"}, "line 1: x must be a finite number, not 'here'"),
    "falling times": ({"Robot1_Measurement_dat": "10.3 72 1.0 0.1\n10.2 72 1.0 0.1\n"}, "line 2: time 10.2 is earlier"),
    "half a barcode": ({"Barcodes_dat": "6 72.5\n"}, "line 1: barcode must be a whole number"),
    "a barcode twice": ({"Barcodes_dat": "6 72\n7 72\n"}, "line 2: barcode 72 stands there for the second time"),
    "a landmark twice": ({"Landmark_Groundtruth_dat": "6 1 1 0 0\n6 2 2 0 0\n"}, "line 2: landmark 6 stands"),
}


@pytest.mark.parametrize("what", sorted(BAD))
def test_bad_files_are_refused_by_file_and_line(tmp_path: Path, what: str) -> None:
    changed, message = BAD[what]
    with pytest.raises(LogFormatError) as caught:
        load_mrclam(write(tmp_path, **changed))
    assert message in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "Robot1_Odometry.dat").write_bytes(b"10.0 0.1 0.1\n\xff\xfe")
    with pytest.raises(LogFormatError, match="line 2"):
        load_mrclam(tmp_path)


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="no such folder"):
        load_mrclam(tmp_path / "nothing")


def test_the_fixture(data_dir: Path) -> None:
    """Oracles: counts by hand from the files' lines; residuals within what the data's own notes say."""
    folder = data_dir / "mrclam"
    log = load_mrclam(folder)
    lines = {
        file: sum(not line.startswith("#") for line in (folder / f"Robot1_{file}.dat").read_text().splitlines() if line.strip())
        for file in ("Odometry", "Measurement")
    }
    detections = [d for o in log.observations for d in o.landmarks]
    assert sum(o.twist is not None for o in log.observations) == lines["Odometry"]
    left_out = sum(int(text.split()[0]) for text in log.skipped)
    assert len(detections) + left_out == lines["Measurement"]
    assert len(log.landmarks) == 15
    assert log.truth is not None
    places = {mark.name: mark.position[:2] for mark in log.landmarks}
    off = []
    for d in detections:
        k = int(np.searchsorted(log.truth.times, d.time))
        if 0 < k < len(log.truth.times):
            x, y, theta = log.truth.poses[k]
            delta = places[d.landmark] - (x, y)
            off.append((d.range - np.hypot(*delta), math.remainder(d.bearing - math.atan2(delta[1], delta[0]) + theta, math.tau)))
    spread = np.array(off).std(axis=0)
    assert 0.12 < spread[0] < 0.28
    assert 0.011 < spread[1] < 0.096
