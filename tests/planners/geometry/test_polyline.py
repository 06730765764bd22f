"""Where a robot is along a path; more in `test_pure_pursuit.py`."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.planners.geometry.polyline import nearest_on_path, point_ahead


def test_a_segment_longer_than_the_window_is_left_at_its_end() -> None:
    """By hand: 4 m along x, then along y. 0.1 m around the corner it is on the second segment, with any window."""
    points = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]])
    assert nearest_on_path(points, 0, 4.0, 0.1, 2.0) == pytest.approx((1, 0.025, 0.0))


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_car_on_a_path_of_any_segments_gets_to_its_end(seed: int) -> None:
    """Property: whoever goes on to the point ahead, again and again, arrives; the way left shrinks at each step by the step."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-1.5, 1.5, 8).cumsum()
    lengths = rng.choice([0.05, 0.3, 5.0], 8)
    points = np.concatenate([[[0.0, 0.0]], (lengths[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)).cumsum(axis=0)])
    x, y, segment, left = 0.0, 0.0, 0, math.inf
    for _ in range(math.ceil(lengths.sum() / 0.02) + 1):
        segment, share, distance = nearest_on_path(points, segment, x, y, 0.2)
        assert distance < 1e-9
        x, y, left = point_ahead(points, segment, share, 0.02)
    assert (x, y) == pytest.approx(tuple(points[-1]))
    assert left < 0.02 + 1e-9
