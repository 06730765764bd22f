"""Estimates from particles. Oracles: numpy's weighted means and covariances, and groups put there by hand."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import wrap_angle
from robocar.estimation.landmarks.estimates import largest_group, mean_of_all


@given(st.integers(0, 1000), st.floats(-3.1, 3.1))
def test_the_mean_of_all_is_the_weighted_one_and_circular_for_the_heading(seed: int, heading: float) -> None:
    rng = np.random.default_rng(seed)
    particles = rng.normal([1.0, 2.0, heading], [0.2, 0.1, 0.15], (200, 3))
    particles[::2, 2] += math.tau
    weights = rng.dirichlet(np.ones(200))
    got = mean_of_all(particles, weights)
    np.testing.assert_allclose((got.pose.x, got.pose.y), weights @ particles[:, :2])
    angle = np.angle(weights @ np.exp(1j * particles[:, 2]))
    assert abs(wrap_angle(got.pose.theta - angle)) < 1e-9
    centred = particles - (got.pose.x, got.pose.y, angle)
    centred[:, 2] = np.angle(np.exp(1j * centred[:, 2]))
    np.testing.assert_allclose(got.covariance, (weights[:, None] * centred).T @ centred, atol=1e-12)


@given(st.integers(0, 1000), st.floats(-3.1, 3.1))
def test_particles_elsewhere_do_not_pull_the_group(seed: int, heading: float) -> None:
    rng = np.random.default_rng(seed)
    group = rng.normal([1.0, 2.0, heading], [0.03, 0.03, 0.05], (140, 3))
    others = rng.uniform([3, -3, -math.pi], [6, 0, math.pi], (60, 3))
    particles, weights = np.concatenate([others, group]), np.full(200, 1 / 200)
    got = largest_group(particles, weights, 0.4, 0.5)
    np.testing.assert_allclose((got.pose.x, got.pose.y), group[:, :2].mean(axis=0), atol=1e-9)
    assert abs(got.share - 0.7) < 1e-9
    np.testing.assert_allclose(got.covariance[:2, :2], np.cov(group[:, :2].T, bias=True), atol=1e-9)


def test_a_scattered_cloud_is_reported_as_such() -> None:
    rng = np.random.default_rng(2)
    particles = rng.uniform([0, 0, -math.pi], [4, 3, math.pi], (500, 3))
    got = largest_group(particles, np.full(500, 1 / 500), 0.4, 0.5)
    assert got.share > 0.999
    np.testing.assert_allclose(got.covariance[:2, :2], np.cov(particles[:, :2].T, bias=True), atol=1e-9)


def test_headings_on_both_sides_of_pi_are_one_group() -> None:
    particles = np.array([[0, 0, math.pi - 0.1], [0, 0, -math.pi + 0.1], [0, 0, math.pi]])
    got = largest_group(particles, np.full(3, 1 / 3), 0.4, 0.5)
    assert abs(wrap_angle(got.pose.theta - math.pi)) < 1e-9
    assert abs(got.covariance[2, 2] - 2 * 0.01 / 3) < 1e-9
