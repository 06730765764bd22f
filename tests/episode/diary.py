"""A robot, its world, its parts and a recorder that keep a diary: for tests of the loop and its judge."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robocar.core import (
    SE2,
    STOP,
    Belief,
    Command,
    Drive,
    Goal,
    Observation,
    State,
    Twist,
)
from robocar.core.truth import GroundTruth
from robocar.episode.checked import CheckedEstimator, CheckedNavigator
from robocar.episode.judge import Judge, Rules
from robocar.episode.loop import Agent, navigate
from robocar.estimation.cascade import Cascade
from robocar.recording import NullRecorder

DT = 0.1
GO = Drive(Twist(0.5))


@dataclass
class Car:
    """A robot and its world at once. Moves exactly as told; contact, trouble and a busy firmware come by the clock."""

    contact_from: float = math.inf
    trouble_from: float = math.inf
    busy_until: float = -1.0
    pushed: Twist = Twist()
    mover_until: float = -1.0
    diary: list[Any] = field(default_factory=list)
    pose: SE2 = SE2()
    twist: Twist = Twist()
    ticks: int = 0
    told: Command = STOP

    @property
    def time(self) -> float:
        return self.ticks * DT

    @property
    def busy(self) -> bool:
        return self.time < self.busy_until

    def sense(self) -> Observation:
        self.diary.append("sense")
        return Observation(self.time)

    def act(self, command: Command) -> None:
        self.diary.append(("act", command))
        self.told = command

    def step(self) -> None:
        self.diary.append("step")
        self.twist = self.told.twist if isinstance(self.told, Drive) else self.twist
        self.pose = self.pose @ self.twist.step(DT)
        self.ticks += 1

    def ground_truth(self, robot: Any) -> GroundTruth:
        touching = self.time >= self.contact_from - 1e-9
        # A wall stops the car at once; a mover pushes it.
        movers = {} if self.mover_until < 0 else {"cart": SE2(2.0, 0.0)}
        return GroundTruth(self.time, self.pose, self.pushed if touching else self.twist, movers=movers, contact=touching)

    def diverged(self) -> str | None:
        return "the state is not finite" if self.time >= self.trouble_from - 1e-9 else None

    def kidnap(self, pose: SE2) -> None:
        self.diary.append(("kidnap", self.time, pose))
        self.pose = pose

    def mover_at(self, point: np.ndarray, robot: Any) -> str | None:
        return "cart" if self.time < self.mover_until else None


@dataclass
class Parts:
    """Estimator, mapper, navigator and odometry at once."""

    car: Car
    answer: Callable[[int], Any] = lambda tick: GO
    lie: SE2 | None = None
    heard: list[Command] = field(default_factory=list)
    tick: int = -1

    def command(self, state: State, observation: Observation, goal: Goal | None) -> Any:
        self.car.diary.append("navigator")
        self.tick += 1
        return self.answer(self.tick)


class Estimator(Parts):
    def update(self, observation: Observation, command: Command) -> Belief:
        self.car.diary.append("estimator")
        self.heard.append(command)
        return Belief(self.lie or self.car.pose)


class Mapper(Parts):
    def update(self, belief: Belief, observation: Observation) -> None:
        self.car.diary.append("mapper")

    def grid(self) -> None:
        return None


class Odometry(Parts):
    def update(self, observation: Observation, command: Command) -> Belief:
        return Belief(SE2(-1.0, 0.0, 0.0))


class Diary(NullRecorder):
    def __init__(self, car: Car, error: Exception | None = None) -> None:
        self.car, self.error, self.rows = car, error, []

    def log(self, observation, state, command, truth, *, odometry=None, planning_time=None, signals=None) -> None:
        self.car.diary.append("recorder")
        self.rows.append((truth.time, command, odometry))
        if self.error is not None:
            raise self.error


def drive(
    car: Car | None = None,
    answer: Callable[[int], Any] = lambda tick: GO,
    goal: Goal | None = None,
    lie: SE2 | None = None,
    recorder: Any = None,
    progress: Any = None,
    measure: Any = None,
    **rules: Any,
) -> tuple[Judge, Car, Estimator, Diary]:
    car = car or Car()
    estimator = Estimator(car, lie=lie)
    recorder = recorder or Diary(car)
    judge = Judge(Rules(**({"time_limit": 2.0} | rules)), goal, car, car, measure)
    cascade = CheckedEstimator(Cascade(estimator, Mapper(car)))
    agent = Agent(car, cascade, CheckedNavigator(Parts(car, answer)), goal, judge, Odometry(car), recorder)
    navigate(car, [agent], progress)
    return judge, car, estimator, recorder


class Two:
    """A world of two robots."""

    def __init__(self, *cars: Car) -> None:
        self.cars = cars

    def step(self) -> None:
        for car in self.cars:
            car.step()

    def ground_truth(self, robot: Car) -> GroundTruth:
        return robot.ground_truth(robot)

    def diverged(self) -> str | None:
        return None

    def mover_at(self, point: np.ndarray, robot: Car) -> str | None:
        return None


def goal(x: float, y: float = 0.0) -> Goal:
    return Goal(np.array([x, y]))
