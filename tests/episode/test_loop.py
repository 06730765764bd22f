"""The loop and its judge; car, parts and recorder keep a diary. Oracle: the design, sections 6 and 7, tick by tick."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Iterator
from types import SimpleNamespace
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
    Hold,
    Observation,
    OutputError,
    Points,
    Scalar,
    Serial,
    State,
    Text,
    Twist,
)
from robocar.core.trace import LazyTrace
from robocar.core.work import total
from robocar.episode.checked import CheckedEstimator, CheckedNavigator, checked, checked_state
from robocar.episode.judge import Judge, Rules
from robocar.episode.loop import Agent, navigate
from robocar.estimation.cascade import Cascade
from robocar.recording import NullRecorder
from tests.episode.diary import GO, Car, Diary, Estimator, Odometry, Parts, Two, drive, goal


class TestLoop:
    def test_is_the_block_diagram(self) -> None:
        episode, car, estimator, recorder = drive(time_limit=0.2)
        tick = ["sense", "estimator", "mapper", "navigator", "recorder"]
        # When the run is over the robot is told to stand, and the world does not go on.
        assert car.diary == [*tick, ("act", GO), "step", *tick, ("act", GO), "step", *tick, ("act", STOP)]
        assert estimator.heard == [STOP, GO, GO]  # the last command that was executed
        assert [row[0] for row in recorder.rows] == pytest.approx([0.0, 0.1, 0.2])
        assert {row[2] for row in recorder.rows} == {SE2(-1.0, 0.0, 0.0)}
        assert [tick.truth.pose.x for tick in episode.ticks] == pytest.approx([0.0, 0.05, 0.10])

    def test_progress_is_told_after_every_tick(self) -> None:
        told: list[tuple[float, float]] = []
        drive(time_limit=0.3, progress=lambda time, limit: told.append((time, limit)))
        assert np.array(told) == pytest.approx(np.array([(0.0, 0.3), (0.1, 0.3), (0.2, 0.3), (0.3, 0.3)]))

    def test_what_a_command_took_is_kept_and_traces_are_not_looked_at(self) -> None:
        def never() -> Scalar:
            raise AssertionError("nobody records, so nobody looks")

        def answer(tick: int) -> Command:
            work = {"replans": 1, "expansions": 10 * tick} if tick in (2, 4) else {}
            return Drive(Twist(0.5), trace=LazyTrace({"replans": never}), work=work)

        efforts = drive(answer=answer, time_limit=0.9)[0].efforts
        assert [effort.time for effort in efforts] == pytest.approx([0.2, 0.4])
        assert total(*(effort.work for effort in efforts)) == {"replans": 2, "expansions": 60}

    def test_each_robot_has_its_own_end_and_stays_in_the_world(self) -> None:
        """Two in one world: the first arrives after 0.9 s and is told to stand from then on, the second goes on."""
        first, second = Car(), Car()
        world = Two(first, second)
        agents = []
        for car, reach in ((first, 0.5), (second, 0.75)):
            judge = Judge(Rules(time_limit=2.0), goal(reach), world, car)
            parts = CheckedEstimator(Cascade(Estimator(car))), CheckedNavigator(Parts(car))
            agents.append(Agent(car, *parts, judge.goal, judge, Odometry(car), NullRecorder()))
        navigate(world, agents)
        assert [agent.judge.status for agent in agents] == ["success", "success"]
        assert [agent.judge.ticks[-1].truth.time for agent in agents] == pytest.approx([0.9, 1.3])
        assert first.ticks == second.ticks == 13
        assert first.told == STOP
        assert first.pose.x == pytest.approx(0.45)

    def test_a_recording_that_cannot_be_written_is_the_callers(self) -> None:
        car = Car()
        with pytest.raises(OutputError, match="disk"):
            drive(car, recorder=Diary(car, OutputError("the disk is full")))

    def test_any_other_fault_of_a_part_ends_the_run_with_its_traceback(self) -> None:
        car = Car()
        episode = drive(car, recorder=Diary(car, ValueError("cannot draw")))[0]
        assert episode.status == "error"
        assert episode.reason.startswith("ValueError: cannot draw (tests/episode/")  # and the line
        assert "cannot draw" in episode.traceback
        assert episode.ticks == []


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

    @pytest.mark.parametrize(
        "state",
        [None, SE2(), Belief(SE2()), State.of(Belief(SE2(), trace=None)), State.of(Belief(SE2()), 42)],  # type: ignore[arg-type]
    )
    def test_bad_states(self, state: Any) -> None:
        with pytest.raises(TypeError, match=r"the estimator|the state's map"):
            checked_state(state)

    @pytest.mark.parametrize("belief", [None, SE2(), State.of(Belief(SE2()))])
    def test_bad_beliefs(self, belief: Any) -> None:
        with pytest.raises(TypeError, match="the estimator must return a belief"):
            Cascade(SimpleNamespace(update=lambda observation, command: belief)).update(Observation(0.0), STOP)

    @pytest.mark.parametrize("work", [None, {"expansions": -1}, {"expansions": 0.5}, {1: 1}])
    def test_bad_work(self, work: Any) -> None:
        with pytest.raises(TypeError, match="the navigator's work must map units to counts"):
            checked(Hold(work=work))
