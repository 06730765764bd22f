"""The planner in contact physics: it arrives, keeps off the walls, and does tomorrow what it does today."""

import pytest
import wall_shy


@pytest.mark.parametrize("scenario", ["u-trap", "tilted"])
def test_it_arrives_and_nothing_changed(physics_run, assert_no_regression, scenario):
    run = physics_run(scenario, navigator=wall_shy.build, estimator="truth", seed=0)
    assert run.status == "success", run.reason
    assert run.value("contacts") == 0
    assert_no_regression(run)


def test_it_keeps_off_the_walls(physics_run):
    run = physics_run("tilted", navigator=wall_shy.build, estimator="truth", seed=0)  # not run again: it is remembered
    assert run.value("min_clearance") > 0.15
