"""From a scenario to a finished run: builds the world and the parts, runs the loop, judges and files the result."""

from __future__ import annotations

import time as wall
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from robocar.core import SE2, Array, Goal, OccupancyGrid, ScenarioError, frozen_array
from robocar.core.randomness import stream
from robocar.core.solids import Box, Cylinder, Solid
from robocar.core.work import total
from robocar.episode.assembly import Assembly
from robocar.episode.checked import CheckedEstimator, CheckedNavigator
from robocar.episode.exploration import Exploration
from robocar.episode.judge import Judge, Measure, Rules, Tick
from robocar.episode.loop import Agent, navigate
from robocar.episode.map_watch import MapWatch
from robocar.episode.progress import RunProgress
from robocar.episode.result import RunResult
from robocar.episode.run_directory import RunDirectory
from robocar.episode.spec import RunOptions, RunSpec
from robocar.formats import Trajectory
from robocar.metrics import DrawnMap, Eye, RunLog, Shape, Track, declared, summarize
from robocar.recording import NullRecorder, Scenery
from robocar.scenario.load import load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.scene import Scene
from robocar.scenario.settings import flat, split_overrides
from robocar.sim.movers import Mover, MovingObstacle
from robocar.sim.robot_handle import RobotHandle, RobotSetup
from robocar.sim.world import World

EXPLORATION_TIME = 4.0
"""Times the scenario's time limit, which is meant for the way to its goal, an exploration may take, unless one is set for it."""


def run(
    scenario: str | Path | Mapping[str, Any] | Scenario,
    *,
    out: str | Path | None = None,
    record: bool = True,
    live: bool = False,
    force: bool = False,
    progress: RunProgress | None = None,
    **options: Unpack[RunOptions],
) -> RunResult:
    """Run one episode.

    Args:
        scenario: a name from `models/scenarios`, a file, a mapping with the same keys, or a `Scenario`.
        out: the run directory is made in here; None writes no files.
        record: write `run.rrd` (with `out`); live: also show the run in a viewer while it goes on.
        force: replace an existing run.
        progress: told after every tick how far the run has got.
        options: navigator, estimator, mapper, seed and settings, see `robocar.episode.spec.RunOptions`.

    Raises:
        RobocarError: bad input or an output that cannot be written. What goes wrong during the run is in the result's status.
    """
    spec = RunSpec.of(scenario, **options)
    declared()  # metrics of a package that cannot be imported are an error before the run, not after it
    scene = Scene.load(spec.scenario, spec.scenario.robot_model().footprint)
    with ExitStack() as stack:
        files = stack.enter_context(RunDirectory(out, spec, force)) if out is not None else None
        world = world_of(scene, spec.seed)
        stack.callback(world.close)
        subject = _Subject(spec, scene, world, world.robot)
        agent = subject.agent()
        if files is not None and record:
            subject.record(agent, files, live)
        started = wall.perf_counter()
        navigate(world, [agent], progress)
        wall_time = wall.perf_counter() - started  # of the loop: building the world does not count
        grid = agent.finish()
        result = subject.result(agent, grid, wall_time)
        agent.recorder.close(result.summary())
        return result if files is None else files.file(result, grid)


def simulate(
    scenario: str | Path | Mapping[str, Any] | Scenario, *, seed: int = 0, settings: Mapping[str, Any] | None = None
) -> World:
    """The physics of a scenario without a navigator: for serial ports, learning environments and experiments of one's own.

    A control tick is `world.robot.sense()`, a decision, `world.robot.act(command)`, `world.step()`.
    """
    scenario_settings, parameters = split_overrides(flat(settings or {}))
    for kind, given in parameters.items():
        if given:
            raise ScenarioError(f"--set {kind}.{next(iter(given))}: there is no {kind} here")
    loaded = load_scenario(scenario, scenario_settings)
    return world_of(Scene.load(loaded, loaded.robot_model().footprint), seed)


def world_of(scene: Scene, seed: int) -> World:
    """The physics of a scene, with its robot."""
    section = scene.scenario.robot
    robot = RobotSetup(scene.start, model=scene.scenario.robot_model(), fit_out=section.fit_out, sensors=section.sensors)
    return World(
        scene.world(),
        [robot],
        seed=seed,
        physics=section.physics,
        clearance=scene.clearance,
        movers=[MovingObstacle(mover, stream(seed, f"mover/{mover.name}"), scene.clearance) for mover in scene.movers],
    )


class _Subject:
    """One robot of a run, before and after the loop: its parts become an `Agent`, which drives, and its log a `RunResult`."""

    def __init__(self, spec: RunSpec, scene: Scene, world: World, handle: RobotHandle) -> None:
        self.spec, self.scene, self.world, self.handle = spec, scene, world, handle
        start = scene.start if spec.scenario.start_known else None
        self.assembly = Assembly(
            spec, handle.robot, scene.prior, start, scene.landmarks, world.control_period, lambda: world.ground_truth(handle)
        )
        self.explores = self.assembly.explores
        self.goal: Goal | None = None if self.explores else scene.goal

    def agent(self) -> Agent:
        """The robot with all that drives and watches it; nothing is recorded yet."""
        patience = EXPLORATION_TIME if self.explores and "time_limit" not in self.spec.settings else 1.0
        return Agent(
            self.handle,
            CheckedEstimator(self.assembly.estimator()),
            CheckedNavigator(self.assembly.navigator()),
            None if self.goal is None else replace(self.goal),  # nobody moves the one that is judged
            Judge(_rules(self.spec.scenario, patience), self.goal, self.world, self.handle, self._measure()),
            self.assembly.odometry(),
            NullRecorder(),
        )

    def _measure(self) -> Measure | None:
        """Of a task without a goal."""
        radius = self.handle.robot.footprint.inscribed_radius
        return Exploration(lambda: self.scene.judged_map, radius) if self.explores else None

    def record(self, agent: Agent, files: RunDirectory, live: bool) -> None:
        """Has the run recorded, beginning with what stands in the world before anything happens."""
        scene = self.scene
        scenery = Scenery(
            truth=scene.enclosed,
            prior=scene.prior,
            robot=self.handle.robot,
            goal=self.goal,
            landmarks=scene.landmarks,
            solids=scene.solids,
            movers={mover.name: _shape(mover) for mover in scene.movers},
            wall_height=scene.scenario.wall_height,
        )
        agent.recorder = files.recorder(scenery, live, {"scenario": scene.scenario.name})
        if self.assembly.draws_map:
            agent.watch = MapWatch(scene.judged_map, self.handle.robot)

    def result(self, agent: Agent, grid: OccupancyGrid | None, wall_time: float) -> RunResult:
        """What the judge has seen, measured."""
        judge, ticks = agent.judge, agent.judge.ticks
        times = np.array([tick.truth.time for tick in ticks])
        truth = _poses(ticks, lambda tick: tick.truth.pose)
        estimate = _poses(ticks, lambda tick: tick.belief.pose)
        odometry = _poses(ticks, lambda tick: tick.odometry)
        log = RunLog(
            time=times,
            truth_poses=truth,
            estimate_poses=estimate,
            odometry_poses=odometry,
            status=judge.status,
            footprint=self.handle.robot.footprint,
            truth_twists=np.array([(t.truth.twist.v, t.truth.twist.omega) for t in ticks]).reshape(-1, 2),
            clearance=np.array([tick.truth.clearance for tick in ticks]),
            contact=np.array([tick.truth.contact for tick in ticks], dtype=bool),
            standing=np.array([tick.standing for tick in ticks], dtype=bool),
            plan_time=np.array([tick.plan_time for tick in ticks]),
            work=total(*(effort.work for effort in judge.efforts)),
            grid=self.scene.judged_map,
            start=self.scene.start,
            goal=self.goal,
            wall_time=wall_time,
            carried=np.array([tick.carried for tick in ticks], dtype=bool),
            discs=self.scene.only_discs,
            covariances=covariances_of([tick.belief.covariance for tick in ticks]),
            localized=not self.assembly.knows_truth,
            movers=self._tracks(ticks) if self.scene.movers else None,
            drawn=None if grid is None else DrawnMap(grid, self.scene.judged_map, Eye.of(self.handle.robot), self.explores),
        )
        return RunResult(
            scenario=self.spec.scenario.name,
            navigator=self.spec.navigator,
            estimator=self.spec.estimator,
            mapper=self.spec.mapper,
            seed=self.spec.seed,
            status=judge.status,
            reason=judge.reason,
            metrics=summarize(log),
            hash=self.world.hash,
            truth=Trajectory(frozen_array(times), frozen_array(truth)),
            estimate=Trajectory(frozen_array(times), frozen_array(estimate)),
            odometry=Trajectory(frozen_array(times), frozen_array(odometry)),
            efforts=tuple(judge.efforts),
            traceback=judge.traceback,
            notes=self.scene.notes,
            name=self.spec.label,
            settings=self.spec.settings,
        )

    def _tracks(self, ticks: list[Tick]) -> dict[str, Track]:
        truths = [tick.truth for tick in ticks]
        return {
            mover.name: Track(
                Shape(mover.outline(SE2()), mover.radius),
                np.array([truth.movers[mover.name].as_array() for truth in truths]).reshape(-1, 3),
                np.array([truth.mover_velocities[mover.name] for truth in truths]).reshape(-1, 3),
            )
            for mover in self.scene.movers
        }


def covariances_of(stated: list[Array | None]) -> Array:
    """(n, 3, 3), nan where none was stated."""
    nothing = np.full((3, 3), np.nan)
    return np.array([nothing if covariance is None else covariance for covariance in stated]).reshape(-1, 3, 3)


def _poses(ticks: list[Tick], of: Callable[[Tick], SE2]) -> Array:
    return np.array([of(tick).as_array() for tick in ticks]).reshape(-1, 3)


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


def _shape(mover: Mover) -> Solid:
    """A mover's body in its own frame."""
    if mover.shape == "box":
        return Box((mover.size[0], mover.size[1], mover.size[2]))
    return Cylinder(mover.radius, mover.height)
