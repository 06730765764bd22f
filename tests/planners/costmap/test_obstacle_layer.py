"""The compiled obstacle layer against its readable reference."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from robocar.core import LETHAL
from robocar.planners.costmap import obstacle_layer
from tests.planners.costmap import obstacle_reference as reference

SHAPE = (36, 44)


def layer(rng: np.random.Generator) -> tuple[NDArray[np.int8], NDArray[np.uint8]]:
    """Evidence, mostly none, and what the prior map explains."""
    evidence = np.where(rng.random(SHAPE) < 0.4, rng.integers(0, 5, SHAPE), 0).astype(np.int8)
    return evidence, (rng.random(SHAPE) < 0.1).astype(np.uint8)


def readings(rng: np.random.Generator, n: int, longest: float) -> NDArray[np.float64]:
    """Ranges (n,) in cells, some lost, without return, or below zero."""
    ranges = rng.uniform(0.0, longest, n)
    return np.where(rng.random(n) < 0.2, rng.choice([math.nan, math.inf, -0.5, 0.0], n), ranges)


def place(rng: np.random.Generator) -> tuple[float, float, float]:
    """Anywhere on the grid, and a little beyond its edges."""
    return float(rng.uniform(-4, SHAPE[1] + 4)), float(rng.uniform(-4, SHAPE[0] + 4)), float(rng.uniform(-4, 4))


def cells(touched: NDArray[np.int64], n: int) -> list[tuple[int, int]]:
    return [divmod(cell, SHAPE[1]) for cell in touched[:n].tolist()]


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_lasers_mark_and_clear_as_the_reference_does(seed: int) -> None:
    """Oracle: `obstacle_reference.laser`; equal evidence, and the same cells in the same order; a second scan on top."""
    rng = np.random.default_rng(seed)
    (evidence, explained), near = layer(rng), np.zeros(SHAPE, dtype=np.bool_)
    expected = evidence.copy()
    for _ in range(2):
        pose, ranges, bearings = place(rng), readings(rng, 40, 30.0), rng.uniform(-math.pi, math.pi, 40)
        n, touched = obstacle_layer.mark_laser(
            evidence, explained, near, np.empty(4, dtype=np.int64), *pose, ranges, bearings, 22.0, 18.0, 1.0
        )
        changed = reference.laser(expected, explained, pose, ranges, bearings, 22.0, 18.0)
        np.testing.assert_array_equal(evidence, expected)
        assert cells(touched, n) == changed
        assert not near.any()


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_sonars_mark_and_clear_as_the_reference_does(seed: int) -> None:
    """Oracle: `obstacle_reference.sonar`, which looks at all cells of the grid."""
    rng = np.random.default_rng(seed)
    evidence, explained = layer(rng)
    explained[rng.random(SHAPE) < 0.9] = 0
    expected = evidence.copy()
    pose, ranges, bearings = place(rng), readings(rng, 5, 25.0), rng.uniform(-math.pi, math.pi, 5)
    n, touched = obstacle_layer.mark_sonar(
        evidence, explained, np.empty(4, dtype=np.int64), *pose, ranges, bearings, 0.13, 20.0, 12.0, 6.0, 1.0
    )
    changed = reference.sonar(expected, explained, pose, ranges, bearings, 0.13, (20.0, 12.0), 6.0)
    np.testing.assert_array_equal(evidence, expected)
    assert cells(touched, n) == changed


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_committing_brings_touched_cells_up_to_date(seed: int) -> None:
    """Oracle: numpy on the whole grid where touched; the box is the smallest one around what differs, or empty."""
    rng = np.random.default_rng(seed)
    evidence, _ = layer(rng)
    ground = rng.choice(np.array([0, LETHAL, 255], dtype=np.uint8), SHAPE)
    solid = rng.choice(np.array([0, LETHAL, 255], dtype=np.uint8), SHAPE)
    touched = rng.integers(0, solid.size, int(rng.integers(0, 12)))
    expected, here = solid.copy(), np.zeros(solid.size, dtype=bool)
    here[touched] = True
    target = np.maximum(ground, np.where(evidence >= reference.HIT, LETHAL, 0)).astype(np.uint8)
    np.copyto(expected, target, where=here.reshape(SHAPE))
    rows, cols = np.nonzero(expected != solid)
    box = obstacle_layer.commit(evidence, ground, solid, touched, len(touched))
    np.testing.assert_array_equal(solid, expected)
    assert box == ((rows.min(), rows.max() + 1, cols.min(), cols.max() + 1) if len(rows) else (SHAPE[0], 0, SHAPE[1], 0))
