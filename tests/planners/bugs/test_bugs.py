"""The bug family and what it shares. Oracles: brute force, published bounds, the world's own check of contact."""

import gc
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.registry import CPUDispatcher

from robocar.core import OCCUPIED, SE2, STOP, Belief, Goal, Observation, OccupancyGrid, ParameterError, Scan, State, Text, Twist
from robocar.episode.registry import build
from robocar.planners.bugs.bug import Bug
from robocar.planners.bugs.open_points import VirtualCircle
from robocar.planners.bugs.view import BugParameters, free_way, narrow_gap
from tests.planners.beams import Disc, Drives, drive, laser_car, scan_of
from tests.planners.kinematic import car, context

LOOPS = ("bug1", "bug2", "dist-bug", "tangent-bug")
POINTS = ("point-bug", "critical-point-bug", "ocpb")
RADIUS = VirtualCircle.of(car(()).footprint, BugParameters().safety_constant).radius
START, GOAL = SE2(0.6, 1.5, 0.0), Goal(np.array([3.9, 1.5]))


def room(*boxes: tuple[float, float, float, float], size: tuple[float, float] = (4.5, 3.0)) -> OccupancyGrid:
    data = np.zeros((round(size[1] / 0.05), round(size[0] / 0.05)), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
    for x0, y0, x1, y1 in boxes:
        data[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = OCCUPIED
    return OccupancyGrid(data, 0.05)


def run(name: str, world: OccupancyGrid, start: SE2 = START, goal: Goal = GOAL, **more) -> Drives:
    return drive(build("navigator", name, context(laser_car(), None, start)), world, start, goal, **more)


points = st.lists(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), min_size=1, max_size=12)


@settings(deadline=None)
@given(points, st.floats(-math.pi, math.pi), st.floats(0.05, 0.4))
def test_the_free_way_of_a_disc(cloud: list[tuple[float, float]], heading: float, radius: float) -> None:
    """Brute force: a disc moved on by 1 mm until it comes nearer to a point than its radius, or than it was."""
    hits = np.array(cloud)
    steps = np.arange(0.0, 1.0, 0.001)
    way = steps[:, None] * np.array([math.cos(heading), math.sin(heading)])
    apart = np.linalg.norm(hits[None] - way[:, None], axis=2)  # (steps, points)
    limit = np.minimum(radius, 0.98 * apart[0])
    blocked = np.flatnonzero(np.any(apart < limit, axis=1))
    expected = steps[blocked[0]] if len(blocked) else 1.0
    # A grazing pass may fall between two steps.
    near = np.abs(apart.min(axis=0) - limit).min()
    free = free_way(hits, 0.0, 0.0, heading, radius, 1.0)
    assert free == pytest.approx(expected, abs=0.003) or near < 1e-3


@settings(deadline=None)
@given(points, points, st.floats(0.1, 0.6))
def test_a_narrow_gap_is_two_points_on_either_side(left: list, right: list, width: float) -> None:
    """Brute force over all pairs, with the x axis as way."""
    lefts = np.abs(np.array(left)) + np.array([0.0, 1e-3])
    rights = np.abs(np.array(right)) * np.array([1.0, -1.0]) - np.array([0.0, 1e-3])
    crossings = [a[0] + (b[0] - a[0]) * a[1] / (a[1] - b[1]) for a in lefts for b in rights if math.dist(a, b) < width - 1e-9]
    inside = [x for x in crossings if 0.1 < x <= 1.1]
    found = narrow_gap(np.concatenate([lefts, rights]), 0.0, 0.0, 0.0, 1.0, width, 0.1)
    assert found == pytest.approx(min(inside, default=math.inf), abs=1e-6)


@pytest.mark.parametrize("name", LOOPS)
def test_an_enclosed_goal_is_recognized(name: str) -> None:
    """Lumelsky and Stepanov: a boundary followed all round without reaching the goal encloses it, or the robot."""
    walled = room((2.6, 0.6, 4.1, 0.7), (2.6, 2.3, 4.1, 2.4), (2.6, 0.6, 2.7, 2.4), (4.0, 0.6, 4.1, 2.4), size=(4.8, 3.0))
    drives = run(name, walled, goal=Goal(np.array([3.4, 1.5])), seconds=200)
    assert (drives.status, drives.reason[:10]) == ("stuck", "once round")


@pytest.mark.parametrize("name", POINTS)
def test_the_others_end_stuck(name: str) -> None:
    walled = room((2.6, 0.6, 4.1, 0.7), (2.6, 2.3, 4.1, 2.4), (2.6, 0.6, 2.7, 2.4), (4.0, 0.6, 4.1, 2.4), size=(4.8, 3.0))
    drives = run(name, walled, goal=Goal(np.array([3.4, 1.5])), seconds=600)
    assert drives.status == "stuck", drives.reason


@pytest.mark.parametrize("side", [0.4, 0.8])
def test_the_ways_of_bug1_and_bug2_keep_their_bounds(side: float) -> None:
    """Lumelsky and Stepanov 1987, theorems 2 and 4: at most D + 1.5 p for Bug1, and D + n p / 2 with n = 2 for Bug2 and a convex
    obstacle; p is the perimeter of the box grown by the virtual circle, here and by a band of 4 cm that noise makes wider."""
    low, high = 1.5 - 0.5 * side, 1.5 + 0.5 * side
    world = room((2.0, low, 2.0 + side, high), size=(4.5, 3.0))
    direct = math.dist(START.position, GOAL.position)
    perimeter = 4 * side + math.tau * (RADIUS + 0.04)
    assert direct < run("bug1", world).length <= direct + 1.5 * perimeter
    assert direct < run("bug2", world).length <= direct + perimeter


@pytest.mark.parametrize("name", [*LOOPS, *POINTS])
@pytest.mark.parametrize("seed", [0, 1])
def test_nothing_is_touched_in_a_cluttered_room(name: str, seed: int) -> None:
    """The world checks contact exactly; random boxes, the laser's noise."""
    rng = np.random.default_rng(seed)
    corners = [(x + rng.uniform(-0.2, 0.2), y + rng.uniform(-0.2, 0.2)) for x in (1.3, 2.5, 3.7) for y in (0.9, 2.1, 3.3)]
    boxes = [(x, y, x + rng.uniform(0.1, 0.5), y + rng.uniform(0.1, 0.5)) for x, y in corners]
    drives = run(name, room(*boxes, size=(5.5, 4.5)), SE2(0.5, 0.5, 0.3), Goal(np.array([4.9, 3.9])), seconds=120, seed=seed)
    assert drives.status in ("success", "timeout", "stuck"), drives.reason


def test_what_takes_the_shorter_way_round() -> None:
    """A wall with one end 0.5 m and the other 0.9 m off the line: those with a range sensor see it, Bug2 turns to the far end."""
    world = room((2.2, 0.6, 2.3, 2.0), size=(4.5, 4.0))
    ways = {name: run(name, world) for name in ("tangent-bug", "ocpb", "bug2")}
    assert [drives.status for drives in ways.values()] == ["success"] * 3
    assert max(ways["tangent-bug"].length, ways["ocpb"].length) < ways["bug2"].length - 0.4
    assert min(pose.y for pose in ways["ocpb"].poses) > 1.4


def test_it_stands_while_all_beams_are_lost_and_goes_on_after() -> None:
    robot, world = laser_car(), room()
    bug = build("navigator", "ocpb", context(robot, None, START))
    scan = scan_of(robot, world, START, 0.0)
    dead = Scan(0.0, np.full(360, np.nan), scan.bearings, scan.max_range)
    stopped = bug.command(State.of(Belief(START)), Observation(0.0, lidar=dead), GOAL)
    assert stopped.twist == Twist()
    assert isinstance(stopped.trace["bug"], Text)
    assert bug.command(State.of(Belief(START)), Observation(0.1), GOAL).twist == STOP.twist
    twists = [bug.command(State.of(Belief(START)), Observation(0.2 + 0.1 * k, lidar=scan), GOAL).twist for k in range(6)]
    assert twists[-1].v > 0.0


@pytest.mark.parametrize("name", ["ocpb", "bug2"])
def test_too_close_to_turn_it_drives_out_first_and_says_so(name: str) -> None:
    """It starts 3 cm beside a wall and 1 cm before another, the goal to its right; contact is checked exactly."""
    world = room((0.4, 1.6, 1.2, 1.7), (0.74, 1.45, 0.8, 1.7))
    start = SE2(0.62, 1.48, 0.0)
    drives = run(name, world, start, Goal(np.array([0.6, 0.6])), seconds=60)
    assert drives.status == "success", drives.reason
    notes = [trace["bug"].message for trace in drives.traces if "bug" in trace]
    assert notes[0] == "too close to turn: driving to where there is room"
    assert drives.twists[np.flatnonzero([twist != Twist() for twist in drives.twists])[0]].v < 0.0


@pytest.mark.parametrize("name", ["ocpb", "tangent-bug", "critical-point-bug"])
def test_nothing_is_compiled_while_it_drives(name: str) -> None:
    """Oracle: numba's own count of what it has compiled of the planners' kernels, before and after; boxes and a mover."""
    world, mover = room((1.6, 0.8, 2.0, 1.6), (2.8, 1.3, 3.0, 2.6)), Disc((2.4, 0.3), (0.0, 0.2), 0.1)
    bug = build("navigator", name, context(laser_car(), None, START))

    def compiled() -> dict[str, int]:
        kernels = [
            o for o in gc.get_objects() if isinstance(o, CPUDispatcher) and o.py_func.__module__.startswith("robocar.planners.")
        ]
        # The world checks contact with `footprint_free`.
        return {o.py_func.__qualname__: len(o.signatures) for o in kernels if o.py_func.__name__ != "footprint_free"}

    before = compiled()
    assert len(drive(bug, world, START, GOAL, seconds=30, movers=[mover]).poses) > 50
    assert compiled() == before


def test_a_goal_with_a_heading_is_turned_to() -> None:
    goal = Goal(np.array([3.0, 1.5]), heading=-2.0)
    drives = run("tangent-bug", room(), goal=goal)
    assert drives.status == "success"
    assert goal.reached(drives.poses[-1])


@pytest.mark.parametrize(
    "field", ["safety_constant", "range_jump", "desired_linear_vel", "boundary_vel", "looks", "gap_tolerance"]
)
@pytest.mark.parametrize("value", [-1, math.nan, math.inf])
def test_senseless_parameters_are_refused(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        BugParameters(**{field: value})  # type: ignore[arg-type]


def test_too_few_sonars_are_refused_with_the_number_needed() -> None:
    with pytest.raises(ParameterError, match="at least 15 beams"):
        build("navigator", "bug1", context(car(), None, START))


def test_sixteen_sonars_will_do() -> None:
    """The ring of the car: 16 cones of 15 degrees, in a world where every cone answers."""
    from tests.planners.kinematic import drive as drive_by_sonar

    angles = np.arange(16) * math.tau / 16
    robot = car(tuple(SE2(0.085 * math.cos(a), 0.085 * math.sin(a), a) for a in angles))
    world = room((2.0, 1.1, 2.4, 1.9))
    for name in ("ocpb", "bug2"):
        bug = build("navigator", name, context(robot, None, START))
        assert isinstance(bug.controller, Bug)
        assert drive_by_sonar(bug, robot, world, START, GOAL, ticks=2000).status == "success"
