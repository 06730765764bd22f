"""The command `check`: files of any kind, what is in them or what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from robocar.cli.output import Flag, complain, fail, put

if TYPE_CHECKING:
    from robocar.scenario.scene import Scene


def check_files(
    files: tyro.conf.Positional[tuple[Path, ...]],
    /,
    resolution: float | None = None,
    subject: int | None = None,
    debug: Flag = False,
) -> int:
    """Validate maps, worlds, scenarios and trajectories; say what is wrong and where.

    Args:
        files: of any kind that Robocar reads.
        resolution: side of a cell where the file does not say [m].
        subject: number of the robot in an MRCLAM folder; by default its first.
        debug: show tracebacks.
    """
    from robocar.core import RobocarError

    if not files:
        fail("check takes at least one file")
    bad = 0
    for file in files:
        try:
            put(check(file, resolution, subject))
        except RobocarError as error:
            if debug:
                raise
            bad += 1
            complain(str(error))
    return 2 if bad else 0


def check(path: Path, resolution: float | None, subject: int | None = None) -> str:
    """One or more lines about a readable file.

    Raises:
        RobocarError: what is wrong with it, and where.
    """
    from robocar.formats import check_file
    from robocar.scenario.map_scenario import is_scenario

    if not is_scenario(path):
        return str(check_file(path, resolution, subject))
    from robocar.core import RobocarError
    from robocar.episode.assembly import check_sight_of_movers
    from robocar.episode.registry import find
    from robocar.formats.load_log import refuse_subject
    from robocar.scenario.load import load_scenario
    from robocar.scenario.scene import Scene

    refuse_subject(path, subject)
    scenario = load_scenario(path)
    model = scenario.robot_model()
    model.describe(scenario.robot.fit_out, scenario.robot.sensors)
    scene = Scene.load(scenario, model.footprint)
    for kind in ("navigator", "estimator", "mapper"):
        find(kind, getattr(scenario.defaults, kind))  # type: ignore[arg-type]
    section = scenario.robot
    robot = scenario.robot_model().describe(section.fit_out, section.sensors)
    try:
        check_sight_of_movers(scenario.defaults.navigator, scenario, robot)
    except RobocarError as error:
        raise RobocarError(f"{path}: {error}") from error
    try:
        scene.world().compile()
    except ValueError as error:
        raise RobocarError(f"{path}: the world cannot be built: {error}") from error
    width, height = scene.grid.size
    remarks = [] if (text := _through_unknown(scene)) is None else [f"  warning: {text}"]
    prior = {"none": "no prior map", "truth": "the map is known"}.get(scenario.prior, f"prior map {scenario.prior}")
    facts = (
        f"{path}: scenario, {width:g} x {height:g} m, {prior}, {len(scenario.unknown_obstacles)} unknown obstacles, "
        f"{len(scene.movers)} movers, {len(scene.landmarks)} landmarks, at most {scenario.time_limit:g} s"
        + "".join(f"\n  warning: {note}" for note in scene.notes)
    )
    return "\n".join([facts, *remarks])


def _through_unknown(scene: Scene) -> str | None:
    """How much of the map is unknown, and whether the way to the goal leads there; None where nothing is."""
    from robocar.core.way import LARGEST, find_way, length_over, through

    grid = scene.grid if scene.prior is None else scene.prior
    if not grid.unknown.any():
        return None
    text = f"{grid.unknown.mean():.1%} of the map are unknown, and free floor to the robot"
    if scene.goal is None or grid.data.size > LARGEST:
        return text
    radius = scene.scenario.robot_model().footprint.inscribed_radius
    way = find_way(grid, grid.occupied, scene.start.position, scene.goal.position, radius)
    if way is None:
        return text + "; no way leads to the goal"
    known = find_way(grid, grid.occupied | grid.unknown, scene.start.position, scene.goal.position, radius)
    return "; ".join(
        [
            text,
            f"shortest {through(length_over(grid, grid.unknown, way.points), way.length)}",
            "no way is known all along" if known is None else f"the way through known cells has {known.length:.1f} m",
        ]
    )


COMMANDS: dict[str, Callable[..., int]] = {"check": check_files}
