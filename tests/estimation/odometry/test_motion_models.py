"""Motion models. Oracles: exact arcs without noise, stated variances, pieces of a way against the whole, samples."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import SE2, Twist, wrap_angle
from robocar.estimation.odometry.motion_models import Alphas, MotionParameters, arc_of, draw, move, propagate, turn_move_turn

small = st.floats(-0.5, 0.5)
STILL = {f"alpha{k}": 0.0 for k in (1, 2, 3, 4)} | {f"velocity_alpha{k}": 0.0 for k in (1, 2, 3, 4)}


def moved(start: SE2, step: SE2, parameters: MotionParameters, *, velocity: bool, n: int = 1, seed: int = 0) -> np.ndarray:
    particles = np.tile(start.as_array(), (n, 1))
    move(particles, np.zeros((n, 2)), step, velocity, parameters, np.random.default_rng(seed))
    return particles


@given(small, small, st.floats(-3.0, 3.0))
def test_turn_move_turn_puts_the_step_together_again(x: float, y: float, theta: float) -> None:
    rot1, trans, rot2 = turn_move_turn(x, y, theta)
    again = SE2(theta=rot1) @ SE2(x=trans) @ SE2(theta=rot2)
    assert math.hypot(again.x - x, again.y - y) < 2e-4  # below a tenth of a millimetre the direction is not known
    assert abs(wrap_angle(again.theta - theta)) < 1e-9
    assert abs(rot1) <= math.pi / 2 + 1e-9 or math.hypot(x, y) < 1e-4


@given(small, small, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_without_noise_the_odometry_model_composes(x: float, y: float, theta: float, heading: float) -> None:
    start, step = SE2(1.0, 2.0, heading), SE2(x, y, theta)
    got = SE2(*moved(start, step, MotionParameters(**STILL), velocity=False)[0])
    expected = start @ step
    assert got.distance_to(expected) < 2e-4
    assert abs(wrap_angle(got.theta - expected.theta)) < 1e-9


@given(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0), st.floats(-3.0, 3.0))
def test_without_noise_the_velocity_model_is_the_arc(v: float, omega: float, heading: float) -> None:
    """Thesis, eq. 2.39: x' = x - (v / w) sin(theta) + (v / w) sin(theta + w dt), and so on."""
    start, step = SE2(1.0, 2.0, heading), Twist(v, omega).step(0.7)
    got = moved(start, step, MotionParameters(**STILL), velocity=True)[0]
    if abs(omega) > 1e-3:
        r = v / omega
        x = 1.0 - r * math.sin(heading) + r * math.sin(heading + omega * 0.7)
        y = 2.0 + r * math.cos(heading) - r * math.cos(heading + omega * 0.7)
    else:
        x, y = 1.0 + v * 0.7 * math.cos(heading + 0.35 * omega), 2.0 + v * 0.7 * math.sin(heading + 0.35 * omega)
    assert got[:2] == pytest.approx((x, y), abs=1e-6)
    assert abs(wrap_angle(got[2] - heading - omega * 0.7)) < 1e-9


@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0))
def test_the_arc_of_a_step_is_the_arc_it_came_from(way: float, turn: float) -> None:
    assert arc_of(Twist(way, turn).step(1.0)) == pytest.approx((way, turn), abs=1e-6)


@pytest.mark.parametrize("kind", ["normal", "triangular"])
def test_noise_has_mean_0_and_variance_1(kind: str) -> None:
    noise = draw(np.random.default_rng(1), (200_000, 1), kind)  # type: ignore[arg-type]
    assert abs(noise.mean()) < 0.01
    assert noise.var() == pytest.approx(1.0, rel=0.02)
    assert abs((noise**4).mean() - {"normal": 3.0, "triangular": 2.4}[kind]) < 0.1  # their kurtoses
    assert (np.abs(noise).max() < math.sqrt(6.0)) == (kind == "triangular")


@pytest.mark.parametrize("noise", ["normal", "triangular"])
@pytest.mark.parametrize("velocity", [False, True])
@pytest.mark.parametrize("pieces", [1, 10])
def test_the_variances_are_those_of_the_table_however_the_way_is_cut(noise: str, velocity: bool, pieces: int) -> None:
    """A straight way of 1 m: turn alpha2, way alpha3. On the spot by 1 rad: turn alpha1."""
    a = {"alpha1": 0.01, "alpha2": 0.004, "alpha3": 0.002, "alpha4": 0.0}
    parameters = MotionParameters(noise=noise, **a, **{f"velocity_{name}": value for name, value in a.items()})
    rng, n = np.random.default_rng(3), 40_000
    ahead, turned = np.zeros((n, 3)), np.zeros((n, 3))
    for _ in range(pieces):
        move(ahead, np.zeros((n, 2)), SE2(x=1.0 / pieces), velocity, parameters, rng)
        move(turned, np.zeros((n, 2)), SE2(theta=1.0 / pieces), velocity, parameters, rng)
    assert ahead[:, 2].var() == pytest.approx(0.004, rel=0.05)
    assert ahead[:, 0].var() == pytest.approx(0.002, rel=0.05)
    assert turned[:, 2].var() == pytest.approx(0.01, rel=0.05)


def test_biases_scale_way_and_turn() -> None:
    parameters = MotionParameters(**STILL, bias_std=0.1, velocity_bias_std=0.2)
    for velocity, std in ((False, 0.1), (True, 0.2)):
        particles = np.zeros((2, 3))
        move(particles, np.array([[1.0, 0.0], [0.0, -2.0]]), SE2(x=2.0), velocity, parameters, np.random.default_rng(0))
        np.testing.assert_allclose(particles, [[2.0 * (1 + std), 0, 0], [2.0, 0, 0]], atol=1e-12)
        particles = np.zeros((2, 3))
        move(particles, np.array([[1.0, 0.0], [0.0, -2.0]]), SE2(theta=1.0), velocity, parameters, np.random.default_rng(0))
        np.testing.assert_allclose(particles, [[0, 0, 1.0], [0, 0, 1 - 2 * std]], atol=1e-12)


def test_the_propagated_covariance_is_the_spread_of_the_samples() -> None:
    alphas = Alphas(2e-3, 1e-3, 1e-3, 5e-4)
    parameters = MotionParameters(**{f"alpha{k}": value for k, value in enumerate(alphas, start=1)}, bias_std=0.02)
    rng, n = np.random.default_rng(4), 60_000
    start, step = SE2(0.3, -0.2, 0.7), SE2(0.30, 0.06, 0.4)
    before = np.diag([0.01**2, 0.02**2, 0.03**2, 1.0, 1.0])
    drawn = rng.multivariate_normal([0.3, -0.2, 0.7, 0.0, 0.0], before, n)
    particles, biases = drawn[:, :3].copy(), drawn[:, 3:].copy()
    move(particles, biases, step, False, parameters, rng)
    sampled = np.cov(np.concatenate([particles, biases], axis=1).T)
    stated = propagate(before, start, step, alphas, 0.02)
    np.testing.assert_allclose(sampled[:3, :3], stated[:3, :3], atol=0.06 * np.abs(stated[:3, :3]).max())
    np.testing.assert_allclose(sampled[:3, 3:], stated[:3, 3:], atol=3e-4)


@pytest.mark.parametrize("bad", [{"model": "flying"}, {"noise": "pink"}, {"alpha1": -1.0}, {"velocity_alpha3": math.nan}])
def test_senseless_parameters_are_refused(bad: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        MotionParameters(**bad)


def test_the_model_follows_from_the_odometry() -> None:
    assert [MotionParameters().by_velocity(commanded) for commanded in (True, False)] == [True, False]
    assert [MotionParameters(model="velocity").by_velocity(commanded) for commanded in (True, False)] == [True, True]
