"""Worlds for the bugs, and how their runs are counted and drawn."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

from robocar.core import OCCUPIED, Array, OccupancyGrid
from robocar.episode.result import RunResult
from robocar.formats import save_ros_map
from robocar.planners.bugs.open_points import VirtualCircle
from robocar.planners.bugs.view import BugParameters
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

BUGS = ("ocpb", "tangent-bug", "dist-bug", "bug2", "bug1", "critical-point-bug", "point-bug")
ROBOT = {"robot.lidar": "scan360", "robot.sonars": "none"}
CIRCLE = VirtualCircle.of(RobotModel.load().footprint, BugParameters().safety_constant)
SHIPPED = {
    "boxes": "cluttered",
    "U": "u-trap",
    "spiral": "spiral",
    "offices": "office",
    "corridors": "corridors",
    "doors": "doors",
    "field": "thesis-field",
    "warehouse": "warehouse",
}
BARN_WORLDS = (0, 6)
_TURN = math.radians(10.0)  # on the spot, from which on it counts


def grid(width: float, height: float, boxes: Sequence[tuple[float, float, float, float]] = ()) -> OccupancyGrid:
    """An empty room of this size with boxes (x0, y0, x1, y1), all in metres, on 5 cm cells."""
    data = np.zeros((round(height / 0.05), round(width / 0.05)), dtype=np.int8)
    for x0, y0, x1, y1 in boxes:
        data[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = OCCUPIED
    return OccupancyGrid(data, 0.05)


def room(folder: Path, name: str, world: OccupancyGrid, **keys: Any) -> dict[str, Any]:
    """A scenario without a prior in this world, whose map file is written to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    path = save_ros_map(world, folder / name)
    return {"name": name, "map": str(path.resolve()), "prior": "none", "defaults": {"estimator": "truth"}, **keys}


def worlds(folder: Path) -> dict[str, Mapping[str, Any] | str]:
    """Twelve worlds by name: shipped scenarios, walls and a comb made here, and two of the BARN challenge where its data are."""
    found: dict[str, Mapping[str, Any] | str] = dict(SHIPPED)
    walls = [(1.5, 1.0, 1.6, 5.0), (3.0, 0.0, 3.1, 2.2), (3.0, 3.0, 3.1, 6.0), (4.4, 1.2, 4.5, 6.0)]
    found["walls"] = room(folder, "walls", grid(6.0, 6.0, walls), start=[0.6, 3.0, 0.0], goal=[5.4, 3.0])
    teeth = [(1.6 + 0.9 * k, 1.5, 1.7 + 0.9 * k, 4.0) for k in range(4)]
    comb = grid(6.5, 5.0, [(1.6, 4.0, 4.4, 4.1), *teeth])
    found["comb"] = room(folder, "comb", comb, start=[3.0, 2.6, 1.57], goal=[3.0, 4.6])
    data = Path(os.environ.get("ROBOCAR_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data") / "barn"
    for number in BARN_WORLDS:
        path = data / f"world_{number}.yaml"
        if path.is_file():
            found[f"BARN {number}"] = {
                "name": f"barn-{number}",
                "map": str(path.resolve()),
                "prior": "none",
                "start": [-2.25, 3.0, 1.57],
                "goal": [-2.25, 10.6],  # behind the field; beyond it the challenge goes on through nothing
                "border": "open",
                "defaults": {"estimator": "truth"},
            }
    return found


def scene_of(scenario: Mapping[str, Any] | str) -> Scene:
    """The scene of a world, for pictures."""
    return Scene.load(load_scenario(scenario), RobotModel.load().footprint)


def turns(result: RunResult) -> int:
    """How often the car has turned on the spot by more than 10 degrees."""
    poses, times = result.truth.poses, result.truth.times
    dt = np.maximum(np.diff(times), 1e-9)
    speed = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) / dt
    turn = (np.diff(poses[:, 2]) + math.pi) % math.tau - math.pi
    on_spot = (speed < 0.06) & (np.abs(turn) / dt > 0.1)
    count, angle = 0, 0.0
    for spot, step in zip(on_spot, turn, strict=True):
        if spot:
            before, angle = angle, angle + step
            count += abs(before) < _TURN <= abs(angle)
        else:
            angle = 0.0
    return int(count)


def draw(axis: Axes, scene: Scene) -> None:
    """The world from above, with start and goal."""
    world = scene.true_grid
    extent = (0.0, float(world.size[0]), 0.0, float(world.size[1]))
    image = axis.imshow(np.where(world.occupied, 0.45, 1.0), cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent)
    place = Affine2D().rotate(world.origin.theta).translate(world.origin.x, world.origin.y)
    image.set_transform(place + axis.transData)
    corners = np.asarray(world.corners())
    axis.plot(*np.vstack([corners, corners[:1]]).T, color="black", lw=1.5)
    axis.plot(scene.start.x, scene.start.y, "o", color="black", ms=4)
    if scene.goal is not None:
        axis.plot(*scene.goal.position, "*", color="tab:orange", ms=10)
    low, high = corners.min(axis=0), corners.max(axis=0)
    axis.set(aspect="equal", xlim=(low[0] - 0.05, high[0] + 0.05), ylim=(low[1] - 0.05, high[1] + 0.05), xticks=[], yticks=[])


def circle(centre: Array, radius: float) -> Array:
    """Points on a circle, (33, 2) [m]."""
    angles = np.linspace(0.0, math.tau, 33)
    return np.asarray(centre) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
