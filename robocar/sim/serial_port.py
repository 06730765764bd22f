"""The firmware's serial line on a pseudo-terminal, so that any serial program drives the simulated car in real time."""

from __future__ import annotations

import fcntl
import os
import select
import struct
import termios
import time
import tty
from collections.abc import Callable

from robocar.sim.world import World

MAX_LINE = 256  # [bytes] commands are much shorter; more is not kept, and the line is refused as a whole
MAX_READ = 1024  # [bytes] a control tick, more than 115 200 baud bring in 50 ms; a faster client waits
MAX_UNSENT = 4096  # [bytes] of answers that nobody reads; later ones are lost, as in a UART's buffer
READ_OUT_TIME = 1.0  # [s] for the client to read the last answers: closing the port throws away what it has not read


class LineSplitter:
    """Cuts a stream of bytes into lines of text, whatever the bytes are and however they arrive."""

    def __init__(self, limit: int = MAX_LINE) -> None:
        self._limit = limit
        self._partial = bytearray()
        self._overlong = False

    def feed(self, chunk: bytes) -> list[str]:
        """The lines that are complete now, without their line feeds.

        Bytes that are no ASCII become U+FFFD, and of an overlong line only the first `limit` bytes and one U+FFFD are left: no
        command holds that character, so the firmware refuses the line. Empty lines are left out (clients end lines in CR LF).
        """
        *complete, rest = chunk.split(b"\n")
        lines = []
        for part in complete:
            self._keep(part)
            text = self._partial.decode("ascii", errors="replace").rstrip("\r") + "\ufffd" * self._overlong
            self.clear()
            if text:
                lines.append(text)
        self._keep(rest)
        return lines

    def clear(self) -> None:
        """Forget what has come of the line that is not complete."""
        self._partial.clear()
        self._overlong = False

    def _keep(self, part: bytes) -> None:
        room = self._limit - len(self._partial)
        self._partial += part[:room]
        self._overlong = self._overlong or len(part) > room


class Pacer:
    """Holds simulated time back to the wall clock. The clock decides when a tick is computed, never what happens in it."""

    def __init__(self, period: float, clock: Callable[[], float] = time.monotonic) -> None:
        """`period` of the ticks [s]."""
        self._period, self._clock = period, clock
        self._due = clock() + period

    def left(self) -> float:
        """Until the next tick is due [s], never negative."""
        return max(self._due - self._clock(), 0.0)

    def tick(self) -> None:
        """One tick was computed. Time lost by more than one (a suspended process) is not caught up with."""
        self._due = max(self._due, self._clock() - self._period) + self._period


def serve(
    world: World,
    *,
    real_time: bool = True,
    stop: Callable[[], bool] = lambda: False,
    announce: Callable[[str], None],
) -> None:
    """Offer the firmware's protocol (`robocar.sim.firmware`) on a pseudo-terminal until a client says `F`.

    Each answer ends in a line feed. A client may hang up and another one, or the same again, take over.

    Args:
        world: of one robot; stepped here.
        real_time: keep pace with the wall clock; otherwise as fast as it goes.
        stop: asked before every control tick; True ends the session.
        announce: told the pseudo-terminal's path once, when it is open.
    """
    port, client_side = os.openpty()
    try:
        path = os.ttyname(client_side)
        tty.setraw(client_side)  # no echo, no translation of line ends; lasts as long as the port
    finally:
        os.close(client_side)  # else nobody would notice that a client hangs up
    try:
        os.set_blocking(port, False)
        announce(path)
        _serve(world, port, real_time, stop)
        _wait_until_read(path)
    finally:
        os.close(port)


def _serve(world: World, port: int, real_time: bool, stop: Callable[[], bool]) -> None:
    robot, firmware = world.robot, world.robot.firmware
    splitter = LineSplitter()
    pacer = Pacer(world.control_period)
    unsent = b""
    while not (stop() or firmware.finished):
        for line in _listen(port, splitter, pacer.left if real_time else lambda: 0.0):
            if not firmware.finished:  # whatever stands behind F is none of its instructions
                firmware.receive(line)
        pacer.tick()
        world.step()
        for answer in robot.sense().serial:
            if len(unsent) < MAX_UNSENT:  # whole lines are lost, never parts
                unsent += f"{answer}\n".encode("ascii")
        unsent = unsent[_write(port, unsent) :]


def _listen(port: int, splitter: LineSplitter, time_left: Callable[[], float]) -> list[str]:
    """The lines that arrive until no time is left [s]; at least what is there already."""
    lines: list[str] = []
    room = MAX_READ
    while room and select.select([port], [], [], time_left())[0]:
        try:
            chunk = os.read(port, room)
        except OSError:  # EIO: no client is connected
            splitter.clear()
            break
        room -= len(chunk)
        lines += splitter.feed(chunk)
    time.sleep(time_left())
    return lines


def _write(port: int, text: bytes) -> int:
    """Sends what the line takes and returns how much that was [bytes]."""
    try:
        return os.write(port, text) if text else 0
    except BlockingIOError:
        return 0


def _wait_until_read(path: str) -> None:
    """Until the client has read all answers, or for `READ_OUT_TIME`."""
    client_side = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        deadline = time.monotonic() + READ_OUT_TIME
        waiting = 1
        while waiting and time.monotonic() < deadline:
            time.sleep(0.05)  # first: what was written takes a moment to arrive
            (waiting,) = struct.unpack("i", fcntl.ioctl(client_side, termios.FIONREAD, b"\0" * 4))
    finally:
        os.close(client_side)
