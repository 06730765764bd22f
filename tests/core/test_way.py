"""Ways on maps of any size. Oracles: the shortest path of a disc (`robocar.core.geodesic`), and lengths by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robocar.core.way as module
from robocar.core import OCCUPIED, SE2, GridMap, OccupancyGrid
from robocar.core.geodesic import geodesic_path
from robocar.core.way import find_way, length_over, through


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 0.25))
def test_on_large_maps_the_way_is_at_most_8_percent_longer(seed: int, share: float) -> None:
    """The wave over lattice lines against the shortest path: 7/5 for a diagonal is 1 % short, octile ways up to 8.3 % long."""
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid(np.where(rng.random((40, 50)) < share, OCCUPIED, 0).astype(np.int8), 0.1, SE2(1.0, -2.0, 0.7))
    start, goal = grid.origin.transform(rng.uniform([0.5, 0.5], [4.5, 3.5], (2, 2)))
    shortest = geodesic_path(grid, grid.occupied, start, goal, 0.09)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "EXACT", 0)
        way = find_way(grid, grid.occupied, start, goal, 0.09)
    if shortest is not None:
        assert way is not None
        np.testing.assert_allclose(way.points[[0, -1]], [start, goal])
        # With a disc that may be half a diagonal narrower where there is no node in a gap, it may be shorter too.
        assert way.length < 1.085 * shortest.length + 0.6
        assert way.length > 0.5 * math.dist(start, goal)


def test_ways_around_walls_on_a_large_map() -> None:
    """700 x 700 cells with five walls that are open at alternating ends: 6 crossings of 34 m, by hand to a few metres."""
    data = np.zeros((700, 700), dtype=np.int8)
    for k in range(5):
        data[100 + 100 * k] = OCCUPIED
        data[100 + 100 * k, slice(690, 700) if k % 2 == 0 else slice(0, 10)] = 0
    grid = OccupancyGrid(data, 0.05)
    way = find_way(grid, grid.occupied, (0.3, 1.0), (0.3, 34.0), 0.09)
    assert way is not None
    assert 6 * 34.0 < way.length < 6 * 34.0 + 40.0
    data[100] = OCCUPIED
    assert find_way(OccupancyGrid(data, 0.05), data == OCCUPIED, (0.3, 1.0), (0.3, 34.0), 0.09) is None
    assert find_way(grid, grid.occupied, (0.3, 1.0), (99.0, 1.0), 0.09) is None


def test_the_length_over_cells() -> None:
    """A strip of cells from x = 1 to 2 is crossed straight (1 m) and at 45 degrees (sqrt 2); what is carried does not count."""
    grid = GridMap(np.zeros((40, 40), dtype=np.uint8), 0.1)
    marked = np.zeros((40, 40), dtype=bool)
    marked[:, 10:20] = True
    assert length_over(grid, marked, [(0.5, 1.0), (3.0, 1.0)]) == pytest.approx(1.0, abs=0.02)
    assert length_over(grid, marked, [(0.5, 0.5), (3.0, 3.0)]) == pytest.approx(math.sqrt(2.0), abs=0.02)
    assert length_over(grid, marked, [(0.5, 1.0), (3.0, 1.0), (0.5, 1.0)], [False, True, False]) == pytest.approx(1.0, abs=0.02)
    assert length_over(grid, marked, [(1.5, -9.0), (1.5, -5.0)]) == 0.0
    assert length_over(grid, marked, np.empty((0, 2))) == 0.0
    assert through(10.44, 21.7) == "path through unknown: 10.4 m of 21.7 m"
