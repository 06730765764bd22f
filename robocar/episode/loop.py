"""The loop: sense, estimate, decide, act; then the world moves on.

Ground truth reaches the recorder and the judge only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from robocar.core import STOP, Command, Goal, MapView, OccupancyGrid
from robocar.core.work import total
from robocar.episode.body import Body, DeadReckoning, Physics
from robocar.episode.checked import CheckedEstimator, CheckedNavigator
from robocar.episode.interrupt import Interrupt
from robocar.episode.judge import Judge, Tick
from robocar.episode.map_watch import MapWatch
from robocar.episode.progress import RunProgress
from robocar.recording import Recorder


@dataclass(slots=True, eq=False)
class Agent:
    """A robot with what drives it, and who watches it.

    Args:
        goal: where it shall go, or None.
        estimator: says pose and map; `Assembly.estimator` makes it.
        odometry: dead reckoning beside the estimator.
        watch: says how good the map is so far; None where nobody wants to know.
        command: the last one that was executed; map: the last one that was drawn.
    """

    robot: Body
    estimator: CheckedEstimator
    navigator: CheckedNavigator
    goal: Goal | None
    judge: Judge
    odometry: DeadReckoning
    recorder: Recorder
    watch: MapWatch | None = None
    command: Command = STOP
    map: MapView | None = None

    def tick(self, world: Physics) -> None:
        """One control tick; the robot acts when the world moves on."""
        truth = world.ground_truth(self.robot)
        standing = self.judge.stands(self.command, truth)
        with self.judge.failures():
            observation = self.robot.sense()
            reckoned = self.odometry.update(observation, self.command).pose
            state = self.estimator.update(observation, self.command)
            command = self.navigator.command(state, observation, self.goal)
            self.recorder.log(
                observation,
                state,
                command,
                truth,
                odometry=reckoned,
                planning_time=self.navigator.seconds,
                signals=self.watch.look(truth, state.map) if self.watch is not None else {},
            )
            tick = Tick(truth, state.belief, reckoned, standing, self.navigator.seconds, self.judge.carried)
            self.judge.judge(tick, command, total(state.work, command.work), state.map)
            self.command, self.map = command, state.map
        self.robot.act(STOP if self.judge.done else self.command)

    def finish(self) -> OccupancyGrid | None:
        """See `Outcome.finish`."""
        return self.judge.finish(self.recorder, self.map)


def navigate(world: Physics, agents: Sequence[Agent], progress: RunProgress | None = None) -> None:
    """Runs until all agents are done; one that is done stands, and stays in the world as an obstacle.

    Errors of the parts end the episode, not the process; so does Ctrl-C.

    Raises:
        OutputError: a recording cannot be written.
    """
    try:
        with Interrupt() as interrupt:
            _loop(world, agents, interrupt, progress)
    except KeyboardInterrupt:
        _end(agents)


def _loop(world: Physics, agents: Sequence[Agent], interrupt: Interrupt, progress: RunProgress | None) -> None:
    while True:
        for agent in agents:
            if not agent.judge.done:
                agent.tick(world)
        if interrupt.asked:
            _end(agents)
        if progress is not None and (ticks := agents[0].judge.ticks):
            progress(ticks[-1].truth.time, agents[0].judge.rules.time_limit)
        if all(agent.judge.done for agent in agents):
            return
        for agent in agents:
            if not agent.judge.done:
                agent.judge.play_events(agent.judge.ticks[-1].truth.time)
        world.step()


def _end(agents: Sequence[Agent]) -> None:
    for agent in agents:
        agent.judge.end("interrupted", "stopped by the user")
