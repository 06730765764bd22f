"""Fixtures of the sensors' tests."""

from __future__ import annotations

import pytest

from robocar.sim.fit_out import FitOut
from robocar.sim.world import World
from tests.sim.rooms import room
from tests.sim.sensors.exact import EXACT, HALL


@pytest.fixture(scope="module")
def hall() -> World:
    """One hall with exact sensors for all static distances: the car is put where it is wanted."""
    return room(*HALL, fit_out=FitOut("front+sides", "scan360"), sensors=EXACT)
