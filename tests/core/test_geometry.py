"""Poses, twists and angles against group axioms, matrices and numerical integration."""

import math
from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import SE2, Twist, frozen_array, wrap_angle, wrap_angles

lengths = st.floats(-100, 100)
angles = st.floats(-20, 20)
poses = st.builds(SE2, lengths, lengths, angles)


def assert_same(a: SE2, b: SE2, tolerance: float = 1e-9) -> None:
    assert math.hypot(a.x - b.x, a.y - b.y) <= tolerance
    assert abs(math.remainder(a.theta - b.theta, math.tau)) <= tolerance


def matrix(pose: SE2) -> np.ndarray:
    c, s = np.cos(pose.theta), np.sin(pose.theta)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0, 0, 1]])


@given(poses, poses, poses)
def test_se2_is_a_group(a: SE2, b: SE2, c: SE2) -> None:
    """Oracle: group axioms."""
    assert_same((a @ b) @ c, a @ (b @ c), 1e-8)
    assert_same(a @ SE2(), a)
    assert_same(SE2() @ a, a)
    assert_same(a @ a.inverse(), SE2())
    assert_same(a.inverse() @ a, SE2())
    assert_same((a @ b).inverse(), b.inverse() @ a.inverse(), 1e-8)


@given(poses, poses, lengths, lengths)
def test_se2_agrees_with_homogeneous_matrices(a: SE2, b: SE2, x: float, y: float) -> None:
    """Oracle: 3 x 3 matrices."""
    np.testing.assert_allclose(matrix(a @ b), matrix(a) @ matrix(b), atol=1e-9)
    np.testing.assert_allclose(matrix(a.inverse()), np.linalg.inv(matrix(a)), atol=1e-9)
    np.testing.assert_allclose(a.transform([x, y]), (matrix(a) @ [x, y, 1])[:2], atol=1e-9)
    np.testing.assert_allclose(a.transform(np.full((2, 3, 2), [x, y])), np.full((2, 3, 2), a.transform([x, y])))


def test_quarter_turn_by_hand() -> None:
    """Oracle: drawn on paper: 1 m ahead of a car at (2, 3) that looks along +y is (2, 4)."""
    world_from_robot = SE2(2, 3, math.pi / 2)
    np.testing.assert_allclose(world_from_robot.transform([[1, 0], [0, 1]]), [[2, 4], [1, 3]], atol=1e-15)
    assert_same(world_from_robot @ SE2(1, 0, math.pi / 2), SE2(2, 4, math.pi), 1e-15)
    np.testing.assert_array_equal(world_from_robot.position, [2, 3])
    np.testing.assert_array_equal(world_from_robot.as_array(), [2, 3, math.pi / 2])
    assert world_from_robot.distance_to(SE2(5, 7)) == 5


@pytest.mark.parametrize("bad", [(math.nan, 0, 0), (0, math.inf, 0), (0, 0, -math.inf)])
def test_pose_must_be_finite(bad: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="finite"):
        SE2(*bad)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angle_is_the_same_direction_in_the_half_open_interval(angle: float) -> None:
    """Oracle: the unit vector, and the interval (-pi, pi]."""
    for wrapped in (wrap_angle(angle), float(wrap_angles(angle)), float(wrap_angles([[angle]])[0, 0])):
        assert -math.pi < wrapped <= math.pi
        assert math.hypot(math.cos(wrapped) - math.cos(angle), math.sin(wrapped) - math.sin(angle)) < 1e-9


@pytest.mark.parametrize(
    ("angle", "expected"), [(math.pi, math.pi), (-math.pi, math.pi), (3 * math.pi, math.pi), (0, 0), (4, 4 - math.tau)]
)
def test_wrap_at_the_ends(angle: float, expected: float) -> None:
    assert wrap_angle(angle) == pytest.approx(expected, abs=1e-15)
    assert wrap_angles([angle])[0] == pytest.approx(expected, abs=1e-15)
    assert SE2(0, 0, angle).theta == pytest.approx(expected, abs=1e-15)


@given(st.floats(-2, 2), st.floats(-3, 3), st.floats(0.001, 2))
def test_twist_steps_along_the_arc(v: float, omega: float, dt: float) -> None:
    """Oracle: the midpoint rule for x' = v cos(theta), y' = v sin(theta) with 4000 steps (error below 1e-6)."""
    n = 4000
    heading = omega * dt * (np.arange(n) + 0.5) / n
    expected = SE2(v * dt * np.cos(heading).mean(), v * dt * np.sin(heading).mean(), omega * dt)
    assert_same(Twist(v, omega).step(dt), expected, 1e-6)


@given(st.floats(0.1, 2), st.floats(1e-13, 1e-4), st.sampled_from([-1.0, 1.0]))
def test_slow_turns_keep_their_sideways_motion(v: float, omega: float, side: float) -> None:
    """Oracle: Taylor series y = v omega t^2 / 2, to a relative 1e-6, where 1 - cos(turn) would cancel."""
    step = Twist(v, side * omega).step(1.0)
    assert step.y == pytest.approx(side * v * omega / 2, rel=1e-6)
    assert step.x == pytest.approx(v, rel=1e-6)


@given(st.floats(-2, 2), st.floats(-3, 3), st.floats(0, 1), st.floats(0, 1))
def test_twist_is_a_one_parameter_group(v: float, omega: float, a: float, b: float) -> None:
    """Oracle: exp((a + b) xi) = exp(a xi) exp(b xi)."""
    twist = Twist(v, omega)
    assert_same(twist.step(a) @ twist.step(b), twist.step(a + b), 1e-8)


def test_half_circle_in_closed_form() -> None:
    """Oracle: v / omega = 0.5 m of radius, so half a turn ends 1 m to the left, looking back."""
    assert_same(Twist(1.0, 2.0).step(math.pi / 2), SE2(0, 1, math.pi), 1e-12)


def test_frozen_array_cannot_be_changed_by_anyone() -> None:
    """Oracle: writing to every array it could share memory with."""
    mine = np.zeros(3)
    view = mine.view()
    view.flags.writeable = False
    from_mine, from_view = frozen_array(mine), frozen_array(view)
    mine[0] = 7
    assert from_mine[0] == 0
    assert from_view[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        from_mine[0] = 1
    assert frozen_array(from_mine) is from_mine


@pytest.mark.parametrize("number", [1, True, np.float32(1.0), np.int8(1), np.array(1.0), Decimal(1)])
def test_poses_and_twists_hold_floats_whatever_they_are_given(number: Any) -> None:
    """Numbers of their own: an array that is written to later changes none of them."""
    pose, twist = SE2(number, number, number), Twist(number, number)
    assert [type(value) for value in (pose.x, pose.y, pose.theta, twist.v, twist.omega)] == [float] * 5
    if isinstance(number, np.ndarray):
        number[...] = 5.0
    assert (pose.x, pose.y, pose.theta) == (1.0, 1.0, 1.0)
    assert (twist.v, twist.omega) == (1.0, 1.0)


@pytest.mark.parametrize("wrong", ["1", b"1", None, [1.0], np.ones(1), 1j, 10**400])
def test_what_is_no_number_is_no_part_of_a_pose_or_a_twist(wrong: Any) -> None:
    for make in (
        lambda: SE2(wrong),
        lambda: SE2(0.0, wrong),
        lambda: SE2(0.0, 0.0, wrong),
        lambda: Twist(wrong),
        lambda: Twist(0.0, wrong),
    ):
        with pytest.raises((TypeError, ValueError), match=r"^a (pose|twist)'s (x|y|theta|v|omega) is "):
            make()
