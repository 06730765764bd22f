"""Runs an estimator, and a mapper, over recorded sensor data instead of the simulator: with the same outputs as a run."""

from __future__ import annotations

import hashlib
import json
import time as wall
import traceback
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from robocar.core import (
    SE2,
    STOP,
    Array,
    Belief,
    Command,
    Context,
    Goal,
    Hold,
    LogFormatError,
    Observation,
    OccupancyGrid,
    RangeSensor,
    Robot,
    Scan,
    ScenarioError,
    frozen_array,
    wrap_angles,
)
from robocar.core.randomness import stream
from robocar.core.truth import GroundTruth
from robocar.episode.map_watch import decided, map_metrics
from robocar.episode.registry import build, find
from robocar.episode.result import RunResult
from robocar.episode.run import simulate
from robocar.episode.run_directory import RunDirectory
from robocar.estimation.odometry.odometry import OdometryEstimator
from robocar.formats import Trajectory, save_ros_map, write_tum
from robocar.formats.load_log import is_log, load_log
from robocar.formats.log import Log
from robocar.metrics.localization import summarize_localization
from robocar.metrics.run import RunLog, summarize
from robocar.recording import NullRecorder, Recorder, Scenery
from robocar.scenario.model import Scenario
from robocar.scenario.scene import Scene
from robocar.scenario.settings import split_overrides
from robocar.sim import car

_CONTROL_PERIOD = 0.1  # [s] of logs, which do not say
_NOT_IN_A_LOG = ("min_clearance", "mean_clearance", "contacts", "contacts_standing", "replans", "spl", "jerk_rms")


@dataclass(frozen=True, slots=True, eq=False)
class _Tape:
    """What is replayed, and the context that it was made in."""

    name: str
    steps: tuple[tuple[Observation, Command], ...]  # and the command that followed
    robot: Robot
    log: Log
    prior: OccupancyGrid | None
    control_period: float
    scenario: Scenario
    scene: Scene | None = None
    seed: int = 0
    settings: Mapping[str, Any] | None = None
    estimator: str | None = None


def replay(
    source: str | Path,
    *,
    estimator: str | None = None,
    mapper: str = "none",
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    record: bool = True,
    live: bool = False,
    force: bool = False,
) -> RunResult:
    """Run an estimator over a log.

    Args:
        source: a run directory or its `run.rrd`, an MRCLAM folder, a CARMEN log or a table of laser scans.
        estimator: its name; for a run by default the one of the run, for a log with poses `odometry`. With the run's own
            estimator, seed and settings the estimate is the run's, bit by bit.
        mapper: its name.
        seed: of the estimator's random numbers; by default the run's, or 0.
        settings: parameters, e.g. `{"estimator.max_particles": 400}`.
        out, record, live, force: see `robocar.run`.

    Returns:
        The result; its `status` is `success` when the log was read to its end, its navigator `replay`, its `hash` that of the
        estimate. Metrics that need a simulator are None. Poses are judged at the ticks with odometry.

    Raises:
        RobocarError: the log cannot be read, or does not hold what the estimator needs.
    """
    tape = _open(Path(source))
    # A log that holds poses (CARMEN) needs nobody to estimate them.
    name = estimator or tape.estimator or ("odometry" if tape.steps and tape.steps[0][0].odom_pose is not None else None)
    if name is None:
        raise ScenarioError(f"{source}: a log does not say which estimator to run; give --estimator")
    if name == "truth":
        raise ScenarioError("the pose oracle needs a simulator: a log cannot be replayed with --estimator truth")
    chosen = {"navigator": "replay", "estimator": name, "mapper": mapper}
    find("estimator", name)
    find("mapper", mapper)
    given = dict(settings or {})
    others, parameters = split_overrides(given)
    if others or parameters["navigator"]:
        wrong = next(iter(others), None) or f"navigator.{next(iter(parameters['navigator']))}"
        raise ScenarioError(f"--set {wrong}: a log is as it is; only parameters of the estimator and the mapper can be set")
    if name == tape.estimator:
        parameters["estimator"] = split_overrides(tape.settings or {})[1]["estimator"] | parameters["estimator"]
        given |= {f"estimator.{key}": value for key, value in parameters["estimator"].items()}
    number = tape.seed if seed is None else seed
    if isinstance(number, bool) or not isinstance(number, int) or number < 0:
        raise ScenarioError(f"the seed must be a whole number from 0 on, not {number!r}")
    with ExitStack() as stack:
        files = stack.enter_context(RunDirectory(out, tape.scenario, chosen, number, given, force)) if out is not None else None
        return _replay(tape, chosen, parameters, number, files, record, live)


def _replay(
    tape: _Tape,
    chosen: Mapping[str, str],
    parameters: Mapping[str, dict[str, Any]],
    seed: int,
    files: RunDirectory | None,
    record: bool,
    live: bool,
) -> RunResult:
    def context(component: str, given: dict[str, Any]) -> Context:
        log = tape.log
        return Context(tape.robot, tape.prior, log.start, log.landmarks, given, stream(seed, component), tape.control_period)

    estimator = build("estimator", chosen["estimator"], context(f"estimator/{chosen['estimator']}", parameters["estimator"]))
    mapper = build("mapper", chosen["mapper"], context(f"mapper/{chosen['mapper']}", parameters["mapper"]))
    odometry = OdometryEstimator(context("odometry", {}))
    truth = _truth_at(tape.log.truth, [step[0].time for step in tape.steps])
    recorder = _recorder(tape, chosen, seed, files, live) if files and record else NullRecorder()
    beliefs: list[Belief] = []
    reckoned: list[SE2] = []
    status, reason, trace = "success", f"{len(tape.steps)} observations of {tape.log.path}{_skipped(tape.log)}", ""
    started = wall.perf_counter()
    command: Command = STOP
    for k, (observation, following) in enumerate(tape.steps):
        reckoned.append(odometry.update(observation, command).pose)
        try:
            belief = estimator.update(observation, command)
            mapper.update(belief, observation)
        except Exception as error:
            status, reason, trace = "error", f"{type(error).__name__}: {error}", traceback.format_exc()
            reckoned.pop()
            break
        beliefs.append(belief)
        known = None if truth is None or np.isnan(truth[k, 0]) else GroundTruth(observation.time, SE2(*map(float, truth[k])))
        recorder.log(observation, belief, mapper, following, known, odometry=reckoned[-1])
        command = following
    result = _result(tape, chosen, seed, beliefs, reckoned, truth, status, reason, trace, wall.perf_counter() - started)
    if tape.scene is not None:
        result.metrics.update(map_metrics(mapper, tape.scene, tape.robot, result.truth.poses, False))
    recorder.close(result.summary())
    return result if files is None else _file(files, result, mapper.grid())


def _result(
    tape: _Tape,
    chosen: Mapping[str, str],
    seed: int,
    beliefs: list[Belief],
    reckoned: list[SE2],
    truth: Array | None,
    status: str,
    reason: str,
    trace: str,
    wall_time: float,
) -> RunResult:
    n = len(beliefs)
    seen = [step[0] for step in tape.steps[:n]]
    times = np.array([observation.time for observation in seen])
    # Between two lines of odometry a log may hold many measurements at once: they are no more time. Equal times count once.
    judged = np.array([o.twist is not None or o.wheel_angles is not None or o.odom_pose is not None for o in seen], dtype=bool)
    if not judged.any():
        judged[:] = True
    judged[:-1] &= np.diff(times) > 0
    estimate = np.array([belief.pose.as_array() for belief in beliefs]).reshape(-1, 3)[judged]
    odometry = np.array([pose.as_array() for pose in reckoned]).reshape(-1, 3)[judged]
    true = np.full((n, 3), np.nan)[judged] if truth is None else truth[:n][judged]
    nowhere = np.full((3, 3), np.nan)
    covariances = np.array([nowhere if b.covariance is None else b.covariance for b in beliefs]).reshape(-1, 3, 3)[judged]
    times = times[judged]
    count, nothing = len(times), np.full(len(times), np.nan)
    log = RunLog(
        time=times,
        truth_poses=true,
        truth_twists=np.full((count, 2), np.nan),
        estimate_poses=estimate,
        odometry_poses=odometry,
        clearance=nothing,
        contact=np.zeros(count, dtype=bool),
        standing=np.zeros(count, dtype=bool),
        plan_time=nothing,
        replans=0,
        status=status,
        grid=tape.prior or OccupancyGrid(np.zeros((1, 1), dtype=np.int8), 1.0),
        footprint=tape.robot.footprint,
        start=tape.log.start or SE2(),
        wall_time=wall_time,
    )
    metrics = summarize(log)
    for name in _NOT_IN_A_LOG:
        metrics[name] = {"value": None, "unit": metrics[name]["unit"]}
    if count:
        metrics.update(summarize_localization(times, true, estimate, covariances))
    known = np.isfinite(true).all(axis=1)
    return RunResult(
        scenario=tape.name,
        navigator=chosen["navigator"],
        estimator=chosen["estimator"],
        mapper=chosen["mapper"],
        seed=seed,
        status=status,
        reason=reason,
        metrics=metrics,
        hash=hashlib.sha256(np.concatenate([times[:, None], estimate], axis=1).tobytes()).hexdigest(),
        truth=Trajectory(frozen_array(times[known]), frozen_array(true[known])),
        estimate=Trajectory(frozen_array(times), frozen_array(estimate)),
        odometry=Trajectory(frozen_array(times), frozen_array(odometry)),
        traceback=trace,
    )


def _file(files: RunDirectory, result: RunResult, grid: OccupancyGrid | None) -> RunResult:
    for name in ("truth", "estimate", "odometry"):
        trajectory: Trajectory = getattr(result, name)
        write_tum(files.path / f"{name}.tum", trajectory.times, trajectory.poses)
    if grid is not None:
        save_ros_map(decided(grid), files.path / "map")
    if result.traceback:
        (files.path / "error.txt").write_text(result.traceback)
    (files.path / "metrics.json").write_text(json.dumps(result.summary(), indent=1) + "\n")
    return replace(result, directory=files.complete())


def _recorder(tape: _Tape, chosen: Mapping[str, str], seed: int, files: RunDirectory, live: bool) -> Recorder:
    from robocar.recording import RerunRecorder

    scene = tape.scene
    goal: Goal | None = scene.goal if scene is not None else None
    scenery = Scenery(
        truth=scene.enclosed if scene is not None else tape.prior,
        prior=tape.prior,
        robot=tape.robot,
        goal=goal,
        landmarks=tape.log.landmarks,
        solids=scene.solids if scene is not None else (),
    )
    properties = {"log": str(tape.log.path.name), **chosen, "seed": seed}
    return RerunRecorder(files.path / "run.rrd", run_id=files.name, scenery=scenery, live=live, properties=properties)


def _truth_at(truth: Trajectory | None, times: list[float]) -> Array | None:
    """True poses (n, 3) at these times, on the straight line between two known ones; nan before the first and after the last."""
    if truth is None or len(truth.times) == 0:
        return None
    at, (first, last) = np.array(times), truth.times[[0, -1]]
    ends = (np.abs(at - first) < 1e-6) | (np.abs(at - last) < 1e-6)  # recordings keep times in whole nanoseconds
    at[ends] = np.clip(at[ends], first, last)
    turns = np.concatenate([truth.poses[:1, 2], truth.poses[:1, 2] + np.cumsum(wrap_angles(np.diff(truth.poses[:, 2])))])
    columns = [np.interp(at, truth.times, column, left=np.nan, right=np.nan) for column in (*truth.poses[:, :2].T, turns)]
    poses = np.stack(columns, axis=1)
    finite = np.isfinite(poses[:, 2])
    poses[finite, 2] = wrap_angles(poses[finite, 2])
    return poses


# -- what can be replayed ------------------------------------------------------------------------------------------------


def _open(source: Path) -> _Tape:
    """The log at a path, whatever its format.

    Raises:
        LogFormatError: nothing is there, or nothing that is known.
    """
    if source.is_dir() and (source / "run.rrd").is_file():
        return _run_tape(source)
    if source.is_dir() and not is_log(source):
        raise LogFormatError(f"{source}: neither a run directory (run.rrd) nor an MRCLAM data set (Barcodes.dat)")
    if source.is_file() and source.name == "run.rrd":
        return _run_tape(source.parent)
    return _log_tape(load_log(source))


def _log_tape(log: Log) -> _Tape:
    """A robot of which only its log is known: its size does not matter, it sees what the log holds."""
    robot = Robot(
        car.footprint(),
        car.LIMITS,
        car.load_calibration(),
        car.PULSES_PER_TURN,
        lidar=next((_laser(o.lidar) for o in log.observations if o.lidar is not None), None),
        camera=bool(log.landmarks),
    )
    name = log.path.name.partition(".")[0] or "log"
    # Nothing but the name matters of it: where the run directory is named and described, a scenario is asked for.
    scenario = Scenario(name=name, description=f"{log.kind} log", map="none", prior="none", start=(0.0, 0.0, 0.0))
    return _Tape(name, tuple((o, Hold()) for o in log.observations), robot, log, None, _CONTROL_PERIOD, scenario)


def _laser(scan: Scan) -> RangeSensor:
    """The scanner that took a scan."""
    return RangeSensor(
        scan.name or "laser", scan.robot_from_sensor, scan.bearings, scan.beam_width, 0.0, scan.max_range, _CONTROL_PERIOD
    )


def _skipped(log: Log) -> str:
    """How many lines of the log made no sense, and which are the first."""
    if not log.skipped:
        return ""
    first = "; ".join(log.skipped[:3])
    return f", {len(log.skipped)} lines skipped ({first}{'; ...' if len(log.skipped) > 3 else ''})"


def _run_tape(folder: Path) -> _Tape:
    """A run of ours: its recording holds what was sensed, its `config.yaml` the world."""
    from robocar.recording import read_observations, read_trajectory

    try:
        config = yaml.safe_load((folder / "config.yaml").read_text())
        seed, settings, estimator = int(config["seed"]), dict(config["settings"]), str(config["estimator"])
        if config["navigator"] == "replay" and config["scenario"]["map"] == "none":
            raise LogFormatError(f"{folder}: the replay of a log holds no world; replay the log itself")
        place = {"folder": Path(config["folder"])} if "folder" in config else {}
        scenario = Scenario.model_validate(config["scenario"] | place)
    except (OSError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        raise LogFormatError(f"{folder / 'config.yaml'}: not the configuration of a run: {error}") from error
    scene = Scene.load(scenario, car.footprint())
    simulation = simulate(scenario, seed=seed)
    robot, period = simulation.robot, simulation.control_period
    simulation.close()
    times, poses = read_trajectory(folder / "run.rrd", "world/truth")
    steps = tuple(read_observations(folder / "run.rrd"))
    start = scene.start if scenario.start_known else None
    log = Log(folder, "run", tuple(o for o, _ in steps), scene.landmarks, Trajectory(times, poses), start)
    return _Tape(scenario.name, steps, robot, log, scene.prior, period, scenario, scene, seed, settings, estimator)
