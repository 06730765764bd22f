"""The way out of tight places. Oracles: exact clearance along the way, blind trials that show that there is a way."""

from __future__ import annotations

import numpy as np
import pytest

from robocar.core import SE2, Array, Costmap
from robocar.experiments.parked import FOOTPRINT, OUTLINE, _walls, parked
from robocar.planners.geometry.escape import CELLS, MARGIN, Escape
from robocar.planners.geometry.surfaces import clearance, room, surfaces
from tests.planners.kinematic import car

DT = 0.1
ROOM = 0.01
WANTED = FOOTPRINT.circumscribed_radius + ROOM


def walls(*boxes: tuple[int, int, int, int]) -> Costmap:
    """A room of 2 x 3 m of 5 cm cells with a wall around it, boxes (first row, first column, last row, last column)."""
    costs = np.zeros((40, 60), dtype=np.uint8)
    costs[0], costs[-1], costs[:, 0], costs[:, -1] = 254, 254, 254, 254
    for top, left, low, right in boxes:
        costs[top : low + 1, left : right + 1] = 254
    return Costmap(costs, 0.05)


def carry_out(segments: Array, start: SE2, period: float = DT) -> tuple[bool, list[SE2]]:
    """Whether there is a way, and all poses on it, without physics."""
    escape = Escape(car(), ROOM)
    poses = [start]
    found = escape.begin(start, segments)
    for _ in range(3000):
        drive = escape.command(poses[-1], segments, period)
        if drive is None:
            return found, poses
        for _ in range(4):
            poses.append(poses[-1] @ drive.twist.step(period / 4))
    raise AssertionError("it never ends")


def kept(segments: Array, poses: list[SE2]) -> float:
    return min(clearance(segments, p.x, p.y, p.theta, OUTLINE, 0.1) for p in poses)


@pytest.mark.parametrize("seed", range(100, 140))
def test_wherever_there_is_a_way_out_it_is_found_and_keeps_off(seed: int) -> None:
    """Random rooms and poses 5 to 80 mm from something, where blind trials have found a way that keeps 3 mm."""
    case = parked(seed)
    segments = _walls(case.world, case.start, 2.0)
    first = room(segments, case.start.x, case.start.y)
    found, poses = carry_out(segments, case.start)
    assert found or first >= WANTED
    assert kept(segments, poses) >= min(MARGIN, kept(segments, poses[:1])) - 5e-4
    assert room(segments, poses[-1].x, poses[-1].y) >= min(WANTED, first + ROOM) - 5e-3


@pytest.mark.parametrize("gap", [0.001, 0.002, 0.004, 0.005, 0.008, 0.015, 0.04])
@pytest.mark.parametrize("period", [0.02, 0.2])
def test_beside_a_wall_it_comes_no_nearer_than_it_stands(gap: float, period: float) -> None:
    """Parallel, with 1 m of free floor ahead, and a box beside the end of which there is room."""
    costmap = walls((1, 1, 6, 20))
    start = SE2(0.7, 0.35 + 0.09 + gap, 0.0)
    segments = surfaces(costmap, start, 2.0)
    found, poses = carry_out(segments, start, period)
    assert found
    assert kept(segments, poses) >= min(MARGIN, gap) - 5e-4
    assert room(segments, poses[-1].x, poses[-1].y) >= WANTED - 5e-3


def test_boxed_in_there_is_none_and_it_says_so_at_once_until_something_changes() -> None:
    costs = np.full((7, 8), 254, dtype=np.uint8)
    costs[1:6, 1:7] = 0
    costs[0:2, :], costs[5:, :], costs[:, :2], costs[:, 6:] = 254, 254, 254, 254  # 15 x 20 cm are left
    costmap = Costmap(costs, 0.0667)
    start = SE2(4 * 0.0667, 3.5 * 0.0667, 0.0)
    escape, segments = Escape(car(), ROOM), surfaces(costmap, start, 2.0)
    assert not escape.begin(start, segments)
    assert escape.command(start, segments, DT) is None
    assert not escape.begin(start, segments)
    assert escape.begin(start, np.array([[-1.0, start.y - 0.1, 1.0, start.y - 0.1]]))


def test_nothing_is_gained_where_nothing_is_in_the_way() -> None:
    escape = Escape(car(), ROOM)
    assert escape.roomy(SE2(), np.empty((0, 4)))
    assert not escape.begin(SE2(), np.empty((0, 4)))


def test_what_seems_to_reach_into_the_robot_may_be_misplaced() -> None:
    """A cell 15 mm inside the outline: with doubt it gets away from it, and never more than the doubt deeper into it."""
    segments = np.array([[-1.0, -0.075, 1.0, -0.075]])
    escape, pose, least = Escape(car(), ROOM, CELLS), SE2(), 0.0
    assert escape.begin(pose, segments)
    while (drive := escape.command(pose, segments, DT)) is not None:
        pose = pose @ drive.twist.step(DT)
        least = min(least, clearance(segments, pose.x, pose.y, pose.theta, OUTLINE, 0.1))
    assert least >= -0.015 - CELLS - 1e-3
    assert room(segments, pose.x, pose.y) >= WANTED - 5e-3


def test_what_turns_up_on_the_way_is_driven_around_or_stopped_for() -> None:
    """A box appears across the way after a second; the car keeps off it, and ends with more room than where it began."""
    start = SE2(0.8, 0.05 + 0.09 + 0.006, 0.0)
    escape, pose = Escape(car(), ROOM), start
    before = surfaces(walls(), start, 2.0)
    after = np.concatenate([before, [[1.2, 0.05, 1.2, 0.5]]])
    assert escape.begin(start, before)
    least, tick = 1.0, 0
    while (drive := escape.command(pose, before if tick < 10 else after, DT)) is not None:
        pose, tick = pose @ drive.twist.step(DT), tick + 1
        least = min(least, clearance(after, pose.x, pose.y, pose.theta, OUTLINE, 0.1))
    assert least >= MARGIN - 5e-4
    assert room(after, pose.x, pose.y) > room(before, start.x, start.y) + ROOM


def test_what_it_computed_is_counted_and_shown_once() -> None:
    start = SE2(0.8, 0.05 + 0.09 + 0.006, 0.0)
    escape, segments = Escape(car(), ROOM), surfaces(walls(), start, 2.0)
    assert escape.begin(start, segments)
    first, second = (escape.command(start, segments, DT) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.work["expansions"] > 0
    assert set(first.trace) == {"escape", "escape/why"}
    assert (dict(second.work), dict(second.trace)) == ({}, {})
