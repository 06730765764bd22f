"""The loop: sense, estimate, map, decide, act.

Ground truth reaches the recorder and the judge only.
"""

from __future__ import annotations

import time as wall
import traceback

from robocar.core import STOP, Command, Estimator, Goal, Mapper, Navigator, OutputError
from robocar.episode.car import Car, DeadReckoning
from robocar.episode.checked import checked, checked_belief
from robocar.episode.interrupt import Interrupt
from robocar.episode.judge import Episode, Rules, Tick
from robocar.episode.progress import RunProgress
from robocar.recording import Recorder


def navigate(
    car: Car,
    estimator: Estimator,
    mapper: Mapper,
    navigator: Navigator,
    recorder: Recorder,
    odometry: DeadReckoning,
    goal: Goal | None,
    rules: Rules,
    progress: RunProgress | None = None,
) -> Episode:
    """Runs until the episode is over. Errors of the parts end the episode, not the process; so does Ctrl-C.

    Raises:
        OutputError: the recording cannot be written.
    """
    episode = Episode(rules, goal)
    try:
        with Interrupt() as interrupt:
            _loop(car, estimator, mapper, navigator, recorder, odometry, goal, episode, progress, interrupt)
    except KeyboardInterrupt:
        episode.end("interrupted", "stopped by the user")
    return episode


def _loop(
    car: Car,
    estimator: Estimator,
    mapper: Mapper,
    navigator: Navigator,
    recorder: Recorder,
    odometry: DeadReckoning,
    goal: Goal | None,
    episode: Episode,
    progress: RunProgress | None,
    interrupt: Interrupt,
) -> None:
    command: Command = STOP
    while not episode.done:
        observation = car.sense()
        truth = car.ground_truth()
        dead_reckoning = odometry.update(observation, command)
        standing = episode.stands(car, command, truth)
        try:
            belief = checked_belief(estimator.update(observation, command))
            mapper.update(belief, observation)
            started = wall.perf_counter()
            command = checked(navigator.command(belief, mapper, observation, goal))
            planning_time = wall.perf_counter() - started
            recorder.log(observation, belief, mapper, command, truth, odometry=dead_reckoning.pose, planning_time=planning_time)
        except OutputError:
            raise
        except (Exception, SystemExit) as error:  # also a mapper's grid or a trace that cannot be drawn
            episode.end("error", f"{type(error).__name__}: {error}")
            episode.traceback = traceback.format_exc()
            return
        episode.judge(car, Tick(truth, belief, dead_reckoning.pose, standing, planning_time, episode.carried), command)
        if interrupt.asked:
            episode.end("interrupted", "stopped by the user")
        if not episode.done:
            episode.play_events(car, truth.time)
            car.act(command)
        if progress is not None:
            progress(truth.time, episode.rules.time_limit)
