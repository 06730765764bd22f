"""From a scenario to a finished run: builds the parts, runs the loop, judges and files the result."""

from __future__ import annotations

import json
import time as wall
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from robocar.core import SE2, Array, Context, Goal, Mapper, ScenarioError, frozen_array
from robocar.core.randomness import stream
from robocar.core.solids import Box, Cylinder, Solid
from robocar.episode.judge import Episode, Rules
from robocar.episode.loop import navigate
from robocar.episode.map_watch import MapWatch, decided, explores, map_metrics
from robocar.episode.progress import RunProgress
from robocar.episode.registry import build, find
from robocar.episode.result import RunResult
from robocar.episode.run_directory import RunDirectory
from robocar.estimation.mapping.no_mapper import NoMapper
from robocar.estimation.odometry.odometry import OdometryEstimator
from robocar.formats import Trajectory, save_ros_map, write_tum
from robocar.metrics.localization import summarize_localization
from robocar.metrics.movers import Shape, Track, summarize_movers
from robocar.metrics.run import Metric, RunLog, summarize
from robocar.recording import NullRecorder, Recorder, Scenery
from robocar.scenario.load import load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.scene import Scene
from robocar.scenario.settings import split_overrides
from robocar.sim.car import FitOut, footprint
from robocar.sim.movers import Mover, MovingObstacle
from robocar.sim.oracle import PoseOracle
from robocar.sim.simulation import Simulation

EXPLORATION_TIME = 4.0
"""Times the scenario's time limit, which is meant for the way to its goal, an exploration may take, unless one is set for it."""


def run(
    scenario: str | Path | Mapping[str, Any] | Scenario,
    *,
    navigator: str | None = None,
    estimator: str | None = None,
    mapper: str | None = None,
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    record: bool = True,
    live: bool = False,
    force: bool = False,
    progress: RunProgress | None = None,
) -> RunResult:
    """Run one episode.

    Args:
        scenario: a name from `models/scenarios`, a file, a mapping with the same keys, or a `Scenario`.
        navigator, estimator, mapper: registered names or `package.module:factory`; the scenario's defaults otherwise.
        seed: of all noise, tolerances and sampling.
        settings: what `--set` takes, e.g. `{"robot.lidar": "hokuyo", "navigator.speed": 0.2}`.
        out: the run directory is made in here; None writes no files.
        record: write `run.rrd` (with `out`); live: also show the run in a viewer while it goes on.
        force: replace an existing run.
        progress: told after every tick how far the run has got.

    Raises:
        RobocarError: bad input or an output that cannot be written. What goes wrong during the run is in the result's status.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ScenarioError(f"the seed must be a whole number from 0 on, not {seed!r}")
    scenario_settings, parameters = split_overrides(settings or {})
    loaded = load_scenario(scenario, scenario_settings)
    chosen = {
        "navigator": navigator or loaded.defaults.navigator,
        "estimator": estimator or loaded.defaults.estimator,
        "mapper": mapper or loaded.defaults.mapper,
    }
    for kind, name in chosen.items():
        find(kind, name)  # type: ignore[arg-type]
    scene = Scene.load(loaded, footprint())
    with ExitStack() as stack:
        files = stack.enter_context(RunDirectory(out, loaded, chosen, seed, settings or {}, force)) if out is not None else None
        patient = "time_limit" not in (settings or {})
        return _run(stack, loaded, scene, chosen, parameters, seed, files, record, live, progress, patient)


def _run(
    stack: ExitStack,
    scenario: Scenario,
    scene: Scene,
    chosen: Mapping[str, str],
    parameters: Mapping[str, dict[str, Any]],
    seed: int,
    files: RunDirectory | None,
    record: bool,
    live: bool,
    progress: RunProgress | None,
    patient: bool,
) -> RunResult:
    car = simulation_of(scene, seed)
    stack.callback(car.close)

    def context(component: str, given: dict[str, Any]) -> Context:
        return Context(
            robot=car.robot,
            prior=scene.prior,
            start=scene.start if scenario.start_known else None,
            landmarks=scene.landmarks,
            parameters=given,
            rng=stream(seed, component),
            control_period=car.control_period,
        )

    parts = {
        kind: build(kind, chosen[kind], context(f"{kind}/{chosen[kind]}", parameters[kind]))  # type: ignore[arg-type]
        for kind in ("navigator", "estimator", "mapper")
    }
    if isinstance(parts["estimator"], PoseOracle):
        parts["estimator"].connect(car.ground_truth)
    exploring = explores(parts["navigator"], parts["mapper"])
    goal = None if exploring else scene.goal
    recorder: Recorder = _recorder(files, scenario, scene, car, chosen, seed, goal, live) if files and record else NullRecorder()
    if not isinstance(recorder, NullRecorder) and not isinstance(parts["mapper"], NoMapper):
        recorder = MapWatch(recorder, scene, car.robot)
    started = wall.perf_counter()
    episode = navigate(
        car,
        parts["estimator"],
        parts["mapper"],
        parts["navigator"],
        recorder,
        OdometryEstimator(context("odometry", {})),
        goal,
        _rules(scenario, EXPLORATION_TIME if exploring and patient else 1.0),
        progress,
    )
    wall_time = wall.perf_counter() - started  # of the loop: building the world does not count
    result = _result(episode, scenario, scene, car, chosen, seed, goal, wall_time)
    if chosen["estimator"] != "truth":
        result.metrics.update(_localization(episode, result))
    result.metrics.update(map_metrics(parts["mapper"], scene, car.robot, result.truth.poses, exploring))
    if scene.movers:
        result.metrics.update(_mover_metrics(episode, scene, car, result))
    recorder.close(result.summary())
    if files is not None:
        result = _file(files, result, parts["mapper"])
    return result


def simulate(
    scenario: str | Path | Mapping[str, Any] | Scenario, *, seed: int = 0, settings: Mapping[str, Any] | None = None
) -> Simulation:
    """The physics of a scenario without a navigator: for serial ports, learning environments and experiments of one's own."""
    scenario_settings, parameters = split_overrides(settings or {})
    for kind, given in parameters.items():
        if given:
            raise ScenarioError(f"--set {kind}.{next(iter(given))}: there is no {kind} here")
    return simulation_of(Scene.load(load_scenario(scenario, scenario_settings), footprint()), seed)


def simulation_of(scene: Scene, seed: int) -> Simulation:
    """The physics of a scene."""
    robot = scene.scenario.robot
    return Simulation(
        scene.world(),
        start=scene.start,
        seed=seed,
        fit_out=FitOut(robot.sonars, robot.lidar, robot.compass, robot.camera, robot.top_camera, robot.camera_pan),
        sensors=robot.sensors,
        physics=robot.physics,
        clearance=scene.clearance,
        movers=[MovingObstacle(mover, stream(seed, f"mover/{mover.name}"), scene.clearance) for mover in scene.movers],
    )


def _rules(scenario: Scenario, patience: float) -> Rules:
    return Rules(
        time_limit=scenario.time_limit * patience,
        end_on_contact=scenario.on_contact == "end",
        success_radius=scenario.success_radius,
        movement_radius=scenario.progress.required_movement_radius,
        movement_angle=scenario.progress.required_movement_angle,
        movement_time=scenario.progress.movement_time_allowance,
        kidnaps=tuple(sorted(((e.time, SE2(*e.kidnap)) for e in scenario.events), key=lambda event: event[0])),
    )


def _recorder(
    files: RunDirectory,
    scenario: Scenario,
    scene: Scene,
    car: Simulation,
    chosen: Mapping[str, str],
    seed: int,
    goal: Goal | None,
    live: bool,
) -> Recorder:
    from robocar.recording import RerunRecorder  # takes most of a second to import

    scenery = Scenery(
        truth=scene.enclosed,
        prior=scene.prior,
        robot=car.robot,
        goal=goal,
        landmarks=scene.landmarks,
        solids=scene.solids,
        movers={mover.name: _shape(mover) for mover in scene.movers},
        wall_height=scenario.wall_height,
    )
    properties = {"scenario": scenario.name, **chosen, "seed": seed}
    return RerunRecorder(files.path / "run.rrd", run_id=files.name, scenery=scenery, live=live, properties=properties)


def _shape(mover: Mover) -> Solid:
    """A mover's body in its own frame."""
    if mover.shape == "box":
        return Box((mover.size[0], mover.size[1], mover.size[2]))
    return Cylinder(mover.radius, mover.height)


def _result(
    episode: Episode,
    scenario: Scenario,
    scene: Scene,
    car: Simulation,
    chosen: Mapping[str, str],
    seed: int,
    goal: Goal | None,
    wall_time: float,
) -> RunResult:
    ticks = episode.ticks
    times = np.array([tick.truth.time for tick in ticks])

    def poses(of: Callable[[Any], SE2]) -> Array:
        return np.array([of(tick).as_array() for tick in ticks]).reshape(-1, 3)

    truth = poses(lambda tick: tick.truth.pose)
    estimate = poses(lambda tick: tick.belief.pose)
    odometry = poses(lambda tick: tick.odometry)
    log = RunLog(
        time=times,
        truth_poses=truth,
        truth_twists=np.array([(t.truth.twist.v, t.truth.twist.omega) for t in ticks]).reshape(-1, 2),
        estimate_poses=estimate,
        odometry_poses=odometry,
        clearance=np.array([tick.truth.clearance for tick in ticks]),
        contact=np.array([tick.truth.contact for tick in ticks], dtype=bool),
        standing=np.array([tick.standing for tick in ticks], dtype=bool),
        plan_time=np.array([tick.plan_time for tick in ticks]),
        carried=np.array([tick.carried for tick in ticks], dtype=bool),
        replans=episode.replans,
        status=episode.status,
        grid=scene.true_grid,
        discs=scene.only_discs,
        footprint=car.robot.footprint,
        start=scene.start,
        goal=goal,
        wall_time=wall_time,
    )
    return RunResult(
        scenario=scenario.name,
        navigator=chosen["navigator"],
        estimator=chosen["estimator"],
        mapper=chosen["mapper"],
        seed=seed,
        status=episode.status,
        reason=episode.reason,
        metrics=summarize(log),
        hash=car.hash,
        truth=Trajectory(frozen_array(times), frozen_array(truth)),
        estimate=Trajectory(frozen_array(times), frozen_array(estimate)),
        odometry=Trajectory(frozen_array(times), frozen_array(odometry)),
        traceback=episode.traceback,
    )


def _localization(episode: Episode, result: RunResult) -> dict[str, Metric]:
    nothing = np.full((3, 3), np.nan)
    stated = [nothing if tick.belief.covariance is None else tick.belief.covariance for tick in episode.ticks]
    carried = [tick.carried for tick in episode.ticks]
    return summarize_localization(
        result.truth.times, result.truth.poses, result.estimate.poses, np.array(stated).reshape(-1, 3, 3), carried
    )


def _mover_metrics(episode: Episode, scene: Scene, car: Simulation, result: RunResult) -> dict[str, Metric]:
    truths = [tick.truth for tick in episode.ticks]
    tracks = {
        mover.name: Track(
            Shape(mover.outline(SE2()), mover.radius),
            np.array([truth.movers[mover.name].as_array() for truth in truths]).reshape(-1, 3),
            np.array([truth.mover_velocities[mover.name] for truth in truths]).reshape(-1, 3),
        )
        for mover in scene.movers
    }
    twists = [(truth.twist.v, truth.twist.omega) for truth in truths]
    return summarize_movers(car.robot.footprint, result.truth.poses, twists, tracks)


def _file(files: RunDirectory, result: RunResult, mapper: Mapper) -> RunResult:
    """Writes the files of a finished run and returns the result that knows where they are."""
    for name in ("truth", "estimate", "odometry"):
        trajectory: Trajectory = getattr(result, name)
        write_tum(files.path / f"{name}.tum", trajectory.times, trajectory.poses)
    grid = mapper.grid()
    if grid is not None:
        save_ros_map(decided(grid), files.path / "map")
    if result.traceback:
        (files.path / "error.txt").write_text(result.traceback)
    (files.path / "metrics.json").write_text(json.dumps(result.summary(), indent=1) + "\n")
    directory = files.complete()
    return RunResult(
        **{name: getattr(result, name) for name in RunResult.__dataclass_fields__ if name != "directory"}, directory=directory
    )
