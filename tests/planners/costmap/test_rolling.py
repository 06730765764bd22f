"""The local costmap against the one that keeps everything."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import FREE, OCCUPIED, SE2, Observation, OccupancyGrid
from robocar.planners.costmap.layered import CostmapParameters, LayeredCostmap
from robocar.planners.costmap.rolling import RollingCostmap, RollingCostmapParameters
from tests.planners.costmap.test_layered import laser, lethal_points, sonar
from tests.planners.kinematic import car


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), walled=st.booleans())
def test_it_shows_what_the_whole_costmap_shows(seed: int, walled: bool) -> None:
    """Oracle: `LayeredCostmap` with the same prior and readings, at the window's cells more than an inflation from its rim; the
    robot stays so near that nothing is forgotten."""
    rng = np.random.default_rng(seed)
    prior = OccupancyGrid(np.where(rng.random((80, 90)) < 0.02, OCCUPIED, FREE), 0.05, SE2(1.0, 2.0, 0.3))
    p = CostmapParameters(walled=walled)
    whole, window = LayeredCostmap(prior, car(), p), RollingCostmap(prior, car(), p, RollingCostmapParameters(local_width=3.0))
    middle = prior.origin.transform([2.2, 2.0])
    for _ in range(10):
        x, y = middle + rng.uniform(-0.1, 0.1, 2)
        pose = SE2(x, y, rng.uniform(-3, 3))
        for seen in (laser(rng.uniform(0.1, 1.0, 30), rng.uniform(-1.5, 1.5, 30)), sonar(rng.uniform(0.1, 0.9))):
            whole.update(pose, seen)
            window.update(pose, seen)
    local = window.costmap()
    cells = np.argwhere(np.ones(local.shape, dtype=bool))
    inside = np.all((cells >= 9) & (cells < local.shape[0] - 9), axis=1)
    places = whole.costmap().cell_from_world(local.world_from_cell(cells[inside]))
    on_map = whole.costmap().contains(places)
    assert np.count_nonzero(on_map) > 1000
    expected = whole.costmap().data[tuple(places[on_map].T)]
    np.testing.assert_array_equal(local.data[tuple(cells[inside][on_map].T)], expected)


def test_what_was_seen_keeps_its_place_until_it_leaves_the_window() -> None:
    """By hand: a window of 4 m follows in steps above 0.5 m; an obstacle at x = 1 is gone when the car is 3 m past it."""
    layer = RollingCostmap(None, car(), CostmapParameters(), RollingCostmapParameters(local_width=4.0))
    with pytest.raises(ValueError, match="cover"):
        layer.costmap()
    layer.update(SE2(0.0, 0.02, 0.0), laser(np.array([1.02]), np.array([0.0])))
    marked = lethal_points(layer)
    np.testing.assert_allclose(marked, [[1.025, 0.025]], atol=1e-9)
    shown = []
    for x in np.arange(0.0, 5.0, 0.25):
        layer.update(SE2(x, 0.5, 0.0), Observation(0.0))
        points = lethal_points(layer)
        shown.append(len(points))
        costmap = layer.costmap()
        assert costmap.contains(costmap.cell_from_world([[x - 1.4, -0.9], [x + 1.4, 1.9]])).all()
        np.testing.assert_allclose(points, marked[: len(points)], atol=1e-9)
    assert shown[:8] == [1] * 8
    assert shown[-4:] == [0] * 4


def test_it_marks_and_clears_as_the_whole_costmap_does() -> None:
    """A ghost: seen once, and looked through three times."""
    layer = RollingCostmap(None, car())
    bearing = np.array([0.0])
    layer.update(SE2(0.0, 0.02, 0.0), laser(np.array([1.02]), bearing))
    assert len(lethal_points(layer)) == 1
    for _ in range(3):
        layer.update(SE2(0.0, 0.02, 0.0), laser(np.array([math.inf]), bearing))
    assert len(lethal_points(layer)) == 0
    assert (layer.costmap().data == 0).all()


def test_clearing_forgets_what_was_seen_and_keeps_the_prior() -> None:
    data = np.zeros((80, 100), dtype=np.int8)
    data[50, 50] = OCCUPIED
    layer = RollingCostmap(OccupancyGrid(data, 0.05, SE2(-1.0, -2.0)), car(), CostmapParameters(walled=False))
    layer.update(SE2(), Observation(0.0))
    fresh = layer.costmap().data
    assert np.count_nonzero(fresh == 254) == 1
    layer.update(SE2(), sonar(0.5))
    assert np.count_nonzero(layer.costmap().data == 254) > 1
    layer.clear()
    np.testing.assert_array_equal(layer.costmap().data, fresh)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_wrong_widths_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="local_width"):
        RollingCostmapParameters(local_width=value)
