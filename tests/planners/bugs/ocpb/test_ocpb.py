"""Operative Critical Point Bug: gaps, movers, what it remembers. Oracles: the paper's claims, the world, graph search."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from robocar.core import OCCUPIED, SE2, Arrows, Goal, Lines, OccupancyGrid, Points
from robocar.episode.registry import build
from robocar.episode.run import run as run_in_physics
from robocar.planners.bugs.ocpb.parameters import OcpbParameters
from robocar.planners.bugs.ocpb.strategy import OperativeCriticalPointBug
from robocar.planners.bugs.ocpb.sub_goals import SAME
from robocar.planners.bugs.ocpb.surfaces import Surfaces
from robocar.planners.bugs.ocpb.traverse import Candidate, Traverse
from robocar.planners.bugs.open_points import OpenPoint, VirtualCircle
from robocar.planners.bugs.view import BugParameters, BugView, narrow_gap
from robocar.planners.tracking.panorama import ScanPanorama
from tests.planners.beams import Disc, Drives, drive, laser_car
from tests.planners.kinematic import context

CELL = 0.01
RADIUS = VirtualCircle.of(laser_car().footprint, 0.03).radius


def doorway(share: float) -> OccupancyGrid:
    """4 x 2.4 m on cells of 1 cm; a wall across it with a door of `share` times 2 r, to the nearest cell."""
    data = np.zeros((240, 400), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
    half = share * RADIUS / CELL
    data[: round(120 - half), 195:205] = data[round(120 + half) :, 195:205] = OCCUPIED
    return OccupancyGrid(data, CELL)


def open_room() -> OccupancyGrid:
    data = np.zeros((200, 200), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
    return OccupancyGrid(data, 0.05)


def run(world: OccupancyGrid, start: SE2, goal: tuple[float, float], **more) -> tuple[Drives, OperativeCriticalPointBug]:
    bug = build("navigator", "ocpb", context(laser_car(), None, start))
    return drive(bug, world, start, Goal(np.array(goal)), **more), bug.controller.strategy


@pytest.mark.parametrize("share", [1.15, 1.4])
@pytest.mark.parametrize("seed", [0, 1])
def test_wide_gaps_are_passed(share: float, seed: int) -> None:
    """SAFE_POINT: wider than 2 r; contact is checked exactly."""
    drives, _ = run(doorway(share), SE2(0.7, 0.8, 0.0), (3.3, 1.2), seed=seed)
    assert drives.status == "success", drives.reason


@pytest.mark.parametrize("share", [0.9, 0.97])
@pytest.mark.parametrize("seed", [0, 1])
def test_narrow_gaps_are_not_entered(share: float, seed: int) -> None:
    drives, _ = run(doorway(share), SE2(0.7, 1.2, 0.0), (3.3, 1.2), seed=seed, seconds=200)
    assert drives.status == "stuck", drives.reason
    assert max(pose.x for pose in drives.poses) < 1.95


@pytest.mark.parametrize("speed", [0.1, 0.25, 0.4])
@pytest.mark.parametrize("angle", [45, 90, 135, 180])
def test_one_that_would_meet_it_is_not_touched(speed: float, angle: float) -> None:
    """A mover timed to be at (5, 5) when a robot that drives straight at 0.4 m/s is; distance to its disc is checked exactly."""
    time = 0.7 + 3.0 / 0.4
    velocity = speed * np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    mover = Disc(tuple(np.array([5.0, 5.0]) - time * velocity), tuple(velocity), 0.15)
    drives, _ = run(open_room(), SE2(2.0, 5.0, 0.0), (8.0, 5.0), movers=[mover], seconds=90)
    assert drives.status == "success", drives.reason
    assert drives.closest > 0.05


def test_a_mover_that_will_have_passed_is_no_reason_to_give_way() -> None:
    """RTC is not OTC: it crosses the line three seconds before the robot comes; the way stays straight."""
    velocity = np.array([0.0, 0.4])
    mover = Disc(tuple(np.array([5.0, 5.0]) - (0.7 + 3.0 / 0.4 - 4.0) * velocity), tuple(velocity), 0.15)
    drives, strategy = run(open_room(), SE2(2.0, 5.0, 0.0), (8.0, 5.0), movers=[mover])
    assert drives.status == "success"
    assert drives.length < 6.1
    assert strategy.decisions <= 2


def test_what_it_has_visited_it_does_not_choose_again() -> None:
    """Property of T and D after a run through rooms: places apart, no open sub-goal at one of them, all places in one tree."""
    data = np.zeros((120, 120), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
    data[40:43, :80] = data[80:83, 40:] = OCCUPIED
    drives, strategy = run(OccupancyGrid(data, 0.05), SE2(1.0, 0.7, 0.0), (5.0, 5.3), seconds=300)
    assert drives.status == "success", drives.reason
    points = strategy.seen.points()
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) + np.eye(len(points))
    assert len(points) >= 3
    assert apart.min() >= SAME
    assert [place.parent < k for k, place in enumerate(strategy.seen.places)] == [True] * len(points)
    shown = {name: trace[name] for trace in drives.traces for name in trace}
    kinds = {"open_points": Points, "subgoals": Points, "critical_point": Points, "visited": Points, "virtual_circle": Lines}
    kinds |= {"d_min": Lines, "moving": Arrows, "collision": Points, "virtual_obstacle": Lines, "obstacles": Lines}
    assert {name: type(shown[name]) for name in kinds} == kinds


@settings(deadline=None, max_examples=50)
@given(st.integers(2, 40), st.integers(0, 2**32 - 1))
def test_the_way_back_is_the_one_in_the_tree(count: int, seed: int) -> None:
    """Oracle: scipy's Dijkstra on the tree of places, which has one way only; random trees."""
    rng, seen = np.random.default_rng(seed), Traverse()
    parents = [-1]
    seen.arrive(np.zeros(2))
    for k in range(1, count):
        seen.at = int(rng.integers(k))
        parents.append(seen.at)
        seen.arrive(np.array([float(k), 0.0]))
    target = int(rng.integers(count))
    edges = coo_array((np.ones(count - 1), (range(1, count), parents[1:])), shape=(count, count)).tocsr()
    hops = dijkstra(edges, directed=False, indices=seen.at)[target]
    way = [k for k in reversed(seen.way(target)) if k != seen.at]
    assert len(way) == hops
    steps = [seen.at, *way]
    assert all(parents[a] == b or parents[b] == a for a, b in pairwise(steps))
    assert steps[-1] == target


def view_of(hits: np.ndarray, centre: tuple[float, float] = (0.0, 0.0), goal: tuple[float, float] = (5.0, 0.0)) -> BugView:
    seen = ScanPanorama(0.0, np.zeros(2), np.zeros(0), np.zeros(0), 6.0, 0.1)
    circle = VirtualCircle.of(laser_car().footprint, 0.03)
    return BugView(0.0, SE2(*centre), np.array(centre), seen, hits, True, Goal(np.array(goal)), False, circle, BugParameters())


def row_of(point: OpenPoint) -> np.ndarray:
    """An open point as a row of `open_point_rows`, (1, 10)."""
    return np.array([
        [*point.position, point.bearing, point.range, point.side, point.sure, point.before, point.beyond, *point.along]
    ])  # fmt: skip


def candidates(seen: Traverse, view: BugView, *points: OpenPoint) -> list[Candidate]:
    rows = np.concatenate([row_of(point) for point in points])
    return seen.candidates(view, rows, np.zeros(len(rows), dtype=bool), False, 0.05)


def test_the_same_open_point_gives_one_subgoal() -> None:
    """Line 7 of MAIN: seen again within 12 cm and with its free side the same way, it is the same; else it is another."""
    seen, view = Traverse(), view_of(np.empty((0, 2)))
    seen.arrive(np.zeros(2))
    (first,) = candidates(seen, view, OpenPoint(np.array([2.0, 0.0]), 0.0, 2.0, 1))
    assert first.point == pytest.approx([2.0, RADIUS])
    assert first.distance == pytest.approx(math.hypot(3.0, RADIUS))
    assert candidates(seen, view, OpenPoint(np.array([2.05, 0.05]), 0.3, 2.0, 1))[0].subgoal == first.subgoal
    others = [(2.2, 0.0, 0.0, 1), (2.0, 0.0, 1.2, 1), (2.0, 0.0, 0.0, -1)]
    found = [candidates(seen, view, OpenPoint(np.array([x, y]), b, 2.0, side))[0].subgoal for x, y, b, side in others]
    assert len({first.subgoal, *found}) == 4


def test_an_end_seen_vaguely_is_the_one_known_better() -> None:
    """A wall's end is somewhere in the next 0.6 m: it is the corner known to lie there, whose place stays. Beyond: another."""
    seen, view = Traverse(), view_of(np.empty((0, 2)))
    seen.arrive(np.zeros(2))
    (sharp,) = candidates(seen, view, OpenPoint(np.array([2.0, 0.0]), 0.0, 2.0, 1))
    vague = OpenPoint(np.array([1.6, 0.0]), 0.0, 1.6, 1, True, 0.1, 0.5, (1.0, 0.0))
    assert candidates(seen, view, vague)[0].subgoal == sharp.subgoal
    assert seen.subgoals[sharp.subgoal].point == pytest.approx(sharp.point)
    seen.close(sharp.subgoal)
    assert candidates(seen, view, vague) == []
    assert candidates(seen, view, replace(vague, beyond=0.2))[0].subgoal != sharp.subgoal


def test_an_unsure_end_is_none_where_the_surface_was_seen_to_go_on() -> None:
    """Oracle: the wall. It is seen from its middle first, then at a grazing angle; where it was not seen it may end."""
    wall = np.stack([np.linspace(0.0, 3.0, 61), np.full(61, -0.3)], axis=1)
    view = view_of(wall)
    unsure = OpenPoint(np.array([2.0, -0.3]), -0.15, 2.0, 1, False, 0.1, 0.2, (1.0, 0.0))
    blank, knows = Traverse(), Traverse()
    blank.arrive(np.zeros(2))
    knows.arrive(np.zeros(2))
    knows.surfaces.remember(wall)
    assert len(candidates(blank, view, unsure)) == 1
    assert candidates(knows, view, unsure) == []
    last = replace(unsure, position=np.array([2.9, -0.3]))
    assert len(candidates(knows, view, last)) == 1


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_surfaces_hold_what_was_seen(points: list[tuple[float, float]], seed: int) -> None:
    """Oracle: a set of cells of 5 cm; scans of many points make the table grow."""
    rng, surfaces = np.random.default_rng(seed), Surfaces()
    hits = np.concatenate([np.array(points), rng.uniform(-30, 30, (4000, 2))])
    cells = {(math.floor(x / 0.05), math.floor(y / 0.05)) for x, y in hits}
    for part in np.array_split(hits, 5):
        surfaces.remember(part)
    asked = np.concatenate([np.array(points), rng.uniform(-30, 30, (200, 2))])
    near = [
        any((math.floor(x / 0.05) + i, math.floor(y / 0.05) + k) in cells for i in (-1, 0, 1) for k in (-1, 0, 1))
        for x, y in asked
    ]
    assert [surfaces.hold(x, y) for x, y in asked] == near


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_candidates_are_those_that_fit(seed: int) -> None:
    """Oracle: the same rules with the view's own tests, one open point after the other; random posts, T and open points."""
    rng, seen = np.random.default_rng(seed), Traverse()
    hits = np.repeat(rng.uniform(-2, 2, (6, 2)), 3, axis=0) + rng.uniform(-0.03, 0.03, (18, 2))
    hits = hits[np.linalg.norm(hits, axis=1) > 0.3]
    view = view_of(hits, goal=tuple(rng.uniform(-3, 3, 2)))
    for place in rng.uniform(-2, 2, (3, 2)):
        seen.arrive(place)
    seen.arrive(np.zeros(2))
    bearings, ranges = np.sort(rng.uniform(-3, 3, 12)), rng.uniform(0.3, 2.5, 12)
    points = [
        OpenPoint(r * np.array([math.cos(b), math.sin(b)]), b, r, int(rng.choice([-1, 1])))
        for b, r in zip(bearings, ranges, strict=True)
    ]
    found = candidates(seen, view, *points)
    width = 2.0 * RADIUS * 1.05
    fitting = []
    for point in points:
        x, y = target = point.subgoal(RADIUS)
        narrow = narrow_gap(hits, 0.0, 0.0, math.atan2(y, x), math.hypot(x, y), width, view.circle.body)
        new = min(math.dist(target, place) for place in seen.points()) >= SAME
        if new and view.reachable(target) and math.isinf(narrow):
            fitting.append(target)
    reached = [tuple(c.point) for c in found]
    assert {tuple(target) for target in fitting} <= set(reached)
    assert {tuple(c.point) for c in found if np.array_equal(c.point, c.way)} <= {tuple(target) for target in fitting}
    assert [c.distance for c in found] == sorted(c.distance for c in found)
    for c in found:  # a detour is beside a corner, and both its parts can be driven
        assert view.reachable(c.way)
        assert replace(view, centre=c.way).reachable(c.point)


@pytest.mark.parametrize(("scenario", "longer"), [("cluttered", 1.3), ("doors", 1.6), ("spiral", 1.15)])
def test_in_physics_it_reaches_the_goal_and_touches_nothing(scenario: str, longer: float) -> None:
    """Shipped scenarios, with noise, slip and encoders; the metrics of the run, its way against the shortest."""
    settings = {"robot.sonars": "none", "robot.lidar": "scan360", "time_limit": 200}
    result = run_in_physics(scenario, navigator="ocpb", settings=settings)
    assert result.status == "success", result.reason
    assert result.value("contacts") == 0
    length, shortest = result.value("path_length"), result.value("shortest_path_length")
    assert length is not None
    assert shortest is not None
    assert length < longer * shortest


@pytest.mark.parametrize("field", ["max_obstacle_width", "tracking_distance", "prediction_horizon", "max_iterations"])
@pytest.mark.parametrize("value", [0, -1, math.nan, math.inf])
def test_senseless_parameters_are_refused(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        OcpbParameters(**{field: value})  # type: ignore[arg-type]
