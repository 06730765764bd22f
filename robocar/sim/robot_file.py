"""`robot.yaml`: a robot as data. What a field means stands beside it in `models/robots/robocar/robot.yaml`."""

from __future__ import annotations

import re
from dataclasses import fields
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, RootModel, ValidationError, model_validator

from robocar.core import Observation, RobocarError
from robocar.core.observation import USUAL_SENSORS
from robocar.sim.fit_out import FitOut
from robocar.sim.sensors.types import checked_overrides, sensor_type
from robocar.validation import Count, NotNegative, NotPositive, Positive


def _name(text: str) -> str:
    """MuJoCo reads names up to a NUL."""
    if not text or not text.isprintable():
        raise ValueError(f"expected a name, not {text!r}")
    return text


def _sensor_name(text: str) -> str:
    """It becomes the name of a column and of an entity of recordings, whose parts are divided by slashes."""
    if not re.fullmatch(r"[\w.+-]+(/[\w.+-]+)*", text):
        raise ValueError(f"expected words (letters, digits, and . _ + -) with single slashes between them, not {text!r}")
    if text in _NO_SENSORS:
        raise ValueError(f"expected another name than {', '.join(sorted(_NO_SENSORS))}, not {text!r}")
    return text


def _unique(names: list[str]) -> list[str]:
    if len(set(names)) < len(names):
        raise ValueError(f"expected different names, not {names}")
    return names


_USUAL_TYPES = ("accelerometer", "bumper", "camera", "compass", "encoder", "psd", "top_camera")
"""Whose readings algorithms find by the sensor's name, in a property of the observation."""
_NO_SENSORS = {name for name in dir(Observation) if not name.startswith("_")} - USUAL_SENSORS | {"serial", "landmarks"}
"""What an observation holds besides the readings of sensors."""

Name = Annotated[str, AfterValidator(_name)]
Names = Annotated[list[Name], AfterValidator(_unique)]
SomeNames = Annotated[Names, Field(min_length=1)]
Choices = dict[str, Annotated[list[bool | str], Field(min_length=1)]]

_CHOICES = tuple(field.name for field in fields(FitOut))


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SideSection(_Section):
    """The wheels of one side, their motors, and the one that carries the encoder."""

    wheels: SomeNames
    motors: SomeNames
    encoder: Name

    @model_validator(mode="after")
    def _of_this_side(self) -> SideSection:
        if self.encoder not in self.wheels:
            raise ValueError(f"encoder: expected a wheel of this side, {' or '.join(self.wheels)}, not {self.encoder!r}")
        return self


class MotorSection(_Section):
    """Direct-current motors, a channel for each side."""

    kind: Literal["dcmotor"]
    supply: Positive
    channel_current: Positive


class DriveSection(_Section):
    """What moves the robot."""

    kind: Literal["skid-steer"]
    left: SideSection
    right: SideSection
    motor: MotorSection
    pulses_per_turn: Count

    @model_validator(mode="after")
    def _two_sides(self) -> DriveSection:
        for key in ("wheels", "motors"):
            if both := sorted(set(getattr(self.left, key)) & set(getattr(self.right, key))):
                raise ValueError(f"right.{key}: expected others than on the left, not {', '.join(both)}")
        return self


class LimitsSection(_Section):
    """`robocar.core.Limits` of a robot that can stand and move."""

    min_vel_x: NotPositive
    max_vel_x: Positive
    max_vel_theta: Positive
    acc_lim_x: Positive
    acc_lim_theta: Positive


class CalibrationEntry(_Section):
    """What the experiment `odometry_calibration` has written: rows of curvature [1/m] and effective track [m]."""

    wheel_radius: Positive
    effective_track: Annotated[list[tuple[NotNegative, Positive]], Field(min_length=1)]

    @model_validator(mode="after")
    def _ascending(self) -> CalibrationEntry:
        if any(following[0] <= row[0] for row, following in pairwise(self.effective_track)):
            raise ValueError("effective_track: expected rows [curvature, track], curvatures ascending")
        return self


class CalibrationFile(RootModel[dict[str, CalibrationEntry]]):
    """Entries by their names."""


class CalibrationSection(_Section):
    """Entry `entry` of a file, or another one where something is fitted."""

    file: Name
    entry: Name
    fitted: dict[str, Name] = {}


class SolverSection(_Section):
    """MuJoCo's options that the tyres were modelled with."""

    impratio: Positive = 1.0


class PanSection(_Section):
    """The actuator that turns the camera."""

    actuator: Name
    sweep_angle: Positive
    sweep_rate: Positive


class OptionalSection(_Section):
    """Parts of the MJCF that belong to a choice."""

    bodies: Names = []
    actuators: Names = []


class RingSection(_Section):
    """Sites on a circle around the base, the first one ahead, each looking outwards."""

    count: Annotated[Count, Field(le=1000)]
    radius: Positive
    height: Positive


class SensorSection(_Section):
    """A sensor, or a ring of equal ones that are numbered."""

    name: Annotated[str, AfterValidator(_sensor_name)]
    type: str
    label: Name | None = None
    site: Name | None = None
    element: Name | None = None
    ring: RingSection | None = None
    parameters: dict[str, Any] = {}
    fitted: Choices = {}

    @model_validator(mode="after")
    def _sensible(self) -> SensorSection:
        try:
            sensor_type(self.type)
            checked_overrides({self.type: self.parameters})
        except ValidationError as error:
            first = error.errors()[0]
            raise ValueError(f"sensor {self.name!r}: parameters.{first['loc'][-1]}: {first['msg']}") from error
        except (RobocarError, ValueError) as error:
            raise ValueError(f"sensor {self.name!r}: {error}") from error
        if self.ring is not None and self.site is None:
            raise ValueError(f"sensor {self.name!r}: a ring needs the name of its sites")
        if self.name in USUAL_SENSORS and self.type in (*_USUAL_TYPES, "lidar", "sonar") and self.type != self.name:
            raise ValueError(f"sensor {self.name!r}: expected one of this type, not of type {self.type}")
        return self

    def chosen(self, fit_out: FitOut) -> bool:
        """Whether this fit-out has it."""
        return all(fit_out.choice(key) in values for key, values in self.fitted.items())


class RobotFile(_Section):
    """The whole file."""

    mjcf: Name
    base: Name
    hull: Name
    drive: DriveSection
    limits: LimitsSection
    calibration: CalibrationSection
    solver: SolverSection = SolverSection()
    firmware: dict[Literal["compass", "bumper"], str] = {}
    pan: PanSection | None = None
    optional: dict[str, OptionalSection] = {}
    sensors: list[SensorSection]

    @model_validator(mode="after")
    def _choices(self) -> RobotFile:
        used = [("calibration", self.calibration.fitted), ("optional", self.optional)]
        for where, choices in [*used, *((f"sensor {sensor.name!r}", sensor.fitted) for sensor in self.sensors)]:
            for key in choices:
                if key not in _CHOICES:
                    raise ValueError(f"{where}: there is no choice {key!r}; known: {', '.join(_CHOICES)}")
        return self

    @model_validator(mode="after")
    def _found_by_name(self) -> RobotFile:
        names = sorted({sensor.name for sensor in self.sensors})
        for kind in _USUAL_TYPES:
            called = [sensor.name for sensor in self.sensors if sensor.type == kind]
            if called and kind not in called:
                raise ValueError(f"sensor {called[0]!r}: expected the name {kind!r}, by which algorithms find the {kind}")
        for key, name in self.firmware.items():
            if name not in names:
                raise ValueError(f"firmware.{key}: there is no sensor {name!r}; known: {', '.join(names)}")
            if other := [s.type for s in self.sensors if s.name == name and sensor_type(s.type).firmware_input != key]:
                raise ValueError(
                    f"firmware.{key}: expected a sensor that measures what it reads, not {name!r} of type {other[0]}"
                )
        return self
