"""Observations and commands as columns of numbers and back, without losing a bit.

Entity `observation` has one row per tick. Column `time` is the tick's [s]. Every sensor has a column of its own, called after the
sensor and the kind of its readings, so that a sensor that this file has never heard of is kept and read back like any other:

* `<sensor>:float`, `:int`, `:bool`, `:vector`  time, value or values
* `<sensor>:wheel_angles`                       time, left, right
* `<sensor>:twist`                              time, v, omega
* `<sensor>:pose`                               time, x, y, theta
* `<sensor>:scan`                               n, time, max_range, beam_width, x, y, theta of the sensor, n ranges, n bearings
* `<sensor>:detections`                         for each: time, bearing, range, the four numbers of the covariance by rows, tail
* `<sensor>:image`                              time, nine of the intrinsics, sixteen of robot_from_camera
* `<sensor>:lines`                              text

Where the scans of a tick are not in the order of their sensors' names, `scans` holds these in the right order.
Texts that belong to numbers stand beside them: `<sensor>:scan.text` is the scan's name where it is not the last part of the
sensor's, `<sensor>:detections.text` the names of the landmarks. A column that has nothing new at a tick is empty there; a
column that is empty in a whole batch is left out. Numbers are float64, an absent value is an empty list. The pixels of images are
PNG, at the entities that the viewer shows them at.

Entity `command`: `kind`, `values` (v, omega of a Drive), `pan`, `text` (line of a Serial, reason of Done and GiveUp), `status`
(of GiveUp), `work` and its `units`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robocar.core import (
    SE2,
    Command,
    Detection,
    Done,
    Drive,
    GiveUp,
    Hold,
    Image,
    Observation,
    Reading,
    Scan,
    Serial,
    Twist,
    WheelAngles,
)

_TEXT = ".text"

Row = dict[str, Any]
"""Values by column; what is missing is empty."""


@dataclass(frozen=True, slots=True)
class _Kind:
    """One type of readings.

    Args:
        name: as in the column's name.
        numbers: of a reading, (n,); of lines, the lines.
        decode: the reading from its numbers, its texts and the sensor's name.
        texts: of a reading.
    """

    name: str
    numbers: Callable[[Any], Any]
    decode: Callable[[Any, Sequence[str], str], Any]
    texts: Callable[[Any, str], Sequence[str]] = lambda reading, sensor: ()


def _value(name: str, numbers: Callable[[Any], Sequence[float]], value: Callable[..., Any]) -> _Kind:
    """The kind of a `Reading` whose value is so many numbers."""
    return _Kind(
        name,
        lambda reading: (reading.time, *numbers(reading.value)),
        lambda n, _, __: Reading(float(n[0]), value(*map(float, n[1:]))),
    )


def _scan_numbers(scan: Scan) -> Sequence[float] | NDArray[np.float64]:
    mount = scan.robot_from_sensor
    head = (len(scan.ranges), scan.time, scan.max_range, scan.beam_width, mount.x, mount.y, mount.theta)
    if len(scan.ranges) == 1:  # a sonar: plain tuples are several times faster than arrays
        return (*head, float(scan.ranges[0]), float(scan.bearings[0]))
    return np.concatenate([head, scan.ranges, scan.bearings])


def _scan(numbers: NDArray[np.float64], texts: Sequence[str], sensor: str) -> Scan:
    count = int(numbers[0])
    time, max_range, beam_width, x, y, theta = map(float, numbers[1:7])
    name = texts[0] if len(texts) else _last(sensor)
    return Scan(time, numbers[7 : 7 + count], numbers[7 + count :], max_range, beam_width, SE2(x, y, theta), name)


def _last(sensor: str) -> str:
    return sensor.rpartition("/")[2]


def _detections(numbers: NDArray[np.float64], names: Sequence[str], _: str) -> tuple[Detection, ...]:
    rows = np.reshape(numbers, (len(names), -1))  # recordings of before the tail have no eighth number
    return tuple(
        Detection(float(row[0]), name, float(row[1]), float(row[2]), row[3:7].reshape(2, 2).copy(), *map(float, row[7:]))
        for row, name in zip(rows, names, strict=True)
    )


_READINGS: dict[type, _Kind] = {
    bool: _value("bool", lambda v: (v,), bool),
    int: _value("int", lambda v: (v,), int),
    float: _value("float", lambda v: (v,), float),
    np.ndarray: _value("vector", lambda v: v, lambda *values: np.array(values)),
    WheelAngles: _value("wheel_angles", lambda v: (v.left, v.right), WheelAngles),
    Twist: _value("twist", lambda v: (v.v, v.omega), Twist),
    SE2: _value("pose", lambda v: (v.x, v.y, v.theta), SE2),
}
"""By the type of a `Reading`'s value."""
_IMAGE = _Kind(
    "image",
    lambda image: np.concatenate([(image.time,), image.intrinsics.ravel(), image.robot_from_camera.ravel()]),
    lambda numbers, _, __: (float(numbers[0]), np.array(numbers[1:10]).reshape(3, 3), np.array(numbers[10:26]).reshape(4, 4)),
)
_LINES = _Kind("lines", lambda lines: lines, lambda lines, _, __: tuple(lines))
_DETECTIONS = _Kind(
    "detections",
    lambda seen: np.concatenate([(d.time, d.bearing, d.range, *d.covariance.ravel(), d.short_tail) for d in seen]),
    _detections,
    lambda seen, _: [d.landmark for d in seen],
)
_SCAN = _Kind("scan", _scan_numbers, _scan, lambda scan, sensor: () if scan.name == _last(sensor) else (scan.name,))
_BY_NAME = {kind.name: kind for kind in (*_READINGS.values(), _SCAN, _IMAGE, _LINES, _DETECTIONS)}


@cache
def _kind_of_value(value: type) -> _Kind | None:
    return next((_READINGS[base] for base in value.__mro__ if base in _READINGS), None)


def plain(reading: Any) -> Any:
    """A reading whose value is a scalar of numpy or an array without axes, as one of Python's own number; others as they are."""
    if isinstance(reading, Reading) and isinstance(reading.value, np.generic | np.ndarray) and np.ndim(reading.value) == 0:
        return Reading(reading.time, reading.value.item())
    return reading


def _kind_of(reading: Any, sensor: str) -> _Kind:
    """How a reading is written.

    Raises:
        TypeError: it is of a type that no one has said how to write.
        ValueError: it is a whole number that no float holds.
    """
    kind: _Kind | None = None
    match reading:
        case Reading(_, np.ndarray() as value) if value.ndim > 1 or value.dtype.kind not in "biuf":
            pass
        case Reading(_, int() as value) if not (abs(value) <= sys.float_info.max and int(float(value)) == value):
            raise ValueError(f"sensor {sensor!r}: {value!r} cannot be recorded: numbers are kept as float64")
        case Reading(_, value):
            kind = _kind_of_value(type(value))
        case Scan():
            kind = _SCAN
        case Image():
            kind = _IMAGE
        case tuple():
            kind = _LINES if isinstance(reading[0], str) else _DETECTIONS
    if kind is None:
        known = ", ".join(sorted(t.__name__ for t in _READINGS))
        raise TypeError(
            f"sensor {sensor!r}: {reading!r} cannot be recorded; give a Scan, an Image, a tuple of Detection or of lines, "
            f"or a Reading of {known}"
        )
    return kind


def encode_observation(observation: Observation) -> Row:
    """The row of `observation`, without pixels.

    Raises:
        TypeError: a reading is of a type that cannot be written.
        ValueError: a sensor's name or a number cannot be written.
    """
    row: Row = {"time": (observation.time,)}
    scans = []
    for sensor, reading in observation.readings.items():
        if "\0" in sensor:  # Rerun aborts the interpreter
            raise ValueError(f"a sensor cannot be called {sensor!r}: the name of a column holds no NUL")
        reading = plain(reading)
        kind = _kind_of(reading, sensor)
        column = f"{sensor}:{kind.name}"
        if kind is _LINES:
            row[column] = reading
            continue
        row[column] = kind.numbers(reading)
        if texts := kind.texts(reading, sensor):
            row[column + _TEXT] = texts
        if kind is _SCAN:
            scans.append(sensor)
    if scans != sorted(scans):
        row["scans"] = scans
    return row


def unknown_columns(row: Row) -> list[str]:
    """Columns that no observation of this version has; recordings of earlier versions have some."""
    known = {"time", "scans"}
    return [name for name in row if name not in known and name.rpartition(":")[2].removesuffix(_TEXT) not in _BY_NAME]


def image_entity(sensor: str) -> str:
    """Where a camera is drawn; its pixels are at `/image` below."""
    return "world/top_camera" if sensor == "top_camera" else f"world/robot/{sensor}"


def images(row: Row) -> list[str]:
    """The sensors of the pictures of a row."""
    return [column.rpartition(":")[0] for column in row if column.endswith(":image")]


def decode_observation(row: Row, pixels: Mapping[str, NDArray[np.uint8]]) -> Observation:
    """The observation of a row; `pixels` holds the pictures by their sensors' names."""
    kinds = {}
    for column in row:
        sensor, colon, name = column.rpartition(":")
        if colon and not name.endswith(_TEXT):
            kinds[sensor] = name
    readings = {}
    for sensor in dict.fromkeys((*row.get("scans", ()), *sorted(kinds))):
        column = f"{sensor}:{kinds[sensor]}"
        reading = _BY_NAME[kinds[sensor]].decode(row[column], row.get(column + _TEXT, ()), sensor)
        if kinds[sensor] == _IMAGE.name:
            time, intrinsics, mount = reading
            reading = Image(time, pixels[sensor], intrinsics, mount)
        readings[sensor] = reading
    return Observation(float(row["time"][0]), readings)


def encode_command(command: Command) -> Row:
    """The row of `command`; its trace is drawn, not kept."""
    row: Row = {"kind": (type(command).__name__,)}
    match command:
        case Drive(twist):
            row["values"] = (twist.v, twist.omega)
        case Serial(line):
            row["text"] = (line,)
        case Done(reason):
            row["text"] = (reason,)
        case GiveUp(reason, status):
            row["text"] = (reason,)
            row["status"] = (status,)
    if command.pan is not None:
        row["pan"] = (command.pan,)
    if command.work:
        row["work"], row["units"] = tuple(command.work.values()), tuple(command.work)
    return row


def decode_command(row: Row) -> Command:
    """The command of a row, with an empty trace."""
    pan = float(row["pan"][0]) if len(row.get("pan", ())) else None
    work = {unit: int(count) for unit, count in zip(row.get("units", ()), row.get("work", ()), strict=True)}
    carried: dict[str, Any] = {"pan": pan, "work": work}
    match str(row["kind"][0]):
        case "Drive":
            v, omega = map(float, row["values"])
            return Drive(Twist(v, omega), **carried)
        case "Serial":
            return Serial(row["text"][0], **carried)
        case "Done":
            return Done(row["text"][0], **carried)
        case "GiveUp":
            return GiveUp(row["text"][0], row["status"][0], **carried)
        case "Hold":
            return Hold(**carried)
        case kind:
            raise ValueError(f"unknown kind of command {kind!r}")


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """A picture (height, width, 3) RGB as PNG, lossless."""
    import cv2

    # Level 1 costs a third of the default's time for a tenth more bytes.
    ok, data = cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not ok:
        raise ValueError(f"cannot write a picture of shape {pixels.shape} as PNG")
    return data.tobytes()


def decode_png(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Inverse of `encode_png`."""
    import cv2

    bgr = cv2.imdecode(data, cv2.IMREAD_COLOR)
    if bgr is None:
        raise ValueError(f"{len(data)} bytes that are no PNG")
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)  # type: ignore[return-value]
