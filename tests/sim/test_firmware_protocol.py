"""The firmware's serial protocol, on the bench.

Oracles: the thesis' command table, kinematics of the differential drive, a model of who is busy.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.sim.firmware import CELL, MAX_CELLS, FirmwareParameters
from tests.sim.firmware_bench import LIMITS, PERIOD, PULSE, RADIUS, TRACK, Bench


@pytest.mark.parametrize(
    ("line", "distance", "turn"),
    [
        ("M1", 0.30, 0.0),
        ("M3", 0.90, 0.0),
        ("M05", 1.50, 0.0),
        ("B", -0.30, 0.0),
        ("Kr90", 0.0, 90.0),
        ("Kn90", 0.0, -90.0),
        ("Kr45.5", 0.0, 45.5),
        ("Kn0.5", 0.0, -0.5),
        ("Kr360", 0.0, 360.0),
    ],
)
@pytest.mark.parametrize("ending", ["", "\n", "\r\n"])
def test_commands_of_the_thesis(line: str, distance: float, turn: float, ending: str) -> None:
    """Table 3.1; cells of 30 cm; left is positive. The wheels may end up to one pulse off."""
    bench = Bench()
    assert bench.send(line + ending) == ["OK"]
    assert bench.finish() == ["DONE"]
    assert bench.x == pytest.approx(distance, abs=RADIUS * PULSE)
    assert math.degrees(bench.heading) == pytest.approx(turn, abs=math.degrees(2 * RADIUS * PULSE / TRACK))
    x, heading = bench.x, bench.heading
    bench.run(1.0)
    assert bench.x == pytest.approx(x, abs=RADIUS * PULSE)
    assert bench.heading == pytest.approx(heading, abs=2 * RADIUS * PULSE / TRACK)


def test_commands_add_up() -> None:
    """Reference angles are kept across commands: rounding to pulses does not accumulate."""
    bench = Bench()
    for _ in range(20):
        assert bench.send("M1") == ["OK"]
        assert bench.finish() == ["DONE"]
    assert bench.x == pytest.approx(20 * CELL, abs=2 * RADIUS * PULSE)


def test_busy_refuses_everything_but_stop() -> None:
    bench = Bench()
    assert bench.send("M9") == ["OK"]
    bench.run(1.0)
    for line in ("M1", "B", "Kr90", "Kn90", "F"):
        assert bench.send(line) == ["BUSY"]
    assert not bench.firmware.finished
    assert bench.send("S") == ["OK"]
    assert not bench.firmware.busy
    assert bench.finish() == []  # what was stopped is not DONE
    bench.run(1.0)
    # It brakes with the largest deceleration: v^2 / 2a after the v t of a second, less the ramp up.
    v, a = FirmwareParameters().command_speed, LIMITS.acc_lim_x
    assert bench.x == pytest.approx(v * 1.0 - v * v / (2 * a) + v * v / (2 * a), abs=0.01)
    assert bench.send("M1") == ["OK"]
    assert bench.finish() == ["DONE"]


def test_stop_is_always_accepted_and_finish_says_so() -> None:
    bench = Bench()
    assert bench.send("S") == ["OK"]
    assert not bench.firmware.finished
    assert bench.send("F") == ["OK", "DONE"]
    assert bench.firmware.finished


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("M0", "ERR M takes 1 to 99 cells, not '0'"),
        ("M100", "ERR M takes 1 to 99 cells, not '100'"),
        ("M", "ERR M takes 1 to 99 cells, not ''"),
        ("M-1", "ERR M takes 1 to 99 cells, not '-1'"),
        ("M1.5", "ERR M takes 1 to 99 cells, not '1.5'"),
        ("M\u0661", "ERR M takes 1 to 99 cells, not an unreadable line"),  # an Arabic digit
        ("M" + "1" * 1000, "ERR M takes 1 to 99 cells, not an unreadable line"),
        ("Kr0", "ERR Kr takes more than 0, at most 360 degrees, not '0'"),
        ("Kn360.1", "ERR Kn takes more than 0, at most 360 degrees, not '360.1'"),
        ("Kr", "ERR Kr takes more than 0, at most 360 degrees, not ''"),
        ("Krnan", "ERR Kr takes more than 0, at most 360 degrees, not 'nan'"),
        ("Kr1e2", "ERR Kr takes more than 0, at most 360 degrees, not '1e2'"),
        ("Kn-90", "ERR Kn takes more than 0, at most 360 degrees, not '-90'"),
        ("B2", "ERR B takes no number, not '2'"),
        ("S1", "ERR S takes no number, not '1'"),
        ("F\xe9", "ERR F takes no number, not an unreadable line"),
        ("m1", "ERR unknown command 'm1': M<n> Kr<d> Kn<d> B S F"),
        ("M 1", "ERR unknown command 'M 1': M<n> Kr<d> Kn<d> B S F"),
        (" M1", "ERR unknown command ' M1': M<n> Kr<d> Kn<d> B S F"),
        ("", "ERR unknown command '': M<n> Kr<d> Kn<d> B S F"),
        ("M1\nM2", "ERR unknown command an unreadable line: M<n> Kr<d> Kn<d> B S F"),
        ("\x00", "ERR unknown command an unreadable line: M<n> Kr<d> Kn<d> B S F"),
    ],
)
def test_bad_lines_are_named_and_move_nothing(line: str, answer: str) -> None:
    bench = Bench()
    assert bench.send(line) == [answer]
    bench.run(0.5)
    assert (bench.x, bench.heading) == (0.0, 0.0)
    assert not bench.firmware.finished


VALID = st.one_of(
    st.integers(1, MAX_CELLS).map("M{}".format),
    st.floats(0.001, 360.0).map(lambda d: f"Kr{d:.3f}"),
    st.sampled_from(["B", "S", "F"]),
)
NEARLY = st.text(st.sampled_from("MKrnBSF0123456789.-+e \t\r\n\0é١"), max_size=8)


@settings(deadline=None, max_examples=60)
@given(line=st.text(max_size=60) | NEARLY)
def test_any_text_is_answered_and_only_commands_move(line: str) -> None:
    """Either it is accepted, or it is refused in one line of printable ASCII and nothing moves."""
    bench = Bench()
    answers = bench.send(line)
    assert all(answer.isascii() and answer.isprintable() and len(answer) < 120 for answer in answers)
    bench.run(0.3)
    refused = len(answers) == 1 and answers[0].startswith("ERR ")
    accepted = answers[0] == "OK"
    assert refused != accepted
    assert (np.abs(bench.ticks).max() > 0.0) == (accepted and line.strip("\r\n")[0] in "MKB")


@settings(deadline=None, max_examples=60)
@given(lines=st.lists(st.tuples(VALID | NEARLY, st.integers(0, 60)), max_size=8))
def test_whoever_sends_what_and_when_the_protocol_holds(lines: list[tuple[str, int]]) -> None:
    """Every accepted motion that is not stopped ends in exactly one DONE; while it lasts, only S is accepted."""
    bench = Bench()
    open_motions = 0
    for line, ticks in lines:
        busy = bench.firmware.busy
        text = line.strip("\r\n")
        answers = bench.send(line)
        assert answers[0] in (("BUSY",) if busy and text != "S" else ("OK",)) or answers[0].startswith("ERR ")
        open_motions = 1 if bench.firmware.busy else 0
        bench.run(ticks * PERIOD)
        said = list(bench.firmware.answers())
        assert said == ([] if bench.firmware.busy == bool(open_motions) else ["DONE"])
