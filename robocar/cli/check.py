"""The command `check`: files of any kind, what is in them or what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import tyro

from robocar.cli.output import Flag, complain, fail, put


def check_files(files: tyro.conf.Positional[tuple[Path, ...]], /, resolution: float | None = None, debug: Flag = False) -> int:
    """Validate maps, worlds, scenarios and trajectories; say what is wrong and where.

    Args:
        files: of any kind that Robocar reads.
        resolution: side of a cell where the file does not say [m].
        debug: show tracebacks.
    """
    from robocar.core import RobocarError

    if not files:
        fail("check takes at least one file")
    bad = 0
    for file in files:
        try:
            put(check(file, resolution))
        except RobocarError as error:
            if debug:
                raise
            bad += 1
            complain(str(error))
    return 2 if bad else 0


def check(path: Path, resolution: float | None) -> str:
    """One or more lines about a readable file.

    Raises:
        RobocarError: what is wrong with it, and where.
    """
    from robocar.formats import check_file
    from robocar.scenario.map_scenario import is_scenario

    if not is_scenario(path):
        return str(check_file(path, resolution))
    from robocar.core import RobocarError
    from robocar.episode.registry import find
    from robocar.scenario.load import load_scenario
    from robocar.scenario.scene import Scene

    scenario = load_scenario(path)
    model = scenario.robot_model()
    model.describe(scenario.robot.fit_out, scenario.robot.sensors)
    scene = Scene.load(scenario, model.footprint)
    for kind in ("navigator", "estimator", "mapper"):
        find(kind, getattr(scenario.defaults, kind))  # type: ignore[arg-type]
    try:
        scene.world().compile()
    except ValueError as error:
        raise RobocarError(f"{path}: the world cannot be built: {error}") from error
    width, height = scene.grid.size
    prior = {"none": "no prior map", "truth": "the map is known"}.get(scenario.prior, f"prior map {scenario.prior}")
    return (
        f"{path}: scenario, {width:g} x {height:g} m, {prior}, {len(scenario.unknown_obstacles)} unknown obstacles, "
        f"{len(scene.movers)} movers, {len(scene.landmarks)} landmarks, at most {scenario.time_limit:g} s"
        + "".join(f"\n  warning: {note}" for note in scene.notes)
    )


COMMANDS: dict[str, Callable[..., int]] = {"check": check_files}
