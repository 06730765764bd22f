"""The exact Bayes filter. Oracles: the thesis' door (eq. 2.17-2.33), and Bayes' rule written out over joint histories."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import ParameterError
from robocar.estimation.landmarks.bayes import DiscreteBayesFilter

SENSES_OPEN = (0.6, 0.2)  # given open, closed
PUSH = [[1.0, 0.8], [0.0, 0.2]]  # to open, to closed; from open, closed


def test_the_thesis_door() -> None:
    door = DiscreteBayesFilter((0.5, 0.5))
    door.predict(np.eye(2))
    np.testing.assert_allclose(door.update(SENSES_OPEN), (0.75, 0.25))
    door.predict(PUSH)
    np.testing.assert_allclose(door.belief, (0.95, 0.05))
    np.testing.assert_allclose(door.update(SENSES_OPEN), (0.983, 0.017), atol=5e-4)


@given(st.integers(0, 10_000), st.integers(2, 4), st.integers(1, 4))
def test_recursion_equals_the_sum_over_all_histories(seed: int, states: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    prior = rng.dirichlet(np.ones(states))
    transitions = [rng.dirichlet(np.ones(states), states).T for _ in range(steps)]
    likelihoods = rng.uniform(0.01, 1.0, (steps, states))
    joint = np.zeros(states)
    for history in itertools.product(range(states), repeat=steps + 1):
        p = prior[history[0]]
        for k in range(steps):
            p *= transitions[k][history[k + 1], history[k]] * likelihoods[k][history[k + 1]]
        joint[history[-1]] += p
    belief = DiscreteBayesFilter(prior)
    for transition, likelihood in zip(transitions, likelihoods, strict=True):
        belief.predict(transition)
        belief.update(likelihood)
    np.testing.assert_allclose(belief.belief, joint / joint.sum(), rtol=1e-9)


def test_what_is_no_probability_is_refused() -> None:
    for prior in ((0.5, 0.6), (1.5, -0.5), (), (np.nan, 1.0)):
        with pytest.raises(ParameterError):
            DiscreteBayesFilter(prior)
    door = DiscreteBayesFilter((1.0, 0.0))
    with pytest.raises(ParameterError, match="column 1"):
        door.predict([[1.0, 0.5], [0.0, 0.2]])
    with pytest.raises(ParameterError, match="shape"):
        door.predict(np.eye(3))
    with pytest.raises(ParameterError, match="explains"):
        door.update((0.0, 0.7))
    with pytest.raises(ParameterError):
        door.update((0.5, np.inf))
