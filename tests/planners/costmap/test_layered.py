"""Inflation and the obstacle layer."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import FREE, INSCRIBED, LETHAL, NO_INFORMATION, OCCUPIED, SE2, UNKNOWN, Observation, OccupancyGrid, Scan
from robocar.core.rays import cast_rays
from robocar.planners.costmap.layered import CostmapParameters, LayeredCostmap, inflate
from tests.planners.kinematic import BEAM, car

OPEN = CostmapParameters(walled=False)


def grid_of(seed: int, rows: int, cols: int, resolution: float, unknown: bool = False) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    values = rng.choice(
        [FREE, OCCUPIED, UNKNOWN] if unknown else [FREE, OCCUPIED], (rows, cols), p=[0.85, 0.1, 0.05] if unknown else [0.9, 0.1]
    )
    return OccupancyGrid(values.astype(np.int8), resolution, SE2(0.5, -1.0, 0.4))


def square_distance(grid: OccupancyGrid, solid: np.ndarray) -> np.ndarray:
    """Brute force: from every cell's centre to the nearest point of every solid square, (rows, cols) [m]."""
    rows, cols = np.indices(grid.shape)
    distance = np.full(grid.shape, math.inf)
    for r, c in np.argwhere(solid):
        gap = np.maximum(np.abs(rows - r) - 0.5, 0), np.maximum(np.abs(cols - c) - 0.5, 0)
        distance = np.minimum(distance, np.hypot(*gap) * grid.resolution)
    return distance


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 25), st.integers(1, 25)),
    resolution=st.sampled_from([0.03, 0.05, 0.1, 0.3]),
    radius=st.floats(0.05, 0.3),
    scaling=st.floats(0.5, 20.0),
    reach=st.floats(0.0, 0.6),
    walled=st.booleans(),
)
def test_inflation_follows_the_distance_to_the_squares(
    seed: int, shape: tuple[int, int], resolution: float, radius: float, scaling: float, reach: float, walled: bool
) -> None:
    """Oracle: brute-force distances and Nav2's formula; a walled map is one with a frame of obstacles around it."""
    grid = grid_of(seed, *shape, resolution)
    parameters = CostmapParameters(inflation_radius=reach, cost_scaling_factor=scaling, margin=0.02, walled=walled)
    found = inflate(grid, radius, parameters).data
    framed = OccupancyGrid(np.pad(grid.data, 1, constant_values=OCCUPIED if walled else FREE), resolution)
    d = square_distance(framed, framed.occupied)[1:-1, 1:-1]
    expected = np.where(d <= reach, np.floor(252 * np.exp(-scaling * np.maximum(d - radius - 0.02, 0))), 0)
    expected[d <= radius] = INSCRIBED
    expected[grid.occupied] = LETHAL
    sharp = np.abs(d - radius) > 1e-6  # where rounding decides, both answers are right
    sharp &= np.abs(d - reach) > 1e-6
    np.testing.assert_allclose(found[sharp], expected[sharp], atol=1)
    assert np.array_equal(found >= INSCRIBED, expected >= INSCRIBED) or not sharp.all()


def test_unknown_cells_are_free_or_obstacles() -> None:
    """By hand: a row of 5 with its first cell unknown, robot radius 0.12 m on cells of 0.1 m: one neighbour is too near, 0.05
    m."""
    grid = OccupancyGrid(np.array([[UNKNOWN, 0, 0, 0, 0]]), 0.1)
    allowed = CostmapParameters(walled=False, inflation_radius=0.0)
    np.testing.assert_array_equal(inflate(grid, 0.12, allowed).data, [[0, 0, 0, 0, 0]])
    forbidden = CostmapParameters(walled=False, inflation_radius=0.0, allow_unknown=False)
    np.testing.assert_array_equal(inflate(grid, 0.12, forbidden).data, [[NO_INFORMATION, INSCRIBED, 0, 0, 0]])


@pytest.mark.parametrize("name", ["cost_scaling_factor", "resolution", "obstacle_max_range"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_wrong_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        CostmapParameters(**{name: value})


def test_coarse_maps_are_split_about_their_cells_centres() -> None:
    """By hand: 0.3 m cells become 7 x 7 cells of 0.043 m, odd, so that a corridor one cell wide keeps a cell on its middle."""
    grid = OccupancyGrid(np.array([[OCCUPIED, 0, OCCUPIED]]), 0.3)
    costmap = LayeredCostmap(grid, car(), OPEN).costmap()
    assert costmap.shape == (7, 21)
    assert costmap.resolution == pytest.approx(0.3 / 7)
    np.testing.assert_allclose(costmap.world_from_cell((3, 10)), [0.45, 0.15])
    assert not costmap.blocked[3, 10]
    assert costmap.blocked[:, :7].all()


def laser(ranges: np.ndarray, bearings: np.ndarray) -> Observation:
    return Observation(0.0, lidar=Scan(0.0, ranges, bearings, 6.0))


def sonar(reading: float, bearing: float = 0.0) -> Observation:
    return Observation(0.0, sonars=(Scan(0.0, np.array([reading]), np.array([bearing]), 4.0, BEAM),))


def lethal_points(layer: LayeredCostmap) -> np.ndarray:
    """World centres of the lethal cells, (n, 2) [m]."""
    costmap = layer.costmap()
    return costmap.world_from_cell(np.argwhere(costmap.data == LETHAL))


EMPTY = OccupancyGrid(np.zeros((80, 100), dtype=np.int8), 0.05, SE2(-1.0, -2.0))


def test_a_laser_hit_marks_its_cell_and_a_look_through_it_clears_it() -> None:
    """By hand: a hit 1 m ahead; three looks through after two hits forget it (evidence 4, threshold 2)."""
    layer = LayeredCostmap(EMPTY, car(), OPEN)
    bearing = np.array([0.0])
    assert layer.update(SE2(0.0, 0.02, 0.0), laser(np.array([1.02]), bearing))
    np.testing.assert_allclose(lethal_points(layer), [[1.025, 0.025]])
    assert not layer.update(SE2(0.0, 0.02, 0.0), laser(np.array([1.02]), bearing))
    seen = [layer.update(SE2(0.0, 0.02, 0.0), laser(np.array([math.inf]), bearing)) for _ in range(4)]
    assert seen == [False, False, True, False]
    assert len(lethal_points(layer)) == 0


def test_dropped_and_far_readings_mark_nothing() -> None:
    layer = LayeredCostmap(EMPTY, car(), OPEN)
    assert not layer.update(SE2(), laser(np.array([math.nan, 2.9]), np.array([0.0, 0.3])))
    assert not layer.update(SE2(), sonar(1.5))
    assert not layer.update(SE2(), sonar(math.nan))
    assert len(lethal_points(layer)) == 0


def test_a_sonar_marks_the_inner_part_of_its_arc() -> None:
    """Analytic: every marked cell touches the arc of radius 0.8 m within 0.6 of the cone, and the arc's middle is marked."""
    layer = LayeredCostmap(EMPTY, car(), replace(OPEN, sonar_shadow=0.0))
    assert layer.update(SE2(0.0, 0.0, 0.5), sonar(0.8))
    points = lethal_points(layer)
    assert np.all(np.abs(np.hypot(*points.T) - 0.8) <= 0.05 / math.sqrt(2))
    assert np.all(np.abs(np.arctan2(points[:, 1], points[:, 0]) - 0.5) <= 0.6 * BEAM / 2 + 0.05)
    middle = np.array([0.8 * math.cos(0.5), 0.8 * math.sin(0.5)])
    assert np.linalg.norm(points - middle, axis=1).min() <= 0.05


def test_what_answers_a_sonar_is_taken_to_be_deep_until_an_echo_comes_from_beyond() -> None:
    """Analytic: the marked cells are those that the sector from 0.8 to 1.1 m holds; an echo from 1.6 m clears up to 1.12 m."""
    layer = LayeredCostmap(EMPTY, car(), replace(OPEN, sonar_shadow=0.3))
    assert layer.update(SE2(0.0, 0.0, 0.5), sonar(0.8))
    points = lethal_points(layer)
    ranges, angles = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0]) - 0.5
    slack = 0.05 / math.sqrt(2)
    assert np.all((ranges >= 0.8 - slack) & (ranges <= 1.1 + slack))
    assert np.all(np.abs(angles) <= 0.6 * BEAM / 2 + slack / ranges)
    inside = EMPTY.world_from_cell(np.argwhere(np.ones(EMPTY.shape, dtype=bool)))
    depth, aside = np.hypot(*inside.T), np.abs(np.arctan2(inside[:, 1], inside[:, 0]) - 0.5)
    for point in inside[(depth > 0.8 + slack) & (depth < 1.1 - slack) & (aside * depth < 0.6 * BEAM / 2 * depth - slack)]:
        assert np.linalg.norm(points - point, axis=1).min() < 1e-9
    for _ in range(2):
        layer.update(SE2(0.0, 0.0, 0.5), sonar(1.6))
    left = lethal_points(layer)
    middle = np.abs(np.arctan2(left[:, 1], left[:, 0]) - 0.5) < 0.4 * BEAM / 2
    assert not np.any(middle & (np.hypot(*left.T) < 1.05))


def test_silence_of_a_sonar_clears_nothing_and_an_echo_only_well_short_of_its_range() -> None:
    """Scan's contract: inf may be an echo lost at grazing incidence. Depth 0.7 of the range: 0.8 m is cleared by 1.3 m, not by
    1.0 m."""
    layer = LayeredCostmap(EMPTY, car(), OPEN)
    layer.update(SE2(), sonar(0.8))
    marked = len(lethal_points(layer))
    for reading in (math.inf, 1.0):
        for _ in range(5):
            layer.update(SE2(), sonar(reading))
        assert len(lethal_points(layer)) == marked
    for _ in range(5):
        layer.update(SE2(), sonar(1.3))
    assert np.count_nonzero(np.hypot(*lethal_points(layer).T) < 0.85) < marked


def test_an_echo_that_the_prior_explains_marks_nothing_new() -> None:
    """A wall of the prior 1 m ahead: heard at 0.95 m (noise) it explains the echo, at 0.6 m something else stands there."""
    data = np.zeros((80, 100), dtype=np.int8)
    data[:, 60:62] = OCCUPIED  # x = 2.0 to 2.1
    layer = LayeredCostmap(OccupancyGrid(data, 0.05, SE2(-1.0, -2.0)), car(), OPEN)
    before = len(lethal_points(layer))
    assert not layer.update(SE2(1.05, 0.0, 0.0), sonar(0.93))
    assert not layer.update(SE2(1.05, 0.0, 0.0), laser(np.array([0.93, 1.0]), np.array([0.0, 0.1])))
    assert layer.update(SE2(1.05, 0.0, 0.0), sonar(0.6))
    assert len(lethal_points(layer)) > before


def test_obstacles_of_the_prior_are_never_cleared() -> None:
    data = np.zeros((80, 100), dtype=np.int8)
    data[:, 60:62] = OCCUPIED
    layer = LayeredCostmap(OccupancyGrid(data, 0.05, SE2(-1.0, -2.0)), car(), OPEN)
    before = layer.costmap().data.copy()
    for _ in range(6):
        layer.update(SE2(1.0, 0.0, 0.0), laser(np.full(50, math.inf), np.linspace(-1, 1, 50)))
    np.testing.assert_array_equal(layer.costmap().data, before)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_local_inflation_equals_inflating_everything(seed: int) -> None:
    """Oracle: `inflate` on the occupancy that the layer shows, after random laser and sonar readings from random poses."""
    rng = np.random.default_rng(seed)
    prior = OccupancyGrid(np.where(rng.random((50, 60)) < 0.02, OCCUPIED, FREE), 0.05, SE2(1.0, 2.0, 0.3))
    parameters = CostmapParameters(walled=bool(rng.integers(2)))
    robot = car()
    layer = LayeredCostmap(prior, robot, parameters)
    for _ in range(12):
        at = prior.origin.transform(rng.uniform(0.3, 2.2, 2))
        pose = SE2(at[0], at[1], rng.uniform(-3, 3))
        layer.update(pose, laser(rng.uniform(0.1, 2.0, 30), rng.uniform(-1.5, 1.5, 30)))
        layer.update(pose, sonar(rng.uniform(0.1, 1.2), rng.uniform(-0.5, 0.5)))
    costmap = layer.costmap()
    shown = OccupancyGrid(np.where(costmap.data == LETHAL, OCCUPIED, FREE), 0.05, prior.origin)
    assert np.count_nonzero(shown.occupied & ~prior.occupied) > 0
    np.testing.assert_array_equal(inflate(shown, robot.footprint.inscribed_radius, parameters).data, costmap.data)


def test_the_costmap_is_the_same_object_until_costs_change() -> None:
    layer = LayeredCostmap(EMPTY, car(), OPEN)
    first, version = layer.costmap(), layer.version
    layer.update(SE2(), sonar(math.inf))
    assert layer.costmap() is first
    assert layer.version == version
    layer.update(SE2(), sonar(0.5))
    assert layer.costmap() is not first
    assert layer.version > version
    assert (first.data == 0).all()


def test_where_the_robot_stands_nothing_else_is() -> None:
    """Marks inside the inscribed radius go, so that the robot is not walled in by its own error."""
    layer = LayeredCostmap(EMPTY, car(), OPEN)
    layer.update(SE2(), laser(np.array([0.5]), np.array([0.0])))
    assert len(lethal_points(layer)) == 1
    layer.update(SE2(0.52, 0.0, 0.0), laser(np.array([math.nan]), np.array([0.0])))
    assert len(lethal_points(layer)) == 0


def test_without_a_prior_the_grid_covers_what_it_must_and_grows_with_the_way() -> None:
    """Property: start, goal and robot always have half the room around them; what was seen keeps its place in the world."""
    layer = LayeredCostmap(None, car(), CostmapParameters(free_space=2.0))
    with pytest.raises(ValueError, match="cover"):
        layer.costmap()
    layer.cover([(0.0, 0.0), (3.0, 1.0)])
    assert (layer.costmap().data == 0).all()
    assert layer.costmap().size == pytest.approx((7.0, 5.0))
    layer.update(SE2(0.0, 0.02, 0.0), laser(np.array([1.02]), np.array([0.0])))
    marked = lethal_points(layer)
    assert marked.shape == (1, 2)
    first = layer.costmap()
    for position in ([-4.0, -3.0], [6.0, 5.0], [20.0, 0.3]):
        layer.update(SE2(*position, 0.0), Observation(0.0))
        corners = [np.add(position, offset) for offset in ([-0.99, -0.99], [0.99, 0.99])]
        assert layer.costmap().contains(layer.costmap().cell_from_world(corners)).all()
        np.testing.assert_allclose(lethal_points(layer), marked, atol=1e-9)
    assert not layer.costmap().same_place(first)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), width=st.sampled_from([0.0, 0.3]))
def test_readings_that_no_surface_gives_change_nothing(seed: int, width: float) -> None:
    """Property: below zero (noise at a surface that is touched) or not a number, a reading says nothing."""
    rng = np.random.default_rng(seed)
    layer = LayeredCostmap(EMPTY, car(), OPEN)
    layer.update(SE2(), laser(np.array([0.5]), np.array([0.0])))
    before = layer.costmap()
    for _ in range(20):
        ranges = np.where(rng.random(9) < 0.2, np.nan, -rng.uniform(1e-6, 0.1, 9))
        pose = SE2(*rng.uniform(-0.3, 0.0, 2), rng.uniform(-3.0, 3.0))
        layer.update(pose, Observation(0.0, sonars=(Scan(0.0, ranges, rng.uniform(-3.0, 3.0, 9), 6.0, width),)))
    assert layer.costmap() is before


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_wall_seen_along_does_not_crumble(seed: int) -> None:
    """Oracle: the world. Along a wall one cell thick, seen with 2 cm of noise, no column of the wall is ever without a mark."""
    data = np.zeros((60, 120), dtype=np.int8)
    data[30] = OCCUPIED
    world = OccupancyGrid(data, 0.05, SE2(-1.0, -2.0))
    layer, rng = LayeredCostmap(None, car(), CostmapParameters(walled=False)), np.random.default_rng(seed)
    layer.cover(world.corners())
    bearings = np.radians(np.arange(0.0, 360.0, 1.0))
    gaps = []
    for k in range(60):
        pose = SE2(0.5 + 0.05 * k, -0.9 + rng.uniform(-0.25, 0.25), rng.uniform(-3.0, 3.0))
        ranges = cast_rays(world, world.occupied, pose.position, pose.theta + bearings, 6.0)
        layer.update(pose, laser(ranges + 0.02 * rng.standard_normal(360), bearings))
        columns = {round(x / 0.05 - 0.5) for x in lethal_points(layer)[:, 0]}
        gaps.append([column for column in range(10, 10 + k) if column not in columns])
    assert gaps == [[]] * 60


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_without_a_prior_a_way_leads_round_everything_that_was_seen(seed: int) -> None:
    """Property: wherever the car was and whatever it heard, the rim of the grid is one ring of free cells."""
    rng = np.random.default_rng(seed)
    layer = LayeredCostmap(None, car(), CostmapParameters())
    pose = SE2()
    for _ in range(30):
        pose = pose @ SE2(rng.uniform(0.0, 0.8), 0.0, rng.uniform(-1.0, 1.0))
        layer.update(pose, sonar(rng.uniform(0.3, 1.0)))
    data = layer.costmap().data
    assert len(lethal_points(layer)) > 0
    for rim in (data[0], data[-1], data[:, 0], data[:, -1]):
        assert (rim == 0).all()


def test_forgetting_leaves_the_prior() -> None:
    data = np.zeros((80, 100), dtype=np.int8)
    data[10, 10] = OCCUPIED
    prior = OccupancyGrid(data, 0.05, SE2(-1.0, -2.0))
    layer = LayeredCostmap(prior, car(), OPEN)
    fresh = layer.costmap().data
    layer.update(SE2(), sonar(0.5))
    layer.clear()
    np.testing.assert_array_equal(layer.costmap().data, fresh)
