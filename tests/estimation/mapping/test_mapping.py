"""Mapping with a laser: against Bayes' rule, exact cell traversal, brute-force scans, and what malformed scans must not do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Belief, MapTooLarge, Observation, OccupancyGrid, Scan
from robocar.core.rays import cast_rays, traverse
from robocar.estimation.mapping.log_odds_grid import MAX_CELLS
from robocar.estimation.mapping.mapping import MappingParameters, OccupancyMapper, log_odds

INF, NAN = math.inf, math.nan
SIZE = 0.05


def scan(ranges: list[float] | np.ndarray, bearings: list[float] | np.ndarray, max_range: float = 6.0) -> Observation:
    return Observation(0.0, lidar=Scan(0.0, np.asarray(ranges, dtype=float), np.asarray(bearings, dtype=float), max_range))


def mapper(**parameters: float) -> OccupancyMapper:
    return OccupancyMapper(True, False, parameters=MappingParameters(**parameters))


def snapshot(subject: OccupancyMapper) -> OccupancyGrid:
    grid = subject.grid()
    assert grid is not None
    return grid


def cells(grid: OccupancyGrid, mask: np.ndarray) -> set[tuple[int, int]]:
    """Cells as (row, col) counted from the map frame's origin, which do not depend on how the grid has grown."""
    shift = np.rint(np.array([grid.origin.y, grid.origin.x]) / grid.resolution).astype(int)
    return {(int(r), int(c)) for r, c in np.argwhere(mask) + shift}


@settings(max_examples=200, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.2, 3.2), st.floats(0.2, 4.0), st.floats(-3.2, 3.2))
def test_one_beam_is_an_exact_traversal(x: float, y: float, theta: float, reading: float, bearing: float) -> None:
    """Oracle: `core.rays.traverse`: all cells before the one of the beam's end are free; half a cell behind it is occupied."""
    angle = SE2(theta=theta).theta + bearing
    direction = np.array([math.cos(angle), math.sin(angle)])
    start, end = np.array([x, y]) / SIZE, (np.array([x, y]) + reading * direction) / SIZE
    # Rounding may put points that lie on a border into either cell.
    borders = np.concatenate([start, end, end + 0.5 * direction]) % 1.0
    assume(np.min(np.minimum(borders, 1.0 - borders)) > 1e-6 and min(abs(direction)) > 1e-6)
    subject = mapper()
    subject.update(Belief(SE2(x, y, theta)), scan([reading], [bearing]))
    grid = snapshot(subject)
    hit = tuple(int(i) for i in np.floor(end + 0.5 * direction)[::-1])
    passed = {(int(r), int(c)) for r, c in traverse(*start, *end)[:-1]}
    assert cells(grid, grid.occupied) == {hit}
    assert cells(grid, grid.free) == passed - {hit}


def test_a_beam_on_cell_borders_hits_all_the_same() -> None:
    """Oracle: by hand: one occupied cell, wherever rounding puts it."""
    for y, bearing in ((0.0, 0.0), (1.0, 0.0), (1.0, -4.4e-282), (-1.0, math.pi), (0.0, math.pi / 2)):
        subject = mapper()
        subject.update(Belief(SE2(0.0, y)), scan([1.0], [bearing]))
        assert np.count_nonzero(snapshot(subject).occupied) == 1
        assert 19 <= np.count_nonzero(snapshot(subject).free) <= 21


@pytest.mark.parametrize(("hits", "misses"), [(1, 0), (2, 0), (3, 1), (0, 1), (0, 3), (2, 3)])
def test_repeated_looks_are_bayes_rule(hits: int, misses: int) -> None:
    """Oracle: the product of odds, (0.7 / 0.3)^hits (0.35 / 0.65)^misses, in percent."""
    subject = mapper()
    for k in range(hits + misses):
        reading = 1.0 if k < hits else 1.5
        subject.update(Belief(SE2(0.03, 0.03)), scan([reading], [0.0]))
    grid = snapshot(subject)
    row, col = grid.cell_from_world((1.055, 0.03))
    odds = (0.7 / 0.3) ** hits * (0.35 / 0.65) ** misses
    percent = round(100 * odds / (1 + odds))
    assert grid.data[row, col] == (percent if abs(percent - 50) >= 15 else -1)


def test_a_cell_can_change_its_mind() -> None:
    """Oracle: clamped at 0.98, five misses take the log-odds below that of 0.35: a hundred looks are forgotten by eleven."""
    subject = mapper()
    for _ in range(100):
        subject.update(Belief(SE2(0.03, 0.03)), scan([1.0], [0.0]))
    assert snapshot(subject).data.max() == 98
    needed = math.ceil((log_odds(0.98) - log_odds(0.35)) / -log_odds(0.35))
    for _ in range(needed):
        subject.update(Belief(SE2(0.03, 0.03)), scan([2.0], [0.0]))
    grid = snapshot(subject)
    assert grid.free[tuple(grid.cell_from_world((1.055, 0.03)))]


def test_beams_of_one_scan_are_one_look() -> None:
    """Oracle: by hand: fifty equal beams say what one says."""
    one, many = mapper(), mapper()
    one.update(Belief(SE2()), scan([1.0], [0.3]))
    many.update(Belief(SE2()), scan([1.0] * 50, [0.3] * 50))
    assert np.array_equal(snapshot(one).data, snapshot(many).data)


def test_what_stands_is_not_looked_through_by_the_same_scan() -> None:
    """Oracle: by hand: of two beams through one cell, one ends in it and one passes it: it is occupied."""
    for ranges in ([1.0, 3.0], [3.0, 1.0]):
        subject = mapper()
        subject.update(Belief(SE2(0.03, 0.03)), scan(ranges, [0.0, 0.0]))
        grid = snapshot(subject)
        assert grid.occupied[tuple(grid.cell_from_world((1.055, 0.03)))]


def test_more_scans_than_stamps() -> None:
    """Oracle: log-odds are proportional to the number of scans, also beyond the 255 that a stamp can tell apart."""
    subject = mapper(prob_miss=0.499, prob_hit=0.501, clamping_thres_min=1e-4)
    for k in range(600):
        subject.update(Belief(SE2(0.03, 0.03)), scan([1.0, 2.0], [0.0, 0.0]))
        if k + 1 in (200, 400, 600):
            grid = subject._grid
            x, y, _ = grid.local(SE2(0.51, 0.03))
            assert grid.log_odds[int(y), int(x)] == pytest.approx((k + 1) * log_odds(0.499), rel=1e-3)


def room() -> OccupancyGrid:
    """4 x 3 m with a wall around and a box in it."""
    data = np.zeros((60, 80), dtype=np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    data[20:30, 45:60] = 100
    return OccupancyGrid(data, SIZE)


@pytest.mark.parametrize("shift", [SE2(), SE2(-2.0, 1.0)])
def test_a_room_seen_without_noise_is_drawn_as_it_is(shift: SE2) -> None:
    """Oracle: the world's own grid: no free cell is called occupied, nor an occupied one free, and nearly all faces are found."""
    world = OccupancyGrid(room().data, SIZE, shift)
    subject = mapper()
    bearings = np.linspace(-math.pi, math.pi, 1440, endpoint=False)
    for x, y in ((0.51, 0.53), (1.5, 2.41), (3.43, 2.03), (3.41, 0.47)):
        pose = shift @ SE2(x, y, 0.4)
        ranges = cast_rays(world, world.occupied, pose.position, bearings + pose.theta, 6.0)
        subject.update(Belief(pose), scan(ranges, bearings))
    grid = snapshot(subject)
    occupied, free = cells(grid, grid.occupied), cells(grid, grid.free)
    true = cells(world, world.occupied)
    faces = {(r, c) for r, c in true if {(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)} & cells(world, world.free)}
    assert occupied <= true
    assert not free & true
    assert len(faces & occupied) >= 0.98 * len(faces)
    assert len(free) >= 0.98 * np.count_nonzero(world.free)


PLACES = st.integers(-600, 600).map(lambda k: 0.0131 * k + 0.0071)  # [m] not on cell borders, where rounding decides


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(PLACES, PLACES, st.integers(-31, 31).map(lambda k: 0.1 * k + 0.017)), min_size=2, max_size=6))
def test_growing_changes_nothing(poses: list[tuple[float, float, float]]) -> None:
    """Oracle: the same scans on a map that had its full size from the beginning."""
    bearings = np.linspace(-1.0, 1.0, 15)
    growing, ready = mapper(), mapper()
    ready._grid.touch(-20.0, -20.0, 20.0, 20.0)
    for x, y, theta in poses:
        ranges = 1.0 + np.abs(np.sin(7 * bearings + x))
        for subject in (growing, ready):
            subject.update(Belief(SE2(x, y, theta)), scan(ranges, bearings))
            if x > 0:
                subject.grid()  # a snapshot now or later is the same
    a, b = snapshot(growing), snapshot(ready)
    for value in (-1, 35, 70):
        mine, theirs = (a.data == value, b.data == value) if value >= 0 else (a.data >= 0, b.data >= 0)
        assert cells(a, mine) == cells(b, theirs)


def test_snapshots_are_made_when_something_has_changed() -> None:
    """Oracle: identity and the values before and after."""
    subject = mapper()
    assert subject.grid() is None
    subject.update(Belief(SE2()), scan([1.0], [0.0]))
    first = snapshot(subject)
    assert subject.grid() is first
    before = first.data.copy()
    subject.update(Belief(SE2()), scan([1.0], [1.0]))
    assert subject.grid() is not first
    assert np.array_equal(first.data, before)


def test_silence_is_free_up_to_a_limit() -> None:
    """Oracle: by hand: a beam without return clears to the smaller of the limit and the scanner's range, and marks nothing."""
    for limit, max_range in ((2.0, 6.0), (6.0, 2.0)):
        subject = mapper(laser_silent_range=limit)
        subject.update(Belief(SE2(0.03, 0.03)), scan([INF], [0.0], max_range))
        grid = snapshot(subject)
        assert not grid.occupied.any()
        assert np.count_nonzero(grid.free) == pytest.approx(2.0 / SIZE, abs=1)


@pytest.mark.parametrize("ranges", [[], [NAN], [-1.0], [-INF], [6.01], [1e300], [NAN, -2.0, 7.0]], ids=str)
def test_readings_that_mean_nothing_change_nothing(ranges: list[float]) -> None:
    """Oracle: the map before."""
    subject = mapper()
    subject.update(Belief(SE2()), scan(ranges, [0.1] * len(ranges)))
    assert subject.grid() is None
    subject.update(Belief(SE2()), scan([1.0, *ranges], [0.1] * (len(ranges) + 1)))
    only = mapper()
    only.update(Belief(SE2()), scan([1.0], [0.1]))
    assert np.array_equal(snapshot(subject).data, snapshot(only).data)


def test_bearings_that_are_no_angles_are_left_out() -> None:
    """Oracle: the map without that beam."""
    subject, only = mapper(), mapper()
    subject.update(Belief(SE2()), scan([1.0, 1.0], [0.1, NAN]))
    only.update(Belief(SE2()), scan([1.0], [0.1]))
    assert np.array_equal(snapshot(subject).data, snapshot(only).data)


def test_where_the_robot_stands_is_free() -> None:
    """Oracle: by hand: cells whose centres lie within the radius, though the laser sees only ahead."""
    subject = OccupancyMapper(True, False, footprint_radius=0.12)
    subject.update(Belief(SE2(0.5, 0.5)), scan([1.0], [0.0]))
    grid = snapshot(subject)
    row, col = np.indices(grid.shape)
    centres = grid.world_from_cell(np.stack([row, col], axis=-1))
    under = np.hypot(centres[..., 0] - 0.5, centres[..., 1] - 0.5) <= 0.12 - 1e-9
    assert np.count_nonzero(under) >= 12
    assert grid.free[under].all()


def test_a_pose_that_has_gone_astray_is_refused_before_memory_is_asked_for() -> None:
    """Oracle: the message names the size; the map is still what it was."""
    subject = mapper()
    subject.update(Belief(SE2()), scan([1.0], [0.0]))
    before = snapshot(subject)
    with pytest.raises(MapTooLarge, match=r"\d+ x \d+ cells .* at most"):
        subject.update(Belief(SE2(1e9, 1e9)), scan([1.0], [0.0]))
    assert subject.grid() is before
    assert MAX_CELLS * 6 < 2**30


def test_memory() -> None:
    """Oracle: the arrays' own sizes: at most 8 bytes a cell."""
    subject = mapper()
    subject.update(Belief(SE2()), scan([5.0] * 4, [0.0, 1.57, 3.14, -1.57]))
    assert subject.nbytes <= 8 * snapshot(subject).data.size


@pytest.mark.parametrize(
    ("name", "value"),
    [("resolution", 0.0), ("resolution", NAN), ("prob_hit", 0.5), ("prob_hit", 1.0), ("prob_miss", 0.6), ("prob_miss", 0.0)],
)
def test_parameters_out_of_range(name: str, value: float) -> None:
    """Oracle: the message names the parameter and what would be valid."""
    with pytest.raises(ValueError, match=rf"{name} must .*{value}"):
        MappingParameters(**{name: value})
