"""Pose estimator and mapper as one estimator. Oracles: the frames' definition (REP-105), and identity."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from robocar.core import SE2, STOP, Belief, Context, Detection, Landmark, Observation, OccupancyGrid, Reading, State, WheelAngles
from robocar.core.compiling import trial_robot
from robocar.core.truth import GroundTruth
from robocar.episode.registry import build, capabilities, names
from robocar.estimation.cascade import Cascade
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_model import RobotModel

BALL = Landmark("red", "red", np.array([2.0, 0.5, 0.4]), 0.1)
START = SE2(0.5, 0.2, 0.3)
SMOOTH = {"truth", "odometry", "odometry-compass"}


def context() -> Context:
    robot = RobotModel.load().describe(FitOut(compass=True, camera=True, top_camera=True))
    truth = GroundTruth(0.0, START)
    return Context(robot, None, START, (BALL,), {}, np.random.default_rng(0), 0.05, oracle=lambda: truth)


def drive(estimator: Cascade, ticks: int = 40) -> list[State]:
    """Along an arc; the ball is seen somewhat off every fifth tick."""
    states = []
    for k in range(ticks):
        seen = (Detection(0.05 * k, "red", 0.1, 1.5, np.diag([1e-4, 1e-3])),) if k % 5 == 4 else ()
        wheels = Reading(0.05 * k, WheelAngles(0.3 * k, 0.34 * k))
        compass = Reading(0.05 * k, START.theta + 0.01 * k)
        states.append(estimator.update(Observation(0.05 * k, wheel_angles=wheels, compass=compass, landmarks=seen), STOP))
    return states


@pytest.mark.parametrize("name", sorted(names("estimator")))
def test_map_from_odom_jumps_where_the_estimator_corrects_itself_and_odom_never(name: str) -> None:
    """REP-105: the pose is map_from_odom @ odom_from_robot; in `odom` no step is longer than the wheels have rolled."""
    states = drive(Cascade(build("estimator", name, context())))
    odom = [state.odom_from_robot for state in states]
    for state in states:
        pose = state.map_from_odom @ state.odom_from_robot
        assert pose.distance_to(state.belief.pose) < 1e-9
        assert math.remainder(pose.theta - state.belief.pose.theta, math.tau) == pytest.approx(0.0, abs=1e-9)
    if name in SMOOTH:
        assert all(state.map_from_odom == SE2() for state in states)  # exactly, not computed
        assert all(state.odom_from_robot is state.belief.pose for state in states)
    else:
        assert max(a.distance_to(b) for a, b in pairwise(odom)) < 0.042 * 0.34 + 1e-6
    if name in ("ekf", "particle-filter"):
        jumps = [a.map_from_odom.distance_to(b.map_from_odom) for a, b in pairwise(states)]
        assert max(jumps) > 1e-5


def test_only_the_oracle_declares_that_it_wants_the_truth() -> None:
    assert capabilities("estimator", "truth").oracle
    assert not any(capabilities("estimator", name).oracle for name in names("estimator") if name != "truth")


class Columns:
    """A mapper that counts its updates."""

    def __init__(self) -> None:
        self.beliefs: list[Belief] = []

    def update(self, belief: Belief, observation: Observation) -> None:
        self.beliefs.append(belief)

    def grid(self) -> OccupancyGrid | None:
        return OccupancyGrid(np.zeros((1, len(self.beliefs)), dtype=np.int8), 1.0) if self.beliefs else None


def test_the_mapper_draws_from_the_belief_of_the_same_tick() -> None:
    mapper = Columns()
    states = drive(Cascade(build("estimator", "odometry", context()), mapper, complete=True), 3)
    assert mapper.beliefs == [state.belief for state in states]
    view = states[-1].map
    assert view is not None
    assert (view.revision, view.complete) == (0, True)
    drawn = view.grid()
    assert drawn is not None
    assert drawn.shape == (1, 3)


def test_without_a_mapper_there_is_no_map() -> None:
    assert all(state.map is None for state in drive(Cascade(build("estimator", "odometry", context())), 2))
    assert build("mapper", "none", context()) is None


@pytest.mark.parametrize("laser", [True, False])
def test_the_robot_that_throwaways_drive_looks_all_round(laser: bool) -> None:
    robot = trial_robot(laser)
    assert (robot.lidar is not None) == laser
    assert bool(robot.sonars) != laser
