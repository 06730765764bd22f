"""Oracles: reconstruction of grids and polygons from what is drawn, scipy's chi-square quantile, hand-made cases."""

import math

import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import chi2

from robocar.core import SE2, Costmap, GridMap, OccupancyGrid, Scan
from robocar.core.trace import Arrows, Circles, Field, Lines, Points, Scalar, Segments
from robocar.recording import drawing, palette

GRIDS = arrays(np.int8, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.sampled_from([-1, 0, 50, 100]))


@given(GRIDS)
def test_boxes_cover_each_occupied_cell_once(data):
    grid = OccupancyGrid(data, 0.1)
    covered = np.zeros(grid.shape, dtype=int)
    for row, col, rows, cols in drawing.occupied_boxes(grid):
        covered[row : row + rows, col : col + cols] += 1
    np.testing.assert_array_equal(covered, grid.occupied.astype(int))


def test_walls_stand_where_the_rotated_grid_has_them():
    """Every occupied cell's centre, seen from a box's own frame, lies in exactly one box."""
    rng = np.random.default_rng(3)
    grid = OccupancyGrid(np.where(rng.random((9, 7)) < 0.4, 100, 0), 0.2, SE2(1.0, -2.0, 0.7))
    boxes = drawing.walls(grid, 0.3)
    centres = boxes.centers.as_arrow_array().flatten().to_numpy().reshape(-1, 3)
    halves = boxes.half_sizes.as_arrow_array().flatten().to_numpy().reshape(-1, 3)
    cells = grid.world_from_cell(np.argwhere(grid.occupied))
    assert len(cells) > 5
    local = SE2(0.0, 0.0, -0.7).transform(cells[:, None] - centres[None, :, :2])
    inside = np.all(np.abs(local) < halves[None, :, :2], axis=2)
    np.testing.assert_array_equal(inside.sum(axis=1), 1)
    np.testing.assert_allclose(centres[:, 2] + halves[:, 2], 0.3, rtol=1e-6)
    np.testing.assert_allclose(4 * np.prod(halves[:, :2], axis=1).sum(), len(cells) * 0.04, rtol=1e-5)


def test_the_grid_is_flipped_once():
    """Rerun draws row 0 at the top, a grid's row 0 lies at the bottom: the bytes start with the grid's last row."""
    grid = GridMap(np.arange(6.0).reshape(2, 3), 0.5, SE2(1.0, 2.0, 0.0))
    colors = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    drawn = drawing.grid_image(grid, colors, 0.0)
    pixels = drawn.data.as_arrow_array().flatten().to_numpy()
    np.testing.assert_array_equal(pixels.reshape(2, 3, 4), colors[::-1])


@given(st.floats(0.01, 2.0), st.floats(0.01, 2.0), st.floats(-3, 3))
def test_the_ellipse_is_the_95_percent_contour(a, b, angle):
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    covariance = turn @ np.diag([a * a, b * b]) @ turn.T
    position = np.array([3.0, -1.0])
    rim = drawing.covariance_ellipses(position[None], covariance[None])[:, :2].astype(float) - position
    squared = np.einsum("ni,ij,nj->n", rim, np.linalg.inv(covariance), rim)
    np.testing.assert_allclose(squared, chi2.ppf(0.95, df=2), rtol=2e-3)


def test_an_ellipse_of_a_certain_position_is_a_point():
    rim = drawing.covariance_ellipses(np.array([[1.0, 2.0]]), np.zeros((1, 2, 2)))
    np.testing.assert_allclose(rim[:, :2], np.tile([1.0, 2.0], (drawing.ELLIPSE_CORNERS, 1)))


def test_laser_hits_leave_out_what_was_not_heard():
    scan = Scan(0.0, np.array([1.0, np.inf, 2.0, np.nan]), np.array([0.0, 0.1, np.pi / 2, 0.2]), 5.0)
    np.testing.assert_allclose(drawing.laser_hits(scan, 10)[:, :2], [[1.0, 0.0], [0.0, 2.0]], atol=1e-6)
    assert len(drawing.laser_hits(Scan(0.0, np.ones(570), np.linspace(-1, 1, 570), 5.0), 200)) == 190


def test_colours_of_a_heat_map_run_from_low_to_high_and_hide_what_is_not_a_number():
    colors = palette.viridis(np.array([[0.0, 5.0, 10.0, np.nan, np.inf]]))[0]
    assert colors[:, 3].tolist() == [255, 255, 255, 0, 0]
    np.testing.assert_array_equal(colors[0, :3], [68, 1, 84])
    np.testing.assert_array_equal(colors[2, :3], [253, 231, 37])


@pytest.mark.parametrize("values", [np.full((2, 2), 7.0), np.full((2, 2), np.nan)])
def test_colours_of_a_constant_or_empty_field_are_finite(values):
    assert palette.viridis(values).shape == (2, 2, 4)
    assert (palette.viridis(values)[..., 3] == np.where(np.isfinite(values), 255, 0)).all()


def test_overlays_hide_nothing_that_the_robot_does_not_know():
    unknown = palette.grid_colors(OccupancyGrid(np.array([[-1, 100]]), 0.1))
    assert unknown[0, 0, 3] == 0
    assert unknown[0, 1, 3] > 200
    costs = palette.grid_colors(Costmap(np.array([[0, 100, 254]]), 0.1))
    assert costs[0, 0, 3] == 0
    assert costs[0, 1, 3] < costs[0, 2, 3]


XY = np.array([[0.0, 0.0], [1.0, 1.0]])
XYZ = np.array([[0.0, 0.0, 0.012], [1.0, 1.0, 0.012]])
RAMP = np.array([[68, 1, 84, 255], [253, 231, 37, 255]], dtype=np.uint8)  # the ends of viridis
PICTURES = {
    "points": (
        Points(XY, values=np.array([1.0, 2.0]), radius=0.5, labels=("a", "b")),
        rr.Points3D(XYZ, colors=RAMP, radii=1.0, labels=["a", "b"]),
    ),
    "one point": (Points(XY[:1], color=(1, 2, 3)), rr.Points3D(XYZ[:1], colors=[(1, 2, 3)], radii=0.04)),
    "lines": (
        Lines((XY, XY[:1]), values=np.array([1.0, 2.0])),
        rr.LineStrips3D([XYZ, XYZ[:1]], colors=RAMP, radii=0.01),
    ),
    "segments": (Segments(XY[None], color=(9, 8, 7)), rr.LineStrips3D([XYZ], colors=[(9, 8, 7)], radii=0.006)),
    "arrows": (
        Arrows(XY, XY, radius=0.1),
        rr.Arrows3D(origins=XYZ, vectors=XYZ * [1, 1, 0], colors=[(255, 60, 60)], radii=0.2),
    ),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_drawable_becomes_what_its_archetype_gives(name):
    """Oracle: Rerun's own archetypes, whose Arrow arrays are the format."""
    item, archetype = PICTURES[name]
    expected = {b.component_descriptor(): b.as_arrow_array() for b in archetype.as_component_batches()}
    drawn = drawing.drawable(item, scale=2.0)
    assert drawn == {descriptor: values for descriptor, values in expected.items() if values is not None}
    assert drawing.drawable_bytes(item) > 0


def test_circles_lie_around_their_centres_in_the_picture():
    """Oracle: every corner is one radius from its centre, and the ring is closed."""
    seen = Circles(np.array([[80.0, 60.0], [3.0, 4.0]]), np.array([10.0, 2.5]), ((255, 0, 0), (0, 0, 255)), ("red", "blue"))
    drawn = {str(descriptor).split(":")[1]: values.to_pylist() for descriptor, values in drawing.drawable(seen).items()}
    for ring, center, radius in zip(drawn["strips"], seen.centers, seen.radii, strict=True):
        np.testing.assert_allclose(np.linalg.norm(np.array(ring) - center, axis=1), radius, rtol=1e-5)
        np.testing.assert_allclose(ring[0], ring[-1], atol=1e-4)
    assert drawn["labels"] == ["red", "blue"]
    assert drawn["colors"] == [0xFF0000FF, 0x0000FFFF]


def test_particles_are_coloured_by_weight_where_weights_differ():
    """Oracle: viridis from the lightest (dark violet) to the heaviest (yellow)."""

    def colors(weights: list[float]) -> list[int]:
        cloud = np.column_stack([np.zeros((3, 3)), weights])
        return drawing.components(drawing.particles(cloud, 200))[rr.Arrows3D.descriptor_colors()].to_pylist()

    assert colors([0.1, 0.3, 0.6])[::2] == [0x440154FF, 0xFDE725FF]
    assert colors([1 / 3, 1 / 3, 1 / 3]) == [palette.rgba32(palette.PARTICLES)]


def test_a_field_becomes_a_grid_and_a_number_nothing():
    field = Field(GridMap(np.eye(16), 0.1))
    assert {str(descriptor).partition(":")[0] for descriptor in drawing.drawable(field)} == {"GridMap"}
    assert drawing.drawable_bytes(field) > 0
    with pytest.raises(TypeError, match="Scalar"):
        drawing.drawable(Scalar(1.0))


@pytest.mark.parametrize(
    "item", [Points(np.empty((0, 2))), Lines(()), Segments(np.empty((0, 2, 2))), Arrows(np.empty((0, 2)), np.empty((0, 2)))]
)
def test_empty_drawables_clear_the_picture(item):
    drawn = drawing.drawable(item).items()
    shapes = [values for descriptor, values in drawn if str(descriptor).split(":")[1] in ("positions", "strips", "vectors")]
    assert [len(values) for values in shapes] == [0]
