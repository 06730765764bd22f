"""Dead reckoning. Oracles: closed forms of straights, arcs and spins; sampling for the covariance; a scalar Kalman filter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, STOP, Calibration, Context, Footprint, Limits, Observation, Reading, Robot, Twist, WheelAngles
from robocar.estimation.odometry.odometry import (
    CompassOdometryEstimator,
    OdometryEstimator,
    OdometryParameters,
    WheelOdometry,
    build,
    build_with_compass,
    propagate,
)

RADIUS, TRACK, DT = 0.04, 0.25, 0.05
ONE_TRACK = Calibration(RADIUS, np.array([0.0, 100.0]), np.array([TRACK, TRACK]))
SLIPPING = Calibration(RADIUS, np.array([1.0, 10.0]), np.array([0.20, 0.29]))


def context(start: SE2 | None = None, calibration: Calibration = ONE_TRACK, **parameters: object) -> Context:
    limits = Limits(-0.2, 0.4, 1.5, 0.8, 4.0)
    robot = Robot(Footprint.rectangle(0.1, 0.1, 0.1), limits, calibration, 200, compass=True)
    return Context(robot, None, start, (), parameters, np.random.default_rng(0), DT)


def wheels(twist: Twist, time: float, track: float = TRACK) -> WheelAngles:
    """Angles of wheels that have rolled for `time` without slip."""
    half = 0.5 * track * twist.omega
    return WheelAngles((twist.v - half) * time / RADIUS, (twist.v + half) * time / RADIUS)


def seen(time: float, twist: Twist, track: float = TRACK, compass: float | None = None) -> Observation:
    reading = None if compass is None else Reading(time, compass)
    return Observation(time, wheel_angles=Reading(time, wheels(twist, time, track)), compass=reading)


def reckon(estimator: OdometryEstimator, twist: Twist, seconds: float, track: float = TRACK):
    for tick in range(round(seconds / DT) + 1):
        belief = estimator.update(seen(tick * DT, twist, track), STOP)
    return belief


def assert_pose(pose: SE2, x: float, y: float, theta: float, tolerance: float = 1e-9) -> None:
    assert (pose.x, pose.y) == pytest.approx((x, y), abs=tolerance)
    assert math.remainder(pose.theta - theta, math.tau) == pytest.approx(0.0, abs=tolerance)


class TestClosedForms:
    def test_straight(self) -> None:
        belief = reckon(build(context(SE2(1.0, 2.0, math.pi / 2))), Twist(0.3), 4.0)
        assert_pose(belief.pose, 1.0, 2.0 + 1.2, math.pi / 2)
        assert belief.twist.v == pytest.approx(0.3)
        assert belief.twist.omega == pytest.approx(0.0, abs=1e-9)

    def test_spin(self) -> None:
        belief = reckon(build(context(SE2(1.0, 2.0, 0.5))), Twist(0.0, -0.8), 5.0)
        assert_pose(belief.pose, 1.0, 2.0, 0.5 - 4.0)
        assert belief.twist.omega == pytest.approx(-0.8)

    @given(v=st.floats(0.05, 0.4), omega=st.floats(-1.0, 1.0).filter(lambda w: abs(w) > 0.01), theta=st.floats(-3, 3))
    @settings(deadline=None, max_examples=40)
    def test_arc(self, v: float, omega: float, theta: float) -> None:
        """A circle of radius v / omega around the point to the left of the start."""
        belief = reckon(build(context(SE2(0.5, -0.5, theta))), Twist(v, omega), 3.0)
        radius, end = v / omega, theta + 3.0 * omega
        x = 0.5 + radius * (math.sin(end) - math.sin(theta))
        y = -0.5 - radius * (math.cos(end) - math.cos(theta))
        assert_pose(belief.pose, x, y, end, 1e-8)

    @pytest.mark.parametrize(("curvature", "track"), [(0.5, 0.20), (1.0, 0.20), (4.0, 0.23), (10.0, 0.29), (30.0, 0.29)])
    def test_the_track_of_the_curvature_that_is_driven(self, curvature: float, track: float) -> None:
        """By hand from the table (1, 0.20), (10, 0.29): linear in between, held beyond.

        The wheels turn as such a car's would. Speed and track determine each other; odometry settles that to 3 %.
        """
        twist = Twist(0.1, 0.1 * curvature)
        assert SLIPPING.effective_track(0.1, 0.1 * curvature) == pytest.approx(track)
        belief = reckon(build(context(SE2(), SLIPPING)), twist, 2.0, track)
        assert belief.twist.omega == pytest.approx(twist.omega, rel=0.03)
        radius, end = 1.0 / curvature, 2.0 * twist.omega
        assert_pose(belief.pose, radius * math.sin(end), radius * (1 - math.cos(end)), end, 0.03 * end)

    def test_the_first_reading_is_where_counting_begins(self) -> None:
        odometry = WheelOdometry(ONE_TRACK, SE2(1.0, 0.0, 0.0))
        assert odometry.update(0.0, WheelAngles(100.0, 120.0)) == SE2()
        odometry.update(DT, WheelAngles(101.0, 121.0))
        assert_pose(odometry.pose, 1.0 + RADIUS, 0.0, 0.0)

    def test_it_begins_at_the_start_that_it_is_told(self) -> None:
        estimator = build(context(SE2(1.0, 0.0, 0.0)))
        belief = estimator.update(seen(0.0, Twist()), STOP)
        assert belief.pose == SE2(1.0, 0.0, 0.0)
        assert np.array_equal(belief.covariance, np.zeros((3, 3)))


class TestOtherOdometry:
    def test_encoders_slower_than_the_control_period(self) -> None:
        """Between two readings nothing is known, so nothing is added, and the next reading brings all of it."""
        estimator, twist = build(context()), Twist(0.3, 0.4)
        for tick in range(81):
            time = tick * DT
            belief = estimator.update(seen(time, twist) if tick % 4 == 0 else Observation(time), STOP)
        expected = twist.step(4.0)
        assert_pose(belief.pose, expected.x, expected.y, expected.theta)

    def test_a_twist_is_kept_until_the_next_one(self) -> None:
        """MRCLAM: 0.2 m/s from 0 s on, turning on the spot from 1.5 s on, at irregular times."""
        estimator = build(context())
        first, second = Reading(0.0, Twist(0.2)), Reading(1.5, Twist(0.0, 0.5))
        for time, twist in ((0.0, first), (0.4, None), (1.1, None), (1.5, second), (2.0, None), (3.5, None)):
            belief = estimator.update(Observation(time, twist=twist), STOP)
        assert_pose(belief.pose, 0.3, 0.0, 1.0)

    def test_a_pose_that_drifts_counts_by_its_steps(self) -> None:
        """CARMEN: poses in a frame of their own; the first says nothing, the others what changed since."""
        odom_from_world = SE2(4.0, -3.0, 2.0)
        estimator = build(context(SE2(1.0, 1.0, 0.0)))
        way = [SE2(1.0, 1.0, 0.0), SE2(1.5, 1.0, 0.3), SE2(2.0, 1.4, 0.9)]
        for tick, pose in enumerate(way):
            belief = estimator.update(Observation(tick * 1.0, odom_pose=Reading(tick * 1.0, odom_from_world @ pose)), STOP)
            estimator.update(Observation(tick + 0.5), STOP)
        assert_pose(belief.pose, 2.0, 1.4, 0.9)

    def test_without_any_odometry_it_stays(self) -> None:
        estimator = build(context(SE2(1.0, 2.0, 3.0)))
        assert [estimator.update(Observation(t), STOP).pose for t in (0.0, 1.0, 2.0)] == [SE2(1.0, 2.0, 3.0)] * 3


class TestCovariance:
    def test_against_sampling(self) -> None:
        """20 000 cars whose steps carry the noise that the docstring states."""
        rng, parameters = np.random.default_rng(3), OdometryParameters(0.01, 0.03, 0.02)
        steps = [Twist(0.3, 0.5 * math.sin(0.3 * k)).step(0.2) for k in range(30)]
        poses = np.zeros((20_000, 3))
        pose, covariance = SE2(), np.zeros((3, 3))
        for step in steps:
            way, turn = math.hypot(step.x, step.y), abs(step.theta)
            along = step.x + parameters.distance_std * math.sqrt(way) * rng.standard_normal(len(poses))
            heading = math.sqrt(parameters.turn_std**2 * turn + parameters.drift_std**2 * way) * rng.standard_normal(len(poses))
            c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
            poses += np.stack([c * along - s * step.y, s * along + c * step.y, step.theta + heading], axis=1)
            covariance = propagate(covariance, pose, step, parameters)
            pose = pose @ step
        sampled = np.cov(poses.T)
        scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
        assert np.abs((covariance - sampled) / scale).max() < 0.05

    def test_standing_adds_nothing(self) -> None:
        before = np.diag([0.1, 0.2, 0.3])
        assert np.array_equal(propagate(before, SE2(1, 2, 3), SE2(), OdometryParameters()), before)

    @given(st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.2, 0.2), st.floats(-1, 1)), min_size=1, max_size=20))
    @settings(deadline=None)
    def test_it_is_symmetric_and_grows(self, steps: list[tuple[float, float, float]]) -> None:
        covariance, pose, headings = np.zeros((3, 3)), SE2(), [0.0]
        for step in steps:
            covariance = propagate(covariance, pose, SE2(*step), OdometryParameters())
            pose = pose @ SE2(*step)
            headings.append(covariance[2, 2])
        assert np.allclose(covariance, covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(covariance).min() >= -1e-12
        assert np.all(np.diff(headings) >= 0)

    def test_a_belief_is_not_changed_afterwards(self) -> None:
        estimator = build(context())
        estimator.update(seen(0.0, Twist(0.3)), STOP)
        first = estimator.update(seen(DT, Twist(0.3)), STOP)
        assert first.covariance is not None
        kept = first.covariance.copy()
        reckon(estimator, Twist(0.3), 1.0)
        assert np.array_equal(first.covariance, kept)


class TestCompass:
    def drifting(self, estimator: OdometryEstimator, noise: float) -> tuple[float, float, np.ndarray]:
        """The car truly drives straight, its wheels say that it turns left: errors in heading and y, covariance."""
        rng, told = np.random.default_rng(1), Twist(0.3, 0.05)
        for tick in range(401):
            reading = 0.0 + noise * rng.standard_normal()
            belief = estimator.update(seen(tick * DT, told, compass=reading), STOP)
        assert belief.covariance is not None
        return abs(belief.pose.theta), abs(belief.pose.y), belief.covariance

    def test_corrects_heading_and_way(self) -> None:
        """Dead reckoning alone is off by 0.05 rad/s x 20 s = 1 rad."""
        heading, aside, covariance = self.drifting(build_with_compass(context(drift_std=0.05)), math.radians(0.5))
        alone, far, _ = self.drifting(build(context(drift_std=0.05)), math.radians(0.5))
        assert alone == pytest.approx(1.0, abs=1e-6)
        assert far > 2.0
        assert heading < 0.05
        assert aside < 0.2
        assert 0 < covariance[2, 2] < math.radians(0.5) ** 2

    def test_is_the_scalar_kalman_filter_on_the_spot(self) -> None:
        """Turning on the spot the heading alone is uncertain: variance and mean by the textbook's three lines."""
        parameters = OdometryParameters()
        estimator, r = build_with_compass(context()), CompassOdometryEstimator.COMPASS_STD**2
        rng = np.random.default_rng(2)
        mean = variance = 0.0
        for tick in range(100):
            reading = 0.3 * tick * DT + 0.01 * rng.standard_normal()
            belief = estimator.update(seen(tick * DT, Twist(0.0, 0.3), compass=reading), STOP)
            turned = 0.3 * DT if tick else 0.0
            mean, variance = mean + turned, variance + parameters.turn_std**2 * turned
            gain = variance / (variance + r)
            mean, variance = mean + gain * (reading - mean), (1 - gain) * variance
        assert belief.covariance is not None
        assert belief.covariance[2, 2] == pytest.approx(variance, rel=1e-6)
        assert belief.pose.theta == pytest.approx(math.remainder(mean, math.tau), abs=1e-9)

    def test_takes_the_short_way_round(self) -> None:
        """Heading near +pi, compass just beyond: -pi + 0.02."""
        estimator = build_with_compass(context(SE2(0.0, 0.0, math.pi - 0.01), drift_std=1.0))
        for tick in range(20):
            belief = estimator.update(seen(tick * DT, Twist(0.3), compass=-math.pi + 0.02), STOP)
        assert abs(math.remainder(belief.pose.theta - (-math.pi + 0.02), math.tau)) < 0.005
        assert abs(belief.pose.y) < 0.02
        assert belief.pose.x < -0.25

    def test_without_a_reading_it_is_odometry(self) -> None:
        with_compass, without = build_with_compass(context()), build(context())
        assert reckon(with_compass, Twist(0.3, 0.4), 2.0).pose == reckon(without, Twist(0.3, 0.4), 2.0).pose
