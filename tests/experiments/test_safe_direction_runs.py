"""Safe-direction navigation in physics. Oracles: contact in the simulator, run hashes, recorded entities, distances by hand."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from robocar.cli.experiments import run_experiment
from robocar.core.distance import ClearanceField
from robocar.episode.run import run
from robocar.experiments._safe_direction_worlds import FIGURES, culdesac, middle_error
from robocar.experiments.safe_direction_dynamic import CROSSINGS, FASTEST, world
from robocar.experiments.safe_direction_figures import BEST, histogram, transform_path
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel
from tests.experiments.test_experiments import written

FOOTPRINT = RobotModel.load().footprint

LONG = pytest.mark.skipif(not os.environ.get("ROBOCAR_LONG_TESTS"), reason="takes minutes: set ROBOCAR_LONG_TESTS=1")


def test_out_of_a_culdesac_two_metres_deep(tmp_path: Path) -> None:
    """The car starts at its mouth; the laser's sector is 205 degrees. The recording shows both models, the fan and alpha."""
    result = run(culdesac(2.0).scenario("culdesac", tmp_path), out=tmp_path / "runs", seed=1)
    assert result.status == "success", result.reason
    assert result.value("contacts") == 0
    assert result.recording is not None
    shown = {chunk.entity_path for chunk in RrdReader(result.recording).stream()}
    assert {
        f"/world/plan/safe_direction/{name}" for name in ("pessimistic", "optimistic", "fan", "safe", "shortest", "target")
    } <= shown
    assert "/signals/safe_direction/alpha" in shown


def test_equal_seeds_give_equal_runs_and_alpha_keeps_off(tmp_path: Path) -> None:
    """Fig. 9: the same hash for the same seed; at alpha 0.6 farther from obstacles than at 0."""
    scenario = FIGURES["figure-9"].scenario("figure-9", tmp_path)
    first, again = (run(scenario, seed=3) for _ in range(2))
    short = run(scenario, seed=3, settings={"navigator.alpha": 0.0})
    assert first.hash == again.hash
    assert first.success
    assert short.success
    assert (first.value("mean_clearance") or 0.0) > (short.value("mean_clearance") or 0.0) + 0.03
    assert (first.value("path_length") or 0.0) < 1.4 * (first.value("shortest_path_length") or 0.0)


def test_figure_5_has_its_best_direction_where_the_paper_has_it() -> None:
    """The paper's histogram peaks at 112 degrees; the world is drawn so that it does here, within the grid's precision."""
    degrees, totals = histogram()
    assert degrees[np.argmax(totals)] == pytest.approx(BEST, abs=2.0)
    assert degrees[90] == pytest.approx(90.0)


@pytest.mark.parametrize("name", sorted(FIGURES))
def test_the_worlds_can_be_driven(name: str, tmp_path: Path) -> None:
    """`Scene.load` refuses a start or a goal without room; the distance-transform path keeps the robot's radius to all walls."""
    scene = Scene.load(load_scenario(FIGURES[name].scenario(name, tmp_path)), FOOTPRINT)
    path = transform_path(FIGURES[name])
    assert len(path) > 10
    assert np.allclose(path[-1], scene.goal.position, atol=0.05)  # type: ignore[union-attr]
    assert ClearanceField(scene.grid, scene.grid.occupied).points(path).min() >= FOOTPRINT.circumscribed_radius - 1e-6


def test_distance_from_the_middle_line_by_hand() -> None:
    """Two points beside the first stretch, 0.1 m and -0.2 m off; what lies beyond its ends does not count."""
    assert np.sort(abs(middle_error(np.array([[2.0, 1.6], [2.5, 1.3], [4.0, 1.6], [0.5, 1.5]])))) == pytest.approx([0.1, 0.2])


@pytest.mark.parametrize("movers", [2, 6])
def test_the_hall_of_movers(movers: int, tmp_path: Path) -> None:
    """Equal seeds, equal movers; none faster than 0.3 m/s, and all run free of the walls (`Scene.load` checks that)."""
    drawn = world(5, movers)
    assert drawn == world(5, movers)
    assert drawn != world(6, movers)
    assert len(drawn.movers) == movers <= len(CROSSINGS)
    assert max(mover["speed"] for mover in drawn.movers) <= FASTEST
    scene = Scene.load(load_scenario(drawn.scenario("hall", tmp_path)), FOOTPRINT)
    assert len(scene.movers) == movers


def test_two_movers_are_passed_without_contact(tmp_path: Path) -> None:
    result = run(world(2, 2).scenario("hall", tmp_path), seed=2)
    assert result.status == "success", result.reason
    assert result.value("contacts") == 0


@LONG
@pytest.mark.parametrize("name", ["safe_direction_figures", "safe_direction_dynamic"])
def test_the_experiments(name: str, tmp_path: Path) -> None:
    """In their short versions: every figure's world is driven to the goal without contact."""
    run_experiment(name, tmp_path, quick=True)
    numbers = written(tmp_path, name)
    rates = [
        number["value"] for key, number in numbers.items() if key.endswith("success_rate") and "spiral/safe-direction/" not in key
    ]
    assert len(rates) >= 2
    assert min(rates) == 1.0
