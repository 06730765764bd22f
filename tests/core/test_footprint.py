"""Footprints: radii against projections, and outlines that are none."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import SE2, Footprint


@given(st.floats(0.05, 1), st.floats(0.05, 1), st.floats(0.05, 1))
def test_rectangle_radii(front: float, rear: float, half_width: float) -> None:
    """Oracle: the nearest side and the farthest corner of a rectangle."""
    footprint = Footprint.rectangle(front, rear, half_width)
    assert footprint.inscribed_radius == pytest.approx(min(front, rear, half_width))
    assert footprint.circumscribed_radius == pytest.approx(math.hypot(max(front, rear), half_width))


@given(st.floats(0.05, 2), st.integers(3, 64))
def test_circle_contains_its_disc(radius: float, corners: int) -> None:
    """Oracle: a regular polygon around a circle: apothem r, circumradius r / cos(pi / n)."""
    footprint = Footprint.circle(radius, corners)
    assert footprint.inscribed_radius == pytest.approx(radius)
    assert footprint.circumscribed_radius == pytest.approx(radius / math.cos(math.pi / corners))


@given(st.lists(st.floats(0, 2 * math.pi), min_size=5, max_size=9, unique=True), st.floats(-0.2, 0.2))
def test_radii_of_any_convex_polygon(angles: list[float], shift: float) -> None:
    """Oracle: dense points of the outline: the nearest and the farthest of the origin."""
    spread = np.sort(np.array(angles))
    # Three fixed corners keep the origin inside, and near-equal angles would make no strictly convex corner.
    spread = np.unique(np.round(np.concatenate([spread, [0.1, 2.2, 4.3]]), 2))
    vertices = np.stack([np.cos(spread) + shift, np.sin(spread)], axis=1)
    footprint = Footprint(vertices)
    t = np.linspace(0, 1, 3001)[:, None, None]
    outline = np.linalg.norm((1 - t) * vertices + t * np.roll(vertices, -1, axis=0), axis=2)
    assert footprint.inscribed_radius == pytest.approx(outline.min(), abs=1e-5)
    assert footprint.circumscribed_radius == pytest.approx(outline.max())


def test_outline_in_the_world() -> None:
    """Oracle: by hand: a quarter turn puts the front on the y axis."""
    corners = Footprint.rectangle(0.3, 0.1, 0.2).at(SE2(1, 2, math.pi / 2))
    np.testing.assert_allclose(corners, [[0.8, 2.3], [0.8, 1.9], [1.2, 1.9], [1.2, 2.3]], atol=1e-12)


STAR = [[math.cos(a), math.sin(a)] for a in 2 * math.tau / 5 * np.arange(5)]


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        ([[0, 0], [1, 1]], "at least three corners"),
        ([[0, 0, 0], [1, 1, 1], [1, 2, 3]], "at least three corners"),
        ([[-1, -1], [-1, 1], [1, 1], [1, -1]], "counter-clockwise"),
        ([[-1, -1], [1, -1], [0.1, 0], [1, 1], [-1, 1]], "convex"),
        ([[-1, -1], [0, -1], [1, -1], [1, 1], [-1, 1]], "strictly convex"),
        ([[-1, -1], [-1, -1], [1, -1], [1, 1], [-1, 1]], "strictly convex"),
        ([[1, 1], [2, 1], [2, 2], [1, 2]], "origin"),
        ([[0, -1], [1, -1], [1, 1], [0, 1]], "origin"),
        ([[-1, -1], [1, -1], [math.nan, 1]], "convex"),
        (STAR, "wind"),
    ],
)
def test_outlines_that_are_none(vertices: list, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Footprint(np.array(vertices, dtype=float))


def test_vertices_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Footprint.circle(0.1).vertices[0] = 3.0
