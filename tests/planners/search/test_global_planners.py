"""What every global planner promises, on random costmaps (design, section 5).

The planners are those that the registered navigators are built of, so that a new one joins by its line in the registry.
"""

import importlib
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from robocar.core import (
    SE2,
    BudgetExhausted,
    Costmap,
    GlobalPlanner,
    GoalOccupied,
    NoPathFound,
    OutsideMap,
    StartOccupied,
)
from robocar.core.work import UNITS
from robocar.episode.registry import names
from tests.planners.grids import ORIGINS, costmaps, crosses_blocked, free_pair, random_costs, step_graph
from tests.planners.kinematic import car, context

Case = tuple[str, dict[str, Any]]
"""A factory `module:function`, and parameters."""

GRID_SEARCHES: list[Case] = [
    ("robocar.planners.search.a_star:build", {}),
    ("robocar.planners.search.a_star:build", {"metric": "thesis"}),
    ("robocar.planners.search.a_star:build", {"weight": 3.0}),
    ("robocar.planners.search.a_star:build", {"weight": 0.0}),  # Dijkstra
    ("robocar.planners.search.theta_star:build", {}),
    ("robocar.planners.search.d_star_lite:build", {}),
]
# The first part of a navigator that is built of parts is its global planner.
REGISTERED: list[Case] = [(path, {}) for path in sorted({e.parts[0] for e in names("navigator").values() if e.parts})]
NO_WAY = (NoPathFound, BudgetExhausted)  # who samples cannot tell that there is none
CASES = GRID_SEARCHES + [case for case in REGISTERED if case not in GRID_SEARCHES]


def name_of(case: Case) -> str:
    path, parameters = case
    return " ".join([path.removeprefix("robocar.planners.").removesuffix(":build"), *(f"{k}={v}" for k, v in parameters.items())])


@pytest.fixture(scope="module", params=CASES, ids=name_of, name="case")
def _case(request: pytest.FixtureRequest) -> Case:
    return request.param


@pytest.fixture(scope="module", name="planner")
def _planner(case: Case) -> GlobalPlanner:
    """One instance for all examples: what it keeps from one plan must not show in the next."""
    return built(case)


def built(case: Case) -> GlobalPlanner:
    path, parameters = case
    module, _, function = path.partition(":")
    return getattr(importlib.import_module(module), function)(context(car(), None, **parameters))


def test_the_registered_planners_are_found() -> None:
    """Oracle: the names of the design (section 5)."""
    assert {case[0] for case in GRID_SEARCHES} <= {case[0] for case in REGISTERED}


def test_it_is_a_global_planner(planner: GlobalPlanner) -> None:
    assert isinstance(planner, GlobalPlanner)


@settings(max_examples=60, deadline=None)
@given(costmap=costmaps(), seed=st.integers(0, 2**32 - 1))
def test_path_is_free_and_complete_or_there_is_none(planner: GlobalPlanner, costmap: Costmap, seed: int) -> None:
    """Oracles: scipy's connected components say whether there is a way, dense sampling whether the path is free.

    Only a planner with a budget may miss a way, and then it says so.
    """
    pair = free_pair(costmap, seed)
    assume(pair is not None)
    offsets = np.random.default_rng(seed).uniform(-0.45, 0.45, (2, 2))
    start, goal = costmap.origin.transform((np.array(pair)[:, ::-1] + 0.5 + offsets) * costmap.resolution)
    _, component = connected_components(step_graph(costmap), directed=False)
    component = component.reshape(costmap.shape)
    if component[tuple(pair[0])] != component[tuple(pair[1])]:
        with pytest.raises((NoPathFound, BudgetExhausted), match="no way from"):
            planner.plan(costmap, start, goal)
        return
    try:
        plan = planner.plan(costmap, start, goal)
    except BudgetExhausted:
        assume(False)
    np.testing.assert_allclose(plan.path.points[[0, -1]], [start, goal], rtol=0.0, atol=1e-12)
    assert not crosses_blocked(costmap, plan.path.points)
    assert np.isfinite(plan.cost)
    assert set(plan.work) <= set(UNITS)
    assert min(plan.work.values()) >= 0


@pytest.mark.parametrize("origin", ORIGINS)
def test_the_same_query_gives_the_same_plan(case: Case, origin: SE2) -> None:
    """Property: bit-identical path and cost of a planner built again, whatever was planned in between."""
    costmap = Costmap(random_costs(5, 30, 40, 0.25, True), 0.1, origin)
    start, goal = (costmap.world_from_cell(cell) for cell in np.argwhere(~costmap.blocked)[[0, -1]])
    plans = []
    for _ in range(2):
        planner = built(case)
        plans.append(planner.plan(costmap, start, goal))
        planner.plan(Costmap(np.zeros((3, 3), dtype=np.uint8), 1.0), np.array([0.5, 0.5]), np.array([2.5, 2.5]))
    np.testing.assert_array_equal(plans[0].path.points, plans[1].path.points)
    assert plans[0].cost == plans[1].cost
    assert plans[0].work == plans[1].work


def test_failures_are_typed_and_say_what_would_be_valid(planner: GlobalPlanner) -> None:
    """Contract: one error per cause; the nearest free cell is (0.5, 1.5) for the blocked column x = 1..2, by hand."""
    costs = np.zeros((3, 4), dtype=np.uint8)
    costs[:, 1] = [253, 254, 255]
    costmap = Costmap(costs, 1.0)
    free, behind = np.array([0.5, 1.5]), np.array([3.5, 1.5])
    with pytest.raises(NO_WAY, match=r"no way from \(0\.500, 1\.500\) to \(3\.500, 1\.500\)"):
        planner.plan(costmap, free, behind)
    with pytest.raises(OutsideMap, match=r"goal \(0\.500, 7\.000\).*y 0\.000 to 3\.000"):
        planner.plan(costmap, free, np.array([0.5, 7.0]))
    with pytest.raises(OutsideMap, match="two finite numbers"):
        planner.plan(costmap, np.array([np.nan, 0.5]), free)
    near = r"nearest free cell is at \(0\.500, \d\.500\), 0\.600 m away"
    for y, reason in ((0.5, "inscribed radius"), (1.5, "in an obstacle"), (2.5, "unknown space")):
        blocked = np.array([1.1, y])
        with pytest.raises(StartOccupied, match=f"start .*{reason}.*{near}"):
            planner.plan(costmap, blocked, free)
        with pytest.raises(GoalOccupied, match=f"goal .*{reason}.*{near}"):
            planner.plan(costmap, free, blocked)


def test_a_map_without_a_free_cell_is_said_to_have_none(planner: GlobalPlanner) -> None:
    with pytest.raises(StartOccupied, match="no cell of the map is free"):
        planner.plan(Costmap(np.full((2, 2), 254), 1.0), np.array([0.5, 0.5]), np.array([1.5, 1.5]))


def test_no_way_through_a_corner_between_two_obstacles(planner: GlobalPlanner) -> None:
    """By hand: on [[0, 1], [1, 0]] the free cells only touch at a corner."""
    with pytest.raises(NO_WAY):
        planner.plan(Costmap(np.array([[0, 254], [254, 0]]), 1.0), np.array([0.5, 0.5]), np.array([1.5, 1.5]))


@pytest.mark.parametrize("case", GRID_SEARCHES, ids=name_of, indirect=True)
def test_the_heat_map_shows_each_expanded_cell_once(case: Case) -> None:
    """Property: closed cells carry distinct orders, open cells the highest value, cells never reached nothing."""
    planner = built(case)
    costs = np.zeros((20, 30), dtype=np.uint8)
    costs[10, :25] = 254
    costmap = Costmap(costs, 0.1)
    plan = planner.plan(costmap, np.array([0.15, 0.15]), np.array([0.15, 1.85]))
    field = plan.trace["search"]
    assert field.grid.same_place(costmap)
    heat = field.grid.data
    assert np.isnan(heat[10, :25]).all()
    closed = heat[heat < np.nanmax(heat)]
    assert len(closed) > 0
    assert len(np.unique(closed)) == len(closed)
    assert plan.trace["search"] is field


@pytest.mark.parametrize("case", GRID_SEARCHES, ids=name_of, indirect=True)
def test_the_search_for_an_unreachable_goal_stays_in_one_component(planner: GlobalPlanner) -> None:
    """By hand: 50 cells on either side of the wall; with a weight above 1 some of them are expanded again, few."""
    costs = np.zeros((10, 11), dtype=np.uint8)
    costs[:, 5] = 254
    with pytest.raises(NoPathFound, match=r"cells searched: 5\d$"):
        planner.plan(Costmap(costs, 1.0), np.array([0.5, 0.5]), np.array([9.5, 0.5]))
