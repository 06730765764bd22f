"""Generated BARN worlds. Oracles: the rules by brute force, and the published worlds with their published numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import OutputError, ParameterError
from robocar.core.discs import disc_geodesic
from robocar.formats import BarnWorld, load_barn_cylinders, load_barn_index, load_barn_world, save_barn_world
from robocar.formats.barn import GOAL, START
from robocar.formats.barn_generator import (
    FIELD,
    PARAMETER_SETS,
    ROOM,
    automaton,
    barn_cylinders,
    generate_barn_world,
    reference,
    widest_clearance,
)


def smoothed(filled: np.ndarray) -> np.ndarray:
    """One round of the automaton, cell by cell."""
    n = len(filled)
    new = filled.copy()
    for row in range(n):
        for col in range(n):
            count = 0
            for i in (row - 1, row, row + 1):
                for j in (col - 1, col, col + 1):
                    if (i, j) != (row, col) and 0 <= j < n:
                        count += filled[i, j] if 0 <= i < n else 1
            new[row, col] = True if count > 4 else (False if count < 2 else filled[row, col])
    return new


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**31), parameters=st.sampled_from(PARAMETER_SETS))
def test_the_automaton_follows_its_rules(seed: int, parameters: tuple[float, int]) -> None:
    fill, rounds = parameters
    expected = np.random.default_rng(seed).random((FIELD, FIELD)) < fill
    expected[[0, -1]] = True
    for _ in range(rounds):
        expected = smoothed(expected)
    np.testing.assert_array_equal(automaton(np.random.default_rng(seed), fill, rounds), expected)


def test_cylinders_stand_where_the_benchmark_puts_them() -> None:
    """By hand: sides and back wall alone, then a blob of 3 x 3 cells, whose middle is hollow, at rows 5-7, columns 10-12."""
    filled = np.zeros((FIELD, FIELD), dtype=bool)
    walls = {tuple(c) for c in barn_cylinders(filled).cylinders.round(6).tolist()}
    assert len(walls) == 2 * 34 + 28
    assert (-4.425, 0.075, 0.075) in walls
    assert (-0.075, 5.025, 0.075) in walls
    assert (-2.325, 0.075, 0.075) in walls
    filled[5:8, 10:13] = True
    blob = {tuple(c) for c in barn_cylinders(filled).cylinders.round(6).tolist()} - walls
    ring = [
        (round(-4.425 + 0.15 * r, 6), round(5.175 + 0.15 * c, 6)) for r in (5, 6, 7) for c in (10, 11, 12) if (r, c) != (6, 11)
    ]
    np.testing.assert_allclose(sorted((x, y) for x, y, _ in blob), sorted(ring), atol=1e-6)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**31), parameters=st.sampled_from(PARAMETER_SETS[:9]))
def test_every_world_has_a_way_with_room(seed: int, parameters: tuple[float, int]) -> None:
    """The exact shortest path of a disc with that room, less what a raster may cut, and never longer than the reference."""
    made = generate_barn_world(np.random.default_rng(seed), *parameters)
    shortest = disc_geodesic(made.world.cylinders, START.position, GOAL, ROOM - 0.01)
    assert shortest <= made.reference.path_length + 1e-9
    steps = np.linalg.norm(np.diff(made.path, axis=0), axis=1)
    assert steps.sum() == pytest.approx(made.reference.path_length)
    gaps = np.linalg.norm(made.path[1:-1, None] - made.world.cylinders[:, :2], axis=2) - made.world.cylinders[:, 2]
    assert gaps.min() >= ROOM
    assert made.reference.clearance >= ROOM - 0.03
    assert made.reference.optimal_time == pytest.approx(made.reference.path_length / 2)


def test_equal_generators_make_equal_worlds() -> None:
    worlds = [generate_barn_world(np.random.default_rng(seed), 0.25, 3).world.cylinders for seed in (1, 1, 2)]
    np.testing.assert_array_equal(worlds[0], worlds[1])
    assert not np.array_equal(worlds[0], worlds[2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, 2), "fill 1.0"),
        ((-0.1, 2), "fill -0.1"),
        ((float("nan"), 2), "fill nan"),
        ((0.2, -1), "smoothings -1"),
        ((0.2, 2, 0), "tries 0"),
        ((0.9, 2, 3), "no world with a way in 3 tries"),
    ],
)
def test_numbers_outside_their_range_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        generate_barn_world(np.random.default_rng(0), *arguments)
    with pytest.raises(ParameterError, match="30 x 30"):
        barn_cylinders(np.zeros((3, 3), dtype=bool))


@settings(max_examples=10, deadline=None)
@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(0.01, 2)), min_size=1, max_size=5))
def test_a_saved_world_is_read_back_number_by_number(tmp_path_factory: pytest.TempPathFactory, cylinders: list) -> None:
    path = tmp_path_factory.mktemp("worlds") / "a.world"
    save_barn_world(path, BarnWorld(np.array(cylinders)))
    np.testing.assert_array_equal(load_barn_world(path).cylinders, cylinders)


def test_a_world_that_cannot_be_written_is_named(tmp_path) -> None:
    with pytest.raises(OutputError, match=r"nowhere.*cannot write"):
        save_barn_world(tmp_path / "nowhere" / "a.world", BarnWorld(np.array([[0.0, 0.0, 1.0]])))


def test_published_worlds_have_the_published_numbers(data_dir) -> None:
    """References of the 50 test worlds: the benchmark's own paths are not shortest ones, its clearances are on a raster too."""
    worlds = load_barn_cylinders(data_dir / "barn" / "barn_cylinders_test50.npz")
    index = load_barn_index(data_dir / "barn" / "index.csv")
    lengths, clearances = [], []
    for number in list(worlds)[::5]:
        made = reference(worlds[number])
        assert made is not None
        lengths.append(made[1].path_length / index[number].path_length)
        clearances.append(made[1].clearance - index[number].clearance)
    assert max(lengths) <= 1.0 + 1e-6
    assert min(lengths) > 0.7
    assert min(clearances) > -0.03
    assert abs(np.median(clearances)) < 0.03


def test_generated_worlds_are_as_full_as_published_ones(data_dir) -> None:
    """The challenge takes every sixth world of 25 for each set of parameters in order; their mean numbers of cylinders agree."""
    worlds = load_barn_cylinders(data_dir / "barn" / "barn_cylinders_test50.npz")
    for first, fill in ((0, 0.15), (75, 0.20), (150, 0.25)):
        published = [len(worlds[k].cylinders) for k in worlds if first <= k < first + 75]
        made = [generate_barn_world(np.random.default_rng([first, k]), fill, 2 + k % 3).reference.cylinders for k in range(12)]
        assert np.mean(made) == pytest.approx(np.mean(published), rel=0.15)


def test_clearance_of_a_gap() -> None:
    """Two posts 1.2 m apart between two walls: half the gap, less the radius, up to what the raster misses."""
    walls = np.array([(x, y, 0.075) for x in (-4.425, -0.075) for y in np.arange(0.075, 9.6, 0.15)])
    row = np.array([(x, 7.0, 0.075) for x in np.arange(-4.425, 0, 0.15) if abs(x + 2.25) > 0.59])
    left, right = row[row[:, 0] < -2.25][-1, 0], row[row[:, 0] > -2.25][0, 0]
    widest = widest_clearance(BarnWorld(np.concatenate([walls, row])))
    assert (right - left) / 2 - 0.075 - 0.03 < widest <= (right - left) / 2 - 0.075
