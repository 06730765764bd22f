"""Nodes of the levels. Oracles: links and connected pieces by hand, and the rooms between walls and doors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from robocar.core import ParameterError
from robocar.formats.generated import maze
from robocar.planners.harmonic.laplace import LaplaceProblem, Multigrid, laplace_problem, solve
from robocar.planners.harmonic.laplace.levels import coarser, first_level
from tests.planners.harmonic.laplace.problems import two_rooms


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
