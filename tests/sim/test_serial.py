"""The serial port: pyserial is the client, real physics the car; the splitter's oracle is `bytes.split`."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import SE2, OccupancyGrid
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.serial_port import MAX_LINE, LineSplitter, Pacer, serve
from robocar.sim.world import World
from robocar.sim.world_spec import build_world

START = SE2(1.0, 1.0, 0.0)


class Session:
    """`serve` in a thread, with a client's view of it."""

    def __init__(self, start: SE2 = START, real_time: bool = False) -> None:
        room = OccupancyGrid(np.zeros((20, 30), dtype=np.int8), 0.1)
        self.world = World(build_world(room), [RobotSetup(start)], seed=1)
        self._ready, self._stop = threading.Event(), threading.Event()
        self.thread = threading.Thread(target=self._serve, args=(real_time,), daemon=True)
        self.thread.start()
        assert self._ready.wait(10), "the port was never announced"

    def _serve(self, real_time: bool) -> None:
        serve(self.world, real_time=real_time, stop=self._stop.is_set, announce=self._announce)

    def _announce(self, path: str) -> None:
        self.path = path
        self._ready.set()

    def client(self) -> serial.Serial:
        return serial.Serial(self.path, 115200, timeout=10)

    def moved(self) -> SE2:
        """start_from_robot."""
        return START.inverse() @ self.world.ground_truth().pose

    def end(self) -> None:
        self._stop.set()
        self.thread.join(10)
        self.world.close()


@pytest.fixture
def session() -> Iterator[Session]:
    """As fast as it goes: nothing below depends on the pace."""
    running = Session()
    yield running
    running.end()


def say(port: serial.Serial, *lines: str | bytes) -> None:
    for line in lines:
        port.write(line.encode() + b"\n" if isinstance(line, str) else line)


def hear(port: serial.Serial, lines: int = 1) -> list[str]:
    return [port.readline().decode("ascii") for _ in range(lines)]


def test_a_cell_forward_in_real_time() -> None:
    """30 cm a cell (thesis, section 3.5), and 'real time': the wall clock advances with the simulated one."""
    session = Session(real_time=True)
    try:
        with session.client() as port:
            began, time_began = time.monotonic(), session.world.time
            say(port, "M1")
            assert hear(port, 2) == ["OK\n", "DONE\n"]
            wall, simulated = time.monotonic() - began, session.world.time - time_began
            assert session.moved().x == pytest.approx(0.30, rel=0.02)
            assert wall >= simulated - 2 * session.world.control_period  # never ahead; a busy machine may lag
            say(port, "F")
            assert hear(port, 2) == ["OK\n", "DONE\n"]
        session.thread.join(10)
        assert not session.thread.is_alive()
    finally:
        session.end()


def test_busy_stop_and_errors(session: Session) -> None:
    with session.client() as port:
        say(port, "M9", "M1", "Kr90", "B", "F")
        assert hear(port, 5) == ["OK\n", "BUSY\n", "BUSY\n", "BUSY\n", "BUSY\n"]
        say(port, "S")
        assert hear(port) == ["OK\n"]
        say(port, "M0", "Kr361", "forward")
        answers = hear(port, 3)
        assert [answer[:4] for answer in answers] == ["ERR "] * 3
        say(port, "S")  # it still listens, and nothing else was said meanwhile: the stopped command is never DONE
        assert hear(port) == ["OK\n"]
        assert session.moved().x < 1.0


def test_turning_left_is_positive(session: Session) -> None:
    """REP-103: counter-clockwise; the sign that Kr and Kn must not share."""
    with session.client() as port:
        say(port, "Kr90")
        assert hear(port, 2) == ["OK\n", "DONE\n"]
        assert session.moved().theta == pytest.approx(np.pi / 2, abs=0.1)
        say(port, "Kn90")
        assert hear(port, 2) == ["OK\n", "DONE\n"]
        assert session.moved().theta == pytest.approx(0.0, abs=0.1)


def test_f_ends_the_session_and_what_follows_it_is_not_executed(session: Session) -> None:
    with session.client() as port:
        say(port, b"F\nM1\nKr90\n")
        assert hear(port, 2) == ["OK\n", "DONE\n"]
        session.thread.join(10)
        assert not session.thread.is_alive()
    assert not os.path.exists(session.path)
    assert abs(session.moved().x) < 0.002


def test_commands_in_pieces_and_with_carriage_returns(session: Session) -> None:
    with session.client() as port:
        for piece in (b"K", b"r", b"1", b"0\r", b"\n"):
            port.write(piece)
            port.flush()
            time.sleep(0.01)
        assert hear(port, 2) == ["OK\n", "DONE\n"]
        assert session.moved().theta == pytest.approx(np.radians(10), abs=0.05)


def test_garbage_is_refused_line_by_line_and_moves_nothing(session: Session) -> None:
    garbage = np.random.default_rng(0).integers(0, 256, 3000, dtype=np.uint8).tobytes().replace(b"S\n", b"s\n")
    with session.client() as port:
        say(port, b"\n\r\n", garbage + b"\n", b"M" + b"1" * 5000 + b"\n", b"M1\0\n", b"\xff\xfe M1\n", "S")
        heard = []
        while "OK\n" not in heard:
            heard += hear(port)
    refused = sum(1 for line in (garbage + b"\n").split(b"\n") if line.rstrip(b"\r"))
    assert len(heard) == refused + 3 + 1
    assert all(line.startswith("ERR ") and line.endswith("\n") and line.isascii() for line in heard[:-1])
    assert abs(session.moved().x) < 0.002
    assert abs(session.moved().theta) < 0.002


def test_a_client_may_hang_up_and_the_next_one_starts_afresh(session: Session) -> None:
    with session.client() as port:
        say(port, "M1", b"Kr9")  # the second line is never finished
        assert hear(port) == ["OK\n"]
        before = session.world.time
    deadline = time.monotonic() + 10
    while session.world.time < before + 5.0 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert session.moved().x == pytest.approx(0.30, rel=0.02)  # what was accepted is executed without a listener
    with session.client() as port:
        port.reset_input_buffer()
        say(port, "Kn90")
        assert hear(port, 2) == ["OK\n", "DONE\n"]
        assert session.moved().theta == pytest.approx(-np.pi / 2, abs=0.1)


def test_a_client_that_never_reads_blocks_nobody(session: Session) -> None:
    """More answers than the port's buffers hold are lost; the car goes on, and those that come are whole lines."""
    with session.client() as port:
        for _ in range(40):
            say(port, b"x\n" * 200)
        before = session.world.time
        deadline = time.monotonic() + 10
        while session.world.time < before + 1.0 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert session.world.time >= before + 1.0
        port.timeout = 0.5
        heard = port.read(1_000_000).decode("ascii").splitlines()
        assert set(heard) == {"ERR unknown command 'x': M<n> Kr<d> Kn<d> B S F"}
        assert len(heard) < 40 * 200


def test_stop_ends_the_session_without_a_client() -> None:
    session = Session(real_time=True)
    session.end()
    assert not session.thread.is_alive()
    assert not os.path.exists(session.path)


chunks = st.lists(st.binary(max_size=40) | st.sampled_from([b"M1", b"\n", b"\r\n", b"x" * (MAX_LINE - 1)]), max_size=30)


@given(parts=chunks)
def test_lines_do_not_depend_on_how_the_bytes_arrive(parts: list[bytes]) -> None:
    splitter, stream = LineSplitter(), b"".join(parts)
    lines = [line for part in parts for line in splitter.feed(part)]
    expected = []
    for line in stream.split(b"\n")[:-1]:
        kept = line[:MAX_LINE].decode("ascii", errors="replace").rstrip("\r")
        expected.append(kept + "\ufffd" if len(line) > MAX_LINE else kept)
    assert lines == [line for line in expected if line]


def test_overlong_lines_cost_no_memory_and_do_not_leak_into_the_next() -> None:
    splitter = LineSplitter()
    assert [splitter.feed(b"M1" * 1000) for _ in range(1000)] == [[]] * 1000
    assert len(splitter._partial) == MAX_LINE
    first, second = splitter.feed(b"\nM2\n")
    assert first.endswith("\ufffd")
    assert second == "M2"


def test_the_pacer_keeps_to_the_clock_and_forgets_long_pauses() -> None:
    """Oracle: ticks due at start + k x period, after a pause at pause's end + k x period."""
    now = 10.0
    pacer = Pacer(0.05, lambda: now)
    waits = []
    for worked in (0.01, 0.03, 0.06, 0.02):  # the third tick takes longer than a period: the fourth makes up for it
        now += worked
        waits.append(pacer.left())
        now += pacer.left()
        pacer.tick()
    np.testing.assert_allclose(waits, [0.04, 0.02, 0.0, 0.02], atol=1e-12)
    now += 100.0
    ends = []
    for _ in range(4):
        now += pacer.left()
        pacer.tick()
        ends.append(now)
    assert max(b - a for a, b in pairwise(ends)) <= 0.05 + 1e-12
    assert ends[-1] - ends[0] >= 2 * 0.05 - 1e-12  # at most one tick is caught up with


def test_the_command_line_prints_the_path_first_and_leaves_with_status_0() -> None:
    command = [sys.executable, "-m", "robocar", "serial", "thesis-field"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        path = process.stdout.readline().rstrip("\n")
        with serial.Serial(path, 115200, timeout=10) as port:
            say(port, "M1", "M1")
            assert hear(port, 3) == ["OK\n", "BUSY\n", "DONE\n"]
            say(port, "F")
            assert hear(port, 2) == ["OK\n", "DONE\n"]
        assert process.wait(20) == 0
        assert process.stdout.read() == ""
