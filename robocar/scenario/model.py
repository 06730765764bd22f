"""Scenario files: what world the car is put into, what it carries and knows, and where it shall go (design, section 9)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, field_validator, model_validator

from robocar.core import SE2, ScenarioError
from robocar.core.solids import Box, Cylinder, Solid
from robocar.paths import MODELS
from robocar.sim.movers import Motion, Mover
from robocar.sim.sensors.parameters import SensorParameters
from robocar.sim.simulation import PhysicsParameters


def _no_flag(value: Any) -> Any:
    """YAML's `yes` and `on` are flags, which Python would take for the number 1."""
    if isinstance(value, bool):
        raise ValueError(f"expected a number, not {value}")
    return value


Finite = Annotated[float, BeforeValidator(_no_flag), Field(allow_inf_nan=False)]
NotNegative = Annotated[float, BeforeValidator(_no_flag), Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, BeforeValidator(_no_flag), Field(gt=0, allow_inf_nan=False)]
Point = tuple[Finite, Finite]
PoseTriple = tuple[Finite, Finite, Finite]
# By their count, so that a bad number is reported once and not for either form.
PointOrTriple = Annotated[
    Annotated[Point, Tag("tuple[2]")] | Annotated[PoseTriple, Tag("tuple[3]")],
    Discriminator(lambda value: "tuple[3]" if isinstance(value, list | tuple) and len(value) > 2 else "tuple[2]"),
]
_POSITIVE = ("period", "timestep", "control_period", "max_range", "beam_width", "resolution", "width", "height")


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SolidModel(_Model):
    """A box (length, width, height) or a cylinder (radius, height) that stands in the world."""

    box: tuple[Positive, Positive, Positive] | None = None
    cylinder: tuple[Positive, Positive] | None = None
    pose: PoseTriple

    @model_validator(mode="after")
    def _one_shape(self) -> SolidModel:
        if (self.box is None) == (self.cylinder is None):
            raise ValueError("give either box: [length, width, height] or cylinder: [radius, height]")
        return self

    def solid(self) -> Solid:
        if self.box is not None:
            return Box(self.box, SE2(*self.pose))
        assert self.cylinder is not None
        return Cylinder(*self.cylinder, SE2(*self.pose))


class LandmarkModel(_Model):
    """A coloured ball. Without a z its lowest point is at the height of the walls."""

    color: Literal["red", "green", "blue", "orange", "yellow", "magenta", "cyan"]
    position: PointOrTriple
    radius: Positive = 0.10
    name: str | None = None


class MoverModel(_Model):
    """A moving obstacle: a box or a cylinder. It starts at its first way point.

    `motion` says how it goes: at `constant` speed from way point to way point, again and again; `stop-turn-go`: it stands at
    each for `pause` [s], turns towards the next with `turn_speed` [rad/s] and goes there; `random-walk`: the same to points drawn
    by the run's seed within `roam` [m] of its only way point.
    """

    name: str
    box: tuple[Positive, Positive, Positive] | None = None
    cylinder: tuple[Positive, Positive] | None = None
    motion: Motion = "constant"
    heading: Finite | None = None
    waypoints: Annotated[list[Point], Field(min_length=1)]
    speed: NotNegative = 0.2
    mass: Positive = 5.0
    pause: NotNegative | None = None
    turn_speed: Positive | None = None
    roam: Positive | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> MoverModel:
        if (self.box is None) == (self.cylinder is None):
            raise ValueError("give either box: [length, width, height] or cylinder: [radius, height]")
        uses = {"constant": (), "stop-turn-go": ("pause", "turn_speed"), "random-walk": ("pause", "turn_speed", "roam")}
        for key in ("pause", "turn_speed", "roam"):
            if getattr(self, key) is not None and key not in uses[self.motion]:
                fitting = " or ".join(motion for motion, keys in uses.items() if key in keys)
                raise ValueError(f"{key} is of no use to motion {self.motion}, only to {fitting}")
        if self.motion == "random-walk" and len(self.waypoints) > 1:
            raise ValueError(f"a random-walk takes one way point, its start, not {len(self.waypoints)}")
        if self.motion != "constant" and self.speed == 0:
            raise ValueError(f"speed 0 leads nowhere; {self.motion} needs a positive one")
        return self

    def mover(self) -> Mover:
        """It starts at its first way point; without a heading, one that turns looks towards the second."""
        (x, y), *others = self.waypoints
        heading = self.heading
        if heading is None:
            ahead = next((p for p in others if p != (x, y)), None) if self.motion == "stop-turn-go" else None
            heading = 0.0 if ahead is None else math.atan2(ahead[1] - y, ahead[0] - x)
        given = {key: value for key in ("pause", "turn_speed", "roam") if (value := getattr(self, key)) is not None}
        return Mover(
            self.name,
            "box" if self.box is not None else "cylinder",
            self.box or self.cylinder or (),
            SE2(x, y, heading),
            np.array([*others, (x, y)]) if others else np.empty((0, 2)),
            self.speed,
            self.mass,
            motion=self.motion,
            **given,
        )


class EventModel(_Model):
    """Something that happens at a time, between two ticks."""

    time: NotNegative
    kidnap: PoseTriple


class RobotModel(_Model):
    """The fit-out of the car."""

    sonars: Literal["none", "front", "front+sides", "ring"] = "front"
    lidar: Literal["none", "hokuyo", "scan360"] = "none"
    compass: bool = False
    camera: bool = False
    camera_pan: Literal["fixed", "sweep"] = "fixed"
    top_camera: bool = False
    sensors: SensorParameters = Field(default_factory=SensorParameters)
    physics: PhysicsParameters = Field(default_factory=PhysicsParameters)

    @field_validator("sensors", "physics", mode="after")
    @classmethod
    def _sensible(cls, value: SensorParameters | PhysicsParameters) -> SensorParameters | PhysicsParameters:
        _refuse_senseless(asdict(value))
        return value


class ProgressModel(_Model):
    """The progress checker, with Nav2's names: move this far [m] or turn this far [rad] within this time [s], or be `stuck`."""

    required_movement_radius: Positive = 0.10
    required_movement_angle: Positive = 0.30
    movement_time_allowance: Positive = 20.0


class DefaultsModel(_Model):
    """What runs if the command line does not say."""

    navigator: str = "a-star"
    estimator: str = "odometry"
    mapper: str = "none"

    @field_validator("navigator", "estimator", "mapper")
    @classmethod
    def _registered(cls, name: str) -> str:
        if ":" in name:
            raise ValueError(f"a scenario runs no code: {name!r} may only be given on the command line; name a registered one")
        return name


class Scenario(_Model):
    """One scenario, as in its YAML file."""

    name: str = "unnamed"
    description: str = ""
    map: str
    resolution: Positive | None = None
    prior: str = "truth"
    unknown_obstacles: list[SolidModel] = []
    border: Literal["wall", "open"] = "wall"
    wall_height: Positive = 0.30
    start: PoseTriple
    start_known: bool = True
    goal: PointOrTriple | None = None
    goal_may_be_blocked: bool = False
    xy_goal_tolerance: Positive = 0.10
    yaw_goal_tolerance: Positive = 0.25
    success_radius: Positive = 0.25
    landmarks: list[LandmarkModel] = []
    movers: list[MoverModel] = []
    events: list[EventModel] = []
    robot: RobotModel = RobotModel()
    on_contact: Literal["end", "continue"] = "end"
    lighting: Literal["default", "dim", "bright"] = "default"
    progress: ProgressModel = ProgressModel()
    time_limit: Positive = 120.0
    defaults: DefaultsModel = DefaultsModel()
    folder: Annotated[Path, Field(exclude=True, repr=False)] = MODELS / "scenarios"

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        if self.success_radius < self.xy_goal_tolerance:
            raise ValueError(
                f"success_radius ({self.success_radius}) must not be smaller than xy_goal_tolerance ({self.xy_goal_tolerance})"
            )
        for what, names in (("movers", [m.name for m in self.movers]), ("landmarks", [b.name for b in self.landmarks if b.name])):
            if len(set(names)) != len(names):
                raise ValueError(f"{what} need different names, not {names}")
        return self

    def file(self, field: str) -> Path:
        """The file that `map` or `prior` names: beside the scenario, in its parent folder, or in `models/`.

        Raises:
            ScenarioError: there is none.
        """
        name: str = getattr(self, field)
        path = Path(name).expanduser()
        candidates = [path] if path.is_absolute() else [base / path for base in (self.folder, self.folder.parent, MODELS)]
        for candidate in candidates:
            if candidate.is_file():
                return candidate
        raise ScenarioError(f"scenario {self.name}: {field}: there is no file {name!r} beside it or in {MODELS.name}/")


def _refuse_senseless(parameters: Mapping[str, Any], where: str = "") -> None:
    """Sensors and physics come without negative numbers, and what divides (periods, sizes, ranges) without zeros."""
    for name, value in parameters.items():
        path = f"{where}.{name}" if where else name
        if isinstance(value, Mapping):
            _refuse_senseless(value, path)
            continue
        zero_is_fine = name not in _POSITIVE or path == "encoder.period"
        if not (math.isfinite(value) and (value >= 0 if zero_is_fine else value > 0)):
            raise ValueError(f"{path}: expected a finite number {'from 0 on' if zero_is_fine else 'above 0'}, not {value}")
        if name == "dropout" and value > 1:
            raise ValueError(f"{path}: expected a share of the readings, 0 to 1, not {value}")


def pose_of(values: tuple[float, ...]) -> SE2:
    """x, y and an optional angle."""
    return SE2(values[0], values[1], values[2] if len(values) > 2 else 0.0)


def goal_heading(values: tuple[float, ...] | None) -> float | None:
    """The goal's heading where one is given [rad]."""
    return math.remainder(values[2], math.tau) if values is not None and len(values) > 2 else None
