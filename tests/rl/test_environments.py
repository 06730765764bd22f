"""Learning environments.

Oracles: Gymnasium's `check_env`, dm_env's own test cases, the hash of the physics, the reward's formula.
"""

from __future__ import annotations

import math
import unittest
from typing import Any

import dm_env
import numpy as np
import pytest
from dm_env import test_utils

from robocar.core import Drive, ScenarioError, Twist
from robocar.episode.run import simulate
from robocar.rl.dm import RobocarEnv
from robocar.rl.task import DrivingTask, Reward

ROOM: dict[str, Any] = {
    "name": "room",
    "map": "maps/thesis_field.yaml",
    "start": [0.5, 1.2, 0],
    "goal": [1.0, 1.2],
    "time_limit": 4.0,
    "robot": {"sonars": "ring", "lidar": "scan360", "compass": True},
}
WALL = ROOM | {"start": [3.1, 1.2, 0], "goal": [0.5, 1.2]}
FORWARD = np.array([0.3, 0.0], dtype=np.float32)


class TestOfDmEnv(test_utils.EnvironmentTestMixin, unittest.TestCase):
    """dm_env's conformance tests."""

    def make_object_under_test(self) -> RobocarEnv:
        return RobocarEnv(ROOM | {"time_limit": 1.0})

    def make_action_sequence(self):
        rng, spec = np.random.default_rng(0), self.environment.action_spec()
        for _ in range(40):
            yield rng.uniform(spec.minimum, spec.maximum).astype(spec.dtype)


def test_gymnasium_finds_nothing_wrong(recwarn: pytest.WarningsRecorder) -> None:
    checker = pytest.importorskip("gymnasium.utils.env_checker", reason="the extra `rl` is not installed")
    from robocar.rl.gym import RobocarGymEnv

    env = RobocarGymEnv(ROOM)
    checker.check_env(env, skip_render_check=True)
    env.close()
    ours = [str(w.message) for w in recwarn if "gymnasium" in str(w.filename)]
    # Actions are metres per second and radians per second of this car, not shares of them.
    assert [text for text in ours if "symmetric and normalized" not in text] == []


def test_ids_are_registered() -> None:
    gymnasium = pytest.importorskip("gymnasium", reason="the extra `rl` is not installed")
    import robocar.rl.gym  # noqa: F401

    env = gymnasium.make("robocar/u-trap-v0", settings={"time_limit": 0.2})
    observation, info = env.reset(seed=4)
    assert info["seed"] == 4
    assert env.observation_space.contains(observation)
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(4)]
    assert ends == [(False, False)] * 3 + [(False, True)]  # out of time is no end of the task
    env.close()


def drive(task: DrivingTask, seed: int, actions: np.ndarray) -> tuple[list[dict], list[float], str]:
    seen, rewards = [task.reset(seed)], []
    for action in actions:
        outcome = task.step(action)
        seen.append(outcome.observation)
        rewards.append(outcome.reward)
    return seen, rewards, task.world.hash


def test_same_seed_same_trajectory_and_it_is_the_simulations() -> None:
    actions = np.random.default_rng(1).uniform([-0.1, -1.0], [0.3, 1.0], (30, 2))
    task = DrivingTask(ROOM)
    first, again, other = drive(task, 5, actions), drive(task, 5, actions), drive(task, 6, actions)
    assert first[1:] == again[1:]
    assert all(np.array_equal(a[name], b[name]) for a, b in zip(first[0], again[0], strict=True) for name in a)
    assert first[2] != other[2]
    world = simulate(ROOM, seed=5)
    low, high = task.low.astype(float), task.high.astype(float)
    for action in actions:
        world.robot.sense()
        world.robot.act(Drive(Twist(*np.clip(action, low, high))))
        world.step()
    assert world.hash == first[2]
    world.close()
    task.close()


def test_the_reward_is_its_formula() -> None:
    """Straight to the goal in the open: the geodesic progress is the distance driven, and the success comes once, at the end."""
    weights = Reward(progress=2.0, contact=5.0, time=0.1, success=7.0)
    for distance in ("geodesic", "straight"):
        task = DrivingTask(ROOM, reward=Reward(2.0, 5.0, 0.1, 7.0, distance), pose="truth")  # type: ignore[arg-type]
        task.reset(0)
        start, total, steps = task.world.ground_truth().pose.x, 0.0, 0
        for _ in range(80):
            outcome = task.step(FORWARD)
            total, steps = total + outcome.reward, steps + 1
            if outcome.terminated:
                break
        assert (outcome.terminated, outcome.truncated, outcome.reason) == (True, False, "success")
        way = task.world.ground_truth().pose.x - start
        expected = weights.progress * way - weights.time * steps * task.period + weights.success
        assert total == pytest.approx(expected, abs=0.02)
        task.close()


@pytest.mark.parametrize(("on_contact", "terminated"), [("end", True), ("continue", False)])
def test_contact_costs_and_ends_where_the_scenario_says_so(on_contact: str, terminated: bool) -> None:
    task = DrivingTask(WALL | {"on_contact": on_contact}, reward=Reward(progress=0.0, contact=3.0))
    task.reset(0)
    outcomes = [task.step(FORWARD)]
    while not outcomes[-1].reward and len(outcomes) < 60:
        outcomes.append(task.step(FORWARD))
    assert outcomes[-1].reward == -3.0
    assert (outcomes[-1].terminated, outcomes[-1].truncated) == (terminated, False)
    assert all(outcome.reward == 0.0 for outcome in outcomes[:-1])
    task.close()


def test_what_is_observed_is_what_the_sensors_say() -> None:
    task = DrivingTask(ROOM)
    seen = task.reset(0)
    robot = task.world.robot.robot
    assert robot.lidar is not None
    assert {name: value.shape for name, value in seen.items()} == {
        "goal": (3,), "speed": (2,), "sonars": (len(robot.sonars),), "lidar": (len(robot.lidar.bearings),),
        "psd": (1,), "acceleration": (2,), "bumper": (1,), "compass": (2,),
    }  # fmt: skip
    assert seen["goal"] == pytest.approx([0.5, 1.0, 0.0], abs=1e-3)
    for _ in range(10):
        seen = task.step(np.zeros(2)).observation
    ahead = int(np.argmin(np.abs(np.asarray(robot.lidar.bearings))))
    assert seen["lidar"][ahead] == pytest.approx(3.0 - robot.lidar.robot_from_sensor.x, abs=0.1)  # the wall at x = 3.5
    assert math.hypot(*seen["compass"]) == pytest.approx(1.0, abs=1e-6)
    task.close()


def test_the_way_to_the_goal_goes_round_the_walls() -> None:
    """Oracle: the run metric's geodesic distance, by another method: within the eight directions' 8 %, and a cell or two."""
    from robocar.core.geodesic import geodesic_distance

    task = DrivingTask("u-trap")
    task.reset(0)
    scene = task.scene
    exact = geodesic_distance(scene.grid, scene.grid.occupied, scene.start.position, task.goal.position, 0.09)
    assert exact * 0.98 <= task.distance() <= exact * 1.083 + 0.15
    assert task.distance() > 1.2 * float(np.linalg.norm(task.goal.position - scene.start.position))
    task.close()


def test_dm_env_begins_by_itself_and_begins_anew_after_the_end() -> None:
    env = RobocarEnv(ROOM | {"time_limit": 0.1}, seed=3)
    steps = [env.step(FORWARD) for _ in range(4)]
    kinds = dm_env.StepType
    assert [step.step_type for step in steps] == [kinds.FIRST, kinds.MID, kinds.LAST, kinds.FIRST]
    assert steps[2].discount == 1.0  # truncated
    env.close()


@pytest.mark.parametrize("action", [[0.1], [0.1, math.nan], [[0.1, 0.2]], "fast"])
def test_bad_actions_are_refused(action: Any) -> None:
    task = DrivingTask(ROOM)
    task.reset(0)
    with pytest.raises(ValueError, match=r"two finite numbers|could not convert"):
        task.step(action)
    task.close()


@pytest.mark.parametrize(
    ("change", "settings", "words"),
    [
        ({"goal": None}, {}, "needs a goal"),
        ({"events": [{"time": 1, "kidnap": [1, 1, 0]}]}, {}, "plays no events"),
        ({}, {"navigator.speed": 1}, "no navigator, estimator or mapper"),
    ],
)
def test_scenarios_that_are_no_task(change: dict, settings: dict, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        DrivingTask(ROOM | change, settings)


def test_bad_weights() -> None:
    with pytest.raises(ValueError, match="contact must be a finite number"):
        Reward(contact=math.inf)
    with pytest.raises(ValueError, match="distance must be"):
        Reward(distance="manhattan")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="pose must be"):
        DrivingTask(ROOM, pose="gps")  # type: ignore[arg-type]
