"""The commands `run`, `replay` and `serial`. Heavy imports wait until a command needs them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from robocar.cli.output import Flag, fail, put

if TYPE_CHECKING:
    from robocar.episode.result import RunResult

Settings = Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="PATH.TO.PARAMETER=VALUE")]


@dataclass(frozen=True)
class RunArguments:
    """
    Args:
        scenario: a scenario (name or file), or any map file together with --start and --goal.
        navigator: who decides where to go, see `robocar list navigators`.
        estimator: who says where the robot is, see `robocar list estimators`.
        mapper: who draws the map, see `robocar list mappers`.
        seed: of all noise, tolerances and sampling.
        set: changes a value of the scenario (robot.lidar=hokuyo) or of a part, which each has its own (of --navigator a-star:
            navigator.controller.lookahead_dist=0.3); may be repeated.
        resolution: side of a cell of a map file [m].
        start: where the robot starts on a map file [m, m, rad].
        goal: where it shall go on a map file [m, m, rad].
        out: folder in which the run directory is made.
        live: show the run in a viewer while it goes on.
        no_recording: write no run.rrd.
        force: replace an existing run.
        json: print metrics.json on stdout.
        debug: show tracebacks.
    """

    scenario: tyro.conf.Positional[str]
    navigator: str | None = None
    estimator: str | None = None
    mapper: str | None = None
    seed: int = 0
    set: Settings = ()
    resolution: float | None = None
    start: Annotated[str | None, tyro.conf.arg(metavar="X,Y[,THETA]")] = None
    goal: Annotated[str | None, tyro.conf.arg(metavar="X,Y[,THETA]")] = None
    out: Path = Path("runs")
    live: Flag = False
    no_recording: Flag = False
    force: Flag = False
    json: Flag = False
    debug: Flag = False


def run_scenario(args: Annotated[RunArguments, tyro.conf.arg(name="")]) -> int:
    """Run one episode and leave its run directory."""
    from robocar.episode.registry import capabilities
    from robocar.episode.run import run
    from robocar.reporting.terminal import progress_bar
    from robocar.scenario.load import find_scenario
    from robocar.scenario.map_scenario import is_map, map_scenario
    from robocar.scenario.settings import parse_setting

    find_modules_here(args.navigator, args.estimator, args.mapper)
    settings = dict(parse_setting(text) for text in args.set)
    source: Any = args.scenario
    estimator = args.estimator
    if is_map(args.scenario):
        explores = args.navigator is not None and capabilities("navigator", args.navigator).explores
        source = map_scenario(args.scenario, args.resolution, args.start, args.goal, goal_needed=not explores)
        estimator = estimator or "truth"
    for option, value in (("resolution", args.resolution), ("start", args.start), ("goal", args.goal)):
        if value is not None:
            if source is not args.scenario:
                settings.setdefault(option, source[option])  # so that every start and goal has its run directory
            else:
                find_scenario(args.scenario)  # a name that leads nowhere is the greater mistake
                fail(f"--{option} goes with a map file; in a scenario use --set {option}=…")
    with progress_bar() as progress:
        result = run(
            source,
            navigator=args.navigator,
            estimator=estimator,
            mapper=args.mapper,
            seed=args.seed,
            settings=settings,
            out=args.out,
            record=not args.no_recording,
            live=args.live,
            force=args.force,
            progress=progress,
        )
    return _report(result, args.json, args.debug)


def find_modules_here(*names: str | None) -> None:
    """A part's module may lie where the command is typed."""
    if any(name is not None and ":" in name for name in names):
        sys.path.append(str(Path.cwd()))


def _report(result: RunResult, as_json: bool, debug: bool) -> int:
    from robocar.core.way import through
    from robocar.reporting.terminal import metrics_table, say

    say(metrics_table(result))
    for note in result.notes:
        say(f"warning: {note}")
    if result.traceback and debug:
        say(result.traceback)
    say(f"{result.status}: {result.reason}")
    unknown, length = (result.metrics.get(name, {}).get("value") for name in ("unknown_length", "path_length"))
    if unknown:
        say(through(unknown, length or 0.0))
    if result.directory is not None:
        say(f"run directory: {result.directory}")
    if result.recording is not None:
        say(f"recording:     {result.recording}   (open it: robocar view {result.directory})")
    if as_json:
        put(json.dumps(result.summary(), indent=1))
    if result.status == "interrupted":
        return 130
    return 0 if result.success else 1


@dataclass(frozen=True)
class ReplayArguments:
    """
    Args:
        log: a run directory, an MRCLAM folder, a CARMEN log, or a table of laser scans.
        estimator: who says where the robot is; by default, for a run, the one that it was made with.
        mapper: who draws the map.
        seed: of the estimator's random numbers; by default the run's, or 0.
        subject: number of the robot in an MRCLAM folder; by default its first.
        set: changes a parameter of the estimator or the mapper (of --estimator particle-filter: estimator.max_particles=400);
            may be repeated.
        out: folder in which the run directory is made.
        live: show the replay in a viewer while it goes on.
        no_recording: write no run.rrd.
        force: replace an existing run.
        json: print metrics.json on stdout.
        debug: show tracebacks.
    """

    log: tyro.conf.Positional[Path]
    estimator: str | None = None
    mapper: str = "none"
    seed: int | None = None
    subject: int | None = None
    set: Settings = ()
    out: Path = Path("runs")
    live: Flag = False
    no_recording: Flag = False
    force: Flag = False
    json: Flag = False
    debug: Flag = False


def replay_log(args: Annotated[ReplayArguments, tyro.conf.arg(name="")]) -> int:
    """Run an estimator over recorded sensor data and leave a run directory as `robocar run` does."""
    from robocar.episode.replay import replay
    from robocar.scenario.settings import parse_setting

    find_modules_here(args.estimator, args.mapper)
    result = replay(
        args.log,
        estimator=args.estimator,
        mapper=args.mapper,
        seed=args.seed,
        subject=args.subject,
        settings=dict(parse_setting(text) for text in args.set),
        out=args.out,
        record=not args.no_recording,
        live=args.live,
        force=args.force,
    )
    return _report(result, args.json, args.debug)


def serve_scenario(
    scenario: tyro.conf.Positional[str],
    /,
    seed: int = 0,
    set: Settings = (),
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

    world = simulate(scenario, seed=seed, settings=dict(parse_setting(text) for text in set))
    try:
        serve(world, announce=put)
    except KeyboardInterrupt:
        return 130
    finally:
        world.close()
    return 0


COMMANDS: dict[str, Callable[..., int]] = {"run": run_scenario, "replay": replay_log, "serial": serve_scenario}
