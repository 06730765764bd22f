"""The door for all kinds of maps, and `check_file`. Oracles: hand-made files, the published files."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import MapFormatError, OccupancyGrid, ParameterError, RobocarError
from robocar.formats import check_file, file_kind, load_map, load_movingai_map, save_ros_map, write_tum

GRID = np.array([[0, 100, -1], [0, 0, 100]], np.int8)
KNOWN = np.array([[0, 100, 100], [0, 0, 100]], np.int8)
WORLD = (
    "<sdf><world><model name='c'><pose>0.075 0.075 0 0 0 0</pose><link><collision><geometry><cylinder><radius>0.075</radius>"
    "</cylinder></geometry></collision></link></model></world></sdf>"
)


@pytest.fixture
def folder(tmp_path):
    """The same small grid in every format that can hold it."""
    save_ros_map(OccupancyGrid(GRID, 0.05), tmp_path / "a")
    (tmp_path / "a.map").write_text("type octile\nheight 2\nwidth 3\nmap\n..@\n.@@\n")
    (tmp_path / "a.txt").write_text("..#\n.#?\n")
    (tmp_path / "a.world").write_text(WORLD)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "kind", "resolution", "data"),
    [
        ("a.yaml", "ros_map", 0.05, GRID),
        ("a.map", "movingai_map", 1.0, KNOWN),
        ("a.txt", "text_grid", 1.0, GRID),
        ("a.world", "barn_world", 0.15, np.array([[100]])),
    ],
)
def test_every_kind_with_its_own_resolution_and_with_another(folder, name, kind, resolution, data):
    path = folder / name
    assert file_kind(path) == kind
    grid = load_map(path)
    np.testing.assert_array_equal(grid.data, data)
    assert grid.resolution == resolution
    assert load_map(str(path), 0.3).resolution == 0.3
    for bad in (0, -1, float("nan")):
        with pytest.raises(ParameterError, match="resolution"):
            load_map(path, bad)


def test_an_image_needs_a_resolution(folder):
    with pytest.raises(MapFormatError, match=r"a\.pgm: an image alone has no resolution"):
        load_map(folder / "a.pgm")
    grid = load_map(folder / "a.pgm", 0.2)
    np.testing.assert_array_equal(grid.data, GRID)
    assert grid.resolution == 0.2


@pytest.mark.parametrize(
    ("name", "kind"), [("a.map", "movingai_map"), ("a.txt", "text_grid"), ("a.world", "barn_world"), ("a.pgm", "image")]
)
def test_files_with_a_strange_ending_are_told_by_content(folder, name, kind):
    copy = folder / "strange.dat"
    copy.write_bytes((folder / name).read_bytes())
    assert file_kind(copy) == kind
    np.testing.assert_array_equal(load_map(copy, 0.15).data, load_map(folder / name, 0.15).data)


def test_what_is_no_map_is_refused_with_what_would_be(tmp_path):
    (tmp_path / "a.doc").write_bytes(b"\x00\x01\x02")
    (tmp_path / "a.scen").write_text("version 1\n")
    for name in ("a.doc", "a.scen"):
        with pytest.raises(MapFormatError, match=rf"{name}: not a map; maps are map_server \.yaml"):
            load_map(tmp_path / name)
    with pytest.raises(MapFormatError, match=r"gone\.map: no such file"):
        load_map(tmp_path / "gone.map")
    with pytest.raises(MapFormatError, match=r"gone: no such file"):
        load_map(tmp_path / "gone")


def test_a_world_too_large_for_its_resolution_is_named(folder):
    with pytest.raises(MapFormatError, match=r"a\.world: .* cells, at most"):
        load_map(folder / "a.world", 1e-6)


def test_a_report_says_what_is_in_a_map(folder):
    """Counted by hand: 2 of 6 cells occupied, 3 free, 1 unknown."""
    report = check_file(folder / "a.yaml")
    assert (report.kind, report.shape, report.resolution) == ("ros_map", (2, 3), 0.05)
    assert report.size == pytest.approx((0.15, 0.1))
    assert (report.occupied, report.free, report.unknown) == pytest.approx((2 / 6, 3 / 6, 1 / 6))
    odd = "16.7% of the cells are unknown: robots take them for free floor, unless allow_unknown is false"
    assert report.warnings == (odd,)
    shares = "33.3% occupied, 50.0% free, 16.7% unknown"
    assert (
        str(report)
        == f"{folder / 'a.yaml'}: ros map, 3 x 2 cells of 0.05 m (0.15 x 0.1 m), {shares}, mode trinary\n  warning: {odd}"
    )


def test_reports_warn_of_what_is_legal_but_odd(folder):
    text = (folder / "a.yaml").read_text()
    (folder / "a.yaml").write_text(text.replace("trinary", "raw").replace("negate: 0", "negate: 1") + "floor: 3\n")
    assert check_file(folder / "a.yaml").warnings == (
        "unknown field floor is ignored",
        "negate has no effect in mode raw",
        "no cell is occupied",
        "66.7% of the cells are unknown: robots take them for free floor, unless allow_unknown is false",
    )
    (folder / "a.txt").write_text("###\n")
    assert check_file(folder / "a.txt").warnings == ("no cell is free",)
    assert "1 m is assumed" in check_file(folder / "a.pgm").warnings[0]
    assert all("unknown" in line for line in check_file(folder / "a.pgm", 0.1).warnings)


def test_scenarios_are_checked_against_their_map(folder):
    path = folder / "a.scen"
    path.write_text("version 1\n0 far/away/a.map 3 2 0 0 1 0 1\n0 far/away/a.map 3 2 2 0 0 1 2\n")
    report = check_file(path)
    assert report.details == ("2 queries", "checked against a.map")
    assert report.warnings == ("1 starts and goals lie in blocked cells",)
    path.write_text("version 1\n0 a.map 4 2 0 0 1 0 1\n")
    assert check_file(path).warnings == ("queries for a map of 4 x 2 cells, but the map has 3 x 2",)
    path.write_text("version 1\n0 b.map 4 2 0 0 1 0 1\n")
    assert check_file(path).details == ("1 queries", "map b.map is not in the same folder")


def test_trajectories_and_archives_are_reported(tmp_path):
    write_tum(tmp_path / "a.tum", [1.0, 3.5], [[0, 0, 0], [3, 4, 0]])
    assert check_file(tmp_path / "a.tum").details == ("2 poses", "2.500 s", "5.000 m")
    np.savez(tmp_path / "a.npz", world_3=np.ones((2, 3)))
    assert check_file(tmp_path / "a.npz").details == ("1 worlds of cylinders",)
    np.savez(tmp_path / "a.npz", other=np.ones((2, 3)))
    with pytest.raises(MapFormatError, match=r"a\.npz: neither BARN grids, worlds nor paths"):
        check_file(tmp_path / "a.npz")


def test_every_published_map_and_scenario_passes_the_check(data_dir):
    """A clean report for all files of the data folders, as many as there are, but for what is unknown on them."""
    paths = [
        p
        for pattern in ("ros_maps/*/*.yaml", "movingai/*.map", "movingai/*.scen", "barn/*.yaml", "barn/*.npz", "barn/*.gz")
        for p in data_dir.glob(pattern)
    ]
    assert len(paths) >= 21
    reports = {path.name: check_file(path) for path in paths}
    odd = {name: [line for line in report.warnings if "unknown" not in line] for name, report in reports.items()}
    assert odd == {name: [] for name in reports}
    assert [name for name, report in reports.items() if report.warnings] == [n for n, r in reports.items() if r.unknown]


ENDINGS = ["yaml", "map", "scen", "world", "world.gz", "npz", "txt", "pgm", "png", "bmp", "tum", "dat"]
STARTS = [
    b"",
    b"type octile\nheight ",
    b"P2\n2 2\n",
    b"P5 1 1 ",
    b"\x89PNG\r\n\x1a\n",
    b"BM",
    b"<sdf>",
    b"\x1f\x8b",
    b"PK\x03\x04",
    b"version 1\n",
    b"image: a\n",
]


@settings(deadline=None, max_examples=300)
@given(st.sampled_from(ENDINGS), st.sampled_from(STARTS), st.binary(max_size=80))
def test_rubbish_is_an_error_of_ours_or_a_map(tmp_path_factory, ending, start, rest):
    """No other exception, whatever the bytes."""
    path = tmp_path_factory.getbasetemp() / f"rubbish.{ending}"
    path.write_bytes(start + rest)
    try:
        said = str(check_file(path))
    except RobocarError as error:
        said = str(error)
    assert str(path) in said


def test_a_published_map_is_the_same_through_the_door(data_dir):
    path = data_dir / "movingai" / "arena.map"
    np.testing.assert_array_equal(load_map(path, 0.1).data, load_movingai_map(path).data)


def test_importing_the_formats_imports_neither_opencv_nor_yaml():
    code = "import sys, robocar.formats; sys.exit(len({'cv2', 'yaml', 'mujoco', 'rerun', 'scipy'} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
