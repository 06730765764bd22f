"""The command `check`: files of any kind, what is in them or what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import tyro

from robocar.cli.output import Flag, complain, fail, put


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
    scene = Scene.load(scenario, scenario.robot_model().footprint)
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
    prior = {"none": "no prior map", "truth": "the map is known"}.get(scenario.prior, f"prior map {scenario.prior}")
    return (
        f"{path}: scenario, {width:g} x {height:g} m, {prior}, {len(scenario.unknown_obstacles)} unknown obstacles, "
        f"{len(scene.movers)} movers, {len(scene.landmarks)} landmarks, at most {scenario.time_limit:g} s"
    )


COMMANDS: dict[str, Callable[..., int]] = {"check": check_files}
