"""The command line: a thin layer over the Python API. Heavy imports wait until a command needs them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import tyro

from robocar import __version__
from robocar.cli.output import Flag
from robocar.cli.output import dumps as _dumps
from robocar.cli.output import fail as _fail
from robocar.cli.output import put as _print
from robocar.cli.regression import COMMANDS as _REGRESSION

if TYPE_CHECKING:
    from robocar.episode.run import RunResult


def _run(
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
    from robocar.scenario.map_scenario import is_map, map_scenario
    from robocar.scenario.model import find_scenario, parse_setting

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
                _fail(f"--{option} goes with a map file; in a scenario use --set {option}=…")
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
        _print(json.dumps(result.summary(), indent=1))
    if result.status == "interrupted":
        return 130
    return 0 if result.success else 1


def _replay(
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
    from robocar.scenario.model import parse_setting

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


def _list(
    what: tyro.conf.Positional[Literal["scenarios", "navigators", "estimators", "mappers", "experiments", "suites"]],
    /,
    json: Flag = False,
) -> int:
    """List what there is.

    Args:
        what: scenarios, navigators, estimators, mappers, experiments or suites.
        json: as one JSON object.
    """
    from robocar.reporting.terminal import listing

    found = listing(what)
    if json:
        _print(_dumps(found))
    else:
        width = max((len(name) for name in found), default=0)
        for name, summary in found.items():
            _print(f"{name:{width}}  {summary}")
    return 0


def _experiment(name: tyro.conf.Positional[str], /, out: Path = Path("runs"), quick: Flag = False, debug: Flag = False) -> int:
    """Run one experiment: tables, pictures and recordings of a paper.

    Args:
        name: see `robocar list experiments`.
        out: folder in which the experiment's folder is made.
        quick: a short version.
        debug: show tracebacks.
    """
    from robocar.reporting.report import run_experiment

    run_experiment(name, out, quick)
    return 0


def _check(files: tyro.conf.Positional[tuple[Path, ...]], /, resolution: float | None = None, debug: Flag = False) -> int:
    """Validate maps, worlds, scenarios and trajectories; say what is wrong and where.

    Args:
        files: of any kind that Robocar reads.
        resolution: side of a cell where the file does not say [m].
        debug: show tracebacks.
    """
    from robocar.core import RobocarError
    from robocar.scenario.map_scenario import check

    if not files:
        _fail("check takes at least one file")
    bad = 0
    for file in files:
        try:
            _print(check(file, resolution))
        except RobocarError as error:
            if debug:
                raise
            bad += 1
            sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
    return 2 if bad else 0


def _view(run: tyro.conf.Positional[Path], /, web: Flag = False) -> int:
    """Open a recording in the Rerun viewer.

    Args:
        run: a run directory or an .rrd file.
        web: in a browser instead of a window.
    """
    from robocar.reporting.terminal import view

    return view(run, web)


def _serial(
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
    from robocar.scenario.model import parse_setting
    from robocar.sim.serial_port import serve

    simulation = simulate(scenario, seed=seed, settings=dict(parse_setting(text) for text in set))
    try:
        serve(simulation, announce=_print)
    except KeyboardInterrupt:
        return 130
    finally:
        simulation.close()
    return 0


def _schema(kind: tyro.conf.Positional[Literal["scenario", "suite"]], /) -> int:
    """Print the JSON schema of a kind of file, for editors.

    Args:
        kind: scenario or suite.
    """
    from robocar.regression.suite import SuiteModel
    from robocar.scenario.model import json_schema

    _print(_dumps(json_schema() if kind == "scenario" else SuiteModel.model_json_schema()))
    return 0


_COMMANDS: dict[str, Callable[..., int]] = {
    "run": _run,
    "replay": _replay,
    "list": _list,
    "experiment": _experiment,
    "check": _check,
    "view": _view,
    "serial": _serial,
    "schema": _schema,
    **_REGRESSION,
}
_POINTS = ("--start", "--goal")


def main(arguments: list[str] | None = None) -> NoReturn:
    """The console script `robocar`."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words == ["--version"]:
        _print(f"robocar {__version__}")
        sys.exit(0)
    # `--start -1,2`: a value that begins with a minus sign is no option.
    for i in range(len(words) - 1, 0, -1):
        if words[i - 1] in _POINTS and words[i].startswith("-"):
            words[i - 1 : i + 1] = [f"{words[i - 1]}={words[i]}"]
    try:
        status = tyro.extras.subcommand_cli_from_dict(
            _COMMANDS,
            args=words,
            prog="robocar",
            description="Mobile-robot navigation in MuJoCo physics without ROS.",
        )
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone: nothing left to say
        sys.exit(1)
    except Exception as error:
        from robocar.core import RobocarError

        if "--debug" in words or not isinstance(error, RobocarError):
            raise
        _fail(str(error))
    sys.exit(status)


if __name__ == "__main__":
    main()
