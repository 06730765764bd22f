"""Two Robocars side by side, each with its own estimator, navigator and goal, in one world. Oracles: geometry, and the hash."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robocar.core import SE2, Goal
from robocar.episode.assembly import Assembly
from robocar.episode.checked import CheckedEstimator, CheckedNavigator
from robocar.episode.judge import Judge, Rules
from robocar.episode.loop import Agent, navigate
from robocar.episode.spec import RunSpec
from robocar.recording import NullRecorder
from robocar.scenario.scene import Scene
from robocar.sim.robot_handle import RobotHandle, RobotSetup
from robocar.sim.world import World

PARTS: dict[str, dict[str, Any]] = {
    "ann": {"navigator": "a-star", "estimator": "odometry", "settings": {"navigator.controller.desired_linear_vel": 0.2}},
    "bob": {"navigator": "a-star-dwa", "estimator": "truth", "settings": {}},
}
STARTS = {"ann": SE2(1.0, 1.0, 0.0), "bob": SE2(1.0, 1.6, 0.0)}
GOALS = {"ann": Goal(np.array([2.6, 1.0])), "bob": Goal(np.array([2.6, 1.6]))}


@pytest.fixture(scope="module", name="room")
def _room(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """4 x 2.6 m, empty."""
    path = tmp_path_factory.mktemp("room") / "room.txt"
    path.write_text("\n".join(["." * 40] * 26) + "\n")
    return {"name": "side by side", "map": str(path), "resolution": 0.1, "start": [1.0, 1.0, 0.0]}


def run(room: dict[str, Any], seed: int) -> tuple[World, dict[str, Agent]]:
    """Until both have arrived."""
    specs = {name: RunSpec.of(room, seed=seed, **parts) for name, parts in PARTS.items()}
    scene = Scene.load(specs["ann"].scenario, specs["ann"].scenario.robot_model().footprint)
    world = World(
        scene.world(), [RobotSetup(start, name) for name, start in STARTS.items()], seed=seed, clearance=scene.clearance
    )

    def agent(name: str, robot: RobotHandle) -> Agent:
        assembly = Assembly(
            specs[name], robot.robot, scene.prior, STARTS[name], (), world.control_period, lambda: world.ground_truth(robot)
        )
        judge = Judge(Rules(time_limit=30.0), GOALS[name], world, robot)
        parts = CheckedEstimator(assembly.estimator()), CheckedNavigator(assembly.navigator())
        return Agent(robot, *parts, GOALS[name], judge, assembly.odometry(), NullRecorder())

    agents = {name: agent(name, robot) for name, robot in world.robots.items()}
    navigate(world, list(agents.values()))
    return world, agents


def test_each_drives_to_its_own_goal_under_one_hash(room: dict[str, Any]) -> None:
    """Both arrive without contact, the faster one first; it stands from then on. Equal seeds alone give equal hashes."""
    world, agents = run(room, 3)
    assert {name: agent.judge.status for name, agent in agents.items()} == {"ann": "success", "bob": "success"}
    ends = {name: agent.judge.ticks[-1].truth for name, agent in agents.items()}
    assert ends["bob"].time < ends["ann"].time
    for name, truth in ends.items():
        assert truth.pose.distance_to(SE2(*GOALS[name].position)) < 0.25
        assert not any(tick.truth.contact for tick in agents[name].judge.ticks)
    left = world.ground_truth(world.robots["bob"])
    assert left.twist.v == pytest.approx(0.0, abs=0.01)
    assert left.pose.distance_to(ends["bob"].pose) < 0.05
    assert run(room, 3)[0].hash == world.hash
    assert run(room, 4)[0].hash != world.hash
