"""How difficult a BARN world is. Oracle: maps small enough to count on, and symmetry."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.formats import load_barn_cylinders, load_barn_paths
from robocar.formats.barn_difficulty import difficulty, of_cells
from robocar.formats.barn_generator import PARAMETER_SETS, generate_barn_world

BARN = Path(os.environ.get("ROBOCAR_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data") / "barn"


def grid(text: str) -> np.ndarray:
    """`#` is blocked; row 0 first."""
    return np.array([[sign == "#" for sign in line] for line in text.split()])


def test_the_middle_of_a_corridor() -> None:
    """9 columns, 3 free rows between walls; one cell in the middle, (2, 4), and the one beside it, (2, 5)."""
    found = of_cells(grid("######### ......... ......... ......... #########"), [(2, 4), (2, 5)], size=0.5)
    assert found.closest_obstacle == pytest.approx(2 * 0.5)
    # Up and down 2 cells, four diagonals 2 cells; along the corridor 5 and 5, then 6 and 4, to beyond the grid.
    visibility = (2 + 2 + 4 * 2 * math.sqrt(2) + 10) / 8
    assert found.visibility == pytest.approx(visibility * 0.5)
    # Free for three cells: the two directions along, and the four beside them, (1, +-2) and (-1, +-2): they land in rows 1 and 3,
    # then in the walls. So only two ways lead off, each with two changes.
    assert found.dispersion == 4
    assert found.characteristic_dimension == pytest.approx(2 * 0.5)  # one free cell to either side
    assert found.tortuosity == 1.0


def test_open_ground_is_not_difficult() -> None:
    found = of_cells(np.zeros((21, 21), dtype=bool), [(10, 10), (10, 11), (10, 12)])
    assert found.closest_obstacle == math.inf
    assert found.dispersion == 0
    # Along a column 20 cells are free; diagonals lose a cell to either side where they are off the middle.
    assert found.characteristic_dimension == pytest.approx(20.0)


def test_a_single_post_is_seen_in_its_direction_only() -> None:
    blocked = np.zeros((21, 21), dtype=bool)
    blocked[10, 13] = True  # 3 cells from (10, 10), 4 from (10, 9)
    here = of_cells(blocked, [(10, 10), (10, 9)])
    assert here.closest_obstacle == pytest.approx(3.5)
    assert here.dispersion == pytest.approx((2 + 0) / 2)
    blocked[10, 13], blocked[12, 14] = False, True  # two of the steps between an axis and a diagonal
    assert of_cells(blocked, [(10, 10), (10, 9)]).dispersion == pytest.approx((2 + 0) / 2)


def test_a_crossing_has_four_ways() -> None:
    blocked = np.ones((9, 9), dtype=bool)
    blocked[4, :] = blocked[:, 4] = False
    found = of_cells(blocked, [(4, 4), (4, 5)])
    assert found.dispersion == pytest.approx((8 + 4) / 2)  # beside the crossing only the ways to its sides are there
    assert found.characteristic_dimension == 0.0  # a diagonal is blocked at once, and so are the sides of a way
    assert found.closest_obstacle == pytest.approx((math.sqrt(2) + 1) / 2)


def test_tortuosity_is_arc_over_chord() -> None:
    free = np.zeros((10, 10), dtype=bool)
    corner = [(0, k) for k in range(4)] + [(k, 3) for k in range(1, 5)]
    assert of_cells(free, corner).tortuosity == pytest.approx(7 / 5)
    assert of_cells(free, [(k, k) for k in range(5)]).tortuosity == pytest.approx(1.0)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), turns=st.integers(0, 3), flip=st.booleans())
def test_turning_the_map_changes_nothing(seed: int, turns: int, flip: bool) -> None:
    rng = np.random.default_rng(seed)
    blocked = rng.random((12, 12)) < 0.25
    path = [(5, 4), (5, 5), (6, 6), (7, 6)]
    for cell in path:
        blocked[cell] = False
    marks = np.zeros((12, 12), dtype=int)
    marks[tuple(np.array(path).T)] = np.arange(1, 5)

    def turned(array: np.ndarray) -> np.ndarray:
        return np.rot90(array[::-1] if flip else array, turns)

    moved = [tuple(np.argwhere(turned(marks) == k)[0]) for k in range(1, 5)]
    a, b = of_cells(blocked, path), of_cells(turned(blocked), moved)
    for name in a.__dataclass_fields__:
        assert getattr(a, name) == pytest.approx(getattr(b, name)), name


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_more_obstacles_are_no_easier(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = [(5, 4), (5, 5), (6, 6)]
    few = rng.random((12, 12)) < 0.2
    more = few | (rng.random((12, 12)) < 0.2)
    for cell in path:
        few[cell] = more[cell] = False
    a, b = of_cells(few, path), of_cells(more, path)
    assert b.closest_obstacle <= a.closest_obstacle
    assert b.visibility <= a.visibility
    assert b.characteristic_dimension <= a.characteristic_dimension


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ([(1, 1)], "from one cell to another"),
        ([(1, 1), (1, 2), (1, 1)], "from one cell to another"),
        ([(1, 1), (0, 0)], r"\(0, 0\)"),
        ([(1, 1), (1, 9)], r"\(1, 9\)"),
    ],
)
def test_a_path_that_is_none_is_refused(path: list[tuple[int, int]], message: str) -> None:
    blocked = np.zeros((3, 3), dtype=bool)
    blocked[0, 0] = True
    with pytest.raises(ValueError, match=message):
        of_cells(blocked, path)


@pytest.mark.skipif(not BARN.is_dir(), reason="no BARN worlds in ROBOCAR_DATA")
def test_the_benchmark_s_own_paths_keep_to_cells_where_its_robot_fits() -> None:
    """An independent check of where cells lie and which are blocked: the paths were made with the benchmark's own grid."""
    worlds, paths = load_barn_cylinders(BARN / "barn_cylinders_test50.npz"), load_barn_paths(BARN / "barn_paths_test50.npz")
    found = [difficulty(worlds[k], paths[k]) for k in sorted(worlds)]
    assert len(found) == 50
    assert min(d.closest_obstacle for d in found) >= 0.15
    assert all(1.0 <= d.tortuosity < 3.0 and 0.0 <= d.dispersion <= 16.0 for d in found)


def test_generated_worlds_are_measured_alike() -> None:
    """Denser noise is harder: the mean over 8 worlds of the densest set against the sparsest one."""
    sets = (PARAMETER_SETS[0], PARAMETER_SETS[-1])
    means = []
    for chosen in sets:
        made = [generate_barn_world(np.random.default_rng([7, k]), *chosen) for k in range(8)]
        means.append(np.mean([difficulty(m.world, m.path).visibility for m in made]))
    assert means[1] < means[0]
