"""The measures of the experiment on random trees, and its worlds."""

import math

import numpy as np
import pytest

from robocar.experiments.rrt_figures import WORLDS, smoothness, world
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel


def test_smoothness_by_hand() -> None:
    """OMPL's formula: a right angle between segments of 1 m: (2 pi/2 / 2)^2; straight on is 0; half as long, 4 times it."""
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    assert smoothness(corner) == pytest.approx((math.pi / 2) ** 2)
    assert smoothness(corner / 2) == pytest.approx(4 * (math.pi / 2) ** 2)
    assert smoothness(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [5.0, 0.0]])) == 0.0


@pytest.mark.parametrize("kind", WORLDS)
def test_its_worlds_are_valid_for_every_seed(kind: str) -> None:
    """Oracle: the scene's own checks (movers never pass through a wall, nothing stands where the car starts)."""
    movers = {tuple(mover.start.as_array()[:2]) for seed in range(20) for mover in _scene(kind, seed).movers}
    assert len(movers) == (6 * 20 if kind == "moving" else 0)


def _scene(kind: str, seed: int) -> Scene:
    return Scene.load(load_scenario(world(kind, seed)), RobotModel.load().footprint)
