"""Weights of the levels, renewed in part or carried from map to map. Oracles: all weights anew, the walk's equations, and the
walk of level 1 written down with a dense matrix."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from robocar.planners.harmonic.laplace import LaplaceProblem, Multigrid, laplace_problem, solve
from robocar.planners.harmonic.laplace.carry import carry
from tests.planners.harmonic.laplace.problems import two_rooms


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


class Walk(NamedTuple):
    """Of level 1: the probabilities of steps (n, n), of steps to the goal and into walls (n,), what meets at the nodes (n,), and
    the weight of each cell in its node's balance (rows + 2, cols + 2)."""

    probability: np.ndarray
    goal: np.ndarray
    loss: np.ndarray
    conductance: np.ndarray
    share: np.ndarray


def naive_walk(problem: LaplaceProblem, parent: np.ndarray, w: np.ndarray, conditioned: bool) -> Walk:
    """From cell to cell with the conductance w_i w_j, or 1 unless it is conditioned on w, gathered over the nodes.

    Links between nodes count half, those to the goal 0.85 of it where conditioned. What w exceeds the sum of its neighbours by,
    over the degree, is lost, and may be gained, up to half of the other conductances; unconditioned, the part of the degree that
    is no free neighbour, two thirds of it.
    """
    n = int(parent.max()) + 1
    links, goal, lost, share = np.zeros((n, n)), np.zeros(n), np.zeros(n), np.zeros(parent.shape)
    for r, c in np.argwhere(parent >= 0):
        node, beside = parent[r, c], [(r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)]
        degree, mine = 1.0 / problem.inverse_degree[r, c], w[r, c] if conditioned else 1.0
        share[r, c] = degree * mine**2
        for other in beside:
            conductance = mine * w[other] if conditioned else 1.0
            if parent[other] >= 0 and parent[other] != node:
                links[node, parent[other]] += 0.5 * conductance
            elif parent[other] < 0 and w[other] > 0:
                goal[node] += conductance * (0.85 if conditioned else 1.0)
        if conditioned:
            lost[node] += mine * (degree * mine - sum(w[other] for other in beside))
        else:
            lost[node] += 2.0 / 3.0 * (degree - sum(parent[other] >= 0 or w[other] > 0 for other in beside))
    if conditioned:
        lost = np.maximum(lost, -0.5 * (links.sum(axis=1) + goal))
    total = links.sum(axis=1) + goal + lost
    total[total == 0.0] = 1.0
    shares = np.where(parent >= 0, share / total[parent], 0.0)
    return Walk(links / total[:, None], goal / total, lost / total, total, shares)


@pytest.mark.parametrize("conditioned", [True, False], ids=["conditioned", "plain"])
@pytest.mark.parametrize("parts", [(1.0, 0.0), (0.5, 0.01), (0.0, 0.02)], ids=["absorbing", "leaking", "reflecting"])
def test_the_walk_of_the_first_level_is_the_one_gathered_from_the_cells(parts: tuple[float, float], conditioned: bool) -> None:
    """Oracle: a dense matrix, cell by cell; random maps of all sizes and any positive w, one or two goals."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        blocked = rng.random(rng.integers(2, 24, 2)) < rng.choice([0.0, 0.2, 0.4])
        goal = np.argwhere(~blocked)[:: max(1, int(np.count_nonzero(~blocked) * 0.6))]
        if len(goal) == 0:
            continue
        problem = laplace_problem(blocked, goal, *parts)
        if not problem.unknowns.any():
            continue
        w = np.where(problem.inverse_degree > 0, rng.uniform(0.1, 1.0, problem.inverse_degree.shape), problem.start_field())
        levels = Multigrid(problem)
        levels._reweigh(w, conditioned)
        first, expected = levels.levels[0], naive_walk(problem, levels.parent, w, conditioned)
        found = np.zeros((first.size, first.size))
        found[np.repeat(np.arange(first.size), np.diff(first.indptr)), first.indices] = first.probability
        np.testing.assert_allclose(found, expected.probability, rtol=1e-12)
        np.testing.assert_allclose(first.goal, expected.goal, rtol=1e-12)
        np.testing.assert_allclose(first.loss, expected.loss, rtol=1e-10, atol=1e-13)
        np.testing.assert_allclose(np.exp2(first.log_weight), expected.conductance, rtol=1e-12)
        np.testing.assert_allclose(levels.share, expected.share, rtol=1e-6)
