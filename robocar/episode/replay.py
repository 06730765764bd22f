"""Runs an estimator, and a mapper, over recorded sensor data instead of the simulator: with the same outputs as a run."""

from __future__ import annotations

import hashlib
import time as wall
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np

from robocar.core import (
    SE2,
    STOP,
    Belief,
    Command,
    Estimator,
    MapView,
    OccupancyGrid,
    ScenarioError,
    UnknownNameError,
    frozen_array,
)
from robocar.episode.algorithms import Kind
from robocar.episode.assembly import Assembly
from robocar.episode.body import DeadReckoning
from robocar.episode.checked import CheckedEstimator
from robocar.episode.given import Part, part_name
from robocar.episode.outcome import Outcome
from robocar.episode.registry import find, registered
from robocar.episode.result import RunResult
from robocar.episode.run import covariances_of
from robocar.episode.run_directory import RunDirectory
from robocar.episode.spec import RunSpec, checked_seed
from robocar.episode.tape import Tape, open_tape
from robocar.formats import Trajectory
from robocar.metrics import DrawnMap, Eye, RunLog, summarize
from robocar.recording import NullRecorder, Recorder, Scenery
from robocar.scenario.settings import flat, split_overrides


class ReplayOptions(TypedDict, total=False):
    """What `robocar.episode.replay.replay` takes beside the log and the output.

    Args:
        estimator: its name, or a class or factory; for a run by default the one of the run, for a log with poses `odometry`.
            With the run's own estimator, seed and settings the estimate is the run's, bit by bit.
        mapper: the same.
        seed: of the estimator's random numbers; by default the run's, or 0.
        settings: parameters, e.g. `{"estimator.max_particles": 400}`.
    """

    estimator: Part | None
    mapper: Part
    seed: int | None
    settings: Mapping[str, Any] | None


def replay(
    source: str | Path,
    *,
    out: str | Path | None = None,
    record: bool = True,
    live: bool = False,
    force: bool = False,
    subject: int | None = None,
    **options: Unpack[ReplayOptions],
) -> RunResult:
    """Run an estimator over a log.

    Args:
        source: a run directory or its `run.rrd`, an MRCLAM folder, a CARMEN log or a table of laser scans.
        out, record, live, force: see `robocar.run`.
        subject: number of the robot, for an MRCLAM folder; by default its first.
        options: estimator, mapper, seed and settings, see `ReplayOptions`.

    Returns:
        The result; its `status` is `success` when the log was read to its end, its navigator `replay`, its `hash` that of the
        estimate. Metrics that need a simulator are None. Poses are judged at the ticks with odometry.

    Raises:
        RobocarError: the log cannot be read, or does not hold what the estimator needs.
    """
    tape = open_tape(Path(source), subject)
    spec = _spec(tape, source, **options)
    start = tape.log.start
    assembly = Assembly(spec, tape.robot, tape.prior, start, tape.log.landmarks, tape.control_period)
    estimator, odometry = assembly.estimator(), assembly.odometry()
    with ExitStack() as stack:
        files = stack.enter_context(RunDirectory(out, spec, force)) if out is not None else None
        recorder: Recorder = NullRecorder()
        if files is not None and record:
            recorder = files.recorder(_scenery(tape), live, {"log": str(tape.log.path.name)})
        started = wall.perf_counter()
        played = _play(tape, estimator, odometry, recorder)
        wall_time = wall.perf_counter() - started
        grid = played.finish(recorder, played.map)
        result = _result(tape, spec, played, grid, wall_time)
        recorder.close(result.summary())
        return result if files is None else files.file(result, grid)


def _spec(
    tape: Tape,
    source: str | Path,
    estimator: Part | None = None,
    mapper: Part = "none",
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
) -> RunSpec:
    """What is run over the tape."""
    chosen = _estimator_of(tape, source) if estimator is None else estimator
    find("estimator", chosen)
    find("mapper", mapper)
    name = part_name(chosen)
    given = flat(settings or {})
    others, parameters = split_overrides(given)
    if others or parameters["navigator"]:
        wrong = next(iter(others), None) or next(key for key in given if key.startswith("navigator."))
        raise ScenarioError(f"--set {wrong}: a log is as it is; only parameters of the estimator and the mapper can be set")
    if name == tape.estimator:
        own = {key: value for key, value in (tape.settings or {}).items() if key.startswith("estimator.")}
        given = {**own, **given}
        parameters = split_overrides(given)[1]
    number = checked_seed(tape.seed if seed is None else seed)
    handed: dict[Kind, Part] = {"estimator": chosen, "mapper": mapper}
    names = name, part_name(mapper)
    return RunSpec(tape.scenario, "replay", *names, number, given, parameters, handed, log=tape.digest)


def _estimator_of(tape: Tape, source: str | Path) -> str:
    """The estimator that a run was made with. What a file names is never imported: only what is registered is found by name.

    Raises:
        ScenarioError: a log does not say, or a file names code.
        UnknownNameError: nothing is registered under this name.
    """
    # A log that holds poses (CARMEN) needs nobody to estimate them.
    name = tape.estimator or ("odometry" if tape.steps and tape.steps[0][0].odom_pose is not None else None)
    if name is None:
        raise ScenarioError(f"{source}: a log does not say which estimator to run; give --estimator")
    try:
        registered("estimator", name)
    except UnknownNameError as error:
        if ":" not in name:
            raise
        raise ScenarioError(
            f"{source}: the run's estimator is {name}, and a recorded configuration runs no code: give --estimator"
        ) from error
    return name


@dataclass(slots=True, eq=False)
class _Played(Outcome):
    """What the estimator made of the steps, as far as it came."""

    beliefs: list[Belief] = field(default_factory=list)
    reckoned: list[SE2] = field(default_factory=list)
    map: MapView | None = None


def _play(tape: Tape, estimator: Estimator, odometry: DeadReckoning, recorder: Recorder) -> _Played:
    played = _Played()
    estimator = CheckedEstimator(estimator)
    command: Command = STOP
    with played.failures():
        for (observation, following), known in zip(tape.steps, tape.truth(), strict=True):
            reckoned = odometry.update(observation, command).pose
            state = estimator.update(observation, command)
            recorder.log(observation, state, following, known, odometry=reckoned)
            played.beliefs.append(state.belief)
            played.reckoned.append(reckoned)
            played.map = state.map
            command = following
        played.end("success", tape.summary)
    return played


def _result(tape: Tape, spec: RunSpec, played: _Played, grid: OccupancyGrid | None, wall_time: float) -> RunResult:
    n = len(played.beliefs)
    seen = [step[0] for step in tape.steps[:n]]
    times = np.array([observation.time for observation in seen])
    # Between two lines of odometry a log may hold many measurements at once: they are no more time. Equal times count once.
    judged = np.array([o.twist is not None or o.wheel_angles is not None or o.odom_pose is not None for o in seen], dtype=bool)
    if not judged.any():
        judged[:] = True
    judged[:-1] &= np.diff(times) > 0
    estimate = np.array([belief.pose.as_array() for belief in played.beliefs]).reshape(-1, 3)[judged]
    odometry = np.array([pose.as_array() for pose in played.reckoned]).reshape(-1, 3)[judged]
    nowhere = np.full(3, np.nan)
    true = np.array([nowhere if known is None else known.pose.as_array() for known in tape.truth()[:n]]).reshape(-1, 3)[judged]
    times = times[judged]
    log = RunLog(
        time=times,
        truth_poses=true,
        estimate_poses=estimate,
        odometry_poses=odometry,
        status=played.status,
        footprint=tape.robot.footprint,
        grid=tape.prior,
        start=tape.log.start,
        wall_time=wall_time,
        covariances=covariances_of([belief.covariance for belief in played.beliefs])[judged],
        localized=len(times) > 0,
        drawn=None if grid is None or tape.scene is None else DrawnMap(grid, tape.scene.judged_map, Eye.of(tape.robot)),
    )
    known = np.isfinite(true).all(axis=1)
    return RunResult(
        scenario=tape.scenario.name,
        navigator=spec.navigator,
        estimator=spec.estimator,
        mapper=spec.mapper,
        seed=spec.seed,
        status=played.status,
        reason=played.reason,
        metrics=summarize(log),
        hash=hashlib.sha256(np.concatenate([times[:, None], estimate], axis=1).tobytes()).hexdigest(),
        truth=Trajectory(frozen_array(times[known]), frozen_array(true[known])),
        estimate=Trajectory(frozen_array(times), frozen_array(estimate)),
        odometry=Trajectory(frozen_array(times), frozen_array(odometry)),
        traceback=played.traceback,
        name=spec.label,
        settings=spec.settings,
    )


def _scenery(tape: Tape) -> Scenery:
    scene = tape.scene
    return Scenery(
        truth=scene.enclosed if scene is not None else tape.prior,
        prior=tape.prior,
        robot=tape.robot,
        goal=scene.goal if scene is not None else None,
        landmarks=tape.log.landmarks,
        solids=scene.solids if scene is not None else (),
    )
