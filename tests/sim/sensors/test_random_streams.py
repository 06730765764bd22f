"""Each sensor has random numbers of its own. Oracles: runs of equal and of other seeds, correlation of independent noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from robocar.core import SE2, Drive, Hold, Twist
from robocar.sim.fit_out import FitOut
from robocar.sim.world import World
from tests.sim.rooms import drive, room


def readings_of(world: World, names: Sequence[str]) -> list[np.ndarray]:
    """Of the named sonars and all small sensors on a short drive."""
    observations = drive(world, lambda time: Drive(Twist(0.2, math.sin(3 * time))), 2.0)
    rows = [[float(s.ranges[0]) for o in observations for s in o.sonars if s.name == name] for name in names]
    rows += [
        [o.psd.value for o in observations if o.psd],
        [float(v) for o in observations if o.acceleration for v in o.acceleration.value],
    ]
    rows += [[v for o in observations if o.wheel_angles for v in (o.wheel_angles.value.left, o.wheel_angles.value.right)]]
    return [np.array(row) for row in rows]


@pytest.mark.parametrize(
    "more", [FitOut("front+sides"), FitOut(lidar="hokuyo"), FitOut("front+sides", "scan360", compass=True)], ids=str
)
def test_adding_a_sensor_changes_no_other_sensors_readings(more: FitOut) -> None:
    names = ["front_left", "front_right"]
    few = readings_of(room(start=SE2(4, 4, 0.5), seed=5), names)
    many = readings_of(room(start=SE2(4, 4, 0.5), seed=5, fit_out=more), names)
    assert [row.size for row in few] == [40, 40, 40, 80, 80]
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(few, many, strict=True))


def test_equal_seeds_equal_readings_and_other_seeds_others() -> None:
    names = ["front_left", "front_right"]
    first, again, other = (readings_of(room(seed=seed), names) for seed in (3, 3, 4))
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(a, b, equal_nan=True) for a, b in zip(first[:2], other[:2], strict=True))


def test_two_sonars_have_noise_of_their_own() -> None:
    """Uncorrelated: five sigma of the correlation of independent noise."""
    world = room(sensors={"sonar": {"dropout": 0.0}})
    pairs = np.array([[float(s.ranges[0]) for s in o.sonars] for o in drive(world, Hold(), 20.0)])
    assert pairs.shape == (400, 2)
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 5 / math.sqrt(400)
