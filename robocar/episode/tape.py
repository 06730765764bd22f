"""What can be replayed: runs of ours, and logs of others, as observations with what is known of the robot and its world."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robocar.core import (
    SE2,
    Array,
    Command,
    Hold,
    LogFormatError,
    Observation,
    OccupancyGrid,
    RangeSensor,
    Robot,
    Scan,
    wrap_angles,
)
from robocar.core.text import describe
from robocar.core.truth import GroundTruth
from robocar.episode.identity import digest, path_digest, scenario_digest
from robocar.formats import Trajectory
from robocar.formats.load_log import is_log, load_log, refuse_subject
from robocar.formats.log import Log
from robocar.reading import read_yaml
from robocar.scenario.model import Scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

_CONTROL_PERIOD = 0.1  # [s] of logs, which do not say


@dataclass(frozen=True, slots=True, eq=False)
class Tape:
    """What is replayed, and the circumstances that it was made in.

    Args:
        steps: observations, each with the command that followed.
        scene: the world, where it is known.
        seed, settings, estimator: of the run that it was.
        digest: of all that it holds, see `robocar.episode.identity`.
    """

    steps: tuple[tuple[Observation, Command], ...]
    robot: Robot
    log: Log
    prior: OccupancyGrid | None
    control_period: float
    scenario: Scenario
    scene: Scene | None = None
    seed: int = 0
    settings: Mapping[str, Any] | None = None
    estimator: str | None = None
    digest: str = ""

    @property
    def summary(self) -> str:
        """How long it is, what was repaired in the log, and which of its lines made no sense."""
        text = "; ".join([f"{len(self.steps)} observations of {self.log.path}", *self.log.notes])
        if self.log.skipped:
            first = "; ".join(self.log.skipped[:3])
            text += f", {len(self.log.skipped)} lines skipped ({first}{'; ...' if len(self.log.skipped) > 3 else ''})"
        return text

    def truth(self) -> list[GroundTruth | None]:
        """What is known of the truth at each step."""
        poses = truth_at(self.log.truth, [observation.time for observation, _ in self.steps])
        if poses is None:
            return [None] * len(self.steps)
        return [
            None if np.isnan(pose[0]) else GroundTruth(observation.time, SE2(*map(float, pose)))
            for (observation, _), pose in zip(self.steps, poses, strict=True)
        ]


def open_tape(source: Path, subject: int | None = None) -> Tape:
    """The log at a path, whatever its format.

    Args:
        subject: see `robocar.formats.load_log`.

    Raises:
        LogFormatError: nothing is there, or nothing that is known.
    """
    if os.path.isdir(source) and (source / "run.rrd").is_file():
        refuse_subject(source, subject)
        return _run_tape(source)
    if os.path.isdir(source) and not is_log(source):
        raise LogFormatError(f"{source}: neither a run directory (run.rrd) nor an MRCLAM data set (Barcodes.dat)")
    if os.path.isfile(source) and source.name == "run.rrd":
        refuse_subject(source, subject)
        return _run_tape(source.parent)
    return _log_tape(load_log(source, subject), subject)


def _log_tape(log: Log, subject: int | None) -> Tape:
    """A robot of which only its log is known: its size does not matter, it sees what the log holds."""
    model = RobotModel.load()
    robot = Robot(
        model.footprint,
        model.limits,
        model.calibration(),
        model.drive.pulses_per_turn,
        lidar=next((_laser(o.lidar) for o in log.observations if o.lidar is not None), None),
        camera=bool(log.landmarks),
    )
    name = log.path.stem or "log"
    if subject is not None:
        name = f"{name}-robot-{subject}"
    # Nothing but the name matters of it: where the run directory is named and described, a scenario is asked for.
    scenario = Scenario(name=name, description=f"{log.kind} log", map="none", prior="none", start=(0.0, 0.0, 0.0))
    steps = tuple((o, Hold()) for o in log.observations)
    return Tape(steps, robot, log, None, _CONTROL_PERIOD, scenario, digest=path_digest(log.path))


def _laser(scan: Scan) -> RangeSensor:
    """The scanner that took a scan."""
    return RangeSensor(
        scan.name or "laser", scan.robot_from_sensor, scan.bearings, scan.beam_width, 0.0, scan.max_range, _CONTROL_PERIOD
    )


def _run_tape(folder: Path) -> Tape:
    """A run of ours: its recording holds what was sensed, its `config.yaml` the world."""
    from robocar.recording import read_observations, read_trajectory

    config = read_yaml(folder / "config.yaml", LogFormatError)
    try:
        seed, settings, estimator = int(config["seed"]), dict(config["settings"]), str(config["estimator"])
        if config["navigator"] == "replay" and config["scenario"]["map"] == "none":
            raise LogFormatError(f"{folder}: the replay of a log holds no world; replay the log itself")
        place = {"folder": Path(config["folder"])} if "folder" in config else {}
        scenario = Scenario.model_validate(config["scenario"] | place)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise LogFormatError(f"{folder / 'config.yaml'}: not the configuration of a run: {describe(error)}") from error
    model = scenario.robot_model()
    robot = model.describe(scenario.robot.fit_out, scenario.robot.sensors)
    scene = Scene.load(scenario, model.footprint)
    times, poses = read_trajectory(folder / "run.rrd", "world/truth")
    steps = tuple(read_observations(folder / "run.rrd"))
    start = scene.start if scenario.start_known else None
    log = Log(folder, "run", tuple(o for o, _ in steps), scene.landmarks, Trajectory(times, poses), start)
    period = scenario.robot.physics.control_period
    made = {key: config.get(key) for key in ("navigator", "estimator", "mapper", "seed", "settings", "digest")}
    which = digest(scenario_digest(scenario), made, times, poses)
    return Tape(steps, robot, log, scene.prior, period, scenario, scene, seed, settings, estimator, which)


def truth_at(truth: Trajectory | None, times: list[float]) -> Array | None:
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
