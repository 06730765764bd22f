"""The particle filter. Oracles: true poses of a kinematic world, an exact Bayes filter on a grid, the chi-square law."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from robocar.core import (
    SE2,
    STOP,
    Detection,
    Observation,
    OccupancyGrid,
    ParameterError,
    Reading,
    Scalar,
    ScenarioError,
    Segments,
    Text,
)
from robocar.estimation.landmarks import ekf, particle_filter
from robocar.estimation.landmarks.area import Area
from robocar.estimation.landmarks.guesses import Guesses
from robocar.estimation.landmarks.particle_filter import FilterParameters, ParticleFilter
from robocar.estimation.landmarks.sensor_models import Atlas
from robocar.estimation.odometry.motion_models import MotionParameters
from tests.estimation.landmarks.localization import MARKS, PERIOD, context, drive, sight

START = SE2(1.5, 0.8, 0.3)
TWO_HUNDRED = {"min_particles": 200, "max_particles": 200}
ESTIMATORS = {"particle-filter": particle_filter.build, "ekf": ekf.build}


def errors(estimator, steps) -> np.ndarray:
    """x, y, theta [m, m, rad] and their normalized square, per tick, (n, 4)."""
    rows = []
    for observation, true in steps:
        belief = estimator.update(observation, STOP)
        off = belief.pose.as_array() - true.as_array()
        off[2] = math.remainder(off[2], math.tau)
        rows.append((*off, off @ np.linalg.solve(belief.covariance, off)))
    return np.array(rows)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_tracking_from_a_known_start(name: str) -> None:
    off = errors(ESTIMATORS[name](context(START)), drive(START, 40.0, 1))
    assert np.sqrt(np.mean(off[50:, 0] ** 2 + off[50:, 1] ** 2)) < 0.04
    assert np.sqrt(np.mean(off[50:, 2] ** 2)) < math.radians(2.0)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
@pytest.mark.parametrize("seed", range(4))
def test_global_localization_without_a_start(name: str, seed: int) -> None:
    parameters = TWO_HUNDRED if name == "particle-filter" else {}
    off = errors(ESTIMATORS[name](context(None, seed, **parameters)), drive(START, 20.0, seed))
    assert np.all(np.hypot(off[100:, 0], off[100:, 1]) < 0.15)  # from 10 s on
    assert np.all(np.abs(off[100:, 2]) < math.radians(10.0))


@pytest.mark.parametrize("seed", range(4))
def test_a_kidnapped_robot_finds_itself(seed: int) -> None:
    there = SE2(2.8, 1.9, -2.0)
    off = errors(particle_filter.build(context(START, seed, **TWO_HUNDRED)), drive(START, 50.0, seed, {20.0: there}))
    assert np.hypot(*off[201, :2]) > 1.0  # it cannot know at once
    assert np.all(np.hypot(off[350:, 0], off[350:, 1]) < 0.15)  # 15 s later


def test_without_recovery_it_does_not() -> None:
    """Oracle for the test above: it is the recovery that finds it."""
    there = SE2(2.8, 1.9, -2.0)
    estimator = particle_filter.build(context(START, 0, **TWO_HUNDRED, recovery_alpha_fast=0.0))
    off = errors(estimator, drive(START, 50.0, 0, {20.0: there}))
    assert np.hypot(off[-100:, 0], off[-100:, 1]).min() > 0.3


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_odometry_that_always_overstates_turns_is_learnt(name: str) -> None:
    """A car that turns 4 % less than its wheels say: with biases of that size allowed, the errors stay those of a true one."""
    learning = errors(ESTIMATORS[name](context(START, motion={"bias_std": 0.05})), drive(START, 60.0, 2, scale=0.96))
    stubborn = errors(ESTIMATORS[name](context(START, motion={"bias_std": 0.0})), drive(START, 60.0, 2, scale=0.96))
    assert np.mean(learning[200:, 3]) < 0.7 * np.mean(stubborn[200:, 3])
    assert np.sqrt(np.mean(learning[200:, 2] ** 2)) < math.radians(2.0)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_stated_and_real_errors_agree_or_the_filter_is_careful(name: str) -> None:
    """NEES over 20 seeds: its mean has the distribution chi-square(60) / 20; being careful (below the lower bound) is allowed."""
    alphas = {"alpha1": 3e-4, "alpha2": 3e-4, "alpha3": 2e-4, "alpha4": 1e-5}
    parameters = {"bearing_std": 0.0, "range_std": 0.0, "motion": alphas, "detector": {"bearing_std": 0.0, "range_std": 0.0}}
    values = [
        np.mean(errors(ESTIMATORS[name](context(START, s, **parameters)), drive(START, 15.0, s))[30:, 3]) for s in range(20)
    ]
    assert np.mean(values) < chi2.ppf(0.975, 60) / 20
    assert np.mean(values) > 0.5


def test_a_standing_robot_has_the_posterior_of_an_exact_filter_on_a_grid() -> None:
    """Oracle: Bayes' rule on a fine grid of poses around the truth, for four sightings."""
    rng = np.random.default_rng(8)
    seen = [sight(START, mark, 0.0, rng) for mark in MARKS]
    axes = [np.linspace(c - w, c + w, 41) for c, w in zip(START.as_array(), (0.12, 0.12, 0.08), strict=True)]
    x, y, theta = np.meshgrid(*axes, indexing="ij")
    log = np.zeros_like(x)
    for mark, d in zip(MARKS, seen, strict=True):
        dx, dy = mark.position[0] - x, mark.position[1] - y
        bearing = np.angle(np.exp(1j * (np.arctan2(dy, dx) - theta - d.bearing)))
        log -= 0.5 * (bearing**2 / d.covariance[0, 0] + (np.hypot(dx, dy) - d.range) ** 2 / d.covariance[1, 1])
    p = np.exp(log - log.max())
    p /= p.sum()
    mean = np.array([(p * a).sum() for a in (x, y, theta)])
    std = np.sqrt([(p * (a - m) ** 2).sum() for a, m in zip((x, y, theta), mean, strict=True)])
    n = 100_000
    parameters = FilterParameters(
        min_particles=n, max_particles=n, bearing_std=0.0, range_std=0.0, outlier=1e-9, initial_std_xy=0.1, initial_std_theta=0.1
    )
    wide = ParticleFilter(parameters, MotionParameters(), Atlas(MARKS), Area(None, MARKS), START, np.random.default_rng(0))
    # An even prior, as the grid has.
    wide.particles = START.as_array() + np.random.default_rng(1).uniform(-1, 1, (n, 3)) * (0.12, 0.12, 0.08)
    assert wide.weigh(seen)
    got = wide.estimate()
    np.testing.assert_allclose(got.pose.as_array(), mean, atol=0.1 * std.min())
    np.testing.assert_allclose(np.sqrt(np.diag(got.covariance)), std, rtol=0.05)


def test_with_no_sighting_explained_it_goes_on_and_says_so() -> None:
    estimator = particle_filter.build(context(START, outlier=0.0, recovery_alpha_fast=0.0, **TWO_HUNDRED))
    impossible = Detection(0.0, "red", 0.0, 400.0, np.diag([1e-8, 1e-8]))
    belief = estimator.update(Observation(0.0, landmarks=(impossible,)), STOP)
    assert isinstance(belief.trace["localization/state"], Text)
    assert belief.trace["localization/state"].level == "WARN"
    assert np.allclose(belief.particles[:, 3], 1 / 200)
    assert belief.pose.distance_to(START) < 0.1


def test_the_same_seed_gives_the_same_beliefs() -> None:
    runs = [errors(particle_filter.build(context(None, 5)), drive(START, 6.0, 3)) for _ in range(2)]
    np.testing.assert_array_equal(*runs)
    assert not np.array_equal(runs[0], errors(particle_filter.build(context(None, 77)), drive(START, 6.0, 3)))


@pytest.mark.parametrize(
    "settings", [{"resample": "wheel"}, {"resample": "residual"}, {"motion": {"noise": "triangular"}}, {"estimate": "mean"}]
)
def test_the_thesis_variants_track_as_well(settings: dict) -> None:
    off = errors(particle_filter.build(context(START, **TWO_HUNDRED, **settings)), drive(START, 20.0, 4))
    assert np.sqrt(np.mean(off[50:, 0] ** 2 + off[50:, 1] ** 2)) < 0.06


def test_ranges_alone_locate_a_moving_robot() -> None:
    """The thesis' simulation: distances to all four landmarks, from no prior."""
    rng = np.random.default_rng(6)
    estimator = particle_filter.build(context(None, 1, model="ranges", min_particles=1000, max_particles=1000))
    steps = (
        (Observation(o.time, odom_pose=o.odom_pose, landmarks=tuple(sight(true, m, o.time, rng) for m in MARKS)), true)
        for o, true in drive(START, 40.0, 6)
    )
    off = errors(estimator, steps)
    assert np.all(np.hypot(off[200:, 0], off[200:, 1]) < 0.15)
    assert np.all(np.abs(off[200:, 2]) < math.radians(15.0))


def test_headings_keep_the_heading_of_a_robot_that_knows_its_start() -> None:
    """The thesis' robot knows pairs of colours only; it turns 3 % less than its wheels say."""
    estimator = particle_filter.build(context(START, 1, model="headings", **TWO_HUNDRED))
    steps = (
        (
            Observation(o.time, odom_pose=o.odom_pose, landmarks=(sight(true, MARKS[0], o.time), sight(true, MARKS[1], o.time))),
            true,
        )
        for o, true in drive(START, 40.0, 6, scale=0.97)
    )
    off = errors(estimator, steps)
    assert np.abs(off[:, 2]).max() < math.radians(40.0)


def test_two_landmarks_of_one_name_are_told_apart_by_the_others() -> None:
    rng = np.random.default_rng(3)
    names = ("blue", "blue", "orange", "red")
    marks = tuple(type(m)(f"{name}{k}", name, m.position, m.radius) for k, (m, name) in enumerate(zip(MARKS, names, strict=True)))
    estimator = particle_filter.build(context(None, 2, marks))
    steps = (
        (Observation(o.time, odom_pose=o.odom_pose, landmarks=tuple(sight(true, m, o.time, rng, m.color) for m in marks)), true)
        for o, true in drive(START, 15.0, 3)
    )
    off = errors(estimator, steps)
    assert np.all(np.hypot(off[100:, 0], off[100:, 1]) < 0.15)


def test_the_number_of_particles_adapts() -> None:
    """Scattered over the field, many; on one spot, few (Fox 2003)."""
    estimator = particle_filter.build(context(None, 0, min_particles=50, max_particles=3000))
    counts = [len(estimator.update(o, STOP).particles) for o, _ in drive(START, 15.0, 1)]
    assert counts[0] == 3000
    assert counts[-1] < 400


def test_a_late_detection_counts_for_when_it_was_made() -> None:
    """Half a second late, at 0.25 m/s and 0.5 rad/s: the error stays small only if it is moved along with the car."""
    for name, build in ESTIMATORS.items():
        estimator = build(context(START))
        late, steps = [], []
        for o, true in drive(START, 20.0, 1):
            late.append(o.landmarks)
            steps.append((Observation(o.time, odom_pose=o.odom_pose, landmarks=late[-6] if len(late) > 5 else ()), true))
        off = errors(estimator, steps)
        assert np.sqrt(np.mean(off[50:, 0] ** 2 + off[50:, 1] ** 2)) < 0.05, name


def test_a_standing_robot_does_not_count_one_picture_again_and_again() -> None:
    """Fifty copies of one sighting say no more than one."""
    for name, build in ESTIMATORS.items():
        once, often = build(context(START, initial_std_xy=0.2)), build(context(START, initial_std_xy=0.2))
        still = Reading(0.0, SE2())
        one = once.update(Observation(0.0, odom_pose=still, landmarks=(sight(START, MARKS[0], 0.0),)), STOP)
        many = [
            often.update(Observation(k * PERIOD, odom_pose=still, landmarks=(sight(START, MARKS[0], k * PERIOD),)), STOP)
            for k in range(50)
        ][-1]
        np.testing.assert_allclose(many.covariance, one.covariance, err_msg=name)


def test_what_is_shown() -> None:
    estimator = particle_filter.build(context(START))
    seen = sight(START, MARKS[2], 0.0)
    belief = estimator.update(Observation(0.0, landmarks=(seen,)), STOP)
    assert belief.particles.shape[1] == 4
    assert belief.particles[:, 3].sum() == pytest.approx(1.0)
    rays = belief.trace["sightings"]
    assert isinstance(rays, Segments)
    assert rays.segments[0, 1] == pytest.approx(MARKS[2].position[:2], abs=0.1)
    n_eff = belief.trace["localization/n_eff"]
    assert isinstance(n_eff, Scalar)
    assert 1.0 <= n_eff.value <= len(belief.particles)


def test_guesses_from_pairs_and_circles_explain_what_is_seen() -> None:
    rng = np.random.default_rng(1)
    guesses = Guesses(Atlas(MARKS), Area(None, MARKS), 0.0, 0.0)
    before, now = SE2(0.2, 0.1, 0.3), SE2(0.5, 0.2, 0.6)
    then = START @ now.inverse() @ before
    first, second = sight(then, MARKS[3], 0.0), sight(START, MARKS[1], 0.5)
    guesses.see(before, [first])
    poses = guesses.draw(400, now, [second], rng)
    assert len(poses) == 400
    pairs, circles = poses[:200], poses[200:]
    # Two landmarks leave one pose, as well as their noise allows.
    assert np.percentile(np.hypot(*(pairs[:, :2] - START.position).T), 90) < 0.25
    distances = np.hypot(*(circles[:, :2] - MARKS[1].position[:2]).T)
    assert np.percentile(np.abs(distances - second.range), 90) < 0.15
    assert np.ptp(np.arctan2(*(circles[:, :2] - MARKS[1].position[:2]).T)) > 1.0


def test_guesses_from_ranges_lie_where_the_circles_meet() -> None:
    rng = np.random.default_rng(1)
    guesses = Guesses(Atlas(MARKS), Area(None, MARKS), 0.0, 0.0)
    seen = [sight(START, mark, 0.0) for mark in MARKS]
    poses = guesses.by_ranges(500, seen, rng)
    assert poses.shape == (500, 3)
    # Two circles meet twice; outside the area around the field, one of the places is mostly refused.
    near = np.hypot(*(poses[:, :2] - START.position).T) < 0.25
    assert near.mean() > 0.5
    assert np.ptp(poses[near, 2]) > 6.0
    assert guesses.by_ranges(20, seen[:1], rng).shape == (20, 3)
    assert guesses.by_ranges(20, [], rng).shape == (20, 3)


def test_the_area_is_the_free_part_of_the_map() -> None:
    data = np.full((10, 20), 100, dtype=np.int8)
    data[3:6, 5:9] = 0
    area = Area(OccupancyGrid(data, 0.1, SE2(1.0, 2.0, 0.5)), MARKS)
    points = area.sample(500, np.random.default_rng(0))
    assert area.holds(points).all()
    local = SE2(1.0, 2.0, 0.5).inverse().transform(points)
    assert local.min(axis=0) == pytest.approx((0.5, 0.3), abs=0.02)
    assert local.max(axis=0) == pytest.approx((0.9, 0.6), abs=0.02)
    assert not area.holds(np.array([[0.0, 0.0], [100.0, 0.0]])).any()
    around = Area(None, MARKS).sample(500, np.random.default_rng(0))
    assert around.min(axis=0) == pytest.approx((-1, -1), abs=0.1)
    assert around.max(axis=0) == pytest.approx((4.5, 3.5), abs=0.1)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_a_car_without_camera_or_a_field_without_landmarks_is_refused(name: str) -> None:
    from dataclasses import replace

    blind = context(START)
    with pytest.raises(ScenarioError, match=r"robot\.camera=true"):
        ESTIMATORS[name](replace(blind, robot=replace(blind.robot, camera=False)))
    with pytest.raises(ScenarioError, match="landmarks"):
        ESTIMATORS[name](context(START, marks=()))


@pytest.mark.parametrize(
    "bad",
    [
        {"min_particles": 0},
        {"max_particles": -5},
        {"min_particles": 500, "max_particles": 100},
        {"model": "sonar"},
        {"resample": "never"},
        {"outlier": 2.0},
        {"pf_err": 0.0},
        {"scatter_xy": -0.1},
        {"max_particles": "many"},
    ],
)
def test_senseless_parameters_are_refused(bad: dict) -> None:
    with pytest.raises(ParameterError, match="|".join(bad)):
        particle_filter.build(context(START, **bad))


@pytest.mark.parametrize("bad", [{"gate": 0.0}, {"bearing_std": -1.0}])
def test_senseless_parameters_of_the_kalman_filter_are_refused(bad: dict) -> None:
    with pytest.raises(ParameterError, match="|".join(bad)):
        ekf.build(context(START, **bad))


def test_alignment_gives_back_a_motion() -> None:
    rng = np.random.default_rng(2)
    motion = SE2(1.0, -2.0, 2.5)
    points = rng.normal(size=(5, 2))
    found, error = ekf.align(points, motion.transform(points))
    np.testing.assert_allclose(found.as_array(), motion.as_array(), atol=1e-9)
    assert error == 0.2
