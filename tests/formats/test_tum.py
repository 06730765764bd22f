"""TUM trajectories. Oracles: round trip, rotation matrices by scipy, and evo's reader."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from robocar.core import LogFormatError, OutputError, wrap_angles
from robocar.formats import read_tum, write_tum

finite = st.floats(-1e7, 1e7, allow_nan=False)  # what is read


@settings(deadline=None)
@given(
    st.integers(0, 10).flatmap(
        lambda n: st.tuples(
            arrays(float, n, elements=finite), arrays(float, (n, 2), elements=finite), arrays(float, n, elements=st.floats(-7, 7))
        )
    )
)
def test_round_trip(tmp_path_factory, parts):
    """Times and positions bit by bit, headings to a few ulp."""
    times, positions, headings = np.sort(parts[0]), parts[1], parts[2]
    path = write_tum(tmp_path_factory.mktemp("tum") / "a.tum", times, np.column_stack([positions, headings]))
    found = read_tum(path)
    np.testing.assert_array_equal(found.times, times)
    np.testing.assert_array_equal(found.poses[:, :2], positions)
    np.testing.assert_allclose(wrap_angles(found.poses[:, 2] - headings), 0, atol=4e-15)


@settings(deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(0.1, 3))
def test_yaw_of_any_rotation(tmp_path_factory, yaw, pitch, roll, length):
    """scipy's intrinsic z-y-x angles; the quaternion need not be of unit length."""
    path = tmp_path_factory.mktemp("tum") / "a.tum"
    q = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat() * length
    path.write_text("1 2 3 4 " + " ".join(repr(float(v)) for v in q))
    np.testing.assert_allclose(read_tum(path).poses, [[2, 3, yaw]], rtol=0, atol=1e-9)


def test_evo_reads_what_we_write(tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    rng = np.random.default_rng(7)
    times, poses = np.sort(rng.uniform(0, 100, 50)), rng.uniform(-3, 3, (50, 3))
    trajectory = file_interface.read_tum_trajectory_file(str(write_tum(tmp_path / "a.tum", times, poses)))
    np.testing.assert_array_equal(trajectory.timestamps, times)
    np.testing.assert_array_equal(trajectory.positions_xyz[:, :2], poses[:, :2])
    w, x, y, z = trajectory.orientations_quat_wxyz.T
    np.testing.assert_allclose(Rotation.from_quat(np.stack([x, y, z, w], axis=1)).as_euler("ZYX")[:, 0], poses[:, 2], atol=1e-12)


def test_comments_empty_lines_and_crlf(tmp_path):
    path = tmp_path / "a.tum"
    path.write_bytes(b"# a comment\r\n\r\n0 1 2 0 0 0 0 1\r\n  # another\r\n0.5 2 2 0 0 0 1 0\r\n")
    found = read_tum(path)
    assert found.times.tolist() == [0, 0.5]
    assert found.poses.tolist() == [[1, 2, 0], [2, 2, np.pi]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 1 2 0 0 0 1\n", ["line 1", "7 fields", "8", "time x y z qx qy qz qw"]),
        ("# c\n0 1 2 0 0 0 0 1 9\n", ["line 2", "9 fields"]),
        ("0 1 2 0 0 0 0 1\n1 a 2 0 0 0 0 1\n", ["line 2", "x must", "'a'"]),
        ("0 1 nan 0 0 0 0 1\n", ["line 1", "y must", "'nan'"]),
        ("0 1 2 0 0 0 0 0\n", ["line 1", "quaternion", "zero"]),
        ("1 1 2 0 0 0 0 1\n0 1 2 0 0 0 0 1\n", ["line 2", "time 0", "earlier"]),
        ("0,1,2,0,0,0,0,1\n", ["line 1", "1 fields"]),
    ],
)
def test_broken_trajectories_are_named_with_their_line(tmp_path, text, words):
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(LogFormatError) as caught:
        read_tum(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert [word for word in words if word not in message] == []


def test_missing_file_and_missing_folder(tmp_path):
    with pytest.raises(LogFormatError, match=r"a\.tum: no such file"):
        read_tum(tmp_path / "a.tum")
    with pytest.raises(OutputError, match=r"a\.tum: cannot be written"):
        write_tum(tmp_path / "nowhere" / "a.tum", [0.0], [[0.0, 0.0, 0.0]])


def test_wrong_arrays_are_refused_before_anything_is_written(tmp_path):
    for times, poses in (
        ([0.0], [[0.0, 0.0]]),
        ([0.0, 1.0], [[0.0, 0.0, 0.0]]),
        ([0.0], [[0.0, np.nan, 0.0]]),
        ([1.0, 0.0], np.zeros((2, 3))),
    ):
        with pytest.raises(ValueError, match="trajectory"):
            write_tum(tmp_path / "a.tum", times, poses)
    assert list(tmp_path.iterdir()) == []
