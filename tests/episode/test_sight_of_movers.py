"""Who promises to keep off movers sees them, or says at the start that it cannot. Oracles: the fit-outs' geometry, contacts."""

from __future__ import annotations

import itertools
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robocar import run
from robocar.cli.listing import among_movers
from robocar.core import SE2, ParameterError, RangeSensor, Robot
from robocar.episode.algorithms import NAVIGATORS
from robocar.episode.assembly import check_sight_of_movers
from robocar.episode.registry import capabilities
from robocar.experiments.moving import SETS, encounter
from robocar.planners.tracking.moving_obstacles import unseen
from robocar.scenario.load import load_scenario
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_model import RobotModel
from tests.planners.kinematic import car

LONG = pytest.mark.skipif(not os.environ.get("ROBOCAR_LONG_TESTS"), reason="takes minutes: set ROBOCAR_LONG_TESTS=1")
AVOID = sorted(
    ["a-star-dwa", "a-star-mppi", "ocpb", "rrt-dwa", "safe-direction", "safe-direction-memory", "theta-star-dwa"]
)  # as README and docs/movers.md promise
FIT_OUTS = [
    *(FitOut(sonars=sonars, lidar=lidar) for sonars, lidar in itertools.product(
        ("none", "front", "front+sides", "ring"), ("none", "hokuyo", "scan360")
    )),
    FitOut(sonars="none", camera=True),
    FitOut(sonars="none", camera=True, top_camera=True, compass=True),
]  # fmt: skip


def test_those_that_promise_it_are_those_that_say_so() -> None:
    promise = [name for name in NAVIGATORS if capabilities("navigator", name).avoids_movers is not None]
    assert sorted(promise) == AVOID
    assert {name for name in NAVIGATORS if among_movers(name) == "avoids movers"} == set(AVOID)


@pytest.mark.parametrize("navigator", NAVIGATORS)
def test_with_every_fit_out_it_sees_movers_or_is_refused_or_promises_nothing(navigator: str) -> None:
    """A laser shows what moves, nothing else that can be fitted does; without movers nothing is asked for."""
    with_movers, without = load_scenario("warehouse-dynamic"), load_scenario("warehouse")
    refused = {}
    for fit_out in FIT_OUTS:
        robot = RobotModel.load().describe(fit_out)
        check_sight_of_movers(navigator, without, robot)
        try:
            check_sight_of_movers(navigator, with_movers, robot)
        except ParameterError as error:
            refused[fit_out] = str(error)
    assert list(refused) == ([fit_out for fit_out in FIT_OUTS if fit_out.lidar == "none"] if navigator in AVOID else [])
    says = f"navigator '{navigator}' would not see the 8 movers of 'warehouse-dynamic' move: .*fit robot.lidar: scan360 or hokuyo"
    assert all(re.match(says, message) for message in refused.values())


@pytest.mark.parametrize("sonars", ["ring", "none"])
@pytest.mark.parametrize("navigator", AVOID)
def test_a_run_that_cannot_see_its_movers_is_refused_at_the_start(navigator: str, sonars: str) -> None:
    with pytest.raises(ParameterError, match="would not see"):
        run("warehouse-dynamic", navigator=navigator, settings={"robot.lidar": "none", "robot.sonars": sonars})


def laser(opening: float, beams: int, max_range: float, turned: float = 0.0) -> Robot:
    bearings = np.linspace(-opening / 2, opening / 2, beams, endpoint=opening < math.tau)
    sensor = RangeSensor("laser", SE2(0.0, 0.0, turned), bearings, 0.0, 0.05, max_range, 0.1)
    return Robot(car().footprint, car().limits, car().calibration, 200, lidar=sensor)


@given(st.floats(0.2, math.tau), st.integers(2, 800), st.floats(0.3, 10.0), st.floats(-1.5, 1.5))
def test_a_laser_will_do_where_two_beams_end_on_what_comes_from_ahead(
    opening: float, beams: int, max_range: float, turned: float
) -> None:
    """Oracle: discs of 0.2 m at 1.5 m in all directions ahead, as seen by each beam by itself."""
    robot = laser(opening, beams, max_range, turned)
    assert robot.lidar is not None
    bearings = robot.lidar.bearings + turned
    half = math.asin(0.1 / 1.5)
    least = min(
        int((np.abs(np.remainder(bearings - at + math.pi, math.tau) - math.pi) <= half).sum())
        for at in np.linspace(-math.pi / 2, math.pi / 2, 181)
    )
    if unseen(robot) == "":
        assert least >= 1  # at the very edge of the sector half of it is out of sight
        assert max_range >= 1.5
    elif max_range >= 1.5:
        assert least < 3 or opening < math.pi + 2 * abs(turned) + 0.1


def crossing(folder: Path, seed: int) -> dict:
    """A mover that would meet the car at right angles at 0.2 m/s, in a room that leaves space on all sides."""
    found = encounter(folder, SETS[""], 0.2, 90, seed)
    assert found is not None
    return found


@pytest.mark.parametrize("navigator", AVOID)
def test_a_crossing_mover_is_not_touched(navigator: str, tmp_path: Path) -> None:
    result = run(crossing(tmp_path, 0), navigator=navigator, settings={"robot.lidar": "scan360", "robot.sonars": "none"})
    assert (result.status, result.value("contacts"), result.value("contacts_standing")) == ("success", 0, 0), result.reason


@LONG
@pytest.mark.parametrize("lidar", ["hokuyo", "scan360"])
@pytest.mark.parametrize("navigator", AVOID)
def test_three_crossing_movers_of_three_are_not_touched(navigator: str, lidar: str, tmp_path: Path) -> None:
    settings = {"robot.lidar": lidar, "robot.sonars": "none"}
    for seed in (1, 2, 3):
        scenario = crossing(tmp_path, seed)
        if (navigator, lidar) == ("ocpb", "hokuyo"):
            with pytest.raises(ParameterError, match="all round"):
                run(scenario, navigator=navigator, seed=seed, settings=settings)
            continue
        result = run(scenario, navigator=navigator, seed=seed, settings=settings)
        assert (result.status, result.value("contacts"), result.value("contacts_standing")) == ("success", 0, 0), result.reason
