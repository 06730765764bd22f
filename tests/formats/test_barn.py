"""BARN worlds. Oracles: the benchmark's own grids and lengths, points sampled in discs, composition of poses by hand."""

import gzip
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, MapFormatError, ParameterError
from robocar.formats import (
    BarnWorld,
    load_barn_cylinders,
    load_barn_grids,
    load_barn_index,
    load_barn_paths,
    load_barn_world,
    load_ros_map,
)

GROUND = "<model name='ground_plane'><link name='l'><collision name='c'><geometry><plane/></geometry></collision></link></model>"


def model(pose="1 2 0 0 0 0", geometry="<cylinder><radius>0.5</radius><length>1</length></cylinder>", link="", collision=""):
    return (
        f"<model name='thing'>{pose and f'<pose>{pose}</pose>'}<link name='l'>{link}"
        f"<collision name='c'>{collision}<geometry>{geometry}</geometry></collision></link></model>"
    )


def sdf(*models):
    return f"<?xml version='1.0'?>\n<sdf version='1.6'><world name='default'>{GROUND}{''.join(models)}</world></sdf>"


def test_poses_of_model_link_and_collision_are_composed(tmp_path):
    """By hand: 1 m ahead of a model at (1, 2) that looks along y, then 1 m to the left of that link, turned once more."""
    path = tmp_path / "a.world"
    link, collision = "<pose>1 0 5 0 0 1.5707963267948966</pose>", "<pose frame=''>0 1 0 0 0 0</pose>"
    path.write_text(sdf(model(), model("1 2 0 0 0 1.5707963267948966", link=link, collision=collision), model("")))
    np.testing.assert_allclose(load_barn_world(path).cylinders, [[1, 2, 0.5], [1, 2, 0.5], [0, 0, 0.5]], atol=1e-12)


def test_packed_and_plain_worlds_are_the_same(tmp_path):
    text = sdf(
        model(),
        "<include><uri>model://sun</uri></include>",
        "<state><model name='thing'><pose>9 9 0 0 0 0</pose></model></state>",
    )
    (tmp_path / "a.world").write_text(text)
    (tmp_path / "a.world.gz").write_bytes(gzip.compress(text.encode()))
    assert load_barn_world(tmp_path / "a.world").cylinders.tolist() == [[1, 2, 0.5]]
    assert load_barn_world(tmp_path / "a.world.gz").cylinders.tolist() == [[1, 2, 0.5]]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ["SDF", "XML"]),
        ("no xml", ["SDF", "XML"]),
        (sdf(model())[:-20], ["SDF", "XML"]),
        ("<robot/>", ["<sdf><world>", "<robot>"]),
        ("<sdf/>", ["<sdf><world>"]),
        (sdf(), ["no cylinder"]),
        (sdf(model("1 2 0")), ["'thing'", "pose", "6 finite numbers", "'1 2 0'"]),
        (sdf(model("1 x 0 0 0 0")), ["'thing'", "pose", "'1 x 0 0 0 0'"]),
        (sdf(model("1 nan 0 0 0 0")), ["'thing'", "pose", "finite"]),
        (sdf(model("1 2 0 0.5 0 0")), ["'thing'", "roll 0.5", "upright"]),
        (sdf(model(geometry="<box><size>1 1 1</size></box>")), ["'thing'", "cylinder", "box"]),
        (sdf(model(geometry="")), ["'thing'", "cylinder", "nothing"]),
        (sdf(model(geometry="<cylinder><length>1</length></cylinder>")), ["'thing'", "radius", "None"]),
        (sdf(model(geometry="<cylinder><radius>-1</radius></cylinder>")), ["'thing'", "radius", "positive", "-1"]),
        (sdf(model(link="<pose relative_to='other'>0 0 0 0 0 0</pose>")), ["'thing'", "'other'"]),
        (sdf("<include><uri>model://house</uri></include>"), ["model://house"]),
    ],
)
def test_broken_worlds_are_named_with_model_and_value(tmp_path, content, words):
    path = tmp_path / "a.world"
    path.write_text(content)
    with pytest.raises(MapFormatError) as caught:
        load_barn_world(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert [word for word in words if word not in message] == []


def test_truncated_gzip_is_refused(tmp_path):
    path = tmp_path / "a.world.gz"
    packed = gzip.compress(sdf(model()).encode())
    for length in (5, 20, len(packed) - 1):
        path.write_bytes(packed[:length])
        with pytest.raises(MapFormatError, match=r"a\.world\.gz: damaged or truncated gzip"):
            load_barn_world(path)


coordinates = st.floats(-3, 3)


@settings(deadline=None)
@given(st.lists(st.tuples(coordinates, coordinates, st.floats(0.05, 0.8)), min_size=1, max_size=5), st.floats(0.08, 0.5))
def test_cells_that_a_disc_covers_are_occupied_and_others_are_free(cylinders, resolution):
    """Sampled: points well inside a disc lie in occupied cells; an occupied cell is within half its diagonal of some disc."""
    world = BarnWorld(np.array(cylinders))
    grid = world.grid(resolution)
    centres, radii = world.cylinders[:, :2], world.cylinders[:, 2]
    angle, share = (a.ravel() for a in np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(0, 1, 12)))
    inside = np.maximum(radii - 0.01 * resolution, 0)
    points = centres[:, None] + (inside[:, None] * share)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cells = grid.cell_from_world(points).reshape(-1, 2)
    assert grid.contains(cells).all()
    assert grid.occupied[cells[:, 0], cells[:, 1]].all()
    middles = grid.world_from_cell(np.argwhere(grid.occupied))
    gap = np.linalg.norm(middles[:, None] - centres, axis=2) - radii
    assert gap.min(axis=1).max() < resolution * math.sqrt(0.5) + 1e-9
    assert (grid.free | grid.occupied).all()


def test_bounds_widen_the_grid_with_free_cells():
    grid = BarnWorld(np.array([[0.075, 0.075, 0.075]])).grid(bounds=(-0.3, 0.0, 0.15, 0.3))
    assert grid.origin == SE2(-0.3, 0, 0)
    assert grid.data.tolist() == [[0, 0, 100], [0, 0, 0]]


def test_grids_that_make_no_sense_are_refused():
    world = BarnWorld(np.array([[0.0, 0.0, 1.0], [1e6, 0.0, 1.0]]))
    with pytest.raises(MapFormatError, match="cells, at most"):
        world.grid()
    with pytest.raises(ParameterError, match="resolution"):
        world.grid(0.0)
    with pytest.raises(ValueError, match="bounds"):
        BarnWorld(np.empty((0, 3))).grid()
    with pytest.raises(ValueError, match="empty bounds"):
        world.grid(bounds=(0, 0, 0, 1))
    with pytest.raises(ValueError, match="radius"):
        BarnWorld(np.array([[0.0, 0.0, 0.0]]))


def test_cylinders_and_grids_of_all_published_worlds_agree(data_dir):
    """Rasterized cylinders are the benchmark's own grids, cell by cell and in place."""
    worlds = load_barn_cylinders(data_dir / "barn" / "barn_cylinders_test50.npz")
    grids = load_barn_grids(data_dir / "barn" / "barn_grids_test50.npz")
    index = load_barn_index(data_dir / "barn" / "index.csv")
    assert list(worlds) == list(grids) == list(index) == list(range(0, 300, 6))
    for number, world in worlds.items():
        assert len(world.cylinders) == index[number].cylinders
        grid = world.grid()
        assert grid.same_place(grids[number])
        np.testing.assert_array_equal(grid.data, grids[number].data)


def test_published_world_file_map_files_and_archives_agree(data_dir):
    folder = data_dir / "barn"
    grids = load_barn_grids(folder / "barn_grids_test50.npz")
    world = load_barn_world(folder / "world_0.world.gz")
    assert world.cylinders.shape == (209, 3)
    np.testing.assert_array_equal(world.grid().data, grids[0].data)
    for number in (0, 6):
        loaded = load_ros_map(folder / f"world_{number}.yaml")
        assert loaded.same_place(grids[number])
        np.testing.assert_array_equal(loaded.data, grids[number].data)


def test_published_paths_are_free_and_lie_in_the_obstacle_field(data_dir):
    folder = data_dir / "barn"
    paths, grids, index = (
        load_barn_paths(folder / "barn_paths_test50.npz"),
        load_barn_grids(folder / "barn_grids_test50.npz"),
        load_barn_index(folder / "index.csv"),
    )
    assert list(paths) == list(grids)
    for number, path in paths.items():
        cells = grids[number].cell_from_world(path)
        assert grids[number].free[cells[:, 0], cells[:, 1]].all()
        assert len(path) == index[number].path_points
        assert index[number].optimal_time == pytest.approx(index[number].path_length / 2, abs=1e-3)
        assert path[:, 1].min() == pytest.approx(5.175)


@pytest.mark.parametrize("load", [load_barn_cylinders, load_barn_grids, load_barn_paths])
def test_broken_archives(tmp_path, load):
    path = tmp_path / "a.npz"
    good = {"world_1": np.zeros((3, 4)), "index": np.arange(2), "grids": np.full((2, 3, 4), 7), "path_x": np.zeros(2)}
    np.savez(path, **good)
    whole = path.read_bytes()
    for content in (b"", b"no archive", whole[: len(whole) // 2], whole):
        path.write_bytes(content)
        with pytest.raises(MapFormatError) as caught:
            load(path)
        assert str(caught.value).startswith(f"{path}: ")
    np.savez(path, world_1=np.array([{}], dtype=object))
    with pytest.raises(MapFormatError, match=r"a\.npz: "):
        load(path)
    np.savez(path)
    with pytest.raises(MapFormatError, match=r"a\.npz: "):
        load(path)


HEADER = "world,n_cylinders,path_points,runpy_path_length_m,optimal_time_s_at_2mps,maximin_clearance_m\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["line 1", "column world is missing"]),
        ("world,n_cylinders\n", ["line 1", "path_points"]),
        (HEADER + "0,209,43,13.5,6.7\n", ["line 2", "maximin_clearance_m", "None"]),
        (HEADER + "0,209,43,long,6.7,0.4\n", ["line 2", "runpy_path_length_m", "'long'"]),
        (HEADER + "0.5,209,43,13.5,6.7,0.4\n", ["line 2", "world", "integer", "'0.5'"]),
    ],
)
def test_broken_index(tmp_path, text, words):
    path = tmp_path / "index.csv"
    path.write_text(text)
    with pytest.raises(MapFormatError) as caught:
        load_barn_index(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert [word for word in words if word not in message] == []
