"""Zelinsky's path transform as a planner. Oracles: the octile optimum of A*, clearances of the paths, the contract's errors."""

from __future__ import annotations

import numpy as np
import pytest

from robocar.core import LETHAL, Costmap, NoPathFound, ParameterError
from robocar.planners.search.a_star import AStar
from robocar.planners.search.path_transform import PathTransform, PathTransformParameters, build
from robocar.planners.search.transforms import obstacle_transform
from tests.planners.kinematic import car, context

START, GOAL = np.array([0.525, 1.525]), np.array([4.475, 1.525])


def wall() -> Costmap:
    """A wall with a gap of 0.2 m on the straight way, and one of 1.4 m above."""
    costs = np.zeros((80, 100), dtype=np.uint8)
    costs[:52, 48:52] = LETHAL
    costs[29:33, 48:52] = 0
    return Costmap(costs, 0.05)


def least_clearance(costmap: Costmap, points: np.ndarray) -> float:
    """Of the cells under a path, in cells."""
    cells = costmap.cell_from_world(points)
    return float(obstacle_transform(costmap.blocked)[tuple(cells.T)].min())


def test_without_weight_it_is_the_shortest_path() -> None:
    """Oracle: A* on the same cells, whose costs are all zero, is optimal."""
    plan = PathTransform(PathTransformParameters(weight=0.0)).plan(wall(), START, GOAL)
    assert plan.path.length == pytest.approx(AStar().plan(wall(), START, GOAL).path.length)


def test_clearance_is_bought_with_length() -> None:
    """The heavier the weight, the longer the path and the larger its least clearance; it takes the wide gap in the end."""
    plans = [PathTransform(PathTransformParameters(weight=w)).plan(wall(), START, GOAL) for w in (0.0, 3.0, 30.0)]
    lengths, room = [p.path.length for p in plans], [least_clearance(wall(), p.path.points) for p in plans]
    assert lengths == sorted(lengths)
    assert room == sorted(room)
    assert room[0] <= 2.0
    assert room[-1] >= 10.0
    assert plans[-1].cost >= plans[-1].path.length


def test_no_way_is_an_error() -> None:
    costs = np.zeros((40, 60), dtype=np.uint8)
    costs[:, 30] = LETHAL
    with pytest.raises(NoPathFound, match="no way"):
        PathTransform().plan(Costmap(costs, 0.05), np.array([0.5, 0.5]), np.array([2.5, 0.5]))


@pytest.mark.parametrize(("name", "value"), [("weight", -1.0), ("safe_distance", 0.0), ("weight", float("nan"))])
def test_bad_parameters_name_themselves(name: str, value: float) -> None:
    with pytest.raises(ParameterError, match=name):
        build(context(car(), None, None, **{name: value}))
