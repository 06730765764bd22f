"""The Robocar: its MJCF, the fit-outs that a scenario chooses from, and what algorithms are told about it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import mujoco
import numpy as np
import yaml

from robocar.core import SE2, Calibration, Footprint, Limits, RangeSensor, Robot, ScenarioError
from robocar.paths import MODELS
from robocar.sim.sensors.parameters import SensorParameters

FOLDER = MODELS / "robots" / "robocar"
PREFIX = "robocar/"
SUPPLY = 11.1  # [V] the battery, and with it the largest channel voltage
CHANNEL_CURRENT = 2.0  # [A] an L298P channel; each drives the two motors of a side
PULSES_PER_TURN = 200  # 1.8 degrees a pulse (thesis, eq. 3.11 of section 3.5)
LIMITS = Limits(min_vel_x=-0.20, max_vel_x=0.40, max_vel_theta=1.5, acc_lim_x=0.8, acc_lim_theta=4.0)

Sonars = Literal["none", "front", "front+sides", "ring"]
Lidar = Literal["none", "hokuyo", "scan360"]

_RING = 16
_SONAR_MOUNTS: dict[str, tuple[str, ...]] = {
    "none": (),
    "front": ("front_left", "front_right"),
    "front+sides": ("front_left", "front_right", "left", "right"),
    "ring": tuple(f"ring_{i:02d}" for i in range(_RING)),
}
_LIDARS = {
    # opening angle [rad], beams, maximum range [m]
    "hokuyo": (math.radians(205.0), 570, 5.6),
    "scan360": (math.tau, 360, 6.0),
}


@dataclass(frozen=True, slots=True)
class FitOut:
    """Which sensors the car carries. The camera looks ahead (`fixed`) or, where no command turns it, around (`sweep`)."""

    sonars: Sonars = "front"
    lidar: Lidar = "none"
    compass: bool = False
    camera: bool = False
    top_camera: bool = False
    camera_pan: Literal["fixed", "sweep"] = "fixed"


def car_spec(fit_out: FitOut) -> mujoco.MjSpec:
    """The car alone, with the mounts of the fitted sonars; without a camera the pan/tilt head is left off."""
    spec = mujoco.MjSpec.from_file(str(FOLDER / "robot.xml"))
    base = spec.body("base")
    if fit_out.sonars == "ring":
        for name, angle in zip(_SONAR_MOUNTS["ring"], np.arange(_RING) * (math.tau / _RING), strict=True):
            # On the outline of the deck, so that no cone starts inside another part of the car.
            base.add_site(
                name=f"sonar_{name}",
                pos=[0.085 * math.cos(angle), 0.085 * math.sin(angle), 0.12],
                quat=[math.cos(angle / 2), 0, 0, math.sin(angle / 2)],
                size=[0.005, 0, 0],
                group=5,
            )
    if not fit_out.camera:
        for name in ("pan", "tilt"):
            spec.delete(spec.actuator(name))
        spec.delete(spec.body("pan"))
    return spec


@cache
def footprint() -> Footprint:
    """The car's outline on the floor: the box of its hull, which covers the wheels."""
    model = mujoco.MjModel.from_xml_path(str(FOLDER / "robot.xml"))
    hull = model.geom("hull")
    x, half_length, half_width = float(hull.pos[0]), *map(float, hull.size[:2])
    return Footprint.rectangle(half_length + x, half_length - x, half_width)


def geometric_track() -> float:
    """Distance between the middles of the left and the right wheels [m]."""
    model = mujoco.MjModel.from_xml_path(str(FOLDER / "robot.xml"))
    return float(model.body("rear_left_wheel").pos[1] - model.body("rear_right_wheel").pos[1])


def load_calibration(camera: bool = False) -> Calibration:
    """`models/robots/robocar/calibration.yaml`, written by the experiment `odometry_calibration`.

    Args:
        camera: of the car with its camera's head, whose weight lies ahead of the wheels' middle and makes it turn otherwise.
    """
    file = FOLDER / "calibration.yaml"
    try:
        content = yaml.safe_load(file.read_text())["with_camera" if camera else "without_camera"]
        table = np.array(content["effective_track"], dtype=float)
        radius = float(content["wheel_radius"])
        if table.ndim != 2 or table.shape[1] != 2 or np.any(np.diff(table[:, 0]) <= 0) or np.any(table[:, 1] <= 0):
            raise ValueError("effective_track needs rows [curvature, track], curvatures ascending")
        if not radius > 0:
            raise ValueError(f"wheel_radius must be positive, not {radius}")
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise ScenarioError(f"{file}: not a calibration of the car: {error}") from error
    return Calibration(radius, table[:, 0], table[:, 1])


def describe(fit_out: FitOut, sensors: SensorParameters, model: mujoco.MjModel) -> Robot:
    """What planners and estimators are told, read from the compiled model so that nothing stands twice."""
    sonar = sensors.sonar
    sonars = tuple(
        RangeSensor(
            name,
            _mount(model, f"sonar_{name}"),
            np.zeros(1),
            math.radians(sonar.beam_width),
            sonar.min_range,
            sonar.max_range,
            sonar.period,
        )
        for name in _SONAR_MOUNTS[fit_out.sonars]
    )
    lidar = None
    if fit_out.lidar != "none":
        opening, beams, max_range = _LIDARS[fit_out.lidar]
        full_turn = opening >= math.tau
        bearings = np.linspace(-opening / 2, opening / 2, beams, endpoint=not full_turn)
        lidar = RangeSensor(
            fit_out.lidar, _mount(model, "lidar"), bearings, 0.0, sensors.lidar.min_range, max_range, sensors.lidar.period
        )
    return Robot(
        footprint=footprint(),
        limits=LIMITS,
        calibration=load_calibration(fit_out.camera),
        pulses_per_turn=PULSES_PER_TURN,
        sonars=sonars,
        lidar=lidar,
        compass=fit_out.compass,
        camera=fit_out.camera,
        top_camera=fit_out.top_camera,
    )


def _mount(model: mujoco.MjModel, site: str) -> SE2:
    """robot_from_sensor of a site fixed to the car's base."""
    found = model.site(PREFIX + site)
    w, _, _, z = found.quat
    return SE2(float(found.pos[0]), float(found.pos[1]), 2.0 * math.atan2(z, w))
