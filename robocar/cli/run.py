"""The commands `run`, `replay` and `serial`. Heavy imports wait until a command needs them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from robocar.cli.output import Flag, fail, put

if TYPE_CHECKING:
    from robocar.episode.result import RunResult


def run_scenario(
    scenario: tyro.conf.Positional[str],
    /,
    navigator: str | None = None,
    estimator: str | None = None,
    mapper: str | None = None,
    seed: int = 0,
    set: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="PATH.TO.PARAMETER=VALUE")] = (),
    resolution: float | None = None,
    start: Annotated[str | None, tyro.conf.arg(metavar="X,Y[,THETA]")] = None,
    goal: Annotated[str | None, tyro.conf.arg(metavar="X,Y[,THETA]")] = None,
    out: Path = Path("runs"),
    live: Flag = False,
    no_recording: Flag = False,
    force: Flag = False,
    json: Flag = False,
    debug: Flag = False,
) -> int:
    """Run one episode and leave its run directory.

    Args:
        scenario: a scenario (name or file), or any map file together with --start and --goal.
        navigator: who decides where to go, see `robocar list navigators`.
        estimator: who says where the car is, see `robocar list estimators`.
        mapper: who draws the map, see `robocar list mappers`.
        seed: of all noise, tolerances and sampling.
        set: changes a value of the scenario (robot.lidar=hokuyo) or of a part (navigator.speed=0.2); may be repeated.
        resolution: side of a cell of a map file [m].
        start: where the car starts on a map file [m, m, rad].
        goal: where it shall go on a map file [m, m, rad].
        out: folder in which the run directory is made.
        live: show the run in a viewer while it goes on.
        no_recording: write no run.rrd.
        force: replace an existing run.
        json: print metrics.json on stdout.
        debug: show tracebacks.
    """
    from robocar.episode.run import run
    from robocar.reporting.terminal import progress_bar
    from robocar.scenario.load import find_scenario
    from robocar.scenario.map_scenario import is_map, map_scenario
    from robocar.scenario.settings import parse_setting

    settings = dict(parse_setting(text) for text in set)
    source: Any = scenario
    if is_map(scenario):
        source = map_scenario(scenario, resolution, start, goal, goal_needed=navigator != "explore")
        estimator = estimator or "truth"
    for option, value in (("resolution", resolution), ("start", start), ("goal", goal)):
        if value is not None:
            if source is not scenario:
                settings.setdefault(option, source[option])  # so that every start and goal has its run directory
            else:
                find_scenario(scenario)  # a name that leads nowhere is the greater mistake
                fail(f"--{option} goes with a map file; in a scenario use --set {option}=…")
    if any(":" in name for name in (navigator, estimator, mapper) if name):
        sys.path.append(str(Path.cwd()))  # a planner's module may lie where the command is typed
    with progress_bar() as progress:
        result = run(
            source,
            navigator=navigator,
            estimator=estimator,
            mapper=mapper,
            seed=seed,
            settings=settings,
            out=out,
            record=not no_recording,
            live=live,
            force=force,
            progress=progress,
        )
    return _report(result, json, debug)


def _report(result: RunResult, as_json: bool, debug: bool) -> int:
    from robocar.reporting.terminal import metrics_table, say

    say(metrics_table(result))
    if result.traceback and debug:
        say(result.traceback)
    say(f"{result.status}: {result.reason}")
    if result.directory is not None:
        say(f"run directory: {result.directory}")
    if result.recording is not None:
        say(f"recording:     {result.recording}   (open it: robocar view {result.directory})")
    if as_json:
        put(json.dumps(result.summary(), indent=1))
    if result.status == "interrupted":
        return 130
    return 0 if result.success else 1


def replay_log(
    log: tyro.conf.Positional[Path],
    /,
    estimator: str | None = None,
    mapper: str = "none",
    seed: int | None = None,
    set: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="PATH.TO.PARAMETER=VALUE")] = (),
    out: Path = Path("runs"),
    live: Flag = False,
    no_recording: Flag = False,
    force: Flag = False,
    json: Flag = False,
    debug: Flag = False,
) -> int:
    """Run an estimator over recorded sensor data and leave a run directory as `robocar run` does.

    Args:
        log: a run directory, an MRCLAM folder, a CARMEN log, or a table of laser scans.
        estimator: who says where the robot is; by default, for a run, the one that it was made with.
        mapper: who draws the map.
        seed: of the estimator's random numbers; by default the run's, or 0.
        set: changes a parameter (estimator.max_particles=400); may be repeated.
        out: folder in which the run directory is made.
        live: show the replay in a viewer while it goes on.
        no_recording: write no run.rrd.
        force: replace an existing run.
        json: print metrics.json on stdout.
        debug: show tracebacks.
    """
    from robocar.episode.replay import replay
    from robocar.scenario.settings import parse_setting

    result = replay(
        log,
        estimator=estimator,
        mapper=mapper,
        seed=seed,
        settings=dict(parse_setting(text) for text in set),
        out=out,
        record=not no_recording,
        live=live,
        force=force,
    )
    return _report(result, json, debug)


def serve_scenario(
    scenario: tyro.conf.Positional[str],
    /,
    seed: int = 0,
    set: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="PATH.TO.PARAMETER=VALUE")] = (),
    debug: Flag = False,
) -> int:
    """Drive the simulated car in real time over a serial port: prints the port's path, then answers the thesis' commands.

    Args:
        scenario: name or file.
        seed: of the car and its sensors.
        set: changes a value of the scenario; may be repeated.
        debug: show tracebacks.
    """
    from robocar.episode.run import simulate
    from robocar.scenario.settings import parse_setting
    from robocar.sim.serial_port import serve

    simulation = simulate(scenario, seed=seed, settings=dict(parse_setting(text) for text in set))
    try:
        serve(simulation, announce=put)
    except KeyboardInterrupt:
        return 130
    finally:
        simulation.close()
    return 0


COMMANDS: dict[str, Callable[..., int]] = {"run": run_scenario, "replay": replay_log, "serial": serve_scenario}
