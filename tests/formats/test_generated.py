"""Generated maps: what they promise, checked by scipy's labelling and by counting."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from robocar.core import SE2, ParameterError
from robocar.formats.generated import cave, maze, rooms

seeds = st.integers(0, 2**32 - 1)


def assert_closed_and_connected(grid) -> None:
    assert set(np.unique(grid.data)) == {0, 100}
    occupied = grid.occupied
    assert occupied[[0, -1], :].all()
    assert occupied[:, [0, -1]].all()
    assert ndimage.label(grid.free)[1] == 1  # 4-connected by default


@settings(max_examples=60, deadline=None)
@given(rows=st.integers(8, 60), cols=st.integers(8, 60), density=st.floats(0.01, 0.59), rounds=st.integers(0, 6), seed=seeds)
def test_caves_are_closed_and_connected(rows: int, cols: int, density: float, rounds: int, seed: int) -> None:
    grid = cave(rows, cols, np.random.default_rng(seed), density=density, rounds=rounds)
    assert grid.shape == (rows, cols)
    assert_closed_and_connected(grid)


@settings(max_examples=60, deadline=None)
@given(data=st.data(), corridor=st.integers(1, 6), seed=seeds)
def test_mazes_are_closed_connected_and_as_wide_as_asked(data: st.DataObject, corridor: int, seed: int) -> None:
    rows = data.draw(st.integers(corridor + 2, 50))
    cols = data.draw(st.integers(corridor + 2, 50))
    grid = maze(rows, cols, corridor, np.random.default_rng(seed))
    assert grid.shape == (rows, cols)
    assert_closed_and_connected(grid)
    opened = ndimage.binary_opening(grid.free, np.ones((corridor, corridor)))
    np.testing.assert_array_equal(opened, grid.free)


@pytest.mark.parametrize("corridor", [1, 4])
def test_a_maze_is_a_tree_of_rooms(corridor: int) -> None:
    """n rooms joined by n - 1 passages: nothing else is free."""
    n = 12 * 9
    grid = maze(12 * (corridor + 1) + 1, 9 * (corridor + 1) + 1, corridor, np.random.default_rng(5))
    assert grid.free.sum() == n * corridor**2 + (n - 1) * corridor


@settings(max_examples=60, deadline=None)
@given(rows=st.integers(14, 90), cols=st.integers(14, 90), seed=seeds)
def test_rooms_are_closed_and_connected_by_doors(rows: int, cols: int, seed: int) -> None:
    grid = rooms(rows, cols, np.random.default_rng(seed))
    assert grid.shape == (rows, cols)
    assert_closed_and_connected(grid)


def test_every_door_is_as_wide_as_asked() -> None:
    """A square as wide as the doors gets everywhere."""
    grid = rooms(150, 200, np.random.default_rng(2), smallest=20, door=7)
    fits = ndimage.binary_erosion(grid.free, np.ones((7, 7)))
    assert ndimage.label(fits)[1] == 1
    rooms_found = ndimage.label(ndimage.binary_erosion(grid.free, np.ones((9, 9))))[1]
    assert rooms_found > 10  # a square wider than the doors stays in its room


@pytest.mark.parametrize(
    "make", [lambda rng: cave(40, 50, rng), lambda rng: maze(40, 50, 3, rng), lambda rng: rooms(40, 50, rng)]
)
def test_the_seed_decides(make) -> None:
    a, b, c = (make(np.random.default_rng(seed)).data for seed in (7, 7, 8))
    np.testing.assert_array_equal(a, b)
    assert np.any(a != c)


def test_resolution_and_origin_are_kept() -> None:
    origin = SE2(1.0, -2.0, 0.3)
    for grid in (
        cave(20, 20, np.random.default_rng(0), resolution=0.1, origin=origin),
        maze(20, 20, 2, np.random.default_rng(0), resolution=0.1, origin=origin),
        rooms(20, 20, np.random.default_rng(0), resolution=0.1, origin=origin),
    ):
        assert grid.resolution == 0.1
        assert grid.origin == origin


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda rng: cave(7, 20, rng), "rows is 7"),
        (lambda rng: cave(20, 0, rng), "cols is 0"),
        (lambda rng: cave(20, 20, rng, density=0.6), "density 0.6"),
        (lambda rng: cave(20, 20, rng, density=float("nan")), "density nan"),
        (lambda rng: cave(20, 20, rng, rounds=-1), "rounds -1"),
        (lambda rng: maze(20, 20, 0, rng), "corridor is 0"),
        (lambda rng: maze(4, 20, 3, rng), "rows is 4"),
        (lambda rng: rooms(13, 20, rng), "rows is 13"),
        (lambda rng: rooms(40, 40, rng, door=12), "smallest is 12"),
    ],
)
def test_sizes_that_hold_no_map_are_refused(call, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        call(np.random.default_rng(0))
