"""What the tests of the firmware share: a bench on which it turns simulated wheels that obey the motor equation."""

from __future__ import annotations

import math

import numpy as np

from robocar.core import Calibration, Limits
from robocar.sim.firmware import Firmware, FirmwareParameters

LIMITS = Limits(min_vel_x=-0.2, max_vel_x=0.4, max_vel_theta=1.5, acc_lim_x=0.8, acc_lim_theta=4.0)
RADIUS, TRACK, PULSES, VOLTS_PER_SPEED, SUPPLY = 0.042, 0.2333, 200, 0.74, 11.1
PULSE = math.tau / PULSES
PERIOD = FirmwareParameters().period


class Bench:
    """The firmware on a test bench: wheels with a first-order response to their voltage, in the air, and a perfect compass."""

    def __init__(self, compass: bool = False, slip: float = 1.0, blocked: bool = False) -> None:
        calibration = Calibration(RADIUS, np.array([0.0, 100.0]), np.array([TRACK, TRACK]))
        self.firmware = Firmware(LIMITS, calibration, PULSES, VOLTS_PER_SPEED, SUPPLY, compass)
        self._compass, self._slip, self._blocked = compass, slip, blocked
        self.angles, self.speeds = np.zeros(2), np.zeros(2)
        self.x = self.heading = 0.0
        self.ticks: list[tuple[float, float]] = []  # voltages

    def step(self) -> None:
        if self._compass and len(self.ticks) % 5 == 0:
            self.firmware.compass(math.remainder(self.heading, math.tau))
        counts = np.floor(self.angles / PULSE + 1e-9).astype(int)
        voltages = self.firmware.step(int(counts[0]), int(counts[1]))
        self.ticks.append(voltages)
        if not self._blocked:
            target = np.array(voltages) / VOLTS_PER_SPEED
            self.speeds += (target - self.speeds) * (1.0 - math.exp(-PERIOD / 0.03))
        turned = self.speeds * PERIOD
        self.angles += turned
        self.x += RADIUS * turned.mean()
        self.heading += self._slip * RADIUS * (turned[1] - turned[0]) / TRACK

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.step()

    def send(self, line: str) -> list[str]:
        """What is answered at once."""
        self.firmware.receive(line)
        return list(self.firmware.answers())

    def finish(self, limit: float = 60.0) -> list[str]:
        """What is answered until the command has ended."""
        ticks = round(limit / PERIOD)
        while self.firmware.busy and ticks:
            self.step()
            ticks -= 1
        return list(self.firmware.answers())
