"""How the firmware drives, alone with simulated wheels that obey the motor equation.

Oracles: kinematics of the differential drive, the limits themselves, the true heading.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import Twist
from robocar.sim.firmware import CELL, FirmwareParameters
from tests.sim.firmware_bench import LIMITS, PERIOD, PULSE, RADIUS, SUPPLY, TRACK, Bench


def test_the_bench_can_fail() -> None:
    """The simulated wheel itself: no voltage, no motion; its final speed is voltage over back-EMF."""
    bench = Bench()
    step: Callable[[int, int], tuple[float, float]] = lambda left, right: (3.7, -3.7)  # noqa: E731
    bench.firmware.step = step  # type: ignore[method-assign]
    bench.run(1.0)
    assert bench.speeds == pytest.approx([5.0, -5.0])


# -- twists ------------------------------------------------------------------------------------------------------------

TWISTS = st.builds(Twist, st.floats(-2, 2), st.floats(-6, 6))


@settings(deadline=None, max_examples=60)
@given(twists=st.lists(st.tuples(TWISTS, st.integers(1, 80)), min_size=1, max_size=6))
def test_speeds_and_accelerations_stay_within_the_limits(twists: list[tuple[Twist, int]]) -> None:
    """The references' first and second differences, tick by tick, against the limits."""
    bench = Bench()
    references = [(0.0, 0.0)]
    for twist, ticks in twists:
        bench.firmware.drive(twist)
        for _ in range(ticks):
            bench.step()
            references.append(tuple(bench.firmware._reference))
    left, right = np.diff(np.array(references), axis=0).T / PERIOD * RADIUS
    v, omega = 0.5 * (left + right), (right - left) / TRACK
    assert v.min() >= LIMITS.min_vel_x - 1e-9
    assert v.max() <= LIMITS.max_vel_x + 1e-9
    assert np.abs(omega).max() <= LIMITS.max_vel_theta + 1e-9
    assert np.abs(np.diff(v, prepend=0.0)).max() <= LIMITS.acc_lim_x * PERIOD + 1e-9
    assert np.abs(np.diff(omega, prepend=0.0)).max() <= LIMITS.acc_lim_theta * PERIOD + 1e-9


@settings(deadline=None, max_examples=30)
@given(twist=TWISTS)
def test_a_twist_is_reached_and_kept_clamped_to_the_limits(twist: Twist) -> None:
    bench = Bench()
    bench.firmware.drive(twist)
    bench.run(1.5)
    x, heading = bench.x, bench.heading
    bench.run(4.0)
    v = min(max(twist.v, -0.2), 0.4)
    omega = min(max(twist.omega, -1.5), 1.5)
    # Counts are coarse: a mean over 4 s is good to two pulses.
    assert (bench.x - x) / 4.0 == pytest.approx(v, abs=2 * RADIUS * PULSE / 4.0)
    assert (bench.heading - heading) / 4.0 == pytest.approx(omega, abs=4 * RADIUS * PULSE / TRACK / 4.0)


def test_voltages_stay_within_the_supply_and_start_at_rest() -> None:
    bench = Bench()
    bench.run(0.1)
    assert bench.ticks == [(0.0, 0.0)] * 10
    bench.firmware.drive(Twist(5.0, 9.0))
    bench.run(2.0)
    bench.firmware.drive(Twist(-5.0, -9.0))
    bench.run(2.0)
    assert np.abs(bench.ticks).max() <= SUPPLY


def test_a_twist_ends_a_serial_command() -> None:
    bench = Bench()
    assert bench.send("M9") == ["OK"]
    bench.run(0.5)
    bench.firmware.drive(Twist())
    bench.run(3.0)
    assert not bench.firmware.busy
    assert bench.firmware.answers() == ()
    assert bench.x < 0.3


@pytest.mark.parametrize("line", ["M5", "B", "Kr180"])
def test_serial_commands_follow_a_trapezoidal_profile(line: str) -> None:
    """Speed, acceleration and braking within the limits; the top speed is reached where the way is long enough."""
    bench = Bench()
    bench.send(line)
    references = [(0.0, 0.0)]
    while bench.firmware.busy:
        bench.step()
        references.append(tuple(bench.firmware._reference))
    left, right = np.diff(np.array(references), axis=0).T / PERIOD * RADIUS
    turning = line.startswith("K")
    speed = (right - left) / TRACK if turning else 0.5 * (left + right)
    top = FirmwareParameters().command_turn_rate if turning else FirmwareParameters().command_speed
    limit = LIMITS.acc_lim_theta if turning else LIMITS.acc_lim_x
    assert np.abs(speed).max() == pytest.approx(top, rel=1e-6)
    # The last step is shortened to land exactly at the end: up to an eighth of the limit on top.
    assert np.abs(np.diff(speed)).max() <= 1.125 * limit * PERIOD + 1e-9


def test_a_command_waits_until_what_went_before_has_come_to_rest() -> None:
    """Kinematics: braking from v takes v^2 / 2a, and then the cell begins."""
    bench = Bench()
    bench.firmware.drive(Twist(0.4, 0.0))
    bench.run(2.0)
    begin, references = bench.firmware._reference[0] * RADIUS, []
    assert bench.send("M1") == ["OK"]
    while bench.firmware.busy:
        references.append(bench.firmware._reference[0] * RADIUS)
        bench.step()
    assert references[-1] - begin == pytest.approx(0.4**2 / (2 * LIMITS.acc_lim_x) + CELL, abs=0.4 * PERIOD)
    assert np.abs(np.diff(references, n=2)).max() <= 1.125 * LIMITS.acc_lim_x * PERIOD**2 + 1e-9


def test_time_of_a_command_is_the_time_of_its_profile() -> None:
    """A trapezoid over s with top speed v and acceleration a takes s / v + v / a."""
    bench = Bench()
    bench.send("M4")
    bench.finish()
    p = FirmwareParameters()
    expected = 4 * CELL / p.command_speed + p.command_speed / LIMITS.acc_lim_x
    assert len(bench.ticks) * PERIOD == pytest.approx(expected + p.settle_time, abs=0.15)


# -- what can go wrong -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("line", ["M2", "B", "Kr90"])
def test_clamped_wheels_end_a_command(line: str) -> None:
    bench = Bench(blocked=True)
    bench.send(line)
    (answer,) = bench.finish(10.0)
    assert answer.startswith("ERR blocked after 0.")
    assert not bench.firmware.busy
    assert 1.0 < len(bench.ticks) * PERIOD < 2.0  # blocked_time, and the time until the reference runs ahead
    assert bench.send("M1") == ["OK"]


def test_a_pressed_bumper_ends_a_straight_command_but_no_other() -> None:
    for line, ends in {"M2": True, "B": False, "Kr90": False}.items():
        bench = Bench()
        bench.send(line)
        bench.run(0.8)
        bench.firmware.bumper(True)
        answers = bench.finish()
        assert answers[0].startswith("ERR blocked after 0.1") == ends
        assert (answers == ["DONE"]) == (not ends)


def test_a_touch_shorter_than_the_bumped_time_is_no_end() -> None:
    bench = Bench()
    bench.send("M2")
    bench.run(0.5)
    for _ in range(5):
        bench.firmware.bumper(True)
        bench.run(FirmwareParameters().bumped_time - 0.05)
        bench.firmware.bumper(False)
        bench.run(0.1)
    assert bench.finish() == ["DONE"]
    assert bench.x == pytest.approx(0.60, abs=RADIUS * PULSE)


@pytest.mark.parametrize("slip", [0.8, 0.9, 1.1, 1.25])
@pytest.mark.parametrize(("line", "turn"), [("Kr90", 90.0), ("Kn170", -170.0), ("Kr350", 350.0)])
def test_with_a_compass_turns_are_right_whatever_the_wheels_slip(slip: float, line: str, turn: float) -> None:
    """Oracle: the true heading. Without a compass the error is the slip's."""
    without = Bench(slip=slip)
    without.send(line)
    assert without.finish() == ["DONE"]
    assert abs(math.degrees(without.heading) - turn) == pytest.approx(abs(turn) * abs(1 - slip), abs=1.0)
    bench = Bench(compass=True, slip=slip)
    bench.run(0.5)
    bench.send(line)
    assert bench.finish() == ["DONE"]
    assert math.degrees(bench.heading) == pytest.approx(turn, abs=1.0)


def test_headings_are_averaged_across_the_back_direction() -> None:
    """Readings on both sides of 180 degrees: a plain mean would point ahead."""
    bench = Bench(compass=True)
    bench.heading = math.pi - 0.001
    for offset in (0.01, -0.01, 0.02, -0.02):
        bench.firmware.compass(math.remainder(math.pi + offset, math.tau))
    bench.send("Kr10")
    assert bench.finish() == ["DONE"]
    assert math.degrees(bench.heading) == pytest.approx(190.0, abs=1.0)
