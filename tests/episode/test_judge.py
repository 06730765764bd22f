"""The judge; car, parts and recorder keep a diary. Oracle: the design, sections 6 and 7, tick by tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from robocar.core import (
    SE2,
    STOP,
    Command,
    Done,
    Drive,
    GiveUp,
    Hold,
    Serial,
    Twist,
)
from tests.episode.diary import GO, Car, drive, goal


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
        assert drive(answer=lambda tick: GiveUp("a wall", "no_path"))[0].status == "no_path"
        assert drive(answer=lambda tick: GiveUp("a wall"))[0].status == "stuck"
        stuck = drive(answer=lambda tick: GiveUp("a corner", "stuck"))[0]
        assert (stuck.status, stuck.reason) == ("stuck", "a corner")

    @pytest.mark.parametrize(("x", "status"), [(0.05, "success"), (0.2, "success"), (0.3, "missed"), (5.0, "missed")])
    def test_done_at_a_goal_is_what_the_truth_says(self, x: float, status: str) -> None:
        """The car stands at 0 and says so; the radius of success is 0.25 m."""
        assert drive(answer=lambda tick: Done("there"), goal=goal(x))[0].status == status

    def test_done_with_the_wrong_heading_is_missed(self) -> None:
        episode = drive(answer=lambda tick: Done("there"), goal=replace(goal(0.15), heading=1.0))[0]
        assert (episode.status, "1.00 rad off" in episode.reason) == ("missed", True)

    @pytest.mark.parametrize(("measured", "status"), [(True, "success"), (False, "missed")])
    def test_done_without_a_goal_is_what_the_measure_says(self, measured: bool, status: str) -> None:
        episode = drive(answer=lambda tick: Done("all seen"), measure=lambda start, view: (measured, f"{start.x:g} m"))[0]
        assert episode.status == status
        assert episode.reason in ("all seen; 0 m", "all seen; but 0 m")

    def test_done_of_a_task_that_nothing_measures_is_no_success(self) -> None:
        assert drive(answer=lambda tick: Done("all seen"))[0].status == "missed"

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
            return GiveUp("goal occupied", "no_path")

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
