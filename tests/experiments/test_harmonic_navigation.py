"""The harmonic navigators in physics. Oracles: contact in the simulator, run hashes, A* on the same maps, distances by hand."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from robocar.cli.experiments import run_experiment
from robocar.core import OCCUPIED, SE2, OccupancyGrid
from robocar.episode.run import run
from robocar.experiments.harmonic_navigation import NAVIGATORS, on_finer_cells, path_clearance
from robocar.planners.costmap.layered import CostmapParameters, inflate
from robocar.planners.harmonic.planner import Harmonic
from robocar.planners.search.a_star import AStar
from robocar.scenario.load import load_scenario, scenario_names
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

HARMONIC = ("harmonic", "harmonic-local")
WITH_A_MAP = (*HARMONIC, "a-star")
LONG = pytest.mark.skipif(not os.environ.get("ROBOCAR_LONG_TESTS"), reason="takes minutes: set ROBOCAR_LONG_TESTS=1")


@pytest.mark.parametrize("navigator", HARMONIC)
def test_a_slit_that_a_star_squeezes_through_is_left_aside(navigator: str) -> None:
    """A* drives the slit of 0.30 m; the probability that a random walk gets through is larger by the opening of 0.80 m. The car
    is 0.18 m wide, so 0.06 m is the largest clearance that the slit leaves."""
    result = run("narrow-gap", navigator=navigator)
    assert result.status == "success", result.reason
    assert result.value("contacts") == 0
    clearance = result.value("min_clearance")
    assert clearance is not None
    assert clearance > 0.15


@pytest.mark.parametrize("navigator", HARMONIC)
def test_unmapped_obstacles_are_seen_and_driven_around(navigator: str) -> None:
    """Three obstacles that the map does not know stand on the thesis' field: at least one has the potential solved again."""
    result = run("thesis-field", navigator=navigator, seed=3)
    assert result.status == "success", result.reason
    assert result.value("contacts") == 0
    replans = result.value("replans")
    assert replans is not None
    assert replans >= 1


def test_equal_seeds_give_equal_runs() -> None:
    first, second, other = (run("thesis-field", navigator="harmonic-local", seed=seed) for seed in (1, 1, 2))
    assert first.hash == second.hash
    assert first.hash != other.hash


def test_the_recording_shows_potential_streamline_and_path(tmp_path: Path) -> None:
    """Oracle: the entities in the file; the potential is written anew when it is solved again."""
    result = run("thesis-field", navigator="harmonic-local", out=tmp_path)
    assert result.recording is not None
    rows: dict[str, int] = {}
    for chunk in RrdReader(result.recording).stream():
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.to_record_batch().num_rows
    shown = {f"/world/plan/{name}" for name in ("harmonic/potential", "harmonic/streamline", "global", "local")}
    assert shown <= set(rows)
    assert rows["/world/plan/harmonic/potential"] >= 2


@pytest.mark.parametrize("scenario", scenario_names())
def test_streamlines_keep_farther_from_walls_than_a_star(scenario: str) -> None:
    """A* on the inflated costs of the same prior map is the yardstick. Where its path is the middle of a lane already (the
    spiral: 0.325 m at most), a streamline that rounds the corners gives up less than 1 cm of the mean and wins the minimum."""
    scene = Scene.load(load_scenario(scenario), RobotModel.load().footprint)
    if scene.prior is None or scene.goal is None:
        pytest.skip("there is no map, or no goal, to plan to before the run")
    costmap = inflate(scene.prior, RobotModel.load().footprint.inscribed_radius, CostmapParameters())
    ours, theirs = (
        path_clearance(planner.plan(costmap, scene.start.position, scene.goal.position).path.points, scene.prior)
        for planner in (Harmonic(), AStar())
    )
    slack, which = (0.01, np.min) if scenario == "spiral" else (0.0, np.mean)
    assert ours.mean() > theirs.mean() - slack
    assert which(ours) > which(theirs)


def test_bends_are_rounded_by_the_potential_and_not_by_the_grid() -> None:
    """Oracle: refinement. On the spiral, where A* has the larger mean, cells of a quarter of the side move it by 3 mm at most."""
    scene = Scene.load(load_scenario("spiral"), RobotModel.load().footprint)
    assert scene.prior is not None
    assert scene.goal is not None
    costmap = inflate(scene.prior, RobotModel.load().footprint.inscribed_radius, CostmapParameters())
    ends = scene.start.position, scene.goal.position
    coarse = path_clearance(Harmonic().plan(costmap, *ends).path.points, scene.prior)
    fine = path_clearance(on_finer_cells(costmap, *ends, 4), scene.prior)
    assert fine.mean() == pytest.approx(coarse.mean(), abs=0.003)
    assert fine.mean() < path_clearance(AStar().plan(costmap, *ends).path.points, scene.prior).mean()


def test_clearance_of_a_path_by_hand() -> None:
    """A corridor of 1 m, walls only around the map, shifted and turned: 0.5 m in the middle, down to 0.1 m towards a side."""
    origin = SE2(3.0, -2.0, 0.8)
    corridor = OccupancyGrid(np.zeros((10, 100), dtype=np.int8), 0.1, origin)
    middle = path_clearance(origin.transform([[2.0, 0.5], [8.0, 0.5]]), corridor)
    np.testing.assert_allclose(middle, 0.5, atol=1e-9)
    towards = path_clearance(origin.transform([[2.0, 0.5], [8.0, 0.5], [8.0, 0.1]]), corridor)
    assert towards.min() == pytest.approx(0.1)
    assert towards.mean() == pytest.approx((6.0 * 0.5 + 0.4 * 0.3) / 6.4, abs=1e-3)  # by length
    post = np.zeros((10, 100), dtype=np.int8)
    post[4:6, 50] = OCCUPIED
    assert path_clearance(origin.transform([[2.0, 0.5], [4.8, 0.5]]), OccupancyGrid(post, 0.1, origin)).min() == pytest.approx(
        0.2
    )


@LONG
def test_the_experiment(tmp_path: Path) -> None:
    run_experiment("harmonic_navigation", tmp_path, quick=True)
    folder = tmp_path / "harmonic_navigation"
    numbers: dict[str, Any] = json.loads((folder / "summary.json").read_text(), parse_constant=pytest.fail)
    assert numbers["all/plans_with_larger_mean_clearance"]["value"] == 1.0
    for navigator in WITH_A_MAP:
        assert numbers[f"all/{navigator}/success_rate"]["value"] == 1.0
        assert numbers[f"all/{navigator}/contacts"]["value"] == 0
    for navigator in HARMONIC:
        ours, theirs = (numbers[f"doors/{name}/mean_clearance"]["value"] for name in (navigator, "a-star"))
        assert ours > theirs
    picture = cv2.imread(str(folder / "trajectories.png"))
    assert np.std(picture) > 1.0  # type: ignore[arg-type]
    assert len(list((folder / "runs").glob("*--s0*/run.rrd"))) == 3 * len(NAVIGATORS)
