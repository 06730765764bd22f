"""Cones of rays. Oracles: the cone that the rays were drawn from, and the spread of repeated fits."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robocar.estimation.landmarks import cones

angles = st.floats(-0.5, 0.5)


def rim(axis: np.ndarray, half_angle: float, phi: np.ndarray) -> np.ndarray:
    """Rays at `half_angle` from the axis, (n, 3)."""
    a, b, c, d, e = cones.tangents(axis)
    right, down = np.array([a, 0.0, b]), np.array([c, d, e])
    across = np.cos(phi)[:, None] * right + np.sin(phi)[:, None] * down
    return math.cos(half_angle) * axis + math.sin(half_angle) * across


def direction(yaw: float, pitch: float) -> np.ndarray:
    return np.array([math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch)])


@given(angles, angles)
def test_tangents_and_axis_are_a_right_handed_orthonormal_frame(yaw: float, pitch: float) -> None:
    axis = direction(yaw, pitch)
    a, b, c, d, e = cones.tangents(axis)
    frame = np.array([[a, 0.0, b], [c, d, e], axis])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert math.isclose(np.linalg.det(frame), 1.0, abs_tol=1e-12)


@given(angles, angles, st.floats(0.02, 0.4), st.integers(8, 60), st.floats(0.0, 6.0), st.floats(2.0, math.tau))
def test_rays_of_a_cone_or_of_a_part_of_it_give_it_back(
    yaw: float, pitch: float, half_angle: float, count: int, start: float, extent: float
) -> None:
    axis = direction(yaw, pitch)
    phi = start + extent * np.arange(count) / count
    found, angle, inliers = cones.fit(rim(axis, half_angle, phi), 1e-4)
    np.testing.assert_allclose(found, axis, atol=1e-6)
    assert math.isclose(angle, half_angle, abs_tol=1e-6)
    assert inliers.all()


def test_a_third_of_outliers_on_a_straight_edge_is_rejected() -> None:
    axis, half_angle = direction(0.2, -0.1), 0.08
    phi = np.linspace(0.0, 4.2, 40)
    edge = rim(axis, half_angle, np.array([4.2, math.tau]))
    chord = edge[0] + np.linspace(0.1, 0.9, 20)[:, None] * (edge[1] - edge[0])
    chord /= np.linalg.norm(chord, axis=1)[:, None]
    found, angle, inliers = cones.fit(np.concatenate([rim(axis, half_angle, phi), chord]), 0.004)
    np.testing.assert_allclose(found, axis, atol=1e-3)
    assert math.isclose(angle, half_angle, abs_tol=1e-3)
    assert inliers[:40].all()
    assert not inliers[42:58].any()


def test_the_covariance_is_the_spread_of_fits_to_noisy_rays() -> None:
    """Oracle: 2000 fits; of axis and angle for an arc of 250 degrees, where they are correlated."""
    rng = np.random.default_rng(5)
    axis, half_angle, std = direction(0.1, 0.2), 0.1, 0.0005
    phi = np.linspace(0.3, 4.7, 60)
    right, down = (lambda t: (np.array([t[0], 0, t[1]]), np.array(t[2:])))(cones.tangents(axis))
    errors = []
    for _ in range(2000):
        rays = np.concatenate([rim(axis, half_angle + noise, phi[k : k + 1]) for k, noise in enumerate(rng.normal(0, std, 60))])
        found, angle, _ = cones.fit(rays, 0.01)
        errors.append((found @ right, found @ down, angle - half_angle))
    measured = np.cov(np.array(errors).T)
    stated = cones.covariance(cones.around(axis, rim(axis, half_angle, phi)), std)
    np.testing.assert_allclose(measured, stated, atol=0.12 * stated.max())


def test_the_arc_counts_directions() -> None:
    assert cones.arc(np.linspace(0.0, math.pi - 1e-6, 200)) == 0.5
    assert cones.arc(np.linspace(0.0, math.tau - 1e-6, 200)) == 1.0
    assert cones.arc(np.full(100, 1.0)) == 1 / 24
