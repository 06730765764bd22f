"""A robot's folder: its MJCF, its `robot.yaml` and its calibration, and what algorithms are told about it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from robocar.core import SE2, Calibration, Footprint, Limits, RangeSensor, Robot, ScenarioError
from robocar.core.suggestions import did_you_mean
from robocar.paths import MODELS
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_file import CalibrationFile, DriveSection, OptionalSection, PanSection, RobotFile, SensorSection
from robocar.sim.sensors.sensor import Mount, SensorType
from robocar.sim.sensors.types import Overrides, parameters_of, sensor_type
from robocar.validation import read_mapping, validated

FILE = "robot.yaml"
OWN_GROUP = 1
"""Geom group of a robot's own geoms in its MJCF: what its rays must not meet."""


def robot_names() -> list[str]:
    """Robots that come with Robocar."""
    return sorted(file.parent.name for file in (MODELS / "robots").glob(f"*/{FILE}"))


@dataclass(frozen=True, slots=True)
class FittedSensor:
    """A sensor of a fit-out: its type, where it sits, and its parameters."""

    kind: SensorType[Any]
    mount: Mount
    parameters: Any

    @property
    def geometry(self) -> RangeSensor | None:
        """What algorithms are told of one that measures ranges."""
        return None if self.kind.geometry is None else self.kind.geometry(self.mount, self.parameters)


class RobotModel:
    """A robot as data. `load` it: the same folder gives the same object.

    Args:
        folder: of the robot.
        file: its `robot.yaml`.
    """

    def __init__(self, folder: Path, file: RobotFile) -> None:
        self.folder, self._file = folder, file
        self._bare = _checked_mjcf(folder, file)
        self._mounts = lru_cache(maxsize=None)(self._mounts_of)

    @staticmethod
    def load(source: str | Path = "robocar") -> RobotModel:
        """The robot of this name in `models/robots`, of a folder, or of a `robot.yaml`.

        Raises:
            ScenarioError: there is none, or its file is wrong; the message names the field, its value and what would be valid.
        """
        folder = MODELS / "robots" / source if str(source) in robot_names() else Path(source).expanduser()
        folder = folder.parent if folder.name == FILE else folder
        if not os.path.isfile(folder / FILE):
            known = robot_names()
            raise ScenarioError(
                f"unknown robot {str(source)!r}{did_you_mean(str(source), known)}; known: {', '.join(known)}, "
                f"or the path of a folder with a {FILE}"
            )
        return _load(folder.resolve())

    @property
    def name(self) -> str:
        """Of its folder."""
        return self.folder.name

    @property
    def limits(self) -> Limits:
        """Speeds and accelerations that it keeps."""
        return Limits(**self._file.limits.model_dump())

    @property
    def drive(self) -> DriveSection:
        """Wheels, motors, encoders."""
        return self._file.drive

    @property
    def base(self) -> str:
        """The body that moves freely; its joint has the same name."""
        return self._file.base

    @property
    def hull(self) -> str:
        """The geom whose contacts count."""
        return self._file.hull

    @property
    def pan(self) -> PanSection | None:
        """What turns the camera."""
        return self._file.pan

    @property
    def impratio(self) -> float:
        """MuJoCo's option that its tyres were modelled with."""
        return self._file.solver.impratio

    @property
    def firmware_inputs(self) -> Mapping[str, str]:
        """Names of the sensors that the firmware reads, by its inputs `compass` and `bumper`."""
        return {str(name): sensor for name, sensor in self._file.firmware.items()}

    @cached_property
    def footprint(self) -> Footprint:
        """Its outline on the floor: the box of its hull, which covers the wheels."""
        hull = self._bare.geom(self.hull)
        x, half_length, half_width = float(hull.pos[0]), *map(float, hull.size[:2])
        return Footprint.rectangle(half_length + x, half_length - x, half_width)

    @property
    def geometric_track(self) -> float:
        """Distance between the middles of the left and the right wheels [m]."""
        left, right = (self._bare.body(side.encoder) for side in (self.drive.left, self.drive.right))
        return float(left.pos[1] - right.pos[1])

    def spec(self, fit_out: FitOut, group: int = OWN_GROUP) -> mujoco.MjSpec:
        """The robot alone, with the sites of fitted rings, without the optional parts that are not fitted.

        Args:
            fit_out: what it carries.
            group: geom group that its own geoms are put into.
        """
        spec = mujoco.MjSpec.from_file(str(self.folder / self._file.mjcf))
        for sensor in self._chosen(fit_out):
            if sensor.ring is not None:
                for name, angle in zip(_numbered(sensor.site or "", sensor.ring.count), _angles(sensor.ring.count), strict=True):
                    if spec.site(name) is not None:
                        raise ScenarioError(
                            f"{self.folder / FILE}: sensor {sensor.name!r}: ring: there is a site {name!r} already"
                        )
                    x, y = sensor.ring.radius * math.cos(angle), sensor.ring.radius * math.sin(angle)
                    spec.body(self.base).add_site(
                        name=name,
                        pos=[x, y, sensor.ring.height],
                        quat=[math.cos(angle / 2), 0, 0, math.sin(angle / 2)],
                        size=[0.005, 0, 0],
                        group=5,
                    )
        for key, parts in self._file.optional.items():
            if fit_out.choice(key) in (False, "none"):
                _remove(spec, parts)
        if group != OWN_GROUP:
            for geom in spec.geoms:
                if geom.group == OWN_GROUP:
                    geom.group = group
        return spec

    def sensors(self, fit_out: FitOut, overrides: Overrides | None = None) -> tuple[FittedSensor, ...]:
        """What is fitted, in the order in which it is read.

        Args:
            fit_out: what is chosen.
            overrides: parameters by type, which override those of `robot.yaml`.

        Raises:
            ScenarioError: this robot has no such choice.
        """
        given = overrides or {}
        fitted = []
        for sensor, mount in self._mounts(fit_out):
            parameters = parameters_of(sensor.type, sensor.parameters, given.get(sensor.type, {}))
            fitted.append(FittedSensor(sensor_type(sensor.type), mount, parameters))
        return tuple(fitted)

    def describe(self, fit_out: FitOut | None = None, overrides: Overrides | None = None) -> Robot:
        """What planners and estimators are told; no world is compiled for it.

        Args:
            fit_out: what is chosen; by default what a scenario chooses that says nothing.
            overrides: parameters of sensors by type, a scenario's `robot.sensors`.

        Raises:
            ScenarioError: this robot has no such choice.
        """
        fit_out = fit_out or FitOut()
        sensors = self.sensors(fit_out, overrides)
        ranges = [geometry for sensor in sensors if (geometry := sensor.geometry) is not None]
        return Robot(
            footprint=self.footprint,
            limits=self.limits,
            calibration=self.calibration(fit_out),
            pulses_per_turn=self.drive.pulses_per_turn,
            sonars=tuple(sensor for sensor in ranges if sensor.beam_width > 0.0),
            lidar=next((sensor for sensor in ranges if sensor.beam_width == 0.0), None),
            compass=fit_out.compass,
            camera=fit_out.camera,
            top_camera=fit_out.top_camera,
            sensors=tuple(sensor.mount.name for sensor in sensors),
        )

    def calibration(self, fit_out: FitOut | None = None) -> Calibration:
        """What the experiment `odometry_calibration` has written.

        Raises:
            ScenarioError: there is none for this fit-out.
        """
        fit_out, section = fit_out or FitOut(), self._file.calibration
        chosen = [entry for key, entry in section.fitted.items() if fit_out.choice(key) not in (False, "none")]
        file, entry = self.folder / section.file, (*chosen, section.entry)[0]
        entries = validated(CalibrationFile, read_mapping(file, "a calibration"), str(file)).root
        if entry not in entries:
            known = ", ".join(entries) or "none"
            raise ScenarioError(f"{file}: robot {self.name} needs the entry {entry!r}; there are {known}")
        table = np.array(entries[entry].effective_track)
        return Calibration(entries[entry].wheel_radius, table[:, 0], table[:, 1])

    # -- parts ---------------------------------------------------------------------------------------------------------

    def _chosen(self, fit_out: FitOut) -> list[SensorSection]:
        for key in ("sonars", "lidar", "compass", "camera", "top_camera"):
            offered = {value for sensor in self._file.sensors for value in sensor.fitted.get(key, ())}
            value = fit_out.choice(key)
            if value not in (False, "none", FitOut().choice(key), *offered):
                choices = ", ".join(map(str, sorted(offered, key=str))) or "none"
                raise ScenarioError(f"robot {self.name}: it cannot be fitted with {key}: {value}; its choices are {choices}")
        return [sensor for sensor in self._file.sensors if sensor.chosen(fit_out)]

    def _mounts_of(self, fit_out: FitOut) -> list[tuple[SensorSection, Mount]]:
        model = self.spec(fit_out).compile()
        mounts = []
        for sensor in self._chosen(fit_out):
            names, sites = [sensor.name], [sensor.site]
            if sensor.ring is not None and sensor.site is not None:
                names, sites = _numbered(sensor.name, sensor.ring.count), _numbered(sensor.site, sensor.ring.count)
            for name, site in zip(names, sites, strict=True):
                position, pose = np.zeros(3), SE2()
                if site is not None:
                    found = model.site(site)
                    w, _, _, z = found.quat
                    position = found.pos.copy()
                    pose = SE2(float(found.pos[0]), float(found.pos[1]), 2.0 * math.atan2(z, w))
                mounts.append(
                    (sensor, Mount(name, sensor.label or name.rpartition("/")[2], sensor.element or "", position, pose))
                )
        names = [mount.name for _, mount in mounts]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ScenarioError(f"{self.folder / FILE}: sensors need names of their own, not {', '.join(twice)}")
        return mounts


class _Names:
    """Where the names that `robot.yaml` gives are looked up: a compiled model of its MJCF, `what` for the message."""

    def __init__(self, model: mujoco.MjModel, what: str, where: Path) -> None:
        self.model, self.what, self.where = model, what, where

    def find(self, kind: str, name: str, field: str) -> int:
        """Number of the `kind` of this name, which `field` gives."""
        number = mujoco.mj_name2id(self.model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name)
        if number < 0:
            raise self.wrong(field, f"{self.what} has no {kind} {name!r}")
        return number

    def wrong(self, field: str, problem: str) -> ScenarioError:
        """To be raised."""
        return ScenarioError(f"{self.where}: {field}: {problem}")


def _checked_mjcf(folder: Path, file: RobotFile) -> mujoco.MjModel:
    """The MJCF as it is. It holds all that `robot.yaml` names, each as what it is named for; hull and drive in every fit-out."""
    path, where = folder / file.mjcf, folder / FILE
    if not path.is_file():
        raise ScenarioError(f"{where}: mjcf: there is no file {file.mjcf!r} beside it")
    try:
        whole = _Names(mujoco.MjModel.from_xml_path(str(path)), path.name, where)
        _check_base(whole, file)
        _check_drive(whole, file)
        _check_optional(whole, file)
        _check_sensors(whole, file)
        for kept in ((), ("camera",)):
            spec = mujoco.MjSpec.from_file(str(path))
            for key, parts in file.optional.items():
                if key not in kept:
                    _remove(spec, parts)
            bare = _Names(spec.compile(), f"{path.name} without what is optional", where)
            _check_base(bare, file)
            _check_drive(bare, file)
            if file.pan is not None and kept:
                bare.find("actuator", file.pan.actuator, "pan.actuator")
                if file.pan.actuator in (*file.drive.left.motors, *file.drive.right.motors):
                    raise bare.wrong("pan.actuator", f"expected another one than the drive's motors, not {file.pan.actuator!r}")
    except ValueError as error:
        raise ScenarioError(f"{path}: not a model that MuJoCo reads: {error}") from error
    return whole.model


def _check_base(names: _Names, file: RobotFile) -> None:
    """A body that moves freely, with a box."""
    base, joint = (names.find(kind, file.base, "base") for kind in ("body", "joint"))
    if names.model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE or names.model.jnt_bodyid[joint] != base:
        raise names.wrong("base", f"joint {file.base!r} does not let body {file.base!r} move freely")
    if names.model.geom_type[names.find("geom", file.hull, "hull")] != mujoco.mjtGeom.mjGEOM_BOX:
        raise names.wrong("hull", f"geom {file.hull!r} is no box")


def _check_optional(names: _Names, file: RobotFile) -> None:
    """Optional bodies are parts of the base, which itself is always there."""
    base = names.find("body", file.base, "base")
    for key, parts in file.optional.items():
        for name in parts.actuators:
            names.find("actuator", name, f"optional.{key}.actuators")
        for name in parts.bodies:
            body = names.find("body", name, f"optional.{key}.bodies")
            if body == base or names.model.body_rootid[body] != base:
                raise names.wrong(f"optional.{key}.bodies", f"body {name!r} is no part of the base {file.base!r}")


def _check_sensors(names: _Names, file: RobotFile) -> None:
    """Sites are fixed to the base; elements are what the types of their sensors read."""
    for sensor in file.sensors:
        whose, element = f"sensor {sensor.name!r}", sensor_type(sensor.type).element
        if sensor.site is not None and sensor.ring is None:
            site = names.find("site", sensor.site, f"{whose}: site")
            if names.model.site_bodyid[site] != names.find("body", file.base, "base"):
                raise names.wrong(f"{whose}: site", f"{sensor.site!r} is not fixed to {file.base!r}")
        if element is not None:
            number = names.find("sensor", sensor.element or "", f"{whose}: element")
            if names.model.sensor_type[number] != element:
                kind = element.name.removeprefix("mjSENS_").lower()
                raise names.wrong(f"{whose}: element", f"expected a {kind} sensor, not {sensor.element!r}")


def _check_drive(names: _Names, file: RobotFile) -> None:
    """The wheels of a side are hinges that lie on it, and its motors turn them."""
    model, data = names.model, mujoco.MjData(names.model)
    mujoco.mj_kinematics(model, data)
    base = names.find("body", file.base, "base")
    to_the_left = (data.xpos - data.xpos[base]) @ data.xmat[base].reshape(3, 3)[:, 1]
    offsets: dict[str, list[float]] = {}
    for key, side in (("left", file.drive.left), ("right", file.drive.right)):
        joints, field = set(), f"drive.{key}.wheels"
        for wheel in side.wheels:
            body, _, joint = (names.find(kind, wheel, field) for kind in ("body", "geom", "joint"))
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
                raise names.wrong(field, f"joint {wheel!r} is no hinge")
            joints.add(joint)
            offsets.setdefault(key, []).append(to_the_left[body])
        for motor in side.motors:
            actuator = names.find("actuator", motor, f"drive.{key}.motors")
            turns = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_trnid[actuator, 0] in joints
            if not turns or model.actuator_gaintype[actuator] != mujoco.mjtGain.mjGAIN_DCMOTOR:
                raise names.wrong(f"drive.{key}.motors", f"{motor!r} is no dcmotor of a wheel of this side")
    if min(offsets["left"]) <= max(offsets["right"]):
        raise names.wrong("drive", "the wheels of the left side lie right of those of the right side")


@cache
def _load(folder: Path) -> RobotModel:
    path = folder / FILE
    file = validated(RobotFile, read_mapping(path, "a robot"), str(path))
    return RobotModel(folder, file)


def _remove(spec: mujoco.MjSpec, parts: OptionalSection) -> None:
    for name in parts.actuators:
        spec.delete(spec.actuator(name))
    for name in parts.bodies:
        if (body := spec.body(name)) is not None:  # it goes with a body that it is a part of
            spec.delete(body)


def _numbered(name: str, count: int) -> list[str]:
    return [f"{name}_{i:02d}" for i in range(count)]


def _angles(count: int) -> Any:
    return np.arange(count) * (math.tau / count)
