"""The loop and its judge; car, parts and recorder keep a diary. Oracle: the design, sections 6 and 7, tick by tick."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from robocar.core import (
    SE2,
    STOP,
    Belief,
    Command,
    Done,
    Drive,
    GiveUp,
    Goal,
    Hold,
    Observation,
    OutputError,
    Points,
    Scalar,
    Serial,
    Text,
    Twist,
)
from robocar.core.truth import GroundTruth
from robocar.episode.checked import checked, checked_belief
from robocar.episode.judge import Episode, Rules
from robocar.episode.loop import navigate
from robocar.recording import NullRecorder

DT = 0.1
GO = Drive(Twist(0.5))


@dataclass
class Car:
    """Moves exactly as told; contact, trouble and a busy firmware come by the clock."""

    contact_from: float = math.inf
    trouble_from: float = math.inf
    busy_until: float = -1.0
    pushed: Twist = Twist()
    mover_until: float = -1.0
    diary: list[Any] = field(default_factory=list)
    pose: SE2 = SE2()
    twist: Twist = Twist()
    ticks: int = 0

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
        self.twist = command.twist if isinstance(command, Drive) else self.twist
        self.pose = self.pose @ self.twist.step(DT)
        self.ticks += 1

    def ground_truth(self) -> GroundTruth:
        touching = self.time >= self.contact_from - 1e-9
        # A wall stops the car at once; a mover pushes it.
        movers = {} if self.mover_until < 0 else {"cart": SE2(2.0, 0.0)}
        return GroundTruth(self.time, self.pose, self.pushed if touching else self.twist, movers=movers, contact=touching)

    def diverged(self) -> str | None:
        return "the state is not finite" if self.time >= self.trouble_from - 1e-9 else None

    def kidnap(self, pose: SE2) -> None:
        self.diary.append(("kidnap", self.time, pose))
        self.pose = pose

    def mover_at(self, point: np.ndarray) -> str | None:
        return "cart" if self.time < self.mover_until else None


@dataclass
class Parts:
    """Estimator, mapper, navigator and odometry at once."""

    car: Car
    answer: Callable[[int], Any] = lambda tick: GO
    lie: SE2 | None = None
    heard: list[Command] = field(default_factory=list)
    tick: int = -1

    def reset(self, rng: np.random.Generator) -> None: ...

    def command(self, belief: Belief, mapper: Any, observation: Observation, goal: Goal | None) -> Any:
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

    def log(self, observation, belief, mapper, command, truth, *, odometry=None, planning_time=None) -> None:
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
    **rules: Any,
) -> tuple[Episode, Car, Estimator, Diary]:
    car = car or Car()
    estimator = Estimator(car, lie=lie)
    recorder = recorder or Diary(car)
    parts = (estimator, Mapper(car), Parts(car, answer), recorder, Odometry(car))
    episode = navigate(car, *parts, goal, Rules(**({"time_limit": 2.0} | rules)), progress)
    return episode, car, estimator, recorder


def goal(x: float, y: float = 0.0) -> Goal:
    return Goal(np.array([x, y]))


class TestLoop:
    def test_is_the_block_diagram(self) -> None:
        episode, car, estimator, recorder = drive(time_limit=0.2)
        tick = ["sense", "estimator", "mapper", "navigator", "recorder"]
        assert car.diary == [*tick, ("act", GO), *tick, ("act", GO), *tick]  # nobody acts when the run is over
        assert estimator.heard == [STOP, GO, GO]  # the last command that was executed
        assert [row[0] for row in recorder.rows] == pytest.approx([0.0, 0.1, 0.2])
        assert {row[2] for row in recorder.rows} == {SE2(-1.0, 0.0, 0.0)}
        assert [tick.truth.pose.x for tick in episode.ticks] == pytest.approx([0.0, 0.05, 0.10])

    def test_progress_is_told_after_every_tick(self) -> None:
        told: list[tuple[float, float]] = []
        drive(time_limit=0.3, progress=lambda time, limit: told.append((time, limit)))
        assert np.array(told) == pytest.approx(np.array([(0.0, 0.3), (0.1, 0.3), (0.2, 0.3), (0.3, 0.3)]))

    def test_replans_are_read_from_the_trace(self) -> None:
        def answer(tick: int) -> Command:
            return Drive(Twist(0.5), trace={"replans": Scalar(tick)} if tick in (2, 4) else {})

        assert drive(answer=answer, time_limit=0.9)[0].replans == 4

    def test_a_recording_that_cannot_be_written_is_the_callers(self) -> None:
        car = Car()
        with pytest.raises(OutputError, match="disk"):
            drive(car, recorder=Diary(car, OutputError("the disk is full")))

    def test_any_other_fault_of_a_part_ends_the_run_with_its_traceback(self) -> None:
        car = Car()
        episode = drive(car, recorder=Diary(car, ValueError("cannot draw")))[0]
        assert (episode.status, episode.reason) == ("error", "ValueError: cannot draw")
        assert "cannot draw" in episode.traceback
        assert episode.ticks == []


class TestJudge:
    def test_goal(self) -> None:
        """0.5 m/s, a tolerance of 0.10 m: at x = 0.90, after 1.8 s."""
        episode = drive(goal=goal(1.0))[0]
        assert episode.status == "success"
        assert episode.ticks[-1].truth.time == pytest.approx(1.8)

    def test_at_the_start(self) -> None:
        episode, car, _, _ = drive(goal=goal(0.05))
        assert (episode.status, len(episode.ticks), car.ticks) == ("success", 1, 0)

    @pytest.mark.parametrize(("believed", "status"), [(0.2, "success"), (0.3, "missed")])
    def test_belief_arrives_truth_decides(self, believed: float, status: str) -> None:
        """The car stands at 0 and believes to be at the goal; the goal's radius of success is 0.25 m."""
        episode = drive(goal=goal(believed), lie=SE2(believed), answer=lambda tick: STOP)[0]
        assert episode.status == status

    def test_contact(self) -> None:
        episode = drive(Car(contact_from=0.5), goal=goal(9.0))[0]
        assert (episode.status, episode.reason) == ("collision", "contact at (0.25, 0.00), 0.50 s")

    def test_contact_goes_before_the_goal(self) -> None:
        assert drive(Car(contact_from=0.5), goal=goal(0.34))[0].status == "collision"  # both at 0.25 m

    def test_contact_may_be_allowed(self) -> None:
        episode = drive(Car(contact_from=0.5), end_on_contact=False)[0]
        assert episode.status == "timeout"
        assert [tick.truth.contact for tick in episode.ticks] == [False] * 5 + [True] * 16

    @pytest.mark.parametrize("pushed", [Twist(), Twist(0.3)])
    def test_a_car_that_is_told_to_stand_collides_with_nobody(self, pushed: Twist) -> None:
        episode = drive(Car(contact_from=0.5, pushed=pushed), answer=lambda tick: STOP)[0]
        assert episode.status == "timeout"
        assert all(tick.standing for tick in episode.ticks)

    def test_a_car_that_still_rolls_does_not_stand(self) -> None:
        """It is told to stop at 0.5 s, and rolls into something in the same tick."""
        car = Car(contact_from=0.6, pushed=Twist(0.2))
        episode = drive(car, answer=lambda tick: GO if tick < 5 else STOP)[0]
        assert episode.status == "collision"

    def test_holding_goes_on_with_what_was_told(self) -> None:
        episode = drive(Car(contact_from=0.5), answer=lambda tick: Hold() if tick else GO)[0]
        assert episode.status == "collision"

    def test_a_serial_command_moves_while_the_firmware_is_busy(self) -> None:
        answer: Callable[[int], Command] = lambda tick: Hold() if tick else Serial("M1")  # noqa: E731
        assert drive(Car(contact_from=0.5, busy_until=1.0), answer)[0].status == "collision"
        assert drive(Car(contact_from=0.5, busy_until=0.3), answer)[0].status == "timeout"

    def test_physics_that_cannot_be_believed(self) -> None:
        episode = drive(Car(trouble_from=0.3, contact_from=0.3), goal=goal(0.25))[0]
        assert (episode.status, episode.reason) == ("diverged", "the state is not finite")

    def test_time_limit(self) -> None:
        episode = drive(time_limit=1.0)[0]
        assert (episode.status, episode.reason, len(episode.ticks)) == ("timeout", "not there after 1 s", 11)

    def test_done_and_give_up(self) -> None:
        assert drive(answer=lambda tick: Done("all seen"))[0].status == "success"
        assert drive(answer=lambda tick: GiveUp("a wall"))[0].status == "no_path"
        stuck = drive(answer=lambda tick: GiveUp("a corner", "stuck"))[0]
        assert (stuck.status, stuck.reason) == ("stuck", "a corner")

    @pytest.mark.parametrize(
        ("twist", "busy_until", "status"),
        [
            (Twist(), -1.0, "stuck"),
            (Twist(0.05), -1.0, "stuck"),  # 0.05 m in a second
            (Twist(0.15), -1.0, "timeout"),  # 0.15 m in a second
            (Twist(0.0, 0.2), -1.0, "stuck"),  # 0.2 rad in a second
            (Twist(0.0, 0.4), -1.0, "timeout"),
            (Twist(), 9.0, "timeout"),  # holding for a command in execution
        ],
    )
    def test_progress_is_0_1_m_or_0_3_rad_a_second(self, twist: Twist, busy_until: float, status: str) -> None:
        episode = drive(Car(busy_until=busy_until), answer=lambda tick: Drive(twist), time_limit=4.0, movement_time=1.0)[0]
        assert episode.status == status

    def test_stuck_as_soon_as_the_time_is_over(self) -> None:
        episode = drive(answer=lambda tick: STOP, time_limit=9.0, movement_time=1.0)[0]
        assert episode.ticks[-1].truth.time == pytest.approx(1.1)
        assert episode.reason == "no progress for 1 s at (0.00, 0.00)"

    def test_events_happen_between_ticks_each_once(self) -> None:
        first, second = SE2(5.0, 5.0, 1.0), SE2(-5.0, 0.0, 0.0)
        episode, car, _, _ = drive(answer=lambda tick: STOP, kidnaps=((0.25, first), (0.5, second)), time_limit=1.0)
        assert [entry for entry in car.diary if entry[0] == "kidnap"] == [
            ("kidnap", pytest.approx(0.3), first),
            ("kidnap", pytest.approx(0.5), second),
        ]
        assert [tick.carried for tick in episode.ticks] == [k in (4, 6) for k in range(11)]
        assert [tick.truth.pose for tick in episode.ticks] == [SE2()] * 4 + [first] * 2 + [second] * 5

    def test_being_carried_is_no_progress_but_starts_the_clock_anew(self) -> None:
        kidnaps = ((0.8, SE2(5.0, 5.0, 0.0)),)
        episode = drive(answer=lambda tick: STOP, kidnaps=kidnaps, time_limit=9.0, movement_time=1.0)[0]
        assert episode.status == "stuck"
        assert episode.ticks[-1].truth.time == pytest.approx(2.0)

    def test_while_a_mover_stands_on_the_goal_nobody_gives_up(self) -> None:
        """It leaves after 1 s: until 2 s later giving up and standing still are waiting, afterwards they are what they were."""

        def give_up(tick: int) -> GiveUp:
            return GiveUp("goal occupied")

        episode, car, *_ = drive(Car(mover_until=1.0), give_up, goal(5.0), time_limit=9.0)
        assert (episode.status, episode.reason) == ("no_path", "goal occupied")
        assert car.time == pytest.approx(2.9 + 0.1, abs=0.11)  # 0.9 s, when it is seen there for the last time, and 2 s
        episode, car, *_ = drive(Car(mover_until=9.0), give_up, goal(5.0))
        assert (episode.status, episode.reason) == ("timeout", "not there after 2 s: mover 'cart' stands on the goal")
        assert car.time == pytest.approx(2.0)
        idle = {"answer": lambda tick: STOP, "goal": goal(5.0), "movement_time": 0.5}
        episode, car, *_ = drive(Car(mover_until=1.0), time_limit=9.0, **idle)
        assert episode.status == "stuck"
        assert 2.8 < car.time < 4.0
        assert drive(Car(mover_until=9.0), **idle)[0].status == "timeout"
        # One that stands elsewhere changes nothing.
        episode, car, *_ = drive(Car(mover_until=0.0), give_up, goal(5.0))
        assert (episode.status, car.time) == ("no_path", 0.0)


class TestInterrupt:
    @pytest.fixture(autouse=True)
    def _default_handler(self) -> Iterator[None]:
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        yield
        signal.signal(signal.SIGINT, before)

    @staticmethod
    def press(tick: int, at: int, times: int = 1) -> Command:
        for _ in range(times if tick == at else 0):
            os.kill(os.getpid(), signal.SIGINT)
        return GO

    def test_ends_after_its_tick(self) -> None:
        episode, _, _, recorder = drive(answer=lambda tick: self.press(tick, 3))
        assert (episode.status, episode.reason) == ("interrupted", "stopped by the user")
        assert len(episode.ticks) == len(recorder.rows) == 4
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler

    def test_twice_breaks_off(self) -> None:
        episode, _, _, recorder = drive(answer=lambda tick: self.press(tick, 3, times=2))
        assert episode.status == "interrupted"
        assert len(episode.ticks) == len(recorder.rows) == 3
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler

    def test_who_handles_it_himself_keeps_his_say(self) -> None:
        pressed: list[int] = []
        signal.signal(signal.SIGINT, lambda number, frame: pressed.append(number))
        assert drive(answer=lambda tick: self.press(tick, 3))[0].status == "timeout"
        assert pressed == [signal.SIGINT]


class TestChecks:
    @pytest.mark.parametrize(
        "command",
        [
            GO,
            Hold(),
            Hold(pan=0.5),
            Serial("M2"),
            Done("x"),
            GiveUp("x"),
            Drive(Twist(), trace={"a": Scalar(np.float32(1)), "b": Text("x")}),
        ],
    )
    def test_good_commands_pass(self, command: Command) -> None:
        assert checked(command) is command

    @pytest.mark.parametrize(
        ("command", "error"),
        [
            (None, TypeError),
            (Twist(0.1), TypeError),
            ("M2", TypeError),
            (Drive(Twist(math.nan)), ValueError),
            (Drive(Twist(0.0, -math.inf)), ValueError),
            (Hold(pan=math.nan), ValueError),
            (Serial(2), TypeError),  # type: ignore[arg-type]
            (Done(3), TypeError),  # type: ignore[arg-type]
            (Hold(trace=[Points(np.zeros((1, 2)))]), TypeError),  # type: ignore[arg-type]
            (Hold(trace={1: Text("x")}), TypeError),  # type: ignore[dict-item]
            (Hold(trace={"a": 1.0}), TypeError),  # type: ignore[dict-item]
            (Hold(trace={"a": Scalar(None)}), TypeError),  # type: ignore[arg-type]
        ],
    )
    def test_bad_commands(self, command: Any, error: type[Exception]) -> None:
        with pytest.raises(error, match="the navigator"):
            checked(command)

    @pytest.mark.parametrize("belief", [None, SE2(), Belief((0, 0, 0)), Belief(SE2(), trace=None)])  # type: ignore[arg-type]
    def test_bad_beliefs(self, belief: Any) -> None:
        with pytest.raises(TypeError, match="the estimator"):
            checked_belief(belief)
