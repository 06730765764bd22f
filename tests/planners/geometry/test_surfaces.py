"""Surfaces as segments, and the clearance from them. Oracles: dense sampling, the exact check of cells, lines by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import LETHAL, SE2, Costmap
from robocar.core.footprint import Footprint
from robocar.planners.geometry.collision import footprint_free
from robocar.planners.geometry.surfaces import clearance, lines, room, surfaces

OUTLINE = np.array(Footprint.rectangle(0.1, 0.08, 0.09).vertices)
COORDINATE = st.floats(-0.4, 0.4)
POSE = st.tuples(COORDINATE, COORDINATE, st.floats(-4, 4))


def segment_points(segment: np.ndarray, n: int = 2001) -> np.ndarray:
    share = np.linspace(0.0, 1.0, n)[:, None]
    return segment[:2] + share * (segment[2:] - segment[:2])


@settings(max_examples=150, deadline=None)
@given(
    segment=st.tuples(COORDINATE, COORDINATE, COORDINATE, COORDINATE), pose=st.tuples(COORDINATE, COORDINATE, st.floats(-4, 4))
)
def test_clearance_is_the_distance_of_the_nearest_points(segment: tuple[float, ...], pose: tuple[float, float, float]) -> None:
    """Dense sampling of the segment: the distance of each point to the rectangle in its own frame."""
    found = clearance(np.array([segment]), *pose, OUTLINE, 2.0)
    local = SE2(*pose).inverse().transform(segment_points(np.array(segment)))
    beyond = np.maximum(np.maximum(local[:, 0] - 0.1, -0.08 - local[:, 0]), 0.0)
    aside = np.maximum(np.abs(local[:, 1]) - 0.09, 0.0)
    expected = float(np.hypot(beyond, aside).min())
    assert max(found, 0.0) == pytest.approx(expected, abs=1e-3)


def test_what_reaches_in_counts_by_its_depth() -> None:
    """By hand: a wall 3 mm inside the left side, a post 20 mm inside the front."""
    assert clearance(np.array([[-1.0, 0.087, 1.0, 0.087]]), 0.0, 0.0, 0.0, OUTLINE, 1.0) == pytest.approx(-0.003)
    assert clearance(np.array([[0.08, 0.0, 0.08, 0.0]]), 0.0, 0.0, 0.0, OUTLINE, 1.0) == pytest.approx(-0.02)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), walled=st.booleans())
def test_surfaces_of_cells_agree_with_the_cells(seed: int, walled: bool) -> None:
    """Oracle: `footprint_free`, exact; the centre of the robot lies in a free cell, so that a surface is what it meets first."""
    rng = np.random.default_rng(seed)
    data = np.where(rng.random((12, 15)) < 0.1, LETHAL, 0).astype(np.uint8)
    costmap = Costmap(data, 0.05, SE2(0.3, -0.2, 0.4), walled=walled)
    free = np.argwhere(data == 0)
    row, col = free[rng.integers(len(free))] + rng.random(2)
    x, y, theta = col, row, rng.uniform(-math.pi, math.pi)
    pose = costmap.origin @ SE2(x * 0.05, y * 0.05, theta)
    apart = clearance(surfaces(costmap, pose, 0.5), pose.x, pose.y, pose.theta, OUTLINE, 1.0)
    assert (apart > 0.0) == footprint_free(data, x, y, theta, OUTLINE / 0.05, walled)


def test_the_border_of_a_walled_map_is_the_same_as_drawn_cells() -> None:
    open_map = Costmap(np.zeros((20, 20), dtype=np.uint8), 0.05, walled=True)
    drawn = Costmap(np.pad(open_map.data, 1, constant_values=LETHAL), 0.05, SE2(-0.05, -0.05, 0.0))
    for x, y in ((0.1, 0.5), (0.5, 0.95), (0.93, 0.04)):
        pose = SE2(x, y, 0.3)
        assert room(surfaces(open_map, pose, 0.6), x, y) == pytest.approx(room(surfaces(drawn, pose, 0.6), x, y))


def test_no_costmap_has_no_surfaces() -> None:
    assert surfaces(None, SE2(), 1.0).shape == (0, 4)
    assert room(surfaces(None, SE2(), 1.0), 0.0, 0.0) == 1.0


@pytest.mark.parametrize("seed", range(5))
def test_lines_know_a_corner_better_than_its_points(seed: int) -> None:
    """Two walls that meet; 2.5 mm of noise, what a few looks leave of 1 cm: the surfaces lie within 3 mm of the walls."""
    rng = np.random.default_rng(seed)
    along = np.linspace(-0.3, 0.3, 120)
    wall, other = np.stack([along, np.full(120, -0.1)], axis=1), np.stack([np.full(120, 0.3), along + 0.2], axis=1)
    points = np.concatenate([wall, other]) + rng.normal(0.0, 0.0025, (240, 2))
    found = lines(points, SE2(), 0.18, 2.0)
    assert room(found, 0.0, 0.0) == pytest.approx(0.1, abs=0.003)
    assert room(found, 0.2, 0.2) == pytest.approx(0.1, abs=0.003)


def test_lines_close_what_is_narrower_than_the_robot_and_nothing_else() -> None:
    """Posts 10 cm and 30 cm apart, by hand: only between the first two is there a surface."""
    posts = np.array([[0.5, 0.0], [0.5, 0.1], [0.5, 0.4]])
    found = lines(posts, SE2(), 0.18, 2.0)
    assert room(found, 0.5, 0.05) == pytest.approx(0.0, abs=1e-9)
    assert room(found, 0.5, 0.25) == pytest.approx(0.15)
    assert lines(np.empty((0, 2)), SE2(), 0.18, 2.0).shape == (0, 4)
