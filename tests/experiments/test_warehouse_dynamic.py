"""Warehouses with moving obstacles. Oracles: the promises of the experiment, and of the scenario's physics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robocar import run
from robocar.core import STOP, ScenarioError
from robocar.episode.run import simulate
from robocar.experiments import warehouse_dynamic
from robocar.experiments.warehouse_dynamic import COUNTS, KEEP_OFF, dynamic_scenario
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel


@pytest.mark.parametrize("count", COUNTS)
def test_movers_are_as_the_report_says(count: int) -> None:
    scenario = load_scenario(dynamic_scenario(count, 3))
    scene = Scene.load(scenario, RobotModel.load().footprint)  # checks that all ways are free
    assert len(scene.movers) == count
    kinds = [mover.motion for mover in scene.movers]
    assert max(kinds.count(kind) for kind in set(kinds)) - min(kinds.count(kind) for kind in set(kinds)) <= 1
    assert len(set(kinds)) == 3
    assert all(0.1 <= mover.speed <= 0.3 for mover in scene.movers)
    places = np.array([scene.start.position, *(mover.start.position for mover in scene.movers)])
    apart = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(len(places), 1)]
    assert apart.min() > KEEP_OFF - 2e-3  # way points are rounded to a millimetre


def test_each_seed_has_its_own_movers(monkeypatch: pytest.MonkeyPatch) -> None:
    assert dynamic_scenario(5, 1) == dynamic_scenario(5, 1)
    assert dynamic_scenario(5, 1)["movers"] != dynamic_scenario(5, 2)["movers"]
    monkeypatch.setattr(warehouse_dynamic, "TRIES", 500)
    with pytest.raises(ScenarioError, match="400 movers find no room"):
        dynamic_scenario(400, 0)


def test_twenty_movers_keep_moving_and_keep_off_the_shelves() -> None:
    """A quarter of a minute without a car in their way; where two meet, one that walks at random goes elsewhere."""
    scenario = load_scenario(dynamic_scenario(20, 0))
    scene = Scene.load(scenario, RobotModel.load().footprint)
    world = simulate(scenario, seed=5)
    ways = {mover.name: 0.0 for mover in scene.movers}
    nearest = math.inf
    before = world.ground_truth().movers
    for tick in range(300):
        world.robot.sense()
        world.robot.act(STOP)
        world.step()
        now = world.ground_truth().movers
        for mover in scene.movers:
            ways[mover.name] += before[mover.name].distance_to(now[mover.name])
            if tick % 20 == 0:
                nearest = min(nearest, scene.clearance(mover.outline(now[mover.name])) - mover.radius)
        before = now
    assert world.diverged() is None
    assert nearest > -0.01  # a push of another may press one a little into a shelf
    for mover in scene.movers:
        assert ways[mover.name] < mover.speed * 15.0 * 1.2 + 0.1
    assert np.median([ways[mover.name] / (mover.speed * 15.0) for mover in scene.movers]) > 0.4
    world.close()


def test_equal_seeds_give_equal_runs_with_movers() -> None:
    jobs = [{"settings": {"time_limit": 3.0}, "navigator": "a-star", "seed": seed} for seed in (4, 4, 5)]
    hashes = [run("warehouse-dynamic", **job).hash for job in jobs]
    assert hashes[0] == hashes[1]
    assert hashes[0] != hashes[2]
