"""Resampling. Oracles: expected numbers of copies, their floor and ceiling, chi-square quantiles, numpy.unique."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.stats import chi2

from robocar.estimation.landmarks import resampling
from robocar.estimation.odometry.motion_models import bounded

weights = hnp.arrays(float, st.integers(1, 40), elements=st.floats(0.001, 1.0)).map(lambda w: w / w.sum())


@pytest.mark.parametrize("name", sorted(resampling.SCHEMES))
@given(weights, st.integers(1, 100), st.integers(0, 1000))
def test_as_many_as_asked_for_and_all_of_them_particles(name: str, w: np.ndarray, count: int, seed: int) -> None:
    chosen = resampling.SCHEMES[name](w, count, np.random.default_rng(seed))
    assert chosen.shape == (count,)
    assert chosen.min() >= 0
    assert chosen.max() < len(w)


@pytest.mark.parametrize("name", sorted(resampling.SCHEMES))
def test_the_mean_number_of_copies_is_n_w(name: str) -> None:
    w, rng = np.array([0.05, 0.3, 0.0, 0.4, 0.25]), np.random.default_rng(2)
    rounds, count = 4000, 7
    copies = np.zeros(5)
    for _ in range(rounds):
        copies += np.bincount(resampling.SCHEMES[name](w, count, rng), minlength=5)
    np.testing.assert_allclose(copies / rounds, count * w, atol=0.06)
    assert copies[2] == 0


@given(weights, st.integers(1, 100), st.integers(0, 1000))
def test_systematic_copies_are_the_expected_number_rounded_down_or_up(w: np.ndarray, count: int, seed: int) -> None:
    copies = np.bincount(resampling.systematic(w, count, np.random.default_rng(seed)), minlength=len(w))
    assert np.all(copies >= np.floor(count * w - 1e-9))
    assert np.all(copies <= np.ceil(count * w + 1e-9))


@given(weights, st.integers(1, 100), st.integers(0, 1000))
def test_residual_copies_are_at_least_the_expected_number_rounded_down(w: np.ndarray, count: int, seed: int) -> None:
    copies = np.bincount(resampling.residual(w, count, np.random.default_rng(seed)), minlength=len(w))
    assert np.all(copies >= np.floor(count * w - 1e-9))


@given(weights)
def test_the_effective_size_lies_between_one_and_all(w: np.ndarray) -> None:
    assert 1.0 - 1e-9 <= resampling.effective_size(w) <= len(w) + 1e-6
    assert resampling.effective_size(np.full(len(w), 1.0 / len(w))) == pytest.approx(len(w))


@pytest.mark.parametrize(("bins", "error"), [(2, 0.05), (20, 0.05), (200, 0.01)])
def test_the_kld_size_is_half_the_chi_square_quantile_over_the_error(bins: int, error: float) -> None:
    """Fox 2003, eq. 12: n = chi2_{k-1, 1-delta} / (2 epsilon), which eq. 14 approximates (Wilson and Hilferty)."""
    exact = chi2.ppf(0.99, bins - 1) / (2 * error)
    assert resampling.kld_size(bins, error, 2.326348) == pytest.approx(exact, rel=0.03)
    assert resampling.kld_size(1, error, 2.3) == 1.0


@given(st.integers(1, 60), st.integers(0, 1000))
def test_occupied_bins_are_counted(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    particles = rng.uniform(-2.0, 2.0, (n, 3)) * (1.0, 1.0, 3.0)
    chosen = rng.integers(n, size=2 * n)
    keys = np.floor(particles[chosen] / 0.5)
    keys[:, 2] = np.floor((particles[chosen, 2] % math.tau) / (math.tau / 8))
    assert resampling.occupied_bins(particles, chosen, 0.5, math.tau / 8) == len(np.unique(keys, axis=0))


def test_scatter_is_bounded_and_spares_the_heavy() -> None:
    """Thesis, eq. 2.42: Delta (1 - w) g with g within [-1, 1]; a particle of weight 1 stays where it is."""
    particles, noise = np.zeros((2, 3)), np.ones((3, 3))
    moved = resampling.scattered(particles, np.array([1.0, 0.25]), np.array([0, 1, 1]), 0.1, 0.2, noise)
    np.testing.assert_allclose(moved, [[0, 0, 0], [0.075, 0.075, 0.15], [0.075, 0.075, 0.15]])


def test_shrunk_parameters_keep_mean_and_spread() -> None:
    """Liu and West 2001: the new variance is that of the chosen, as a^2 V + (1 - a^2) V = V."""
    rng = np.random.default_rng(4)
    values, chosen = rng.normal((1.0, -2.0), (0.5, 2.0), (50_000, 2)), rng.integers(50_000, size=50_000)
    got = resampling.shrunk(values, chosen, 0.95, 0.0, bounded(rng, (50_000, 2)))
    np.testing.assert_allclose(got.mean(axis=0), values[chosen].mean(axis=0), atol=0.02)
    np.testing.assert_allclose(got.std(axis=0), values[chosen].std(axis=0), rtol=0.02)
    same = resampling.shrunk(np.ones((5, 2)), np.arange(5), 0.9, 0.1, np.full((5, 2), 0.5))
    np.testing.assert_allclose(same, 1.0 + 0.05 * math.sqrt(6.0))
