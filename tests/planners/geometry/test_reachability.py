"""The proof that there is no way. Oracle: the shortest path of a disc, `robocar.core.geodesic`; and doors by hand."""

import ast
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robocar.planners as planners
from robocar.core import OCCUPIED, SE2, UNKNOWN, GiveUp, Goal, OccupancyGrid
from robocar.core.geodesic import geodesic_path
from robocar.planners.geometry.reachability import Proof, unreachable

RADIUS = 0.09
START, GOAL = np.array([0.7, 1.0]), Goal(np.array([3.3, 1.0]))


def door(width: float, resolution: float = 0.01) -> OccupancyGrid:
    """4 x 2 m, with a wall at x = 2 that has a door of this width."""
    data = np.zeros((round(2.0 / resolution), round(4.0 / resolution)), dtype=np.int8)
    rows = np.arange(len(data)) * resolution + resolution / 2
    wall = slice(round(2.0 / resolution), round(2.0 / resolution) + max(1, round(0.1 / resolution)))
    data[np.abs(rows - 1.0) > width / 2, wall] = OCCUPIED
    return OccupancyGrid(data, resolution)


@pytest.mark.parametrize(("width", "proved"), [(0.0, True), (0.1, True), (0.14, True), (0.2, False), (0.3, False)])
def test_a_door_that_the_disc_does_not_fit_through_is_proved_shut(width: float, proved: bool) -> None:
    """The disc is 0.18 m wide; nodes lie 0.01 m apart, so doors below 0.18 - 2 * 0.007 m are proved shut."""
    assert unreachable(door(width), [START], GOAL, RADIUS) is proved


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), resolution=st.sampled_from([0.03, 0.05, 0.1, 0.2, 0.3]), theta=st.floats(-3.0, 3.0))
def test_where_the_disc_can_go_nothing_is_proved(seed: int, resolution: float, theta: float) -> None:
    """Soundness, on random cells, at any resolution and origin: a path that `geodesic_path` constructs refutes every proof."""
    rng = np.random.default_rng(seed)
    data = np.where(rng.random((24, 30)) < rng.uniform(0.02, 0.4), OCCUPIED, np.where(rng.random((24, 30)) < 0.2, UNKNOWN, 0))
    grid = OccupancyGrid(data.astype(np.int8), resolution, SE2(-1.0, 2.0, theta))
    radius = rng.uniform(0.3, 1.2) * resolution
    start, goal = grid.origin.transform(rng.uniform([0, 0], [30, 24], (2, 2)) * resolution)
    found = geodesic_path(grid, grid.occupied, start, goal, radius)
    proved = unreachable(grid, [start], Goal(goal, xy_goal_tolerance=0.1 * resolution), radius)
    assert not (proved and found is not None)


def test_what_is_no_proof() -> None:
    """No map; a start in a wall; a start from where there is a way, whatever the pose says now; a map that one can go around."""
    shut, failure = door(0.0), GiveUp("no way")
    assert Proof(shut, RADIUS).judged(failure, START, GOAL).status == "no_path"
    assert Proof(None, RADIUS).judged(failure, START, GOAL) is failure
    assert Proof(shut, RADIUS).judged(failure, np.array([2.05, 1.0]), GOAL) is failure
    drifted = Proof(shut, RADIUS)
    drifted.begin(np.array([3.0, 1.0]))
    drifted.begin(START)
    assert drifted.judged(failure, START, GOAL) is failure
    assert Proof(shut, RADIUS, walled=False).judged(failure, START, GOAL) is failure
    assert Proof(shut, RADIUS, walled=False).judged(failure, START, Goal(np.array([9.0, 1.0]))) is failure


def test_unknown_cells_prove_nothing() -> None:
    data = door(0.0).data.copy()
    data[data == OCCUPIED] = UNKNOWN
    assert not unreachable(OccupancyGrid(data, 0.01), [START], GOAL, RADIUS)


def test_no_planner_claims_it_otherwise() -> None:
    """Over the sources: the word `no_path` is no constant of any planner, and only the proof makes an `Unreachable`."""
    files = sorted(Path(planners.__path__[0]).resolve().rglob("*.py"))
    assert len(files) > 50
    claims, proofs = [], []
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and node.value == "no_path":
                claims.append(file.name)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Unreachable":
                proofs.append(file.name)
    assert claims == []
    assert proofs == ["reachability.py"]
