"""Oracles: the exact solver, convergence theory (Young 1954), and the paper's reductions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import BudgetExhausted, ParameterError
from robocar.planners.harmonic.laplace import Sweeps, best_omega, block_sweep, laplace_problem, solve, sweep, sweeps
from robocar.planners.harmonic.laplace.blocks import pair_inverses, ring_inverses
from robocar.planners.harmonic.laplace.lattice import make_lattice
from robocar.planners.harmonic.laplace.sweeps import reachable

SCHEMES = ("full", "half", "quarter", "octo")


def empty_box(n: int):
    return laplace_problem(np.zeros((n, n), dtype=bool), (n // 2, n // 2))


def walled(n: int = 61):
    blocked = np.zeros((n, n), dtype=bool)
    blocked[n // 3, : n // 2] = True
    blocked[2 * n // 3, n // 3 :] = True
    blocked[n // 2, n // 2 + 4] = True
    return laplace_problem(blocked, (n // 8, n // 8))


@pytest.mark.parametrize("iteration", ["jacobi", "gauss-seidel", "sor"])
def test_full_sweeps_converge_to_the_solution(iteration) -> None:
    problem = walled()
    found = sweep(problem, "full", iteration, tolerance=1e-14)
    assert np.abs(found.potential.w - solve(problem).w).max() < 1e-10
    assert found.iterations == len(found.changes)
    assert found.changes[-1] <= 1e-14 < found.changes[-2]


def coarse_reference(problem, scheme: str) -> np.ndarray:
    """Values at the lattice's nodes by a dense direct solution of eq. 7 or 8, arms cut by hand-written rules."""
    free = np.pad(problem.unknowns, 3)
    goal = tuple(problem.goals[0] + 3)
    free[goal] = True
    step = [(-1, 0), (1, 0), (0, -1), (0, 1)] if scheme in ("full", "quarter") else [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    size = 2 if scheme in ("quarter", "octo") else 1

    def passes(r: int, c: int, dr: int, dc: int) -> bool:
        ok = True
        for _ in range(size):
            ok = ok and bool(free[r + dr, c + dc]) and (dr * dc == 0 or bool(free[r + dr, c]) or bool(free[r, c + dc]))
            r, c = r + dr, c + dc
        return ok

    nodes = [goal]
    number = {goal: 0}
    entries: list[tuple[int, int]] = []
    for node in nodes:  # grows while it is walked: the lattice through the goal, as far as arms reach
        for dr, dc in step:
            if passes(*node, dr, dc):
                beside = (node[0] + size * dr, node[1] + size * dc)
                if beside not in number:
                    number[beside] = len(nodes)
                    nodes.append(beside)
                if node != goal:
                    entries.append((number[node], number[beside]))
    matrix = 4.0 * np.eye(len(nodes))
    for i, j in entries:
        matrix[i, j] -= 1.0
    right = np.zeros(len(nodes))
    matrix[0], right[0] = np.eye(len(nodes))[0], 1.0
    w = np.zeros(free.shape)
    w[tuple(np.array(nodes).T)] = np.linalg.solve(matrix, right)
    return w[3:-3, 3:-3]


@given(
    st.integers(0, 2**32 - 1), st.sampled_from(SCHEMES), st.integers(3, 12), st.integers(3, 12), st.sampled_from([0.0, 0.15, 0.3])
)
@settings(max_examples=60, deadline=None)
def test_lattices_solve_their_own_equations_and_never_leak(seed, scheme, rows, cols, share) -> None:
    rng = np.random.default_rng(seed)
    blocked = rng.random((rows, cols)) < share
    goal = (int(rng.integers(rows)), int(rng.integers(cols)))
    blocked[goal] = False
    problem = laplace_problem(blocked, goal)
    found = sweep(problem, scheme, "gauss-seidel")
    reference = coarse_reference(problem, scheme)
    at_nodes = reference > 0
    np.testing.assert_allclose(found.potential.w[at_nodes], reference[at_nodes], atol=1e-12)
    # by the maximum principle nothing exceeds the goal, and nothing reaches walls or cells cut off
    assert found.potential.w.max() == 1.0
    assert np.all(found.potential.w[~problem.unknowns] <= (found.potential.w[~problem.unknowns] == 1.0))


def test_iterations_that_share_a_pass_are_those_done_one_by_one() -> None:
    # large enough for the pass over several iterations; the oracle is red-black SOR on whole arrays
    problem = walled(221)
    found = sweep(problem, "full", "sor", omega=1.6, tolerance=1e-9)
    u = problem.start_field()
    rows, cols = np.indices(u.shape)
    unknown = problem.inverse_degree > 0
    colors = [unknown & ((rows + cols) % 2 == k) for k in (0, 1)]
    count, change = 0, 1.0
    while change > 1e-9:
        old = u.copy()
        for color in colors:
            mean = np.zeros_like(u)
            mean[1:-1, 1:-1] = 0.25 * (u[:-2, 1:-1] + u[2:, 1:-1] + u[1:-1, :-2] + u[1:-1, 2:])
            u = np.where(color, 1.6 * mean - 0.6 * u, u)
        change = np.abs(u - old).max()
        count += 1
    assert np.isnan(found.changes).sum() > 0.5 * count
    assert abs(found.iterations - count) <= 1
    np.testing.assert_allclose(found.potential.mantissa, u, atol=1e-9)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("offset", range(4))
def test_a_wall_one_cell_thin_holds_wherever_it_lies_on_the_lattice(scheme, offset) -> None:
    blocked = np.zeros((30, 33), dtype=bool)
    blocked[:, 12 + offset] = True
    problem = laplace_problem(blocked, (10 + offset // 2, 4))
    w = sweep(problem, scheme, "sor").potential.w
    assert np.all(w[:, 12 + offset :] == 0.0)
    assert np.count_nonzero(w[:, : 12 + offset]) > 200


@pytest.mark.parametrize("scheme", SCHEMES)
def test_coarse_schemes_approach_the_fine_solution_as_cells_shrink(scheme) -> None:
    # away from the goal all four discretise the same boundary value problem; a goal block that scales fixes its size
    errors = []
    for n in (31, 63):
        w = sweep(empty_box(n), scheme, "sor").potential.w
        full = sweep(empty_box(n), "full", "sor").potential.w
        # the point-like goal differs by a factor common to all far cells: compare shapes
        q = slice(n // 8, n // 4)
        errors.append(np.abs((w[q, q] / w[q, q].max()) / (full[q, q] / full[q, q].max()) - 1).max())
    assert errors[1] <= errors[0]
    assert errors[1] < 0.05


def test_reductions_at_equal_omega_are_the_papers() -> None:
    # table 2: HSSOR saves 48.6 to 49.3 %, QSSOR 73.5 to 75.2 % of the iterations
    problem = walled(181)
    counts = [sweep(problem, scheme, "sor", omega=1.7).iterations for scheme in ("full", "half", "quarter", "octo")]
    half, quarter, octo = (100 * (1 - c / counts[0]) for c in counts[1:])
    assert 46 < half < 52
    assert 71 < quarter < 77
    assert octo > quarter + 8


def test_iterations_at_fixed_omega_grow_like_n_squared_and_at_the_best_like_n() -> None:
    fixed = [sweep(walled(n), "full", "sor", omega=1.5).iterations for n in (61, 121)]
    best = [sweep(walled(n), "full", "sor").iterations for n in (61, 121)]
    assert 3.2 < fixed[1] / fixed[0] < 4.4
    assert 1.5 < best[1] / best[0] < 2.6


@pytest.mark.parametrize("n", [20, 51])
def test_best_omega_of_an_empty_box_is_youngs(n) -> None:
    # Jacobi on an n x n box without a goal has rho = cos(pi / (n + 1)); a goal in a corner hardly changes it
    problem = laplace_problem(np.zeros((n, n), dtype=bool), (0, 0))
    rho = np.cos(np.pi / (n + 1))
    assert best_omega(problem, "full", accuracy=1e-3) == pytest.approx(2 / (1 + np.sqrt(1 - rho**2)), abs=0.005)


def test_no_other_omega_is_much_better_than_the_best() -> None:
    problem = walled()
    best = best_omega(problem, "full")
    count = sweep(problem, "full", "sor", omega=best).iterations
    others = [sweep(problem, "full", "sor", omega=w).iterations for w in (best - 0.1, best - 0.03, best + 0.03)]
    assert count <= 1.15 * min(others)


def test_gauss_seidel_takes_half_of_jacobis_iterations() -> None:
    problem = empty_box(21)
    jacobi, seidel = (sweep(problem, "full", it, tolerance=1e-13).iterations for it in ("jacobi", "gauss-seidel"))
    assert seidel / jacobi == pytest.approx(0.5, abs=0.05)


def test_sor_of_weight_one_is_gauss_seidel() -> None:
    problem = walled(31)
    one, seidel = sweep(problem, "quarter", "sor", omega=1.0), sweep(problem, "quarter", "gauss-seidel")
    assert np.array_equal(one.potential.mantissa, seidel.potential.mantissa)
    assert one.iterations == seidel.iterations


@pytest.mark.parametrize(("group", "scheme"), [("EDG", "half"), ("MEG", "quarter")])
@pytest.mark.parametrize("omega", [1.0, 1.5])
def test_block_iterations_converge_to_the_same_values_in_fewer_steps(group, scheme, omega) -> None:
    problem = walled()
    block: Sweeps = block_sweep(problem, group, omega)
    point = sweep(problem, scheme, "sor", omega=omega)
    np.testing.assert_allclose(block.potential.w, point.potential.w, atol=1e-12)
    assert block.iterations < point.iterations


def test_block_inverses_are_the_published_ones() -> None:
    # EDG: (1/15) [[4, 1], [1, 4]] (Abdullah 1991); a full group of four: (1/24) [[7, 2, 2, 1], ...] (Evans 1985)
    np.testing.assert_allclose(pair_inverses()[1], np.array([[4, 1], [1, 4]]) / 15)
    whole = np.array([[7, 2, 2, 1], [2, 7, 1, 2], [2, 1, 7, 2], [1, 2, 2, 7]]) / 24
    np.testing.assert_allclose(ring_inverses()[15], whole)


def test_the_papers_threshold_is_met_and_what_lies_below_is_refused() -> None:
    assert sweep(walled(), "full", "sor", tolerance=1e-15).changes[-1] <= 1e-15
    with pytest.raises(ParameterError, match="smallest is 1e-15"):
        sweep(walled(), tolerance=1e-16)


@pytest.mark.parametrize("omega", [1.87, 1.95, 1.99, 1.999])
def test_near_omega_2_the_default_threshold_is_what_rounding_leaves(omega) -> None:
    # oracle: the iteration itself; 1e-15 for the paper's omegas, then growing like 1 / sqrt(2 - omega)
    found = sweep(empty_box(40), "full", "sor", omega, max_iterations=60_000)
    assert found.changes[-1] <= reachable(omega)
    assert reachable(omega) == pytest.approx(max(1e-15, 1.5 * 2.0**-52 * (2.0 - omega) ** -0.5))
    assert reachable(1.87) == 1e-15


def test_changes_that_are_rounding_errors_end_the_iteration(monkeypatch) -> None:
    with pytest.raises(ParameterError, match=r"omega 1.999: 1.1e-14"):
        sweep(empty_box(40), "full", "sor", 1.999, tolerance=1e-15)
    monkeypatch.setattr(sweeps, "reachable", lambda omega: 1e-15)  # as if nobody knew
    with pytest.raises(BudgetExhausted, match="rounding errors"):
        sweep(empty_box(40), "full", "sor", 1.999, tolerance=1e-15)


@pytest.mark.parametrize("omega", [0.0, 2.0, -1.0, 2.5, float("nan")])
def test_omega_outside_0_2_is_refused(omega) -> None:
    with pytest.raises(ParameterError, match="between 0 and 2"):
        sweep(walled(), "full", "sor", omega=omega)
    with pytest.raises(ParameterError, match="between 0 and 2"):
        block_sweep(walled(), "MEG", omega)


def test_bad_input_is_named() -> None:
    problem = walled()
    with pytest.raises(ParameterError, match="full, half, quarter, octo"):
        sweep(problem, "eighth")  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="jacobi, gauss-seidel or sor"):
        sweep(problem, "full", "cg")  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="no weight"):
        sweep(problem, "full", "jacobi", omega=1.0)
    with pytest.raises(ParameterError, match="EDG or MEG"):
        block_sweep(problem, "EG")  # type: ignore[arg-type]
    with pytest.raises(BudgetExhausted, match="after 5 iterations"):
        sweep(problem, "full", "jacobi", max_iterations=5)
    reflecting = laplace_problem(np.zeros((5, 5), dtype=bool), (2, 2), wall_conductance=0.5)
    with pytest.raises(ParameterError, match="absorb"):
        sweep(reflecting)


@pytest.mark.parametrize("shape", [(1, 12), (12, 1), (2, 9), (7, 30)])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_thin_and_oblong_grids(shape, scheme) -> None:
    problem = laplace_problem(np.zeros(shape, dtype=bool), (0, 0))
    w = sweep(problem, scheme, "sor").potential.w
    assert w.shape == shape
    assert w[0, 0] == 1.0
    assert np.all((w >= 0) & (w <= 1))


def test_lattice_passes_through_the_goal() -> None:
    for goal in ((3, 4), (4, 4), (5, 2), (6, 7)):
        problem = laplace_problem(np.zeros((12, 13), dtype=bool), goal)
        for scheme in SCHEMES:
            lattice = make_lattice(problem, scheme)
            (row, col) = np.argwhere(lattice.state == 2)[0]
            back = (lattice.first[0] + (row - 1) * lattice.stride - 1, lattice.first[1] + (col - 1) * lattice.stride - 1)
            assert back == goal
