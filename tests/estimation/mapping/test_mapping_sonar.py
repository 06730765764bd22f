"""Mapping with sonars: the inverse model of one reading against its geometry and against the same model cell by cell in plain
Python; a car between walls against the walls."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from robocar.core import (
    SE2,
    Array,
    Belief,
    Calibration,
    Context,
    Footprint,
    Limits,
    Observation,
    OccupancyGrid,
    ParameterError,
    RangeSensor,
    Robot,
    Scan,
)
from robocar.core.rays import cast_rays
from robocar.estimation.mapping import mapping
from robocar.estimation.mapping.inverse_sensor import SonarModel, update_sonar
from robocar.estimation.mapping.mapping import MappingParameters, OccupancyMapper, log_odds

INF, NAN = math.inf, math.nan
SIZE = 0.05
WIDTH = math.radians(15.0)


def echo(reading: float, mount: SE2 = SE2(), bearing: float = 0.0) -> Observation:
    return Observation(0.0, sonars=(Scan(0.0, np.array([reading]), np.array([bearing]), 5.0, WIDTH, mount),))


def mapper(**parameters: float) -> OccupancyMapper:
    return OccupancyMapper(False, True, parameters=MappingParameters(**parameters))


def log_odds_of(subject: OccupancyMapper) -> tuple[Array, Array, Array]:
    """Log-odds (rows, cols) and the cells' centres in the map frame, x and y."""
    grid = subject.grid()
    assert grid is not None
    row, col = np.indices(grid.shape)
    centres = grid.world_from_cell(np.stack([row, col], axis=-1))
    return subject._grid.log_odds.astype(float), centres[..., 0], centres[..., 1]


@settings(max_examples=100, deadline=None)
@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3), st.floats(0.2, 3.4))
def test_an_echo_touches_only_its_cone(x: float, y: float, theta: float, reading: float) -> None:
    """Oracle: geometry of a sector: raised cells lie on the arc, lowered ones before it and within reach, all within the cone,
    each to a cell's diagonal; the evidence of the arc sums up to that of one hit."""
    subject = mapper()
    subject.update(Belief(SE2(x, y, theta)), echo(reading))
    values, px, py = log_odds_of(subject)
    pose = SE2(x, y, theta)
    local = pose.inverse().transform(np.stack([px, py], axis=-1))
    distance = np.hypot(local[..., 0], local[..., 1])
    beside = np.abs(np.arctan2(local[..., 1], local[..., 0])) - WIDTH / 2
    raised, lowered = values > 1e-5, values < -1e-5
    diagonal = SIZE * math.sqrt(0.5) + 1e-6
    assert raised.any()
    assert np.all(np.abs(distance[raised] - reading - SIZE / 2) <= diagonal)
    assert np.all(distance[lowered] <= min(reading, MappingParameters().sonar_free_range) + diagonal)
    outside = np.where(beside < math.pi / 2, distance * np.sin(np.maximum(beside, 0.0)), distance)
    assert np.all(outside[raised | lowered] <= diagonal)
    assert values[raised].sum() == pytest.approx(log_odds(MappingParameters().sonar_prob_hit), rel=1e-3)


def test_a_cone_is_symmetric_about_its_axis() -> None:
    """Oracle: mirror symmetry; free space is believed most on the axis and near the sensor."""
    subject = mapper()
    subject.update(Belief(SE2(0.0, 0.025, 0.0)), echo(1.2))
    values, px, py = log_odds_of(subject)
    below, above = values[np.abs(py + 0.075) < 1e-6], values[np.abs(py - 0.125) < 1e-6]
    assert np.count_nonzero(below) > 3
    assert below == pytest.approx(above, abs=1e-5)
    axis = values[np.abs(py - 0.025) < 1e-6]
    along = axis[axis < 0]
    assert np.all(np.diff(along) > 0)
    column = values[:, np.argmin(np.abs(px[0] - 1.025))]
    assert np.argmin(column) == np.argmin(np.abs(py[:, 0] - 0.025))


def test_an_arc_across_what_is_known_is_shared_by_the_odds() -> None:
    """Oracle: by hand: of an arc of which one cell has odds a hundred times those of the others, that cell gets nearly all."""
    subject = mapper()
    subject.update(Belief(SE2()), echo(1.0))  # makes the place
    grid = subject._grid
    grid.log_odds[:] = 0.0
    x, y, _ = grid.local(SE2(1.0 + SIZE / 2, 0.01))
    wall = int(y), int(x)
    grid.log_odds[wall] = math.log(100.0)
    subject.update(Belief(SE2()), echo(1.0))
    values, _, _ = log_odds_of(subject)
    bound = log_odds(MappingParameters().clamping_thres_max)
    assert values[wall] == pytest.approx(bound)
    others = values[(values > 1e-5) & (np.arange(values.size).reshape(values.shape) != wall[0] * values.shape[1] + wall[1])]
    assert 0.0 < others.sum() < 0.1 * log_odds(MappingParameters().sonar_prob_hit)


def test_nothing_is_cleared_behind_a_known_wall() -> None:
    """Oracle: by hand: with a wall across the cone, an echo from behind it (lost at grazing incidence) clears nothing there."""
    subject = mapper()
    subject.update(Belief(SE2()), echo(3.0))
    grid = subject._grid
    grid.log_odds[:] = 0.0
    x, _, _ = grid.local(SE2(0.6, 0.0))
    grid.log_odds[:, int(x)] = 3.0
    subject.update(Belief(SE2()), echo(3.0))
    values, px, _ = log_odds_of(subject)
    behind = (px > 0.7) & (px < 2.9)
    assert np.count_nonzero(behind) > 1000
    assert np.all(values[behind] == 0.0)
    assert np.count_nonzero(values[px < 0.55] < 0) > 20


def test_silence_says_little() -> None:
    """Oracle: by hand: it reaches `sonar_silent_range`, weighs less than an echo, and marks nothing."""
    heard, silent = mapper(), mapper()
    heard.update(Belief(SE2()), echo(1.4))
    silent.update(Belief(SE2()), echo(INF))
    free, px, py = log_odds_of(silent)
    assert free.max() < 1e-5
    assert np.hypot(px, py)[free < 0].max() <= MappingParameters().sonar_silent_range + SIZE
    assert 0.0 > free.min() > 0.5 * log_odds_of(heard)[0].min()
    assert not silent.grid().free.any()  # type: ignore[union-attr]


Cell = tuple[int, int]


def changes(grid: NDArray, at: tuple[float, float, float], reading: float, model: SonarModel) -> dict[Cell, float]:
    """What a reading changes of the log-odds of cells, each cell once: those of the arc, then those before it."""
    x, y, axis = at
    change: dict[Cell, float] = {}

    def cell(offset: float, distance: float) -> Cell | None:
        row, col = math.floor(y + distance * math.sin(axis + offset)), math.floor(x + distance * math.cos(axis + offset))
        return (row, col) if 0 <= row < grid.shape[0] and 0 <= col < grid.shape[1] else None

    reach = min(reading, model.free_range)
    each_side = 1 + int(2.0 * model.half_width * (reading if reading <= model.hit_range else reach))
    from_the_axis = sorted(range(-each_side, each_side + 1), key=lambda k: (abs(k), k))
    # What share of the half width they are off the axis, and by what angle; those of a cone without width are all on it.
    rays = [(k / each_side if model.half_width > 0.0 else 0.0, model.half_width * k / each_side) for k in from_the_axis]
    if reading <= model.hit_range:
        odds: dict[Cell, float] = {}
        for share, offset in rays:
            found = cell(offset, reading + 0.5)
            if found is not None and found not in odds:
                odds[found] = max(1.0 - share**2, 0.05) * math.exp(grid[found])
        change = {found: model.hit * value / sum(odds.values()) for found, value in odds.items()}
    for share, offset in rays:
        for distance in np.arange(0.25, 0.5 * int(2.0 * reach), 0.5).tolist():
            found = cell(offset, distance)
            if found is None:
                break
            # A wall as the map is when the ray comes to it: this echo may have made it, an earlier ray unmade it.
            wall = clamped(grid[found] + change.get(found, 0.0)) > model.solid
            miss = model.silent_miss if reading == INF else model.miss
            change.setdefault(found, miss * (1.0 - share**2) * (1.0 - (distance / reach) ** 2))
            if wall:
                break
    return change


def clamped(value: float) -> float:
    return min(max(value, -2.0), 3.5)


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.05, 0.13, 0.5]), st.one_of(st.just(INF), st.floats(0.0, 40.0)),
    st.sampled_from([0.0, 0.03, 0.3]),
)  # fmt: skip
def test_a_reading_changes_the_log_odds_as_in_plain_python(seed: int, half_width: float, reading: float, walls: float) -> None:
    """Oracle: the model ray by ray, with the changed cells in a dict; from anywhere on or beside a map with walls."""
    rng = np.random.default_rng(seed)
    grid = np.where(rng.random((30, 35)) < walls, rng.uniform(0.5, 3.5, (30, 35)), rng.uniform(-2.0, 0.3, (30, 35)))
    grid = grid.astype(np.float32)
    at = (float(rng.uniform(-2.0, 37.0)), float(rng.uniform(-2.0, 32.0)), float(rng.uniform(-7.0, 7.0)))
    model = SonarModel(half_width, 30.0, float(rng.uniform(1.0, 25.0)), 1.3, -0.6, -0.15, 0.9)
    expected = grid.copy()
    for cell, change in changes(grid, at, reading, model).items():
        expected[cell] = clamped(grid[cell] + change)
    update_sonar(grid, np.zeros(grid.shape, dtype=np.uint8), 1, *at, reading, model, -2.0, 3.5)
    np.testing.assert_allclose(grid, expected, atol=1e-5)


@pytest.mark.parametrize("reading", [NAN, -1.0, -INF, 5.01, 1e300])
def test_readings_that_mean_nothing_change_nothing(reading: float) -> None:
    """Oracle: there is no map yet."""
    subject = mapper()
    subject.update(Belief(SE2()), echo(reading))
    assert subject.grid() is None


def test_an_echo_at_the_sensor_itself() -> None:
    """Oracle: by hand: at range 0 one cell or its neighbour is occupied and nothing is free."""
    subject = mapper(sonar_prob_hit=0.9)
    subject.update(Belief(SE2(0.01, 0.01)), echo(0.0))
    grid = subject.grid()
    assert grid is not None
    assert np.count_nonzero(grid.occupied) == 1
    assert not grid.free.any()


def first_echo(world: OccupancyGrid, sensor: SE2) -> float:
    """Nearest surface within the cone; walls are seen whatever their angle."""
    angles = sensor.theta + np.linspace(-WIDTH / 2, WIDTH / 2, 31)
    return float(cast_rays(world, world.occupied, sensor.position, angles, 5.0).min())


def test_a_corridor_is_drawn_by_side_sonars() -> None:
    """Oracle: the walls: every occupied cell is one of theirs or its neighbour, and nearly all of what was passed is there."""
    data = np.zeros((20, 80), dtype=np.int8)
    data[[0, -1]] = 100
    world = OccupancyGrid(data, SIZE)
    subject = mapper()
    mounts = (SE2(0.1, 0.05), SE2(0.1, -0.05), SE2(0.0, 0.09, math.pi / 2), SE2(0.0, -0.09, -math.pi / 2))
    for x in np.arange(0.4, 3.6, 0.02):
        pose = SE2(float(x), 0.45)
        for mount in mounts:
            subject.update(Belief(pose), echo(first_echo(world, pose @ mount), mount))
    grid = subject.grid()
    assert grid is not None
    centres = grid.world_from_cell(np.argwhere(grid.occupied))
    off = np.minimum(np.abs(centres[:, 1] - 0.025), np.abs(centres[:, 1] - 0.975))
    assert off.max() <= SIZE + 1e-9
    for y in (0.025, 0.975):
        passed = [grid.occupied[tuple(grid.cell_from_world((x, y)))] for x in np.arange(0.525, 3.5, SIZE)]
        assert np.mean(passed) >= 0.95
    inside = grid.cell_from_world([(x, 0.45) for x in np.arange(0.5, 3.4, SIZE)])
    assert grid.free[inside[:, 0], inside[:, 1]].all()


def context(sonars: tuple[RangeSensor, ...], lidar: RangeSensor | None, **parameters: object) -> Context:
    limits = Limits(-0.2, 0.4, 1.5, 0.8, 4.0)
    calibration = Calibration(0.042, np.array([0.0, 1.0]), np.array([0.4, 0.4]))
    robot = Robot(Footprint.circle(0.1), limits, calibration, 200, sonars, lidar)
    return Context(robot, None, SE2(), (), dict(parameters), np.random.default_rng(0), 0.05)


SENSOR = RangeSensor("one", SE2(), np.zeros(1), WIDTH, 0.0, 5.0, 0.1)


def test_a_mapper_needs_its_sensor() -> None:
    """Oracle: the message says what to fit."""
    with pytest.raises(ParameterError, match=r"robot\.lidar"):
        mapping.build_laser(context((SENSOR,), None))
    with pytest.raises(ParameterError, match=r"robot\.sonars"):
        mapping.build_sonar(context((), replace(SENSOR, beam_width=0.0)))
    with pytest.raises(ParameterError, match="resolution"):
        mapping.build_sonar(context((SENSOR,), None, resolution=-1.0))


def test_each_mapper_takes_its_own_sensor() -> None:
    """Oracle: by hand: lasers are not for `sonar`, sonars not for `laser`."""
    laser_scan = Observation(0.0, lidar=Scan(0.0, np.array([1.0]), np.zeros(1), 5.0))
    for build, mine, other in (
        (mapping.build_laser, laser_scan, echo(1.0)),
        (mapping.build_sonar, echo(1.0), laser_scan),
    ):
        subject = build(context((SENSOR,), replace(SENSOR, beam_width=0.0)))
        subject.update(Belief(SE2()), other)
        assert subject.grid() is None
        subject.update(Belief(SE2()), mine)
        assert subject.grid().free.any()  # type: ignore[union-attr]
