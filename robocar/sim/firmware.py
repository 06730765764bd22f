"""The program of the car's microcontroller: wheel control on encoder counts and the thesis' serial commands.

It knows what the ATmega knows: encoder counts, the clock, the bumper, and the compass where one is fitted. Both a twist and a
serial command end as *reference angles* of the left and the right wheels, which move as fast as the limits allow; a proportional
controller on the count error with the motor's own back-EMF as feedforward makes the wheels follow. Controlling angles instead of
speeds lets 200 coarse pulses a turn give exact mean speeds and distances.

Commands (thesis, Table 3.1), ASCII lines ending in a line feed:

    M<n>   forward n grid cells of 30 cm      Kr<d>  turn left d degrees       S  stop
    B      back one grid cell                 Kn<d>  turn right d degrees      F  finish: end of the instructions

Answers: `OK` (accepted), `DONE` (executed), `BUSY` (another one is being executed; only S is taken), `ERR <text>` (no motion).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from robocar.core import Calibration, Limits, Twist, wrap_angle

CELL = 0.30  # [m] side of a cell of the thesis' navigation grid
MAX_CELLS = 99
MAX_DEGREES = 360.0

_COMMAND = re.compile(r"(M|Kr|Kn|B|S|F)(\S*)")


@dataclass(frozen=True, slots=True)
class FirmwareParameters:
    """Control constants, flashed once.

    Args:
        period: of the control loop [s].
        gain: voltage for an angle error [V/rad].
        max_lag: the reference never runs farther ahead of a blocked wheel than this [rad].
        command_speed: along a straight command [m/s]; command_turn_rate: on the spot [rad/s].
        settle_time: a command is done when the wheels have rested this long [s].
        blocked_time: a command is given up when the wheels have lagged this long [s].
        bumped_time: a straight one ahead also when the bumper has been pressed this long [s]: wheels slip before they stall.
        heading_gain: turning rate for a heading error, with a compass [1/s].
        compass_readings: that are averaged at rest; heading_tolerance: larger errors than this are corrected then: three standard
            deviations of the difference of two such means, so that noise alone turns nothing [rad].
    """

    period: float = 0.01
    gain: float = 20.0
    max_lag: float = 0.5
    command_speed: float = 0.25
    command_turn_rate: float = 1.0
    settle_time: float = 0.15
    blocked_time: float = 1.0
    bumped_time: float = 0.2
    heading_gain: float = 1.5
    compass_readings: int = 10
    heading_tolerance: float = math.radians(0.55)


@dataclass(slots=True)
class _Motion:
    """A serial command in execution: how far to go, how far the profile has got, and how fast it is.

    `distance` is metres for a straight, radians for a turn; `heading` is where a compass should point at the end; `free` is how
    far the profile had got when the way was last known to be free.
    """

    turning: bool
    distance: float
    heading: float | None
    done: float = 0.0
    free: float = 0.0
    speed: float = 0.0
    resting: float = 0.0
    started: bool = False
    corrections: int = 0


class Firmware:
    """One `step` per control period turns counts into the voltages of the left and the right motor channel."""

    def __init__(
        self,
        limits: Limits,
        calibration: Calibration,
        pulses_per_turn: int,
        volts_per_speed: float,
        max_voltage: float,
        has_compass: bool,
        parameters: FirmwareParameters | None = None,
    ) -> None:
        """`volts_per_speed` is the back-EMF of a wheel [V s/rad]."""
        self.parameters = parameters or FirmwareParameters()
        self._limits = limits
        self._radius = calibration.wheel_radius
        self._calibration = calibration
        self._pulse = math.tau / pulses_per_turn
        self._volts_per_speed = volts_per_speed
        self._max_voltage = max_voltage
        self._has_compass = has_compass
        self._command = Twist()  # what was asked for
        self._current = Twist()  # what the ramps have reached
        self._reference = [0.0, 0.0]  # [rad] left, right
        self._motion: _Motion | None = None
        self._hindered = 0.0  # [s] for how long the motion has been blocked
        self._bumped = False
        self._headings: list[float] = []  # last compass readings
        self._answers: list[str] = []
        self.finished = False

    @property
    def busy(self) -> bool:
        """Whether a serial command is being executed."""
        return self._motion is not None

    def drive(self, twist: Twist) -> None:
        """Keep this twist, within the limits, until told otherwise. Ends a serial command in execution."""
        limits = self._limits
        v = min(max(twist.v, limits.min_vel_x), limits.max_vel_x)
        omega = min(max(twist.omega, -limits.max_vel_theta), limits.max_vel_theta)
        self._motion = None
        self._command = Twist(v, omega)

    def receive(self, line: str) -> None:
        """Take one line from the serial port; what there is to say comes back through `answers`."""
        text = line.strip("\r\n")
        match = _COMMAND.fullmatch(text)
        if match is None:
            self._answers.append(f"ERR unknown command {_shown(text)}: M<n> Kr<d> Kn<d> B S F")
            return
        name, argument = match.groups()
        if name in "BSF" and argument:
            self._answers.append(f"ERR {name} takes no number, not {_shown(argument)}")
        elif name == "S":
            self._motion = None
            self._command = Twist()
            self._answers.append("OK")
        elif self.busy:
            self._answers.append("BUSY")
        elif name == "F":
            self._command = Twist()
            self.finished = True
            self._answers += ["OK", "DONE"]
        else:
            self._begin(name, argument)

    def _begin(self, name: str, argument: str) -> None:
        if name == "M":
            if re.fullmatch(r"[0-9]{1,3}", argument) is None or not 1 <= int(argument) <= MAX_CELLS:
                self._answers.append(f"ERR M takes 1 to {MAX_CELLS} cells, not {_shown(argument)}")
                return
            turning, distance = False, CELL * int(argument)
        elif name == "B":
            turning, distance = False, -CELL
        else:
            if re.fullmatch(r"[0-9]{1,3}(\.[0-9]{1,3})?", argument) is None or not 0 < float(argument) <= MAX_DEGREES:
                self._answers.append(f"ERR {name} takes more than 0, at most {MAX_DEGREES:g} degrees, not {_shown(argument)}")
                return
            turning = True
            distance = math.radians(float(argument)) * (1 if name == "Kr" else -1)
        heading = None
        if self._has_compass and self._headings:
            heading = self._mean_heading() + (distance if turning else 0.0)
        self._command = Twist()
        self._hindered = 0.0
        self._motion = _Motion(turning, distance, heading)
        self._answers.append("OK")

    def compass(self, heading: float) -> None:
        """A new compass reading [rad]."""
        self._headings.append(heading)
        del self._headings[: -self.parameters.compass_readings]

    def bumper(self, pressed: bool) -> None:
        """A new reading of the bumper."""
        self._bumped = pressed

    def _mean_heading(self) -> float:
        return math.atan2(sum(map(math.sin, self._headings)), sum(map(math.cos, self._headings)))

    def answers(self) -> tuple[str, ...]:
        """Lines said since the last call."""
        said = tuple(self._answers)
        self._answers.clear()
        return said

    def step(self, counts_left: int, counts_right: int) -> tuple[float, float]:
        """One control period: encoder counts in, voltages [V] of the left and the right channel out."""
        period = self.parameters.period
        measured = counts_left * self._pulse, counts_right * self._pulse
        if self._motion is not None:
            twist = self._follow(self._motion, measured)
        else:
            twist = self._ramp(self._command)
        self._current = twist
        spread = 0.5 * twist.omega * self._calibration.effective_track(twist.v, twist.omega)
        rates = (twist.v - spread) / self._radius, (twist.v + spread) / self._radius
        voltages = []
        for side in (0, 1):
            reference = self._reference[side] + rates[side] * period
            lag = self.parameters.max_lag
            reference = min(max(reference, measured[side] - lag), measured[side] + lag)
            self._reference[side] = reference
            error = reference - measured[side]
            if rates[side] == 0.0 and 0.0 <= error < self._pulse:
                error = 0.0  # it rests in the pulse that the reference lies in; chasing the rest would make it hunt for ever
            voltage = self._volts_per_speed * rates[side] + self.parameters.gain * error
            voltages.append(min(max(voltage, -self._max_voltage), self._max_voltage))
        return voltages[0], voltages[1]

    def _ramp(self, target: Twist) -> Twist:
        """The current twist, moved towards the target as far as the accelerations allow in one period."""
        current, period = self._current, self.parameters.period
        if current == target:
            return target
        dv = self._limits.acc_lim_x * period
        domega = self._limits.acc_lim_theta * period
        return Twist(
            current.v + min(max(target.v - current.v, -dv), dv),
            current.omega + min(max(target.omega - current.omega, -domega), domega),
        )

    def _follow(self, motion: _Motion, measured: tuple[float, float]) -> Twist:
        """The next twist of a trapezoidal profile, and the end of the command when the wheels rest at its end."""
        p = self.parameters
        errors = [reference - angle for reference, angle in zip(self._reference, measured, strict=True)]
        bumped = self._bumped and not motion.turning and motion.distance > 0
        if bumped or max(map(abs, errors)) >= 0.9 * p.max_lag:
            self._hindered += p.period
        else:
            self._hindered, motion.free = 0.0, motion.done
        if self._hindered > (p.bumped_time if bumped else p.blocked_time):
            self._end(f"ERR blocked after {abs(motion.free):.2f} {'rad' if motion.turning else 'm'}")
            return Twist()
        if not motion.started and self._current != Twist():  # it still rolls from what it did before
            return self._ramp(Twist())
        motion.started = True
        acceleration = self._limits.acc_lim_theta if motion.turning else self._limits.acc_lim_x
        top = p.command_turn_rate if motion.turning else p.command_speed
        left = motion.distance - motion.done
        if left:
            # As fast as still lets it brake to a stop: steps of v, v - dv, v - 2 dv ... over a period each sum up to v^2 / 2a and
            # half a step. The last one lands exactly.
            dv = acceleration * p.period
            braking = math.sqrt(0.25 * dv * dv + 2.0 * acceleration * abs(left)) - 0.5 * dv
            speed = min(motion.speed + dv, top, braking)
            step = math.copysign(min(max(speed * p.period, 1e-5), abs(left)), left)
            motion.done = motion.distance if abs(step) >= abs(left) else motion.done + step
            motion.speed = speed
            rate = step / p.period
            if motion.turning:
                return Twist(0.0, rate)
            correction = 0.0
            if motion.heading is not None:
                correction = p.heading_gain * wrap_angle(motion.heading - self._mean_heading())
            return Twist(rate, correction)
        motion.speed = 0.0
        motion.resting = motion.resting + p.period if max(map(abs, errors)) <= 1.5 * self._pulse else 0.0
        if motion.resting >= p.settle_time + (0.05 * p.compass_readings if motion.heading is not None else 0.0):
            self._settle(motion)
        return Twist()

    def _settle(self, motion: _Motion) -> None:
        """At rest at the end of the profile: done, unless the compass says that the turn is still off."""
        if motion.heading is not None and motion.corrections < 4:
            error = wrap_angle(motion.heading - self._mean_heading())
            if abs(error) > self.parameters.heading_tolerance:
                self._motion = _Motion(True, error, motion.heading, corrections=motion.corrections + 1)
                return
        self._end("DONE")

    def _end(self, answer: str) -> None:
        self._motion = None
        self._command = self._current = Twist()
        self._hindered = 0.0
        self._answers.append(answer)


def _shown(text: str) -> str:
    """What was received, as far as it can stand in an answer: one short line of ASCII."""
    return repr(text) if text.isascii() and text.isprintable() and len(text) <= 32 else "an unreadable line"
