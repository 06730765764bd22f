"""Oracles: exact rational arithmetic, subtraction-free elimination, scipy's sparse LU, and closed forms of corridors."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import GoalOccupied, NoPathFound, OutsideMap, ParameterError
from robocar.formats.generated import cave, maze, rooms
from robocar.planners.harmonic.laplace import laplace_problem, solve
from robocar.planners.harmonic.laplace.elimination import dissection_order, eliminate
from robocar.planners.harmonic.laplace.relaxation import largest_residual
from robocar.planners.harmonic.laplace.solver import REACHABLE
from tests.planners.harmonic.laplace.problems import exact, random_problem, relative_error, sparse_lu, two_rooms


@given(random_problem, st.sampled_from(["auto", "multigrid", "elimination"]))
@settings(max_examples=40, deadline=None)
def test_every_method_agrees_with_rational_arithmetic_in_every_cell(drawn, method) -> None:
    blocked, seed = drawn
    goal = np.unravel_index(np.random.default_rng(seed).integers(blocked.size), blocked.shape)
    blocked[goal] = False
    problem = laplace_problem(blocked, np.array(goal))
    potential = solve(problem, 1e-13, method=method)
    w = exact(problem)
    errors = [abs(Fraction(float(potential.w[c])) / w[c] - 1) for c in map(tuple, np.argwhere(problem.unknowns))]
    assert max(errors, default=0) < 1e-10
    assert np.all(
        potential.w[~problem.unknowns] == (np.indices(blocked.shape).transpose(1, 2, 0) == goal).all(-1)[~problem.unknowns]
    )


@pytest.mark.parametrize("parts", [(0.5, 0.0), (0.0, 0.01), (0.25, 0.125), (1.0, 0.5)])
def test_reflecting_walls_and_leaks_agree_with_rational_arithmetic(parts) -> None:
    conductance, leak = parts
    blocked = np.random.default_rng(3).random((7, 8)) < 0.2
    blocked[3, 3] = False
    problem = laplace_problem(blocked, (3, 3), conductance, leak)
    w = exact(problem)
    cells = [tuple(c) for c in np.argwhere(problem.unknowns)]
    assert len(cells) > 20
    for method in ("multigrid", "elimination"):
        potential = solve(problem, 1e-13, method=method)
        # the oracle rounds 1 / inverse_degree to 20 bits: exact for these numbers but 0.01
        assert max(abs(float(Fraction(float(potential.w[c])) / w[c] - 1)) for c in cells) < (1e-4 if leak == 0.01 else 1e-10)


def test_conductances_may_differ_from_wall_to_wall() -> None:
    blocked = np.zeros((1, 5), dtype=bool)
    blocked[0, [0, 4]] = True
    # border reflects as the mean of the walls, 0.5: w = (1 + k w_wall) / degree by hand
    problem = laplace_problem(blocked, (0, 2), np.array([[1.0, 0, 0, 0, 0.0]]))
    assert solve(problem).w[0, 1] == pytest.approx(1 / (1 + 1 + 2 * 0.5), rel=1e-12)
    assert solve(problem).w[0, 3] == pytest.approx(1 / (1 + 0 + 2 * 0.5), rel=1e-12)


@pytest.mark.parametrize("n", [64, 131])
def test_multigrid_agrees_with_scipy_sparse_lu(n) -> None:
    problem = laplace_problem(*two_rooms(n))
    potential = solve(problem, method="multigrid")
    assert potential.residual <= 1e-12
    assert relative_error(potential, sparse_lu(problem)) < 1e-8


@pytest.mark.parametrize("make", [cave, rooms], ids=["cave", "rooms"])
def test_multigrid_agrees_with_elimination_in_every_cell(make) -> None:
    free = make(150, 130, np.random.default_rng(4)).free
    problem = laplace_problem(~free, np.argwhere(free)[len(np.argwhere(free)) // 3])
    potential = solve(problem, method="multigrid")
    assert relative_error(potential, solve(problem, method="elimination").w) < 1e-9
    assert potential.w[problem.unknowns].min() < 1e-12  # an absolute error would say nothing here


@pytest.mark.parametrize("blocked_share", [0.1, 0.2, 0.3])
def test_multigrid_converges_among_random_obstacles(blocked_share) -> None:
    blocked = np.random.default_rng(8).random((90, 90)) < blocked_share
    blocked[45, 45] = False
    problem = laplace_problem(blocked, (45, 45))
    assert np.count_nonzero(problem.unknowns) > 3000
    potential = solve(problem, method="multigrid")
    assert relative_error(potential, solve(problem, method="elimination").w) < 1e-9


def test_w_falls_as_theory_says_far_below_the_range_of_doubles() -> None:
    # a corridor one cell wide: w_k = (w_{k-1} + w_{k+1}) / 4, hence w falls by 2 - sqrt 3 a cell
    length = 3000
    problem = laplace_problem(np.zeros((1, length), dtype=bool), (0, 0))
    potential = solve(problem)
    slope = np.diff(potential.log2[0, 100:2900])
    assert potential.log2[0, -1] < -5000
    np.testing.assert_allclose(slope, np.log2(2 - np.sqrt(3)), rtol=1e-9)


@pytest.mark.parametrize("width", [4, 9])
def test_decay_along_a_corridor_is_the_discrete_eigenvalue(width) -> None:
    # separation of variables: sin(pi y / (width + 1)) exp(-kappa x), cosh kappa = 2 - cos(pi / (width + 1))
    problem = laplace_problem(np.zeros((width, 120), dtype=bool), (width // 2, 0))
    kappa = np.arccosh(2 - np.cos(np.pi / (width + 1)))
    log2 = solve(problem).log2[:, 60:90]
    np.testing.assert_allclose(np.diff(log2, axis=1), -kappa / np.log(2), rtol=1e-7)


@pytest.mark.parametrize("corridor", [1, 2, 6])
def test_mazes_are_solved_to_the_last_digits(corridor) -> None:
    free = maze(120, 120, corridor, np.random.default_rng(1)).free
    problem = laplace_problem(~free, (1, 1))
    potential = solve(problem)
    assert potential.residual < 1e-14
    assert potential.log2[problem.unknowns].min() < -500
    assert np.array_equal(np.isfinite(potential.log2), free)


def test_elimination_is_exact_in_any_order_and_solves_any_right_side() -> None:
    rng = np.random.default_rng(0)
    n = 40
    pattern = np.triu(rng.random((n, n)) < 0.1, 1)
    pattern |= pattern.T
    steps = np.where(pattern, rng.random((n, n)), 0.0)
    goal, loss = rng.random(n) * 0.01, rng.random(n) * 0.1
    total = steps.sum(1) + goal + loss
    steps, goal, loss = steps / total[:, None], goal / total, loss / total
    matrix = sp.csr_array(steps)
    data = np.asarray(matrix.data, dtype=float)
    right = rng.random(n)
    rows = np.arange(n)
    for order in (rng.permutation(n), dissection_order(rows // 7, rows % 7)):
        factors = eliminate(matrix.indptr, matrix.indices, data, goal, loss, order.astype(np.int32))
        assert factors is not None
        np.testing.assert_allclose(factors.solve(right), np.linalg.solve(np.eye(n) - steps, right), rtol=1e-10)
        mantissa, exponent = factors.hitting()
        np.testing.assert_allclose(np.ldexp(mantissa, exponent), np.linalg.solve(np.eye(n) - steps, goal), rtol=1e-10)
    assert eliminate(matrix.indptr, matrix.indices, data, goal, loss, rows.astype(np.int32), max_fill=3) is None


def test_dissection_order_is_a_permutation_that_keeps_the_middle_lines_for_last() -> None:
    rows, cols = (a.ravel() for a in np.indices((15, 15)))
    order = dissection_order(rows, cols)
    assert sorted(order) == list(range(225))
    last = order[-29:]  # the cross of row 7 and column 7 separates the four quarters
    assert np.all((rows[last] == 7) | (cols[last] == 7))


def test_residual_is_that_of_the_equations() -> None:
    blocked, goal = two_rooms(40)
    problem = laplace_problem(blocked, goal)
    potential = solve(problem, 1e-10, method="multigrid")
    w = np.pad(potential.w, 1)
    mean = 0.25 * (w[:-2, 1:-1] + w[2:, 1:-1] + w[1:-1, :-2] + w[1:-1, 2:])
    by_hand = np.abs(mean / np.where(problem.unknowns, potential.w, 1) - 1)[problem.unknowns].max()
    assert potential.residual <= 1e-10
    assert by_hand == pytest.approx(potential.residual, abs=1e-14)
    assert largest_residual(potential.mantissa, problem.inverse_degree) == pytest.approx(by_hand, abs=1e-14)


def test_the_smallest_tolerance_is_within_reach() -> None:
    problem = laplace_problem(*two_rooms(80))
    assert solve(problem, REACHABLE, method="multigrid").residual <= REACHABLE
    with pytest.raises(ParameterError, match=r"4e-15"):
        solve(problem, 0.9 * REACHABLE)


def test_results_do_not_depend_on_the_run() -> None:
    problem = laplace_problem(*two_rooms(320))  # large enough for the parallel kernels
    first, second = (solve(problem) for _ in range(2))
    assert np.array_equal(first.mantissa, second.mantissa)


def test_cycles_gain_a_digit_about_a_goal_in_the_open() -> None:
    found = solve(laplace_problem(np.zeros((200, 200), dtype=bool), (100, 100)), 1e-12, method="multigrid")
    assert len(found.residuals) == 10
    assert found.residuals[-1] < 0.1 * found.residuals[-2]


def test_bad_input_is_named() -> None:
    free = np.zeros((5, 6), dtype=bool)
    with pytest.raises(ParameterError, match="a goal is a cell"):
        laplace_problem(free, np.empty((0, 2), dtype=int))
    with pytest.raises(ParameterError, match="a goal is a cell"):
        laplace_problem(free, (0.5, 1.0))
    with pytest.raises(OutsideMap, match=r"\(5, 0\).*5 x 6"):
        laplace_problem(free, (5, 0))
    walled = free.copy()
    walled[2, 2] = True
    with pytest.raises(GoalOccupied, match=r"\(2, 2\) is a wall"):
        laplace_problem(walled, (2, 2))
    with pytest.raises(ParameterError, match="wall_conductance goes from 0"):
        laplace_problem(free, (1, 1), wall_conductance=1.5)
    with pytest.raises(ParameterError, match="shape"):
        laplace_problem(free, (1, 1), wall_conductance=np.ones((2, 2)))
    with pytest.raises(ParameterError, match="leak"):
        laplace_problem(free, (1, 1), leak=-0.1)
    with pytest.raises(ParameterError, match="nothing absorbs"):
        laplace_problem(free, (1, 1), wall_conductance=0.0)
    with pytest.raises(ParameterError, match="rows and columns"):
        laplace_problem(np.zeros(4, dtype=bool), (0, 0))
    with pytest.raises(ParameterError, match="method"):
        solve(laplace_problem(free, (1, 1)), method="magic")  # type: ignore[arg-type]


def test_cells_cut_off_are_known_at_once() -> None:
    blocked = np.zeros((6, 6), dtype=bool)
    blocked[:, 3] = True
    problem = laplace_problem(blocked, (2, 1))
    problem.require_connected((5, 0))
    problem.require_connected((2, 1))
    with pytest.raises(NoPathFound, match=r"\(2, 4\)"):
        problem.require_connected((2, 4))
    with pytest.raises(OutsideMap):
        problem.require_connected((6, 0))
    potential = solve(problem)
    assert np.all(potential.w[:, 3:] == 0)


def test_an_enclosed_goal_leaves_nothing_to_solve() -> None:
    blocked = np.ones((5, 5), dtype=bool)
    blocked[2, 2] = blocked[0, 0] = False
    potential = solve(laplace_problem(blocked, (2, 2)))
    assert potential.w.sum() == 1.0
    with pytest.raises(NoPathFound):
        potential.problem.require_connected((0, 0))


def test_several_goals_attract_from_both_ends() -> None:
    problem = laplace_problem(np.zeros((3, 30), dtype=bool), [(1, 0), (1, 29)])
    w = solve(problem).w
    np.testing.assert_allclose(w, w[:, ::-1], rtol=1e-11)
    assert np.all(np.diff(w[1, :15]) < 0)
