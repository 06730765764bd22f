"""map_server maps. Oracles: the formulas of Nav2 in exact fractions, bytes of published maps, round trips."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from robocar.core import SE2, MapFormatError, OccupancyGrid, OutputError, ParameterError
from robocar.formats import load_map_image, load_ros_map, read_ros_yaml, save_ros_map

FIELDS = {
    "image": "map.pgm",
    "resolution": "0.05",
    "origin": "[1.0, -2.0, 0.5]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def write_map(folder, pixels, content=None, **fields):
    """A map folder with `pixels` (rows, cols) uint8 as P5 (or `content` as it stands); a field of None is left out."""
    pixels = np.asarray(pixels, np.uint8)
    raster = b"P5\n%d %d\n255\n" % pixels.shape[::-1] + pixels.tobytes()
    (folder / "map.pgm").write_bytes(raster if content is None else content)
    lines = [f"{name}: {value}" for name, value in {**FIELDS, **fields}.items() if value is not None]
    path = folder / "map.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_image_is_flipped_once_and_placed_by_its_lower_left_corner(tmp_path):
    """Analytic: the black pixel at the image's lower right is cell (0, 2), 2.5 and 0.5 cells from the turned origin."""
    path = write_map(tmp_path, [[254, 254, 254], [254, 254, 0]], resolution="0.1", origin="[2, 3, 1.0]")
    grid = load_ros_map(path)
    assert grid.data.tolist() == [[0, 0, 100], [0, 0, 0]]
    assert grid.resolution == 0.1
    assert grid.origin == SE2(2, 3, 1.0)
    x = 2 + 0.25 * math.cos(1) - 0.05 * math.sin(1)
    y = 3 + 0.25 * math.sin(1) + 0.05 * math.cos(1)
    np.testing.assert_allclose(grid.world_from_cell([0, 2]), [x, y], rtol=0, atol=1e-12)


thousandths = st.integers(0, 1000)


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(["trinary", "scale", "raw"]),
    st.booleans(),
    st.tuples(thousandths, thousandths).map(sorted),
)
def test_all_greys_in_all_modes_follow_nav2(tmp_path_factory, mode, negate, thresholds):
    """Nav2's rule in exact fractions, for every grey and random thresholds, inclusive on both sides."""
    free, occupied = (Fraction(t, 1000) for t in thresholds)
    path = write_map(
        tmp_path_factory.mktemp("map"),
        np.arange(256).reshape(16, 16),
        mode=mode,
        negate=int(negate),
        free_thresh=float(free),
        occupied_thresh=float(occupied),
    )
    loaded = load_ros_map(path).data[::-1].ravel()
    assert loaded.size == 256
    for grey, value in enumerate(loaded.tolist()):
        p = Fraction(grey if negate else 255 - grey, 255)
        if mode == "raw":
            expected = Fraction(grey if grey <= 100 else -1)
        elif p >= occupied:
            expected = Fraction(100)
        elif p <= free:
            expected = Fraction(0)
        elif mode == "trinary":
            expected = Fraction(-1)
        else:
            expected = 100 * (p - free) / (occupied - free)
        assert abs(value - expected) <= Fraction(1, 2) + Fraction(1, 10**9)
        assert mode == "scale" or value == expected


@pytest.mark.parametrize(("free_thresh", "expected"), [("0.196", -1), ("0.25", 0)])
def test_grey_205_depends_on_the_free_threshold(tmp_path, free_thresh, expected):
    """Published: p = 0.19608 is unknown at 0.196 and free at 0.25."""
    assert load_ros_map(write_map(tmp_path, [[205]], free_thresh=free_thresh)).data[0, 0] == expected


@pytest.mark.parametrize(("grey", "field"), [(204, "free_thresh: 0.2"), (102, "occupied_thresh: 0.6")])
def test_thresholds_are_inclusive_for_greys_that_hit_them_exactly(tmp_path, grey, field):
    """(255 - 204) / 255 = 0.2 and (255 - 102) / 255 = 0.6 exactly."""
    name, value = field.split(": ")
    expected = 0 if name == "free_thresh" else 100
    assert load_ros_map(write_map(tmp_path, [[grey]], **{name: value})).data[0, 0] == expected


finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)
shapes = array_shapes(min_dims=2, max_dims=2, max_side=12)
any_grid = arrays(np.int8, shapes, elements=st.integers(-1, 100))
trinary_grid = arrays(np.int8, shapes, elements=st.sampled_from([-1, 0, 100]))


@settings(deadline=None)
@given(
    st.one_of(any_grid, trinary_grid),
    st.floats(min_value=1e-6, max_value=1e6),
    st.builds(SE2, finite, finite, st.floats(-10, 10)),
)
def test_what_is_saved_is_loaded_exactly(tmp_path_factory, data, resolution, origin):
    """Round trip of every value, resolution and origin, bit by bit (numbers such as 1e-05 included)."""
    grid = OccupancyGrid(data, resolution, origin)
    path = save_ros_map(grid, tmp_path_factory.mktemp("map") / "saved.v1")
    assert path.name == "saved.v1.yaml"
    loaded = load_ros_map(path)
    np.testing.assert_array_equal(loaded.data, grid.data)
    assert (loaded.resolution, loaded.origin) == (grid.resolution, grid.origin)


def test_saved_files_are_what_other_map_servers_read(tmp_path):
    """map_saver's greys in an 8-bit P5, top row first, and nothing else left in the folder."""
    path = save_ros_map(OccupancyGrid(np.array([[0, 100], [-1, 0]], np.int8), 0.05), tmp_path / "map.yaml")
    assert (tmp_path / "map.pgm").read_bytes() == b"P5\n2 2\n255\n" + bytes([205, 254, 254, 0])
    assert sorted(file.name for file in tmp_path.iterdir()) == ["map.pgm", "map.yaml"]
    assert read_ros_yaml(path).mode == "trinary"
    save_ros_map(OccupancyGrid(np.array([[0, 37]], np.int8), 0.05), tmp_path / "map")
    assert read_ros_yaml(path).mode == "raw"


def test_a_folder_that_does_not_exist_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match=r"nowhere/map\.pgm: cannot be written"):
        save_ros_map(OccupancyGrid(np.zeros((1, 1), np.int8), 0.05), tmp_path / "nowhere" / "map")


def test_a_given_resolution_replaces_the_files(tmp_path):
    path = write_map(tmp_path, [[0]])
    assert load_ros_map(path).resolution == 0.05
    assert load_ros_map(path, 0.2).resolution == 0.2
    with pytest.raises(ParameterError, match=r"resolution .* -1"):
        load_ros_map(path, -1)


def test_a_bare_image_takes_the_default_thresholds(tmp_path):
    write_map(tmp_path, [[0, 205, 254]])
    grid = load_map_image(tmp_path / "map.pgm", 0.5)
    assert grid.data.tolist() == [[100, -1, 0]]
    assert (grid.resolution, grid.origin) == (0.5, SE2())


@pytest.mark.parametrize("value", ["1e-2", "'0.01'", "1.0e-2", ".01"])
def test_numbers_that_yaml_calls_text_are_numbers(tmp_path, value):
    """YAML 1.1 reads 1e-2 as text; map_server reads it as a number."""
    assert load_ros_map(write_map(tmp_path, [[0]], resolution=value)).resolution == 0.01


@pytest.mark.parametrize(("value", "expected"), [("0", 100), ("1", 0), ("false", 100), ("true", 0)])
def test_negate_is_a_number_or_a_truth_value(tmp_path, value, expected):
    assert load_ros_map(write_map(tmp_path, [[0]], negate=value)).data[0, 0] == expected


def test_crlf_and_byte_order_mark(tmp_path):
    path = write_map(tmp_path, [[0, 254]])
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert load_ros_map(path).data.tolist() == [[100, 0]]


def test_fields_that_nobody_knows_are_ignored_aloud(tmp_path):
    path = write_map(tmp_path, [[0]], floor="3")
    notes: list[str] = []
    assert load_ros_map(path, notes=notes).shape == (1, 1)
    assert notes == ["unknown field floor is ignored"]
    assert read_ros_yaml(path).unknown_fields == ("floor",)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"resolution": "0"}, ["resolution", "positive", "not 0"]),
        ({"resolution": "-0.05"}, ["resolution", "positive", "-0.05"]),
        ({"resolution": ".nan"}, ["resolution", "finite", "nan"]),
        ({"resolution": "nan"}, ["resolution", "finite", "nan"]),
        ({"resolution": ".inf"}, ["resolution", "finite", "inf"]),
        ({"resolution": "fine"}, ["resolution", "number", "'fine'"]),
        ({"resolution": "true"}, ["resolution", "number", "True"]),
        ({"resolution": "[0.1]"}, ["resolution", "number", "[0.1]"]),
        ({"resolution": ""}, ["resolution", "number", "None"]),
        ({"resolution": None}, ["resolution", "missing"]),
        ({"image": None}, ["image", "missing"]),
        ({"image": ""}, ["image", "file name", "None"]),
        ({"image": "[a]"}, ["image", "file name", "['a']"]),
        ({"image": "other.pgm"}, ["image", "other.pgm", "no such file"]),
        ({"image": "."}, ["image", "not a file"]),
        ({"origin": None}, ["origin", "missing"]),
        ({"origin": "[0, 0]"}, ["origin", "three numbers", "[0, 0]"]),
        ({"origin": "[0, 0, 0, 0]"}, ["origin", "three numbers"]),
        ({"origin": "0"}, ["origin", "three numbers", "not 0"]),
        ({"origin": "[0, x, 0]"}, ["origin[1]", "finite number", "'x'"]),
        ({"origin": "[0, 0, .nan]"}, ["origin[2]", "finite number", "nan"]),
        ({"negate": "2"}, ["negate", "0 or 1", "2"]),
        ({"negate": "maybe"}, ["negate", "0 or 1", "'maybe'"]),
        ({"negate": None}, ["negate", "missing"]),
        ({"occupied_thresh": "0.1"}, ["free_thresh 0.196", "occupied_thresh 0.1"]),
        ({"occupied_thresh": "1.5"}, ["occupied_thresh", "[0, 1]", "1.5"]),
        ({"occupied_thresh": "65"}, ["occupied_thresh", "[0, 1]", "65"]),
        ({"free_thresh": "-0.1"}, ["free_thresh", "[0, 1]", "-0.1"]),
        ({"free_thresh": ".nan"}, ["free_thresh", "finite", "nan"]),
        ({"free_thresh": None}, ["free_thresh", "missing"]),
        ({"mode": "binary"}, ["mode", "trinary, scale, raw", "'binary'"]),
        ({"mode": "[raw]"}, ["mode", "trinary, scale, raw", "['raw']"]),
        ({"mdoe": "raw"}, ["mdoe", "mode"]),
        ({"resolution": None, "resolutoin": "0.05"}, ["resolutoin", "resolution"]),
    ],
)
def test_bad_fields_are_named_with_value_and_expectation(tmp_path, fields, words):
    path = write_map(tmp_path, [[0]], **fields)
    with pytest.raises(MapFormatError) as caught:
        load_ros_map(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert [word for word in words if word not in message] == []
    assert "\n" not in message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"image: map.pgm\nresolution: [0.05\n", [", line", "YAML"]),
        (b"image: map.pgm\n\tresolution: 1\n", [", line 2", "YAML"]),
        (b"- a\n- b\n", ["mapping", "list"]),
        (b"", ["mapping", "NoneType"]),
        (b"just text", ["mapping", "str"]),
        (b"image: a\nresolution: \xff\xfe\n", ["line 2", "0xff", "UTF-8"]),
        (b"image: \x00", ["YAML"]),
        (b"a: !!python/object:os.system 1", ["line 1", "YAML"]),
        (b"a: 2020-13-45", ["YAML"]),
    ],
)
def test_broken_yaml_is_named_with_its_line(tmp_path, content, words):
    path = tmp_path / "map.yaml"
    path.write_bytes(content)
    with pytest.raises(MapFormatError) as caught:
        load_ros_map(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert [word for word in words if word not in message] == []
    assert "\n" not in message


def test_a_broken_image_is_named_together_with_its_yaml(tmp_path):
    path = write_map(tmp_path, [[0]], content=b"P5\n4 4\n255\n\0\0\0")
    with pytest.raises(MapFormatError, match=r"map\.yaml: image: .*map\.pgm: truncated PGM.* 16 bytes.* 3"):
        load_ros_map(path)


PUBLISHED = {
    "nav2/testmap.yaml": ((10, 10), 0.1, SE2(2, 3, 1), (29, 71, 0)),
    "ros1_map_server_test/testmap.yaml": ((10, 10), 0.1, SE2(2, 3, 1), (29, 71, 0)),
    "nav2/TenByTen.yaml": ((10, 10), 1.0, SE2(0, 0, 0), None),
    "nav2/tb3_sandbox.yaml": ((384, 384), 0.05, SE2(-10, -10, 0), None),
    "turtlebot3/map.yaml": ((384, 384), 0.05, SE2(-10, -10, 0), None),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_maps(data_dir, name):
    """Sizes and places from the maps' documentation; counts published with the test maps."""
    shape, resolution, origin, counts = PUBLISHED[name]
    grid = load_ros_map(data_dir / "ros_maps" / name)
    assert (grid.shape, grid.resolution, grid.origin) == (shape, resolution, origin)
    found = tuple(int(np.sum(cells)) for cells in (grid.occupied, grid.free, grid.unknown))
    assert sum(found) == shape[0] * shape[1]
    assert counts is None or found == counts


@pytest.mark.parametrize("name", ["nav2/TenByTen.yaml", "nav2/tb3_sandbox.yaml", "turtlebot3/map.yaml"])
def test_published_pgm_maps_cell_by_cell(data_dir, name):
    """Oracle: the last bytes of the P5 file, compared with the thresholds of its YAML file (0.65, 0.196) in 8-bit greys."""
    path = data_dir / "ros_maps" / name
    grid = load_ros_map(path)
    raw = np.frombuffer(path.with_suffix(".pgm").read_bytes()[-grid.data.size :], np.uint8).reshape(grid.shape)[::-1]
    np.testing.assert_array_equal(grid.occupied, raw <= 89)  # 255 (1 - 0.65) = 89.25
    np.testing.assert_array_equal(grid.free, raw >= 206)  # 255 (1 - 0.196) = 205.02
    assert grid.unknown.any()


def test_the_published_test_map_is_the_same_as_pgm_png_and_bmp(data_dir):
    folder = data_dir / "ros_maps" / "nav2"
    grids = [load_map_image(folder / f"testmap.{ending}", 0.1).data for ending in ("pgm", "png", "bmp")]
    np.testing.assert_array_equal(grids[0], grids[1])
    np.testing.assert_array_equal(grids[0], grids[2])
    np.testing.assert_array_equal(grids[0], load_ros_map(data_dir / "ros_maps/ros1_map_server_test/testmap.yaml").data)
