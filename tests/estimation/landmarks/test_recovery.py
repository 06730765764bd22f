"""When the particle filter looks elsewhere: exactly where what is measured is improbable under the sensor model itself.

Oracles: the sensor model's own expectation (closed form), draws from it, true poses of a kinematic world.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from robocar.core import SE2, STOP, Array, Detection, Observation
from robocar.estimation.landmarks import ekf, particle_filter, sensor_models
from robocar.estimation.landmarks.area import Area
from robocar.estimation.landmarks.particle_filter import FilterParameters, ParticleFilter
from robocar.estimation.landmarks.sensor_models import EXPECTED_MATCH, Atlas, reweigh
from robocar.estimation.odometry.motion_models import MotionParameters
from tests.estimation.landmarks.localization import BEARING_STD, MARKS, RANGE_STD, context, drive, sight

START = SE2(1.5, 0.8, 0.3)
EXACT = {"bearing_std": 0.0, "range_std": 0.0, "detector": {"bearing_std": 0.0, "range_std": 0.0}}
KERNELS = {"bearing-range": sensor_models.bearing_range, "ranges": sensor_models.ranges}


def count(particles: int) -> dict[str, int]:
    return {"min_particles": particles, "max_particles": particles}


def measured(pose: SE2, mark: int, tail: float, rng: np.random.Generator) -> Detection:
    """A sighting drawn from the sensor model: a split normal range, a normal bearing."""
    exact = sight(pose, MARKS[mark], 0.0)
    short = rng.random() < tail / (1.0 + tail)
    off = RANGE_STD * abs(rng.standard_normal()) * (-tail if short else 1.0)
    bearing = exact.bearing + BEARING_STD * rng.standard_normal()
    return replace(exact, bearing=bearing, range=exact.range + off, short_tail=tail)


@pytest.mark.parametrize("model", sorted(KERNELS))
@pytest.mark.parametrize("spread", [0.01, 0.05, 0.3])
@pytest.mark.parametrize("tail", [1.0, 2.5])
def test_a_right_filter_explains_on_average_what_the_sensor_model_says(model: str, spread: float, tail: float) -> None:
    """However sure the filter is: truth and particles from one prior, one sighting from the truth (posterior predictive)."""
    rng = np.random.default_rng(4)
    trials, std = 300, np.array([spread, spread, 0.5 * spread])
    values = []
    for trial in range(trials):
        particles = START.as_array() + rng.standard_normal((4000, 3)) * std
        truth = SE2(*map(float, START.as_array() + rng.standard_normal(3) * std))
        matches = KERNELS[model](particles, Atlas(MARKS).sightings([measured(truth, trial % 4, tail, rng)], 0.0, 0.0))
        weights = np.full(len(particles), 1.0 / len(particles))
        reweigh(weights, matches.likelihoods(0.0))
        values.append(matches.explained(weights))
    expected = EXPECTED_MATCH[model]
    assert np.mean(values) == pytest.approx(expected.mean, abs=4.0 * expected.std / math.sqrt(trials))


@pytest.mark.parametrize(("model", "dimensions"), [("bearing-range", 2), ("ranges", 1), ("headings", 1)])
def test_mean_and_spread_of_a_match_are_those_of_normal_errors(model: str, dimensions: int) -> None:
    draws = np.exp(-0.5 * np.sum(np.random.default_rng(0).standard_normal((200_000, dimensions)) ** 2, axis=1))
    assert EXPECTED_MATCH[model].mean == pytest.approx(draws.mean(), abs=0.003)
    assert EXPECTED_MATCH[model].std == pytest.approx(draws.std(), abs=0.003)


def alarms(filtered: ParticleFilter, pictures: Iterator[list[Detection]]) -> list[bool]:
    """Whether the filter thinks that it is lost, after each picture; nothing is resampled."""
    lost = []
    for picture in pictures:
        filtered.weigh(picture)
        lost.append(filtered.lost_share > 0.0)
    return lost


def standing(model: str, start: SE2 = START, **parameters) -> ParticleFilter:
    """A filter on a robot that stands, with all its particles at one place."""
    given = FilterParameters(model=model, bearing_std=0.0, range_std=0.0, initial_std_xy=0.0, initial_std_theta=0.0, **parameters)
    return ParticleFilter(given, MotionParameters(), Atlas(MARKS), Area(None, MARKS), start, np.random.default_rng(0))


@pytest.mark.parametrize("model", sorted(KERNELS))
@pytest.mark.parametrize("tail", [1.0, 2.5])
def test_no_alarm_while_sightings_are_as_the_sensor_model_says(model: str, tail: float) -> None:
    rng = np.random.default_rng(1)
    pictures = ([measured(START, mark, tail, rng) for mark in range(4)] for _ in range(3000))
    assert not any(alarms(standing(model, **count(5)), pictures))


@pytest.mark.parametrize("model", sorted(KERNELS))
def test_good_readings_do_not_make_ordinary_ones_suspect(model: str) -> None:
    """The ratio of a fast to a slow average fired here (MRCLAM's robots 3 and 4)."""
    rng = np.random.default_rng(2)
    good = [[sight(START, mark, 0.0) for mark in MARKS]] * 500
    ordinary = [[measured(START, k % 4, 1.0, rng)] for k in range(500)]
    assert not any(alarms(standing(model, **count(5)), iter(good + ordinary)))


@pytest.mark.parametrize("model", sorted(KERNELS))
def test_a_filter_that_stays_wrong_stays_lost(model: str) -> None:
    """The slow average sank to the fast one, and the alarm ended by itself (the thesis' `ranges`)."""
    rng = np.random.default_rng(3)
    elsewhere = SE2(2.6, 1.9, 2.0)
    lost = alarms(standing(model, elsewhere, **count(5)), ([measured(START, k % 4, 1.0, rng)] for k in range(1000)))
    assert lost.index(True) < 12
    assert all(lost[12:])


def test_one_bad_picture_is_no_alarm_however_much_it_shows() -> None:
    bad = [replace(sight(START, mark, 0.0), bearing=3.0) for mark in MARKS] * 2
    good = [sight(START, mark, 0.0) for mark in MARKS]
    assert not any(alarms(standing("bearing-range", **count(5)), iter([good, bad, bad, good, bad, good])))


def lost_ticks(filtered, steps: Iterator[tuple[Observation, SE2]]) -> tuple[Array, Array]:
    """Whether it was lost after each tick, and the position errors [m]."""
    lost, off = [], []
    for observation, true in steps:
        belief = filtered.update(observation, STOP)
        lost.append(filtered.filter.lost_share > 0.0)
        off.append(belief.pose.distance_to(true))
    return np.array(lost), np.array(off)


@pytest.mark.parametrize("seed", range(2))
def test_a_long_drive_has_no_false_alarm(seed: int) -> None:
    lost, off = lost_ticks(particle_filter.build(context(START, seed, **count(300), **EXACT)), drive(START, 150.0, seed))
    assert not lost.any()
    assert off.max() < 0.3


@pytest.mark.parametrize("seed", range(4))
def test_a_kidnapping_is_noticed_at_once_and_ends(seed: int) -> None:
    there = SE2(2.8, 1.9, -2.0)
    estimator = particle_filter.build(context(START, seed, **count(200)))
    lost, off = lost_ticks(estimator, drive(START, 50.0, seed, {20.0: there}))
    noticed = np.flatnonzero(lost)
    assert 200 <= noticed[0] <= 235  # one picture in 0.2 s
    assert noticed[-1] < 280
    assert off[300:].max() < 0.15


def with_ranges(start: SE2, duration: float, seed: int) -> Iterator[tuple[Observation, SE2]]:
    rng = np.random.default_rng(1000 + seed)
    for o, true in drive(start, duration, seed):
        yield Observation(o.time, odom_pose=o.odom_pose, landmarks=tuple(sight(true, m, o.time, rng) for m in MARKS)), true


@pytest.mark.parametrize("particles", [200, 400])
@pytest.mark.parametrize("seed", range(5))
def test_ranges_find_the_robot_from_no_prior_and_from_a_wrong_one(particles: int, seed: int) -> None:
    """Four labelled distances fix the position; a filter that has settled elsewhere notices."""
    parameters = {"model": "ranges", **count(particles)}
    _, off = lost_ticks(particle_filter.build(context(None, seed, **parameters)), with_ranges(START, 30.0, seed))
    assert off[200:].max() < 0.2
    wrong = SE2(2.9, 2.0, -2.5)
    lost, off = lost_ticks(particle_filter.build(context(wrong, seed, **parameters)), with_ranges(START, 30.0, seed))
    assert lost[:12].any()
    assert off[100:].max() < 0.2


def test_a_range_that_is_too_short_moves_the_kalman_filter_less_than_one_too_long() -> None:
    """With the tail towards short; without it both move it alike."""
    exact = sight(START, MARKS[1], 0.0)
    moved = {}
    for tail in (1.0, 3.0):
        for off in (-0.15, 0.15):
            estimator = ekf.build(context(START, initial_std_xy=0.1))
            seen = replace(exact, range=exact.range + off, short_tail=tail)
            moved[tail, off] = estimator.update(Observation(0.0, landmarks=(seen,)), STOP).pose.distance_to(START)
    assert moved[1.0, -0.15] == pytest.approx(moved[1.0, 0.15], rel=0.1)
    assert moved[3.0, -0.15] < 0.7 * moved[3.0, 0.15]
    assert moved[3.0, 0.15] == pytest.approx(moved[1.0, 0.15], rel=1e-6)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_a_tail_is_a_positive_number(bad: float) -> None:
    with pytest.raises(ValueError, match="short_tail"):
        Detection(0.0, "red", 0.0, 1.0, np.eye(2), bad)
