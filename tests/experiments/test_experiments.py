"""The experiments run, in their short versions, and write what the design says; the helpers that they share.

Oracles: the design's section 9; the thesis' figures as bounds where a short run can hold them; hand-made tables.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import pytest
from scipy.ndimage import distance_transform_edt, label

from robocar.cli.experiments import experiment_names, run_experiment
from robocar.core import OutputError, ScenarioError, UnknownNameError
from robocar.experiments.replanning import NAVIGATORS, UNKNOWN, generated_world
from robocar.reporting.report import Report
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

LONG = pytest.mark.skipif(not os.environ.get("ROBOCAR_LONG_TESTS"), reason="takes minutes: set ROBOCAR_LONG_TESTS=1")


def written(out: Path, name: str) -> dict[str, Any]:
    """What an experiment left: its numbers, after a look at the rest."""
    folder = out / name
    assert (folder / "report.md").read_text().startswith("# ")
    pictures = list(folder.glob("*.png"))
    assert pictures
    assert all(cv2.imread(str(picture)).std() > 1.0 for picture in pictures)
    numbers = json.loads((folder / "summary.json").read_text(), parse_constant=lambda text: pytest.fail(f"{text} in JSON"))
    assert all(set(number) == {"value", "unit", "paper"} for number in numbers.values())
    return numbers


def test_thesis_motion(tmp_path: Path) -> None:
    """Tables 4.6 and 4.7: the thesis' means, 4.8 % of the distance and 4.34 % of the angle, are bounds for the calibrated car."""
    run_experiment("thesis_motion", tmp_path, quick=True)
    numbers = written(tmp_path, "thesis_motion")
    assert numbers["distance_error_mean/encoders_only"]["paper"] == 4.8
    assert numbers["heading_error_mean/encoders_only"]["paper"] == 4.34
    assert 0 < numbers["distance_error_mean/encoders_only"]["value"] < 2.0
    assert 0 < numbers["heading_error_mean/encoders_only"]["value"] < 4.34
    assert 0 < numbers["heading_error_mean/with_compass"]["value"] < 1.0


@LONG
def test_odometry_calibration(tmp_path: Path) -> None:
    run_experiment("odometry_calibration", tmp_path, quick=True)
    numbers = written(tmp_path, "odometry_calibration")
    assert numbers["wheel_radius"]["value"] == pytest.approx(numbers["wheel_radius"]["paper"], rel=0.02)
    assert numbers["effective_track/spin"]["value"] > numbers["geometric_track"]["value"]
    assert numbers["umbmark_systematic_error_calibrated"]["value"] < numbers["umbmark_systematic_error_nominal"]["value"]


@LONG
def test_thesis_navigation(tmp_path: Path) -> None:
    run_experiment("thesis_navigation", tmp_path, quick=True)
    numbers = written(tmp_path, "thesis_navigation")
    for sensing in ("spin", "side_sonars"):
        assert numbers[f"{sensing}/truth/success_rate"]["value"] == 1.0
        assert numbers[f"{sensing}/truth/contacts"]["value"] == 0
        assert numbers[f"{sensing}/truth/cells_off_max"]["value"] == 0
    assert numbers["side_sonars/truth/duration"]["value"] < numbers["spin/truth/duration"]["value"]


@LONG
def test_replanning(tmp_path: Path) -> None:
    """Everyone gets there without contact; where the map is known in part, D* Lite expands fewer cells than A* from scratch."""
    run_experiment("replanning", tmp_path, quick=True)
    numbers = {name: number["value"] for name, number in written(tmp_path, "replanning").items()}
    for case in (f"{world}/{name}" for world in ("warehouse", "unknown-maze") for name in NAVIGATORS):
        assert numbers[f"{case}/success_rate"] == 1.0
        assert numbers[f"{case}/contacts"] == 0
        assert numbers[f"{case}/path_over_shortest"] > 0.95
    assert numbers["warehouse/d-star-lite/expanded_per_replan"] < numbers["warehouse/a-star/expanded_per_replan"]
    assert len(list((tmp_path / "replanning" / "runs").glob("*--s0*/run.rrd"))) == 2 * len(NAVIGATORS)


@pytest.mark.parametrize("kind", UNKNOWN)
def test_worlds_to_replan_on(kind: str, tmp_path: Path) -> None:
    """Oracle: scipy's components of the cells that keep 0.35 m to the walls; they are equal for equal seeds, and differ else."""
    worlds = [generated_world(kind, seed, tmp_path / str(k)) for k, seed in enumerate((3, 3, 4))]
    assert worlds[0]["start"] == worlds[1]["start"]
    assert worlds[0]["goal"] == worlds[1]["goal"]
    assert worlds[0]["start"] != worlds[2]["start"]
    scene = Scene.load(load_scenario(worlds[0]), RobotModel.load().footprint)  # refuses a start that touches something
    room, _ = label(distance_transform_edt(~scene.grid.occupied) * scene.grid.resolution >= 0.35)
    start, goal = (room[tuple(scene.grid.cell_from_world(worlds[0][end][:2]))] for end in ("start", "goal"))
    assert start == goal > 0


def test_the_experiments_of_the_first_issue_are_known() -> None:
    names = experiment_names()
    assert set(names) >= {"thesis_motion", "thesis_navigation", "odometry_calibration"}
    assert [name for name in names if name.startswith(("bench", "_"))] == []
    with pytest.raises(UnknownNameError, match=r"did you mean 'thesis_motion'\?"):
        run_experiment("thesis_notion", Path("nowhere"), quick=True)


def test_a_report(tmp_path: Path) -> None:
    report = Report(tmp_path / "deep" / "down", "Title")
    report.number("time", 1.5, "s", paper=2.0)
    report.number("nothing", None, "m")
    report.table(("what", "how much"), [("a", 1.23456), ("b", None)], "A caption.")
    report.say("The end.")
    path = report.write()
    assert path.read_text() == "# Title\n\nA caption.\n\n| what | how much |\n|---|---|\n| a | 1.23 |\n| b | – |\n\nThe end.\n"
    assert json.loads((path.parent / "summary.json").read_text()) == {
        "time": {"value": 1.5, "unit": "s", "paper": 2.0},
        "nothing": {"value": None, "unit": "m", "paper": None},
    }


def test_a_report_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write: Not a directory"):
        Report(tmp_path / "file" / "below", "Title").write()


def test_many_runs_come_back_in_order_and_errors_come_through() -> None:
    job = {"scenario": "thesis-field", "settings": {"time_limit": 0.3}}
    results = run_many([job | {"seed": seed} for seed in (5, 3)])
    assert [result.seed for result in results] == [5, 3]
    assert len({result.hash for result in results}) == 2
    with pytest.raises(ScenarioError, match="unknown scenario 'nowhere'"):
        run_many([{"scenario": "nowhere"}])
