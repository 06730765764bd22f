"""Solving again after a change of the map. Oracles: elimination, closer solutions, the equations by hand, dilation of changes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.planners.harmonic.laplace import Multigrid, Potential, laplace_problem, solve
from robocar.planners.harmonic.laplace.solver import WARM_CYCLES, WARM_RESIDUAL
from robocar.planners.harmonic.laplace.warm import LARGEST_SHARE, MARGIN, WINDOW_TOLERANCE, warm_start, windows
from tests.planners.harmonic.laplace.problems import relative_error, two_rooms


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
