"""From a grid map to a MuJoCo world without robots: the one source of what physics, range sensors and planners meet.

Why it is built as it is (MuJoCo 4.0, a 512 x 512 cave of 10 011 boxes; `benchmarks/bench_worlds.py` measures it again):

* `sleep` is enabled, not for sleeping (nothing may: `sleep_tolerance` is 0) but because MuJoCo then computes the poses of static
  geoms once instead of at every step. Results are the same bit by bit. Who moves a static geom of a compiled model must make a
  new `MjData`.
* Walls are geoms of the world body. A static child body looks equal but costs seven times the step: broad-phase collision
  detection bounds the geoms of every other body anew at each step, the world body it takes for granted.
* The floor is a body of its own. What touches only the floor (a wheel) is then told apart from the walls by its body, before
  their bounding-volume tree is searched.
* Wall boxes are left to rays and contacts, cameras see one mesh instead (`wall_mesh`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

import mujoco
import numpy as np

from robocar.core import SE2, Landmark, MapFormatError, OccupancyGrid, ScenarioError, UnknownNameError
from robocar.core.solids import Box, Cylinder, Solid
from robocar.sim.cover import cover
from robocar.sim.movers import Mover, add_mover
from robocar.sim.physics import set_physics
from robocar.sim.wall_mesh import wall_mesh

WorldSpec: TypeAlias = mujoco.MjSpec

FLOOR_BIT, SOLID_BIT = 1, 2
"""Collision bits: wheels carry the first; what must not pass through walls, obstacles and movers the second."""

SENSED_GROUP, SEEN_GROUP = 0, 2
"""Geom groups: what range sensors meet; what only cameras see. Robots have others (`world.ROBOT_GROUPS`)."""

TOP_CAMERA = "top"
TOP_CAMERA_FOVY = 45.0  # [deg]
TOP_CAMERA_SIZE = (640, 480)  # width, height [pixels]
BORDER_THICKNESS = 0.1  # [m]
MOST_BOXES = 50_000  # of walls: four times a large cave's
WALL_FRICTION = 0.3  # of painted walls, as the car's hull has it

COLORS: dict[str, tuple[float, float, float]] = {
    "red": (0.85, 0.05, 0.05),
    "green": (0.05, 0.65, 0.10),
    "blue": (0.05, 0.15, 0.85),
    "yellow": (0.95, 0.85, 0.05),
    "cyan": (0.05, 0.80, 0.85),
    "magenta": (0.85, 0.05, 0.75),
    "orange": (1.0, 0.45, 0.0),
    "purple": (0.45, 0.05, 0.75),
}
"""Colours of landmarks: saturated, so that colour tracking tells them from the grey world."""

LIGHTING: dict[str, tuple[float, float]] = {"default": (0.40, 0.45), "dim": (0.15, 0.20), "bright": (0.60, 0.75)}
"""Ambient and directional light."""


def build_world(
    grid: OccupancyGrid,
    *,
    wall_height: float = 0.3,
    landmarks: Sequence[Landmark] = (),
    solids: Sequence[Solid] = (),
    movers: Sequence[Mover] = (),
    border: Literal["wall", "open"] = "wall",
    lighting: str = "default",
) -> mujoco.MjSpec:
    """The world of a map, for `World`, which puts robots into it.

    Occupied cells (`OccupancyGrid.occupied`) become walls; unknown cells are no matter.

    Args:
        grid: the true map.
        wall_height: [m].
        landmarks: coloured balls. One that reaches below the walls' height is an obstacle like any other; one above is only seen.
        solids: obstacles that are not in the grid.
        movers: moving obstacles, wherever they are; `movers.MovingObstacle` drives them.
        border: "wall" closes the grid's rectangle with four walls just outside of it; "open": the floor goes on.
        lighting: a name in `LIGHTING`.

    Raises:
        ScenarioError: a size or position that makes no sense, a name used twice.
        UnknownNameError: a lighting or colour that does not exist.
    """
    if not (math.isfinite(wall_height) and wall_height > 0):
        raise ScenarioError(f"wall_height {wall_height} must be a positive number of metres")
    if border not in ("wall", "open"):
        raise ScenarioError(f"border {border!r} is neither 'wall' nor 'open'")
    if lighting not in LIGHTING:
        raise UnknownNameError(f"lighting {lighting!r} does not exist; choose one of {', '.join(LIGHTING)}")
    spec = mujoco.MjSpec()
    spec.modelname = "world"
    set_physics(spec)
    _set_visuals(spec, grid, wall_height)
    _add_floor(spec)
    _add_light(spec, *LIGHTING[lighting])
    _add_walls(spec, grid, wall_height)
    if border == "wall":
        _add_border(spec, grid, wall_height)
    for solid in solids:
        if isinstance(solid, Box):
            _add_box(spec, solid)
        else:
            _add_cylinder(spec, solid)
    _add_landmarks(spec, landmarks, wall_height)
    _add_movers(spec, movers)
    return spec


def _set_visuals(spec: mujoco.MjSpec, grid: OccupancyGrid, wall_height: float) -> None:
    """Offscreen pictures in software: no shadows, no multisampling; clipping in metres whatever the size of the map."""
    visual = spec.visual
    visual.quality.shadowsize = 0
    visual.quality.offsamples = 0
    visual.quality.numslices, visual.quality.numstacks = 64, 32  # round balls: with 28 facets one looks 0.4 % farther away
    visual.global_.offwidth, visual.global_.offheight = TOP_CAMERA_SIZE
    extent = math.hypot(*grid.size)
    center = grid.corners().mean(axis=0)
    spec.stat.extent = extent
    spec.stat.center = [center[0], center[1], 0.0]
    # MuJoCo gives these two as shares of the extent. Near: the car's camera sits on its nose.
    visual.map.znear = 0.01 / extent
    visual.map.zfar = (2.0 * _top_camera_height(grid, wall_height) + 2.0 * extent) / extent


def _add_floor(spec: mujoco.MjSpec) -> None:
    texture = spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.30, 0.31, 0.33],
        rgb2=[0.38, 0.39, 0.41],
        width=64,
        height=64,
    )
    material = spec.add_material(name="floor", texrepeat=[2, 2], texuniform=True, specular=0.0)  # checks of 0.5 m
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
    spec.worldbody.add_body(name="floor").add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        material=material.name,
        group=SENSED_GROUP,
        contype=FLOOR_BIT,
        conaffinity=FLOOR_BIT,
    )


def _add_light(spec: mujoco.MjSpec, ambient: float, diffuse: float) -> None:
    headlight = spec.visual.headlight
    headlight.ambient, headlight.diffuse, headlight.specular = [ambient] * 3, [0.0] * 3, [0.0] * 3
    # From aside, so that walls facing different ways differ in brightness.
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0, 0, 10],
        dir=[0.3, 0.5, -1.0],
        castshadow=False,
        ambient=[0, 0, 0],
        diffuse=[diffuse] * 3,
        specular=[0, 0, 0],
    )


def _add_walls(spec: mujoco.MjSpec, grid: OccupancyGrid, height: float) -> None:
    spec.add_material(name="wall", rgba=[0.85, 0.82, 0.76, 1.0], specular=0.0)
    blocked = grid.occupied
    if not np.any(blocked):
        return
    rectangles = cover(blocked, MOST_BOXES)
    if len(rectangles) > MOST_BOXES:
        raise MapFormatError(f"the map's walls need {len(rectangles)} boxes, at most {MOST_BOXES} are simulated")
    first, last = rectangles[:, 1::-1] * grid.resolution, rectangles[:, :1:-1] * grid.resolution  # (n, 2) x, y [m] in the grid
    centers = grid.origin.transform((first + last) / 2)
    for (x, y), (length, width) in zip(centers, last - first, strict=True):
        # A geom without alpha and with a material is no matter to the renderer, but is to rays.
        _add_solid_box(spec, SE2(x, y, grid.origin.theta), (length, width, height), rgba=[0, 0, 0, 0])
    vertices, triangles = wall_mesh(blocked, rectangles, grid.resolution, height)
    spec.add_mesh(
        name="walls",
        uservert=vertices.astype(np.float32).ravel(),
        userface=triangles.astype(np.int32).ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # without a bottom there is no volume
    )
    spec.add_material(name="wall_seen", rgba=[1, 1, 1, 0], specular=0.0)  # the reverse: rays pass, cameras see the geom's colour
    spec.worldbody.add_geom(
        name="walls",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="walls",
        material="wall_seen",
        rgba=spec.material("wall").rgba,
        pos=[grid.origin.x, grid.origin.y, 0],
        quat=_quaternion(grid.origin.theta),
        group=SEEN_GROUP,
        contype=0,
        conaffinity=0,
    )


def _add_border(spec: mujoco.MjSpec, grid: OccupancyGrid, height: float) -> None:
    (width, depth), t = grid.size, BORDER_THICKNESS
    for x, y, length_x, length_y in (
        (width / 2, -t / 2, width + 2 * t, t),
        (width / 2, depth + t / 2, width + 2 * t, t),
        (-t / 2, depth / 2, t, depth),
        (width + t / 2, depth / 2, t, depth),
    ):
        _add_solid_box(spec, grid.origin @ SE2(x, y), (length_x, length_y, height))


def _add_box(spec: mujoco.MjSpec, box: Box) -> None:
    if len(box.size) != 3 or not all(math.isfinite(s) and s > 0 for s in box.size):
        raise ScenarioError(f"box at ({box.pose.x}, {box.pose.y}): size {box.size} must be three positive numbers of metres")
    _add_solid_box(spec, box.pose, box.size)


def _add_solid_box(spec: mujoco.MjSpec, pose: SE2, size: tuple[float, float, float], rgba: Sequence[float] | None = None) -> None:
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[pose.x, pose.y, size[2] / 2],
        quat=_box_quaternion(pose.theta),
        size=[s / 2 for s in size],
        **_solid(),
        **({} if rgba is None else {"rgba": rgba}),
    )


def _add_cylinder(spec: mujoco.MjSpec, cylinder: Cylinder) -> None:
    numbers = (cylinder.pose.x, cylinder.pose.y, cylinder.radius, cylinder.height)
    if not (all(math.isfinite(n) for n in numbers) and cylinder.radius > 0 and cylinder.height > 0):
        raise ScenarioError(f"{cylinder}: needs a finite position and a positive radius and height")
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=[cylinder.pose.x, cylinder.pose.y, cylinder.height / 2],
        size=[cylinder.radius, cylinder.height / 2, 0],
        **_solid(),
    )


def _add_landmarks(spec: mujoco.MjSpec, landmarks: Sequence[Landmark], wall_height: float) -> None:
    _refuse_repeated([landmark.name for landmark in landmarks], "landmark")
    for landmark in landmarks:
        if landmark.color not in COLORS:
            raise UnknownNameError(
                f"landmark {landmark.name!r}: color {landmark.color!r} does not exist; choose one of {', '.join(COLORS)}"
            )
        position = np.asarray(landmark.position, dtype=float)
        if position.shape != (3,) or not np.all(np.isfinite(position)):
            raise ScenarioError(
                f"landmark {landmark.name!r}: position {landmark.position} must be three finite numbers of metres"
            )
        if not (math.isfinite(landmark.radius) and landmark.radius > 0):
            raise ScenarioError(f"landmark {landmark.name!r}: radius {landmark.radius} must be a positive number of metres")
        name = f"landmark/{landmark.name}"
        spec.add_material(name=name, rgba=[*COLORS[landmark.color], 1.0], specular=0.0, emission=0.3)
        in_the_way = position[2] - landmark.radius < wall_height - 1e-6  # one that lies on a wall is not
        geom = _solid() if in_the_way else {"group": SEEN_GROUP, "contype": 0, "conaffinity": 0}
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=position,
            size=[landmark.radius, 0, 0],
            **(geom | {"material": name}),
        )


def _add_movers(spec: mujoco.MjSpec, movers: Sequence[Mover]) -> None:
    _refuse_repeated([mover.name for mover in movers], "mover")
    if not movers:
        return
    spec.add_material(name="mover", rgba=[0.55, 0.50, 0.60, 1.0], specular=0.0)
    for mover in movers:
        add_mover(spec, mover, **(_solid() | {"material": "mover"}))


def add_top_camera(spec: mujoco.MjSpec, grid: OccupancyGrid, wall_height: float = 0.3) -> None:
    """A camera named "top" that looks down on the whole grid, its picture's right along the grid's x axis."""
    x, y = grid.corners().mean(axis=0)
    spec.worldbody.add_camera(
        name=TOP_CAMERA,
        pos=[x, y, _top_camera_height(grid, wall_height)],
        quat=_quaternion(grid.origin.theta),  # cameras look along -z, with y up
        fovy=TOP_CAMERA_FOVY,
        resolution=TOP_CAMERA_SIZE,
    )


def _top_camera_height(grid: OccupancyGrid, wall_height: float) -> float:
    """From where the picture holds the whole grid with its border, up to the walls' tops [m]."""
    width, depth = (side + 2 * BORDER_THICKNESS for side in grid.size)
    aspect = TOP_CAMERA_SIZE[0] / TOP_CAMERA_SIZE[1]
    return wall_height + max(depth, width / aspect) / 2 / math.tan(math.radians(TOP_CAMERA_FOVY / 2))


def _solid() -> dict[str, Any]:
    """Attributes of everything that stands in the way."""
    return {
        "group": SENSED_GROUP,
        "contype": SOLID_BIT,
        "conaffinity": SOLID_BIT,
        "friction": [WALL_FRICTION, 0.005, 0.0001],
        "material": "wall",
    }


def _refuse_repeated(names: Sequence[str], what: str) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ScenarioError(f"{what} names must differ; used more than once: {', '.join(repeated)}")


def _quaternion(theta: float) -> list[float]:
    return [math.cos(theta / 2), 0.0, 0.0, math.sin(theta / 2)]


def _box_quaternion(theta: float) -> list[float]:
    """Of a box, which half a turn leaves as it is.

    MuJoCo's compiler takes a geom for unturned in its body's frame where no number of its quaternion differs from (1, 0, 0, 0)
    by 1e-6 (`geom_sameframe`), that is below 2e-6 rad. Half a turn farther on, no rotation is lost.
    """
    return _quaternion(theta) if theta == 0.0 or abs(theta) > 1e-5 else [-math.sin(theta / 2), 0.0, 0.0, math.cos(theta / 2)]
