"""Cones of rays. Oracles: the cone that the rays were drawn from, the spread of repeated fits, and the fit written with numpy."""

import math

import numpy as np
import pytest
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


def off_cone(units: np.ndarray, axis: np.ndarray, half_angle: float) -> np.ndarray:
    """How far rays (n, 3) are off a cone, (n,) [rad]."""
    return np.abs(np.arctan2(np.linalg.norm(np.cross(units, axis), axis=1), units @ axis) - half_angle)


def around_their_mean(units: np.ndarray) -> np.ndarray:
    """Places of the rays (n, 3) in the order in which they lie around their mean, from right over down, (n,)."""
    axis = units.mean(axis=0)
    axis /= np.linalg.norm(axis)
    right = np.array([axis[2], 0.0, -axis[0]])
    down = np.cross(axis, right)
    return np.argsort(np.arctan2(units @ down, units @ right) % math.tau, kind="stable")


def consensus(units: np.ndarray, tolerance: float) -> tuple[np.ndarray, float]:
    """Of the cones through three rays, a third, a quarter, a sixth and a ninth of the rim apart, the first one with most rays."""
    ring, found = units[around_their_mean(units)], []
    for share in (3, 4, 6, 9):
        step = max(1, len(ring) // share)
        for start in range(0, len(ring), max(1, len(ring) // 16)):
            a, b, c = (ring[(start + k * step) % len(ring)] for k in range(3))
            axis = np.cross(b - a, c - a)  # at right angles to the plane through their tips
            if np.linalg.norm(axis) >= 1e-12:
                axis *= np.sign(axis @ a) / np.linalg.norm(axis)
                half_angle = math.acos(min(1.0, axis @ a))
                found.append((np.count_nonzero(off_cone(units, axis, half_angle) < tolerance), axis, half_angle))
    _, axis, half_angle = max(found, key=lambda cone: cone[0])
    return axis, half_angle


def naive_fit(units: np.ndarray, tolerance: float) -> tuple[np.ndarray, float, np.ndarray]:
    """Consensus, then three times least squares: u . w = 1 for rays u of a cone, w = axis / cos(half
    angle). Half angle 0 where fewer than six rays lie on the cone."""
    axis, half_angle = consensus(units, tolerance)
    near = off_cone(units, axis, half_angle) < tolerance
    for _ in range(3):
        if np.count_nonzero(near) < 6:
            return axis, 0.0, near
        w = np.linalg.lstsq(units[near], np.ones(np.count_nonzero(near)), rcond=None)[0]
        axis, half_angle = w / np.linalg.norm(w), math.acos(min(1.0, 1.0 / float(np.linalg.norm(w))))
        near = off_cone(units, axis, half_angle) < tolerance
    return axis, half_angle if np.count_nonzero(near) >= 6 else 0.0, near


@pytest.mark.parametrize("outliers", [0.0, 0.4, 1.0])
def test_the_fit_is_the_one_written_with_numpy(outliers: float) -> None:
    """Oracle: consensus and least squares by numpy; noisy rays of a part of a rim, some or all of them anywhere."""
    rng, rejected = np.random.default_rng(12), 0
    for _ in range(80):
        axis, half_angle, n = direction(*rng.uniform(-0.5, 0.5, 2)), rng.uniform(0.02, 0.4), int(rng.integers(6, 80))
        units = rim(axis, half_angle, rng.uniform(0.0, 6.0) + rng.uniform(2.0, math.tau) * rng.random(n))
        astray = rng.random(n) < outliers
        units += rng.normal(0.0, np.where(astray, half_angle, 0.001)[:, None], (n, 3))
        units /= np.linalg.norm(units, axis=1)[:, None]
        tolerance = rng.uniform(0.001, 0.01)
        found, angle, inliers = cones.fit(units, tolerance)
        expected, expected_angle, expected_inliers = naive_fit(units, tolerance)
        assert angle == pytest.approx(expected_angle, abs=1e-7)
        rejected += expected_angle == 0.0
        if expected_angle > 0.0:
            np.testing.assert_allclose(found, expected, atol=1e-7)
            np.testing.assert_array_equal(inliers, expected_inliers)
    assert rejected < 60


@pytest.mark.parametrize("normal", [0, 1])
def test_rays_of_one_plane_are_no_cone(normal: int) -> None:
    """By hand: what lies on a straight line of the picture through its middle, as half angle 0."""
    units = np.insert(np.array([(math.sin(t), math.cos(t)) for t in np.linspace(-0.3, 0.3, 30)]), normal, 0.0, axis=1)
    assert cones.fit(units, 0.002)[1] == 0.0


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
