"""How runs end. Oracles: the scenario's rules; the places of walls and goals; the true trajectory and its last pose."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from robocar.core import ScenarioError
from robocar.episode.judge import Judge, Rules
from robocar.episode.result import RunResult
from robocar.episode.run import run
from tests.episode.diary import Car
from tests.episode.runs import PARTS, SHORT, short


class TestEndings:
    """Each way in which a run may end, in physics."""

    def test_goal_reached(self, recorded: RunResult) -> None:
        assert recorded.success
        assert recorded.status == "success"
        assert "reached the goal" in recorded.reason

    def test_time_limit(self) -> None:
        result = run(short(time_limit=2), navigator="broken_parts:spin", estimator="truth")
        assert (result.status, result.reason) == ("timeout", "not there after 2 s")
        assert result.value("duration") == pytest.approx(2.0)
        assert result.value("spl") == 0.0

    def test_a_navigator_that_stands_still_is_stuck_and_one_that_turns_is_not(self) -> None:
        progress = {"movement_time_allowance": 3.0}
        still = run(short(progress=progress, time_limit=8), navigator="broken_parts:still", estimator="truth")
        assert still.status == "stuck"
        assert 3.0 <= (still.value("duration") or 0) <= 3.2
        spin = run(short(progress=progress, time_limit=8), navigator="broken_parts:spin", estimator="truth")
        assert spin.status == "timeout"

    @pytest.mark.parametrize("speed", [0.01, 0.3])
    def test_contact_ends_the_run(self, speed: float) -> None:
        """Analytic: nose at the wall x = 3.5 after the way in between, however slowly."""
        result = run(
            short(start=[3.36, 0.4, 0], time_limit=20),
            navigator="broken_parts:straight", estimator="truth", settings={"navigator.speed": speed},
        )  # fmt: skip
        assert result.status == "collision"
        assert re.fullmatch(r"contact at \(3\.4\d, 0\.40\), [\d.]+ s", result.reason)
        assert result.value("contacts") == 1
        assert result.value("contacts_standing") == 0
        assert result.value("min_clearance") == pytest.approx(0.0, abs=1e-3)

    def test_contacts_are_counted_where_the_scenario_says_continue(self) -> None:
        result = run(
            short(start=[3.3, 0.4, 0], time_limit=4, on_contact="continue"), navigator="broken_parts:straight", estimator="truth"
        )
        assert result.status == "timeout"
        assert result.value("contacts") >= 1  # type: ignore[operator]

    def test_a_mover_that_runs_into_the_parked_car_is_no_fault_of_the_car(self) -> None:
        cart = {"name": "cart", "box": [0.3, 0.3, 0.3], "waypoints": [[0.6, 1.25], [2.5, 1.25]], "speed": 0.3, "mass": 20.0}
        parked = short(start=[1.2, 1.25, 1.57], movers=[cart], time_limit=4)
        result = run(parked, navigator="broken_parts:still", estimator="truth")
        assert result.status == "timeout"
        assert result.value("contacts") == 0
        assert result.value("contacts_standing") >= 1  # type: ignore[operator]
        assert result.value("min_clearance") == 0.0
        moved = np.hypot(*(result.truth.poses[-1] - result.truth.poses[0])[:2])
        assert moved > 0.05  # it was pushed

    def test_done_and_give_up(self) -> None:
        done = run(short(goal=None), navigator="broken_parts:done", estimator="truth")
        assert (done.status, done.reason, done.success) == ("missed", "seen all; but this task has no measure", False)
        maze = run("maze", navigator="broken_parts:done", estimator="truth")  # the word of a navigator is no arrival
        assert (maze.status, maze.value("spl")) == ("missed", 0.0)
        stuck = run(SHORT, navigator="broken_parts:give_up", estimator="truth")
        assert (stuck.status, stuck.reason, stuck.success) == ("stuck", "walled in", False)

    def test_who_only_believes_to_be_there_has_missed(self) -> None:
        result = run(SHORT, navigator="broken_parts:still", estimator="broken_parts:at_goal")
        assert result.status == "missed"
        assert result.reason == f"believes to be at the goal but is {math.hypot(0.9, 0.1):.2f} m from it"

    def test_a_goal_with_a_heading_asks_for_it(self) -> None:
        """The pose at the end, by the tolerances' definition; without a heading the car arrives facing along its way."""
        free = run(SHORT, navigator="a-star", estimator="truth")
        turned = run(short(goal=[1.2, 0.4, 1.5708], yaw_goal_tolerance=0.2), navigator="a-star", estimator="truth")
        assert free.success
        assert turned.success
        assert abs(free.truth.poses[-1, 2] - math.pi / 2) > 0.5
        assert abs(turned.truth.poses[-1, 2] - math.pi / 2) <= 0.2
        assert math.dist(turned.truth.poses[-1, :2], (1.2, 0.4)) <= 0.10

    def test_kidnapping(self) -> None:
        """Where, when, unseen by odometry, and not part of the way."""
        spot = [2.8, 2.0, 1.0]
        kidnapped = short(time_limit=3, events=[{"time": 1.0, "kidnap": spot}])
        result = run(kidnapped, navigator="broken_parts:spin", estimator="odometry")
        steps = np.hypot(*np.diff(result.truth.poses[:, :2], axis=0).T)
        jump = int(np.argmax(steps))
        assert result.truth.times[jump + 1] == pytest.approx(1.05)
        assert result.truth.poses[jump + 1] == pytest.approx(spot, abs=0.05)
        assert np.sort(steps)[-2] < 0.02
        assert np.hypot(*np.diff(result.estimate.poses[:, :2], axis=0).T).max() < 0.02
        assert result.value("path_length") == pytest.approx(steps.sum() - steps[jump])
        assert result.value("position_rmse") > 1.0  # type: ignore[operator]

    def test_kidnapping_into_a_wall_is_refused(self) -> None:
        with pytest.raises(ScenarioError, match=r"kidnap at 1 s \(1\.8, 1\.8, 0\) lies in a wall"):
            run(short(events=[{"time": 1.0, "kidnap": [1.8, 1.8, 0]}]), **PARTS)


def test_rules_and_episode_are_plain_values() -> None:
    episode = Judge(Rules(), None, Car(), Car())
    assert not episode.done
    episode.end("timeout", "first")
    episode.end("stuck", "second")
    assert (episode.done, episode.status, episode.reason) == (True, "timeout", "first")  # the first end counts
