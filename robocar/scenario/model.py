"""Scenario files: what world the car is put into, what it carries and knows, and where it shall go."""

from __future__ import annotations

import math
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator, model_validator
from pydantic_core import core_schema

from robocar.core import SE2, ScenarioError
from robocar.core.solids import Box, Cylinder, Solid
from robocar.formats.files import MAX_COORDINATE
from robocar.paths import MODELS
from robocar.sim.fit_out import FitOut
from robocar.sim.movers import Motion, Mover
from robocar.sim.physics import PhysicsParameters
from robocar.sim.robot_model import RobotModel, robot_names
from robocar.sim.sensors.types import checked_overrides, overrides_schema
from robocar.validation import Finite, NotNegative, Positive, refuse_senseless

# What is plausible, for all fields: beyond, physics, planners or the memory give up, or success means nothing.
Coordinate = Annotated[Finite, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]  # [m]
Angle = Annotated[Finite, Field(ge=-1e4, le=1e4)]  # [rad]
Length = Annotated[Positive, Field(ge=1e-3, le=100.0)]  # [m] of things that stand or move in the world
Tolerance = Annotated[Positive, Field(le=2.0)]  # [m] around a goal: a robot farther off has not arrived
Turn = Annotated[Positive, Field(le=math.pi)]  # [rad]
Side = Annotated[Positive, Field(ge=1e-3, le=1e3)]  # [m] of a cell
Time = Annotated[NotNegative, Field(le=1e6)]  # [s]: eleven days
Duration = Annotated[Positive, Field(ge=1e-3, le=1e6)]  # [s]
Speed = Annotated[NotNegative, Field(le=100.0)]  # [m/s] or [rad/s]
Mass = Annotated[Positive, Field(ge=1e-3, le=1e5)]  # [kg]
Reach = Annotated[Positive, Field(le=1e4)]  # [m] or [rad]
MOST_BODIES = 200  # that move: each is solved for in every step of physics
MOST_THINGS = 10_000  # that stand, and points of ways

Point = tuple[Coordinate, Coordinate]
PoseTriple = tuple[Coordinate, Coordinate, Angle]
# By their count, so that a bad number is reported once and not for either form.
PointOrTriple = Annotated[
    Annotated[Point, Tag("tuple[2]")] | Annotated[PoseTriple, Tag("tuple[3]")],
    Discriminator(lambda value: "tuple[3]" if isinstance(value, list | tuple) and len(value) > 2 else "tuple[2]"),
]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SolidModel(_Model):
    """A box (length, width, height) or a cylinder (radius, height) that stands in the world."""

    box: tuple[Length, Length, Length] | None = None
    cylinder: tuple[Length, Length] | None = None
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
    radius: Length = 0.10
    name: str | None = None


class MoverModel(_Model):
    """A moving obstacle: a box or a cylinder. It starts at its first way point.

    `motion` says how it goes: at `constant` speed from way point to way point, again and again; `stop-turn-go`: it stands at
    each for `pause` [s], turns towards the next with `turn_speed` [rad/s] and goes there; `random-walk`: the same to points drawn
    by the run's seed within `roam` [m] of its only way point.
    """

    name: str
    box: tuple[Length, Length, Length] | None = None
    cylinder: tuple[Length, Length] | None = None
    motion: Motion = "constant"
    heading: Angle | None = None
    waypoints: Annotated[list[Point], Field(min_length=1, max_length=MOST_THINGS)]
    speed: Speed = 0.2
    mass: Mass = 5.0
    pause: Time | None = None
    turn_speed: Annotated[Speed, Field(gt=0)] | None = None
    roam: Reach | None = None

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

    time: Time
    kidnap: PoseTriple


class _Overrides:
    """Parameters of sensors by type; only those that are given, so that the robot's own stand behind them."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        return core_schema.no_info_plain_validator_function(checked_overrides)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> Any:
        return overrides_schema()


class RobotSection(_Model):
    """Which robot, and its fit-out."""

    model: str = "robocar"
    sonars: Literal["none", "front", "front+sides", "ring"] = "front"
    lidar: Literal["none", "hokuyo", "scan360"] = "none"
    compass: bool = False
    camera: bool = False
    camera_pan: Literal["fixed", "sweep"] = "fixed"
    top_camera: bool = False
    sensors: Annotated[dict[str, dict[str, Any]], _Overrides] = {}
    physics: PhysicsParameters = Field(default_factory=PhysicsParameters)

    @field_validator("physics", mode="after")
    @classmethod
    def _sensible(cls, value: PhysicsParameters) -> PhysicsParameters:
        refuse_senseless(PhysicsParameters, asdict(value))
        return value

    @property
    def fit_out(self) -> FitOut:
        """What the robot carries."""
        return FitOut(self.sonars, self.lidar, self.compass, self.camera, self.top_camera, self.camera_pan)


class ProgressModel(_Model):
    """The progress checker, with Nav2's names: move this far [m] or turn this far [rad] within this time [s], or be `stuck`."""

    required_movement_radius: Reach = 0.10
    required_movement_angle: Reach = 0.30
    movement_time_allowance: Duration = 20.0


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
    resolution: Side | None = None
    prior: str = "truth"
    unknown_obstacles: Annotated[list[SolidModel], Field(max_length=MOST_THINGS)] = []
    border: Literal["wall", "open"] = "wall"
    wall_height: Length = 0.30
    start: PoseTriple
    start_known: bool = True
    goal: PointOrTriple | None = None
    goal_may_be_blocked: bool = False
    xy_goal_tolerance: Tolerance = 0.10
    yaw_goal_tolerance: Turn = 0.25
    success_radius: Tolerance = 0.25
    landmarks: Annotated[list[LandmarkModel], Field(max_length=MOST_BODIES)] = []
    movers: Annotated[list[MoverModel], Field(max_length=MOST_BODIES)] = []
    events: Annotated[list[EventModel], Field(max_length=MOST_THINGS)] = []
    robot: RobotSection = RobotSection()
    on_contact: Literal["end", "continue"] = "end"
    lighting: Literal["default", "dim", "bright"] = "default"
    progress: ProgressModel = ProgressModel()
    time_limit: Duration = 120.0
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

    def robot_model(self) -> RobotModel:
        """The robot: one that comes with Robocar, or a folder beside the scenario.

        Raises:
            ScenarioError: there is none, or its file is wrong.
        """
        name = self.robot.model
        beside = self.folder / Path(name).expanduser()
        return RobotModel.load(beside if name not in robot_names() and os.path.exists(beside) else name)

    def file(self, field: str) -> Path:
        """The file that `map` or `prior` names: beside the scenario, in its parent folder, or in `models/`.

        Raises:
            ScenarioError: there is none.
        """
        name: str = getattr(self, field)
        path = Path(name).expanduser()
        candidates = [path] if path.is_absolute() else [base / path for base in (self.folder, self.folder.parent, MODELS)]
        for candidate in candidates:
            if os.path.isfile(candidate):
                return candidate
        raise ScenarioError(f"scenario {self.name}: {field}: there is no file {name!r} beside it or in {MODELS.name}/")


def pose_of(values: tuple[float, ...]) -> SE2:
    """x, y and an optional angle."""
    return SE2(values[0], values[1], values[2] if len(values) > 2 else 0.0)


def goal_heading(values: tuple[float, ...] | None) -> float | None:
    """The goal's heading where one is given [rad]."""
    return math.remainder(values[2], math.tau) if values is not None and len(values) > 2 else None
