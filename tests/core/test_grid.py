"""Cells and metres, on shifted and rotated grids, with cells outside."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import SE2, Costmap, GridMap, OccupancyGrid, OutsideMap

origins = st.builds(SE2, st.floats(-50, 50), st.floats(-50, 50), st.floats(-4, 4))
cells = st.tuples(st.integers(-300, 300), st.integers(-300, 300))


@given(origins, st.floats(0.01, 2), cells)
def test_the_centre_of_a_cell_lies_in_the_cell(origin: SE2, resolution: float, cell: tuple[int, int]) -> None:
    """Oracle: round trip, with negative cells."""
    grid = GridMap(np.zeros((4, 7)), resolution, origin)
    centre = grid.world_from_cell(cell)
    np.testing.assert_array_equal(grid.cell_from_world(centre), cell)
    np.testing.assert_allclose(grid.grid_from_world(centre), [cell[1] + 0.5, cell[0] + 0.5], atol=1e-6)


@given(origins, st.floats(0.01, 2), cells, st.floats(-0.49, 0.49), st.floats(-0.49, 0.49))
def test_any_point_within_the_cell_maps_to_it(
    origin: SE2, resolution: float, cell: tuple[int, int], du: float, dv: float
) -> None:
    """Oracle: property; the offset is made along the axes of the grid, with cosines of its own."""
    grid = GridMap(np.zeros((4, 7)), resolution, origin)
    c, s = math.cos(origin.theta), math.sin(origin.theta)
    offset = resolution * np.array([c * du - s * dv, s * du + c * dv])
    np.testing.assert_array_equal(grid.cell_from_world(grid.world_from_cell(cell) + offset), cell)


def test_conversions_by_hand() -> None:
    """Oracle: drawn on paper. Origin (1, 2) turned left: the grid's x runs up, its y to the left."""
    plain = GridMap(np.zeros((3, 4)), 0.5, SE2(-1, -2))
    np.testing.assert_allclose(plain.world_from_cell([[0, 0], [2, 3], [-1, -1]]), [[-0.75, -1.75], [0.75, -0.75], [-1.25, -2.25]])
    np.testing.assert_array_equal(plain.cell_from_world([[-1, -2], [-1.01, -2.01], [0.99, -0.51]]), [[0, 0], [-1, -1], [2, 3]])
    turned = GridMap(np.zeros((3, 4)), 0.5, SE2(1, 2, math.pi / 2))
    np.testing.assert_allclose(turned.world_from_cell([0, 3]), [0.75, 3.75])
    np.testing.assert_array_equal(turned.cell_from_world([-0.4, 2.1]), [2, 0])
    np.testing.assert_allclose(turned.corners(), [[1, 2], [1, 4], [-0.5, 4], [-0.5, 2]], atol=1e-12)
    assert plain.size == (2.0, 1.5)
    assert plain.shape == (3, 4)


def test_inside_and_outside() -> None:
    grid = GridMap(np.zeros((3, 4)), 0.5, SE2(-1, -2))
    np.testing.assert_array_equal(grid.contains([[0, 0], [2, 3], [3, 0], [0, 4], [-1, 0], [0, -1]]), [1, 1, 0, 0, 0, 0])
    assert grid.cell_inside([0.9, -0.6]) == (2, 3)
    with pytest.raises(OutsideMap, match=r"goal \(1\.100, 0\.000\) .* x -1\.000 to 1\.000, y -2\.000 to -0\.500"):
        grid.cell_inside([1.1, 0], "goal")


@pytest.mark.parametrize("data", [np.zeros(3), np.zeros((0, 4)), np.zeros((2, 2, 2))])
def test_a_grid_has_rows_and_columns(data: np.ndarray) -> None:
    with pytest.raises(ValueError, match="rows and columns"):
        GridMap(data, 1.0)


@pytest.mark.parametrize("resolution", [0, -1, math.nan, math.inf])
def test_a_resolution_is_positive(resolution: float) -> None:
    with pytest.raises(ValueError, match="resolution"):
        GridMap(np.zeros((2, 2)), resolution)


def test_grids_are_read_only_and_know_their_place() -> None:
    source = np.zeros((2, 3))
    grid = GridMap(source, 0.1, SE2(1, 2, 3))
    source[0, 0] = 5
    assert grid.data[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        grid.data[0, 0] = 1
    other = grid.with_data(np.ones((2, 3), dtype=np.int8))
    assert other.same_place(grid)
    assert other.data.dtype == np.int8
    assert not grid.same_place(GridMap(source, 0.1, SE2(1, 2, 2)))
    assert not grid.same_place(GridMap(source, 0.2, SE2(1, 2, 3)))
    with pytest.raises(ValueError, match="shape"):
        grid.with_data(np.zeros((3, 2)))


def test_occupancy_classes() -> None:
    """Oracle: Nav2's rule, 65 % counts as an obstacle."""
    grid = OccupancyGrid(np.array([[-1, 0, 64, 65, 100]]), 1.0)
    assert grid.data.dtype == np.int8
    np.testing.assert_array_equal(grid.occupied, [[0, 0, 0, 1, 1]])
    np.testing.assert_array_equal(grid.free, [[0, 1, 1, 0, 0]])
    np.testing.assert_array_equal(grid.unknown, [[1, 0, 0, 0, 0]])


@pytest.mark.parametrize("bad", [np.array([[-2]]), np.array([[101]]), np.array([[np.nan]]), np.array([[101]], dtype=np.int8)])
def test_occupancy_out_of_range(bad: np.ndarray) -> None:
    with pytest.raises(ValueError, match="occupancy"):
        OccupancyGrid(bad, 1.0)


def test_costs() -> None:
    """Oracle: Nav2's costs: 253 inscribed, 254 lethal and 255 unknown must not hold the centre."""
    costmap = Costmap(np.array([[0, 252, 253, 254, 255]]), 1.0)
    assert costmap.data.dtype == np.uint8
    np.testing.assert_array_equal(costmap.blocked, [[0, 0, 1, 1, 1]])


@pytest.mark.parametrize("bad", [-1, 256, math.nan])
def test_costs_out_of_range(bad: float) -> None:
    with pytest.raises(ValueError, match="costs"):
        Costmap(np.array([[bad]]), 1.0)
