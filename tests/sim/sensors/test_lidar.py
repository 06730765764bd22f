"""Laser scanners in a room. Oracles: distances in closed form, moments of the noise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robocar.core import SE2, Hold
from robocar.sim.fit_out import FitOut
from tests.sim.rooms import drive, room
from tests.sim.sensors.exact import EXACT, TILT


def box_room(x: float, y: float, angles: np.ndarray, width: float, depth: float) -> np.ndarray:
    """Closed form: from a point inside of a rectangle to its sides along directions."""
    with np.errstate(divide="ignore"):
        to_x = np.where(np.cos(angles) > 0, width - x, -x) / np.cos(angles)
        to_y = np.where(np.sin(angles) > 0, depth - y, -y) / np.sin(angles)
    return np.minimum(to_x, to_y)


@pytest.mark.parametrize(("lidar", "reach"), [("hokuyo", 5.6), ("scan360", 6.0)])
@pytest.mark.parametrize("start", [SE2(2.0, 1.5, 0.4), SE2(0.5, 7.0, -2.5), SE2(7.2, 3.3, 1.9)])
def test_laser_in_a_room(lidar: Any, reach: float, start: SE2) -> None:
    world = room(10, 8, start=start, fit_out=FitOut(lidar=lidar), sensors=EXACT)
    scan = world.robot.sense().lidar
    assert scan is not None
    laser = world.ground_truth().pose @ scan.robot_from_sensor
    expected = box_room(laser.x, laser.y, laser.theta + scan.bearings, 10, 8)
    clear = np.abs(expected - reach) > 0.01
    assert clear.mean() > 0.9
    np.testing.assert_allclose(scan.ranges[clear], np.where(expected <= reach, expected, np.inf)[clear], atol=0.003)
    assert np.isinf(scan.ranges).any()
    assert scan.max_range == reach
    assert scan.beam_width == 0.0


def test_laser_noise_has_the_moments_it_is_given() -> None:
    """1 cm, and a share of lost beams: five sigma over ten scans."""
    sensors = {"lidar": {"dropout": 0.05}}
    world = room(4, 4, start=SE2(2, 2, 0.3), fit_out=FitOut(lidar="scan360"), sensors=sensors)
    residuals = []
    for observation in drive(world, Hold(), 1.0):
        if observation.lidar is not None:
            laser = SE2(2, 2, 0.3) @ observation.lidar.robot_from_sensor
            residuals.append(
                observation.lidar.ranges - box_room(laser.x, laser.y, laser.theta + observation.lidar.bearings, 4, 4)
            )
    found = np.concatenate(residuals)
    assert len(found) == 10 * 360
    lost = np.isnan(found)
    kept = found[~lost]
    assert lost.mean() == pytest.approx(0.05, abs=5 * math.sqrt(0.05 * 0.95 / 3600))
    assert kept.mean() == pytest.approx(0.0, abs=5 * 0.01 / math.sqrt(len(kept)) + TILT)
    assert kept.std() == pytest.approx(0.01, rel=5 / math.sqrt(2 * len(kept)) + 0.02)
    assert not np.array_equal(residuals[0], residuals[1], equal_nan=True)
