"""Observations and commands as columns of numbers and back, without losing a bit.

Entity `observation` has one row per tick. A column that has nothing new at a tick is empty there; a column that is empty in a
whole batch is left out. Numbers are float64, an absent value is an empty list:

* `time`                                                   [s]
* `wheel_angles`      time, left, right
* `twist`             time, v, omega
* `odom_pose`         time, x, y, theta
* `psd`, `compass`, `bumper`                               time, value
* `acceleration`      time, x, y
* `lidar`, `sonars`   for each scan: n, time, max_range, beam_width, x, y, theta of the sensor, n ranges, n bearings
* `lidar_name`, `sonar_names`                              text
* `landmarks`         for each: time, bearing, range, the four numbers of the covariance by rows
* `landmark_names`    text
* `serial`            text
* `image`, `top_image`                                     time, nine of the intrinsics, sixteen of robot_from_camera

The pixels of images are PNG, at the entities that the viewer shows them at. Entity `command`: `kind`, `values` (v, omega of a
Drive), `pan`, `text` (line of a Serial, reason of Done and GiveUp), `status` (of GiveUp).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
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

NUMBERS = (
    *("time", "wheel_angles", "twist", "odom_pose", "psd", "compass", "bumper", "acceleration"),
    *("lidar", "sonars", "landmarks", "image", "top_image"),
)
TEXTS = ("lidar_name", "sonar_names", "landmark_names", "serial")
COMMAND_NUMBERS = ("values", "pan")
COMMAND_TEXTS = ("kind", "text", "status")

IMAGE_ENTITIES = {"image": "world/robot/camera", "top_image": "world/top_camera"}
"""Where the cameras are; the pixels are at `/image` below."""

Row = dict[str, Any]
"""Values by column; what is missing is empty."""


def encode_observation(observation: Observation) -> Row:
    """The row of `observation`, without pixels."""
    row: Row = {"time": (observation.time,)}
    if (wheels := observation.wheel_angles) is not None:
        row["wheel_angles"] = (wheels.time, wheels.value.left, wheels.value.right)
    if (twist := observation.twist) is not None:
        row["twist"] = (twist.time, twist.value.v, twist.value.omega)
    if (odom := observation.odom_pose) is not None:
        row["odom_pose"] = (odom.time, odom.value.x, odom.value.y, odom.value.theta)
    for name in ("psd", "compass", "bumper"):
        reading = getattr(observation, name)
        if reading is not None:
            row[name] = (reading.time, reading.value)
    if (acceleration := observation.acceleration) is not None:
        row["acceleration"] = (acceleration.time, *acceleration.value)
    if observation.lidar is not None:
        scan = observation.lidar
        row["lidar"] = np.concatenate([_scan_head(scan), scan.ranges, scan.bearings])
        row["lidar_name"] = (observation.lidar.name,)
    if observation.sonars:
        # Single beams: plain lists are several times faster than arrays.
        row["sonars"] = numbers = []
        for scan in observation.sonars:
            numbers += (*_scan_head(scan), *scan.ranges.tolist(), *scan.bearings.tolist())
        row["sonar_names"] = [scan.name for scan in observation.sonars]
    if observation.landmarks:
        row["landmarks"] = np.concatenate([(d.time, d.bearing, d.range, *d.covariance.ravel()) for d in observation.landmarks])
        row["landmark_names"] = [d.landmark for d in observation.landmarks]
    for name in ("image", "top_image"):
        image = getattr(observation, name)
        if image is not None:
            row[name] = np.concatenate([(image.time,), image.intrinsics.ravel(), image.robot_from_camera.ravel()])
    if observation.serial:
        row["serial"] = observation.serial
    return row


def _scan_head(scan: Scan) -> tuple[float, ...]:
    mount = scan.robot_from_sensor
    return (len(scan.ranges), scan.time, scan.max_range, scan.beam_width, mount.x, mount.y, mount.theta)


def decode_observation(row: Row, pixels: Mapping[str, NDArray[np.uint8]]) -> Observation:
    """The observation of a row; `pixels` holds the pictures `image` and `top_image` where the row has them."""

    def reading(name: str, value: Callable[..., Any]) -> Any:
        numbers = row.get(name)
        return None if numbers is None or len(numbers) == 0 else Reading(float(numbers[0]), value(*map(float, numbers[1:])))

    lidar = list(_decode_scans(row.get("lidar", ()), row.get("lidar_name", ())))
    return Observation(
        time=float(row["time"][0]),
        wheel_angles=reading("wheel_angles", WheelAngles),
        twist=reading("twist", Twist),
        odom_pose=reading("odom_pose", SE2),
        sonars=tuple(_decode_scans(row.get("sonars", ()), row.get("sonar_names", ()))),
        lidar=lidar[0] if lidar else None,
        psd=reading("psd", float),
        compass=reading("compass", float),
        acceleration=reading("acceleration", lambda *xy: np.array(xy)),
        bumper=reading("bumper", bool),
        image=_decode_image(row.get("image", ()), pixels.get("image")),
        top_image=_decode_image(row.get("top_image", ()), pixels.get("top_image")),
        landmarks=tuple(_decode_landmarks(row.get("landmarks", ()), row.get("landmark_names", ()))),
        serial=tuple(row.get("serial", ())),
    )


def _decode_scans(numbers: Any, names: Any) -> Iterator[Scan]:
    start = 0
    for name in names:
        count = int(numbers[start])
        time, max_range, beam_width, x, y, theta = map(float, numbers[start + 1 : start + 7])
        ranges = numbers[start + 7 : start + 7 + count]
        bearings = numbers[start + 7 + count : start + 7 + 2 * count]
        yield Scan(time, ranges, bearings, max_range, beam_width, SE2(x, y, theta), name)
        start += 7 + 2 * count


def _decode_landmarks(numbers: Any, names: Any) -> Iterator[Detection]:
    for k, name in enumerate(names):
        time, bearing, distance, *covariance = map(float, numbers[7 * k : 7 * k + 7])
        yield Detection(time, name, bearing, distance, np.array(covariance).reshape(2, 2))


def _decode_image(numbers: Any, pixels: NDArray[np.uint8] | None) -> Image | None:
    if len(numbers) == 0 or pixels is None:
        return None
    return Image(float(numbers[0]), pixels, np.array(numbers[1:10]).reshape(3, 3), np.array(numbers[10:26]).reshape(4, 4))


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
    return row


def decode_command(row: Row) -> Command:
    """The command of a row, with an empty trace."""
    pan = float(row["pan"][0]) if len(row.get("pan", ())) else None
    match str(row["kind"][0]):
        case "Drive":
            v, omega = map(float, row["values"])
            return Drive(Twist(v, omega), pan)
        case "Serial":
            return Serial(row["text"][0], pan)
        case "Done":
            return Done(row["text"][0], pan)
        case "GiveUp":
            return GiveUp(row["text"][0], row["status"][0], pan)
        case "Hold":
            return Hold(pan)
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
