"""Oracles: exact rational arithmetic, subtraction-free elimination, scipy's sparse LU, and closed forms of corridors."""

from __future__ import annotations

from fractions import Fraction

import cv2
import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from robocar.core import GoalOccupied, NoPathFound, OutsideMap, ParameterError
from robocar.formats.generated import cave, maze, rooms
from robocar.planners.harmonic.laplace import LaplaceProblem, Multigrid, Potential, laplace_problem, solve
from robocar.planners.harmonic.laplace.carry import carry
from robocar.planners.harmonic.laplace.elimination import dissection_order, eliminate
from robocar.planners.harmonic.laplace.levels import coarser, first_level
from robocar.planners.harmonic.laplace.relaxation import largest_residual
from robocar.planners.harmonic.laplace.solver import REACHABLE, WARM_CYCLES, WARM_RESIDUAL
from robocar.planners.harmonic.laplace.warm import LARGEST_SHARE, MARGIN, WINDOW_TOLERANCE, warm_start, windows


def exact(problem: LaplaceProblem) -> np.ndarray:
    """w of every unknown by Gaussian elimination in rational numbers, (rows, cols) of Fraction (dtype object)."""
    cells = [tuple(c) for c in np.argwhere(problem.unknowns)]
    number = {c: k for k, c in enumerate(cells)}
    goals = {tuple(g) for g in problem.goals}
    rows = []
    for r, c in cells:
        row: dict[int, Fraction] = {number[r, c]: Fraction(round(2**20 / float(problem.inverse_degree[r + 1, c + 1])), 2**20)}
        right = Fraction(0)
        for n in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            if n in number:
                row[number[n]] = Fraction(-1)
            right += n in goals
        rows.append((row, right))
    for k in range(len(rows)):
        pivot_row, pivot_right = rows[k]
        for i in range(k + 1, len(rows)):
            row, right = rows[i]
            if k in row:
                factor = row.pop(k) / pivot_row[k]
                for j, value in pivot_row.items():
                    if j > k:
                        row[j] = row.get(j, Fraction(0)) - factor * value
                rows[i] = (row, right - factor * pivot_right)
    w = np.zeros(problem.shape, dtype=object)
    solution: list[Fraction] = [Fraction(0)] * len(rows)
    for k in range(len(rows) - 1, -1, -1):
        row, right = rows[k]
        solution[k] = (right - sum(value * solution[j] for j, value in row.items() if j > k)) / row[k]
        w[cells[k]] = solution[k]
    return w


def sparse_lu(problem: LaplaceProblem) -> np.ndarray:
    """w by scipy's direct solver, (rows, cols)."""
    cells = np.argwhere(problem.unknowns)
    number = np.full(problem.inverse_degree.shape, -1)
    number[tuple((cells + 1).T)] = np.arange(len(cells))
    start = problem.start_field()
    entries = []
    right = np.zeros(len(cells))
    for dr, dc in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = number[cells[:, 0] + 1 + dr, cells[:, 1] + 1 + dc]
        entries += [(i, j, -1.0) for i, j in enumerate(beside) if j >= 0]
        right += start[cells[:, 0] + 1 + dr, cells[:, 1] + 1 + dc]
    degrees = 1.0 / problem.inverse_degree[tuple((cells + 1).T)]
    i, j, values = zip(*entries, *((k, k, d) for k, d in enumerate(degrees)), strict=True)
    w = np.zeros(problem.shape)
    w[tuple(cells.T)] = sla.splu(sp.csc_array((values, (i, j)), shape=(len(cells),) * 2)).solve(right)
    return w


def relative_error(potential, reference: np.ndarray) -> float:
    inside = potential.problem.unknowns
    return float(np.abs(potential.w[inside] / reference[inside] - 1.0).max())


def two_rooms(n: int) -> tuple[np.ndarray, tuple[int, int]]:
    blocked = np.zeros((n, n), dtype=bool)
    blocked[:, n // 2] = True
    blocked[n // 5 : n // 5 + n // 10, n // 2] = False
    blocked[n // 2, n // 2 + n // 8 :] = True
    blocked[n // 4 : n // 3, n // 4 : n // 3] = True
    return blocked, (n - n // 8, n // 8)


random_problem = st.builds(
    lambda seed, rows, cols, share: (np.random.default_rng(seed).random((rows, cols)) < share, seed),
    st.integers(0, 2**32 - 1),
    st.integers(1, 7),
    st.integers(2, 7),
    st.sampled_from([0.0, 0.2, 0.4]),
)


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


@pytest.mark.parametrize("change", ["obstacle", "opening", "closed door"])
def test_warm_start_gives_the_new_solution(change) -> None:
    blocked, goal = two_rooms(160)
    old = solve(laplace_problem(blocked, goal), method="multigrid")
    changed = blocked.copy()
    if change == "obstacle":
        changed[20:40, 20:40] = True
    elif change == "opening":
        changed[80, 100:160] = False
    else:
        changed[:, 80] = True
        changed[150:153, 80] = False
    problem = laplace_problem(changed, goal)
    warm = solve(problem, guess=old, method="multigrid")
    cold = solve(problem, method="elimination")
    assert warm.residual <= 1e-12
    assert relative_error(warm, cold.w) < 1e-9
    assert not np.allclose(warm.w, old.w, rtol=1e-3)


def after_an_obstacle(n: int, row: int, col: int) -> tuple[Potential, Multigrid, np.ndarray, list[np.ndarray]]:
    """What two rooms were solved to before 20 x 20 cells were filled; then levels, first guess and nodes to be weighed."""
    blocked, goal = two_rooms(n)
    old = solve(laplace_problem(blocked, goal), 1e-10, method="multigrid")
    changed = blocked.copy()
    changed[row : row + 20, col : col + 20] = True
    levels = Multigrid(laplace_problem(changed, goal))
    assert old.levels is not None
    start = warm_start(levels, old.levels, old.mantissa)
    assert start is not None
    return old, levels, *start


def test_a_warm_start_is_solved_around_the_change_and_untouched_elsewhere() -> None:
    # oracle: the equations by hand; the window reaches 2 x 20 cells beyond the obstacle
    old, levels, guess, stale = after_an_obstacle(400, 60, 290)
    problem = levels.problem
    assert 2000 < stale[0].sum() < 3500  # of 2 x 2 cells, for a window of 100 x 100
    w, neighbours = guess[1:-1, 1:-1], guess[:-2, 1:-1] + guess[2:, 1:-1] + guess[1:-1, :-2] + guess[1:-1, 2:]
    inner, outer = np.zeros_like(problem.unknowns), np.ones_like(problem.unknowns)
    inner[25:115, 255:345], outer[15:125, 245:355] = problem.unknowns[25:115, 255:345], False
    assert np.count_nonzero(inner) > 5000
    assert np.abs(0.25 * neighbours / np.where(inner, w, 1) - 1)[inner].max() < 2 * WINDOW_TOLERANCE
    assert np.array_equal(w[outer], old.w[outer])
    cold, warm = solve(problem, 1e-10, method="multigrid"), solve(problem, 1e-10, method="multigrid", guess=old)
    assert relative_error(warm, solve(problem, 1e-13).w) < 1e-6
    assert len(warm.residuals) <= len(cold.residuals)


def test_one_cycle_finds_a_large_error() -> None:
    # oracle: a closer solution. Behind the obstacle and beside it, the old w is too large by factors of up to 50
    _, levels, w, stale = after_an_obstacle(300, 150, 200)
    exact, free = solve(levels.problem, 1e-13, method="multigrid").mantissa, levels.problem.inverse_degree > 0
    assert np.abs(w[free] / exact[free] - 1).max() > 0.5
    levels.improve(w, 1e-10, 1, stale)
    assert np.abs(w[free] / exact[free] - 1).max() < 0.03
    bent = np.where(
        free, exact * (1.0 + 3.0 * np.sin(np.linspace(0, np.pi, len(exact)))[:, None]), exact
    )  # loss here, gain there
    levels.improve(bent, 1e-10, 1)
    assert np.abs(bent[free] / exact[free] - 1).max() < 0.2


def test_cycles_gain_a_digit_about_a_goal_in_the_open() -> None:
    found = solve(laplace_problem(np.zeros((200, 200), dtype=bool), (100, 100)), 1e-12, method="multigrid")
    assert len(found.residuals) == 10
    assert found.residuals[-1] < 0.1 * found.residuals[-2]


def test_weights_are_renewed_where_w_has_changed_as_if_everywhere() -> None:
    # oracle: all weights anew. Cells of a few nodes of level 1 change by up to a factor, others not at all
    blocked, goal = two_rooms(120)
    problem = laplace_problem(blocked, goal)
    partly, wholly = Multigrid(problem), Multigrid(problem)
    w = solve(problem, 1e-10, method="multigrid").mantissa.copy()
    partly._reweigh(w, conditioned=True)
    before = [level.probability.copy() for level in partly.levels]
    e = np.zeros(partly.levels[0].size)
    e[np.random.default_rng(2).choice(len(e), 40, replace=False)] = 0.7
    inside = partly.parent >= 0
    w[inside] *= 1.0 + e[partly.parent[inside]]
    partly._reweigh(w, True, partly._follow(e))
    wholly._reweigh(w, conditioned=True)
    assert len(partly.levels) >= 3
    for some, every, old in zip(partly.levels, wholly.levels, before, strict=True):
        assert np.array_equal(some.probability, every.probability)
        assert np.array_equal(some.goal, every.goal)
        assert np.array_equal(some.log_weight, every.log_weight)
        assert np.array_equal(some.share, every.share)
        assert not np.array_equal(some.probability, old)
    assert np.array_equal(partly.share, wholly.share)


def test_weights_follow_a_factor_that_varies_slowly() -> None:
    # oracle: all weights anew. w changes by factors from 1 to 4 over 60 nodes, 2 % from node to node
    problem = laplace_problem(*two_rooms(120))
    kept, anew = Multigrid(problem), Multigrid(problem)
    w = solve(problem, 1e-10, method="multigrid").mantissa.copy()
    kept._reweigh(w, conditioned=True)
    e = 4.0 ** (np.abs(kept.levels[0].blocks[:, 0] - problem.goals[0, 0] // 2) / 60.0) - 1.0
    inside = kept.parent >= 0
    w[inside] *= 1.0 + e[kept.parent[inside]]
    stale = kept._follow(e)
    assert stale[0].mean() > 0.9
    kept._reweigh(w, True, [np.zeros_like(nodes) for nodes in stale[:2]] + stale[2:])  # as if the factor varied less
    anew._reweigh(w, conditioned=True)
    for some, every in zip(kept.levels, anew.levels, strict=True):
        np.testing.assert_allclose(some.log_weight - some.log_weight[0], every.log_weight - every.log_weight[0], atol=0.4)


def weights_of(levels: Multigrid) -> list[np.ndarray]:
    per_level = [[level.probability, level.goal, level.loss, level.log_weight, level.share] for level in levels.levels]
    return [levels.share, *(array for arrays in per_level for array in arrays)]


def change_obstacle(blocked: np.ndarray) -> None:
    blocked[20:31, 87:99] = True


def change_opening(blocked: np.ndarray) -> None:
    blocked[65, 85:95] = False


def change_border(blocked: np.ndarray) -> None:
    blocked[-1, 40:47] = blocked[0, 1] = blocked[60:70, 0] = blocked[50:60, -1] = True


def change_thin_walls(blocked: np.ndarray) -> None:
    blocked[45:60, 9] = blocked[100, 70:109] = blocked[90, ::2] = True
    blocked[43, 33:40] = False


def change_cutting_off(blocked: np.ndarray) -> None:
    blocked[26:39, 65] = True  # the door: half of the map is no longer sought


def change_everything(blocked: np.ndarray) -> None:
    for change in (change_obstacle, change_opening, change_border, change_thin_walls):
        change(blocked)
    blocked[np.random.default_rng(5).random(blocked.shape) < 0.001] ^= True


@pytest.mark.parametrize(
    "change",
    [change_obstacle, change_opening, change_border, change_thin_walls, change_cutting_off, change_everything],
    ids=lambda change: change.__name__.removeprefix("change_"),
)
@pytest.mark.parametrize("parts", [(1.0, 0.0), (0.5, 0.01)], ids=["absorbing", "leaking"])
@pytest.mark.parametrize("back", [False, True], ids=["there", "back"])
def test_weights_are_carried_over_a_local_change_as_if_weighed_anew(change, parts, back) -> None:
    before, goal = two_rooms(131)
    after = before.copy()
    change(after)
    after[goal] = False
    old_problem, problem = (laplace_problem(m, goal, *parts) for m in ((after, before) if back else (before, after)))
    old, new, anew = Multigrid(old_problem), Multigrid(problem), Multigrid(problem)
    # any positive w does, also one that is far from smooth
    w = np.random.default_rng(6).uniform(0.1, 1.0, old_problem.inverse_degree.shape)
    at_goal = problem.start_field()
    old._reweigh(np.where(old_problem.inverse_degree > 0, w, at_goal), conditioned=True)
    kept = [array.copy() for array in weights_of(old)]
    for level in new.levels:
        for array in (level.probability, level.goal, level.loss, level.log_weight, level.share):
            array.fill(np.nan)
    w = np.where(problem.inverse_degree > 0, w, at_goal)
    stale = carry(old, new)
    new._reweigh(w, True, stale)
    anew._reweigh(w, conditioned=True)
    assert len(new.levels) >= 3
    for some, every in zip(weights_of(new), weights_of(anew), strict=True):
        np.testing.assert_allclose(some, every, rtol=1e-12)
    for some, every in zip(weights_of(old), kept, strict=True):
        assert np.array_equal(some, every)
    assert not any(np.shares_memory(a, b) for a, b in zip(weights_of(old), weights_of(new), strict=False))
    if change is change_obstacle:
        assert np.mean(stale[0]) < 0.02
    right = np.random.default_rng(7).random(new.levels[0].size)
    np.testing.assert_allclose(new._correction(0, right), anew._correction(0, right), rtol=1e-9)


def test_weights_of_a_problem_without_a_change_are_all_carried_and_levels_without_a_match_are_not() -> None:
    problem = laplace_problem(*two_rooms(131))
    old, new = Multigrid(problem), Multigrid(problem)
    old._reweigh(solve(problem, method="multigrid").mantissa, conditioned=True)
    assert not any(stale.any() for stale in carry(old, new))
    for some, every in zip(weights_of(new), weights_of(old), strict=True):
        assert np.array_equal(some, every)
    removed = old.levels.pop()
    assert [int(stale.sum()) for stale in carry(old, new)] == [0] * len(old.levels) + [removed.size]


def test_weights_of_a_walk_sum_to_one_and_fit_its_equations() -> None:
    # oracle: level 1's walk conditioned on the exact w steps somewhere for certain, and has e = 1 as its solution
    problem = laplace_problem(*two_rooms(64))
    levels = Multigrid(problem)
    levels._reweigh(solve(problem, 1e-13, method="multigrid").mantissa, conditioned=True)
    for level in levels.levels:
        rows = np.add.reduceat(level.probability, level.indptr[:-1])
        np.testing.assert_allclose(rows + level.goal, 1.0, rtol=1e-12)
        assert np.all(level.probability > 0)


def test_a_slow_warm_start_goes_on() -> None:
    # oracle: elimination. Among random obstacles, cycles gain half a digit each
    blocked = np.random.default_rng(9).random((200, 200)) < 0.3
    blocked[100, 100] = False
    old = solve(laplace_problem(blocked, (100, 100)), 1e-10, method="multigrid")
    changed = blocked.copy()
    changed[60:80, 110:130] = True
    problem = laplace_problem(changed, (100, 100))
    warm = solve(problem, 1e-13, method="multigrid", guess=old)
    assert len(warm.residuals) > WARM_CYCLES
    assert warm.residuals[WARM_CYCLES] < WARM_RESIDUAL  # where a first guess would begin with about 1
    assert relative_error(warm, solve(problem, method="elimination").w) < 1e-8


def test_warm_starts_one_after_another_stay_as_quick_and_exact() -> None:
    # oracle: elimination. Weights are carried from each map to the next; obstacles come and go
    rng = np.random.default_rng(3)
    empty, goal = two_rooms(160)
    squares = rng.integers(5, 145, (30, 2))
    squares = squares[np.abs(squares - goal).max(axis=1) > 15]
    potential = solve(laplace_problem(empty, goal), 1e-11, method="multigrid")
    cycles = []
    for k in range(len(squares)):
        blocked = empty.copy()
        for row, col in squares[max(0, k - 3) : k + 1]:
            blocked[row : row + 10, col : col + 10] = True
        problem = laplace_problem(blocked, goal)
        potential = solve(problem, 1e-11, method="multigrid", guess=potential)
        cycles.append(len(potential.residuals))
    assert len(cycles) > 20
    assert max(cycles[-8:]) <= max(cycles[:8]) + 3
    assert relative_error(potential, solve(problem, method="elimination").w) < 1e-9


@given(st.lists(st.tuples(st.integers(0, 199), st.integers(0, 149), st.integers(1, 25)), min_size=1, max_size=6))
def test_windows_hold_every_change_with_a_margin(squares) -> None:
    changed = np.zeros((200, 150), dtype=bool)
    for row, col, side in squares:
        changed[row : row + side, col : col + side] = True
    found = windows(changed)
    covered = np.zeros(changed.shape, dtype=int)
    for window in found:
        covered[window] += 1
    near = cv2.dilate(changed.astype(np.uint8), np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)) > 0
    too_much = not found  # then, and only then, they would cover more than a quarter
    assert np.all((covered >= 1)[near]) or too_much
    assert sum(changed[window].size for window in found) <= LARGEST_SHARE * changed.size
    lone = np.zeros_like(changed)
    lone[squares[0][0], squares[0][1]] = True
    assert len(windows(lone)) == 1


def test_levels_can_be_used_again_but_only_for_their_problem() -> None:
    problem = laplace_problem(*two_rooms(64))
    levels = Multigrid(problem)
    first = solve(problem, method="multigrid", multigrid=levels)
    assert np.array_equal(first.mantissa, solve(problem, method="multigrid", multigrid=levels).mantissa)
    with pytest.raises(ParameterError, match="another problem"):
        solve(laplace_problem(*two_rooms(64)), multigrid=levels)


def links_by_hand(problem: LaplaceProblem, owner: np.ndarray) -> list[list[int]]:
    """Neighbours of each node of level 1, sides in the order left, right, top, bottom."""
    found: dict[tuple[int, int], dict[int, None]] = {}
    for r, c in np.argwhere(owner >= 0):
        for side, (dr, dc) in enumerate(((0, -1), (0, 1), (-1, 0), (1, 0))):
            if owner[r + dr, c + dc] not in (-1, owner[r, c]):
                found.setdefault((owner[r, c], side), {})[owner[r + dr, c + dc]] = None
    return [[j for side in range(4) for j in found.get((i, side), {})] for i in range(owner.max() + 1)]


def pieces_by_hand(level) -> np.ndarray:
    """Number of the connected piece of a 2 x 2 block that each node belongs to."""
    source = np.repeat(np.arange(level.size), np.diff(level.indptr))
    home = level.blocks // 2
    inside = (home[source] == home[level.indices]).all(1)
    graph = sp.coo_array((np.ones(inside.sum()), (source[inside], level.indices[inside])), shape=(level.size,) * 2)
    _, piece = connected_components(graph, directed=False)
    _, leader = np.unique(piece, return_index=True)
    rows, cols = home[leader].T
    rank = np.lexsort((leader, cols, rows, (rows + cols) % 2))
    number = np.empty(len(rank), dtype=int)
    number[rank] = np.arange(len(rank))
    return number[piece]


def thin_walls(rows: int, cols: int) -> np.ndarray:
    blocked = np.zeros((rows, cols), dtype=bool)
    blocked[3::5] = True
    blocked[3::5, 2::13] = False
    blocked[::7, 6::9] = True
    blocked[0, 0] = False
    return blocked


structures = {
    "rooms": two_rooms(90)[0],
    "scattered": np.random.default_rng(1).random((61, 40)) < 0.15,
    "dense": np.random.default_rng(2).random((41, 66)) < 0.35,
    "thin walls": thin_walls(53, 71),
    "maze": ~maze(60, 41, 1, np.random.default_rng(3)).free,
    "row": np.zeros((1, 75), dtype=bool),
    "column": np.zeros((50, 1), dtype=bool),
}


@pytest.mark.parametrize("blocked", structures.values(), ids=structures.keys())
def test_nodes_are_the_connected_pieces_of_blocks_in_order(blocked) -> None:
    problem = laplace_problem(blocked, np.argwhere(~blocked)[len(np.argwhere(~blocked)) // 2])
    level, owner = first_level(problem.inverse_degree)
    assert np.array_equal(owner >= 0, problem.inverse_degree > 0)
    links = links_by_hand(problem, owner)
    for _ in range(8):
        assert np.array_equal(np.diff(level.indptr), [len(to) for to in links])
        assert level.indices.tolist() == [j for to in links for j in to]
        assert np.array_equal(np.arange(level.size) < level.n_red, level.blocks.sum(1) % 2 == 0)
        coarse = coarser(level)
        number = pieces_by_hand(level)
        assert np.array_equal(level.parent, number)
        assert np.array_equal(coarse.children, np.argsort(number, kind="stable"))
        assert np.array_equal(np.diff(coarse.first_child), np.bincount(number))
        assert np.array_equal(coarse.blocks, level.blocks[coarse.children[coarse.first_child[:-1]]] // 2)
        below = np.split(coarse.children, coarse.first_child[1:-1])
        reached = [[number[j] for i in nodes for j in links[i]] for nodes in below]
        links = [list(dict.fromkeys(j for j in to if j != k)) for k, to in enumerate(reached)]
        level = coarse


def test_coarse_nodes_do_not_join_what_a_wall_separates() -> None:
    # walls one cell thin with rooms on both sides: every node of every level must hold cells of one room only
    blocked = np.zeros((64, 64), dtype=bool)
    blocked[21::21] = True
    blocked[::21, 5] = False  # doors
    blocked[:, 40] = True
    blocked[33, 40] = False
    problem = laplace_problem(blocked, (1, 1))
    doors = np.zeros_like(blocked)
    doors[::21, 5] = True
    doors[33, 40] = True
    levels = Multigrid(problem)
    owner = levels.parent[1:-1, 1:-1]
    _, room = cv2.connectedComponents((problem.unknowns & ~doors).astype(np.uint8), connectivity=4)
    assert room.max() >= 4
    inside = (owner >= 0) & (room > 0)
    rooms_of_node = {(int(o), int(r)) for o, r in zip(owner[inside], room[inside], strict=True)}
    crowded = [o for o in {o for o, _ in rooms_of_node} if sum(o == p for p, _ in rooms_of_node) > 1]
    # nodes that hold two rooms must hold a door cell as well
    with_door = set(owner[doors & (owner >= 0)].tolist())
    assert set(crowded) <= with_door


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
