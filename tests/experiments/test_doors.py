"""The experiment `doors`: its rooms, and a short version of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, label

from robocar.cli.experiments import run_experiment
from robocar.experiments.doors import KNOW_THE_MAP, QUICK_DOORS, WIDTHS, door, scenario
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel
from tests.experiments.test_experiments import LONG, written


@pytest.mark.parametrize("seed", range(8))
def test_rooms_have_one_door_of_the_width_that_they_say(seed: int, tmp_path: Path) -> None:
    """Oracle: scipy's components of what a disc can reach: a little slimmer than the door it gets through, wider it does not."""
    place = door(seed)
    Scene.load(load_scenario(scenario(place, tmp_path, "door")), RobotModel.load().footprint)  # refuses what touches something
    assert np.array_equal(place.grid.data, door(seed).grid.data)
    assert 0.1 < place.width <= WIDTHS[1] + 0.1
    fine = 8  # steps per cell
    room = distance_transform_edt(~place.grid.occupied.repeat(fine, 0).repeat(fine, 1)) * place.grid.resolution / fine
    ends = [tuple((point[::-1] * fine).astype(int)) for point in place.grid.grid_from_world([place.start[:2], place.goal])]
    slack = place.grid.resolution * (0.5 + 2.0 / fine)  # posts that are cut into steps do not face each other exactly
    for width, joined in ((place.width - slack, True), (place.width + 2.0 * slack + 0.06, False)):
        parts, _ = label(room >= width / 2)
        assert (parts[ends[0]] == parts[ends[1]] != 0) == joined


@LONG
def test_nobody_touches_a_post(tmp_path: Path) -> None:
    run_experiment("doors", tmp_path, quick=True)
    numbers = {name: number["value"] for name, number in written(tmp_path, "doors").items()}
    assert numbers["runs"] == QUICK_DOORS * len(KNOW_THE_MAP) >= 100
    assert numbers["contacts"] == 0
    assert all(numbers[f"{name}/narrowest_passed"] < 0.45 for name in KNOW_THE_MAP if name != "dynamic-a-star")
