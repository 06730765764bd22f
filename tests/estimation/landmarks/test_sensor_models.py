"""Sensor models. Oracle: the formulas, evaluated in plain Python for one particle and one sighting at a time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import SE2, Detection, Landmark
from robocar.estimation.landmarks import sensor_models
from robocar.estimation.landmarks.sensor_models import Atlas, reweigh

MARKS = (
    Landmark("a", "red", np.array([0.0, 0.0, 0.4]), 0.1),
    Landmark("b", "red", np.array([3.0, 1.0, 0.4]), 0.1),
    Landmark("c", "blue", np.array([1.0, 2.0, 0.4]), 0.1),
    Landmark("6", "", np.array([2.0, 2.0, 0.0]), 0.1),
)
ATLAS = Atlas(MARKS)
COVARIANCE = np.diag([0.1**2, 0.2**2])


def detection(name: str, bearing: float, distance: float) -> Detection:
    return Detection(0.0, name, bearing, distance, COVARIANCE)


def by_hand(pose: SE2, seen: Detection, model: str, outlier: float) -> float:
    matches = []
    for mark in MARKS:
        if seen.landmark in (mark.name, mark.color):
            x, y = pose.inverse_apply(float(mark.position[0]), float(mark.position[1]))
            square = ((math.hypot(x, y) - seen.range) / 0.2) ** 2
            if model == "bearing-range":
                square += 2 * (1 - math.cos(math.atan2(y, x) - seen.bearing)) / 0.1**2
            matches.append(math.exp(-0.5 * square))
    return (1 - outlier) * sum(matches) / len(matches) + outlier


@pytest.mark.parametrize("model", ["bearing-range", "ranges"])
@given(st.lists(st.tuples(st.sampled_from(["red", "a", "c", "6"]), st.floats(-3, 3), st.floats(0.1, 4)), min_size=1, max_size=4))
def test_likelihoods_are_products_over_sightings_of_means_over_candidates(model: str, seen: list) -> None:
    kernel = sensor_models.bearing_range if model == "bearing-range" else sensor_models.ranges
    detections = [detection(*values) for values in seen]
    particles = np.array([[0.5, 0.4, 0.1], [2.0, -1.0, 2.5], [1.1, 1.9, -3.0]])
    tables = ATLAS.sightings(detections, 0.0, 0.0)
    likelihoods = kernel(particles, tables).likelihoods(0.02)
    expected = [math.prod(by_hand(SE2(*p), d, model, 0.02) for d in detections) for p in particles]
    np.testing.assert_allclose(likelihoods, expected, rtol=1e-6, atol=1e-12)


def test_what_is_not_known_or_not_finite_is_left_out() -> None:
    seen = [detection("a", 0.1, 1.0), detection("green", 0.0, 1.0), detection("a", math.nan, 1.0), detection("", 0.0, 1.0)]
    assert len(ATLAS.sightings(seen, 0.0, 0.0)) == 1
    assert len(ATLAS.sightings([], 0.0, 0.0)) == 0
    assert "" not in ATLAS


def test_added_uncertainty_is_added_in_squares() -> None:
    tables = ATLAS.sightings([detection("a", 0.1, 2.0)], 0.05, 0.1)
    assert 1 / tables.values[0, 2] == pytest.approx(0.1**2 + 0.05**2)
    assert 1 / tables.values[0, 3] == pytest.approx(0.2**2 + (0.1 * 2.0) ** 2)


@pytest.mark.parametrize(
    ("colors", "heading"),
    [(("green", "blue"), 0.0), (("orange", "green"), math.pi / 2), (("red", "orange"), math.pi), (("blue", "red"), -math.pi / 2)],
)
def test_the_thesis_headings_are_those_of_its_field(colors: tuple[str, str], heading: float) -> None:
    """Seen from the field's middle, the heading that a pair stands for is the direction to the middle of its side."""
    corners = {"blue": (3.5, 0.0), "green": (3.5, 2.5), "orange": (0.0, 2.5), "red": (0.0, 0.0)}
    x, y = np.mean([corners[c] for c in colors], axis=0) - (1.75, 1.25)
    assert math.cos(math.atan2(y, x) - heading) == pytest.approx(1.0)
    particles = np.array([[0.0, 0.0, heading + off] for off in (0.0, 0.3, -0.3, 2.0)])
    seen = [(color, math.atan2(*(np.array(corners[color]) - (1.75, 1.25))[::-1]) - heading) for color in colors]
    likelihoods = sensor_models.headings(particles, seen).likelihoods(0.01)
    assert likelihoods[0] == pytest.approx(1.0)
    assert likelihoods[1] == pytest.approx(likelihoods[2])
    assert likelihoods[0] > likelihoods[1] > likelihoods[3]


def test_other_pairs_say_nothing() -> None:
    matches = sensor_models.headings(np.zeros((3, 3)), [("red", 0.1), ("green", 0.4)])
    assert len(matches.first) == 1
    assert np.all(matches.likelihoods(0.01) == 1.0)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=20), st.integers(0, 100))
def test_reweigh_normalizes_and_returns_the_mean(likelihoods: list[float], seed: int) -> None:
    weights = np.random.default_rng(seed).dirichlet(np.ones(len(likelihoods)))
    expected = weights * likelihoods
    got = reweigh(weights, np.array(likelihoods))
    assert got == pytest.approx(expected.sum())
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights, expected / expected.sum() if got > 0 else 1 / len(weights), atol=1e-12)
