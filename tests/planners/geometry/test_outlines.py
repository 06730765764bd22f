"""The costmap seen from the robot.

Oracles: what was asked for, bit by bit; the same place with its wall drawn as cells.
"""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import (
    LETHAL,
    OCCUPIED,
    SE2,
    Belief,
    Costmap,
    Footprint,
    GiveUp,
    Goal,
    Observation,
    OccupancyGrid,
    Path,
    Scan,
    State,
)  # fmt: skip
from robocar.core.distance import ClearanceField
from robocar.planners.controllers.pure_pursuit import PurePursuit
from robocar.planners.costmap.layered import CostmapParameters, LayeredCostmap
from robocar.planners.costmap.rolling import RollingCostmap, RollingCostmapParameters
from robocar.planners.geometry.collision import footprint_free
from robocar.planners.geometry.line_of_sight import segment_cost
from robocar.planners.geometry.outlines import SLIP, CostmapView, Outlines
from robocar.planners.search.obstacle_memory import ObstacleMemory
from tests.planners.kinematic import car

RESOLUTIONS = st.floats(0.005, 0.5) | st.sampled_from([0.039, 0.05, 0.078, 0.1])
LENGTHS = st.floats(-2.0, 2.0).filter(lambda length: abs(length) > 1e-4)


def view_of(costmap: Costmap, pose: SE2, outline: np.ndarray) -> CostmapView:
    at, r, reach = costmap.origin.inverse() @ pose, costmap.resolution, float(np.linalg.norm(outline, axis=1).max())
    return CostmapView(costmap.data, r, at.x / r, at.y / r, at.theta, outline / r, reach, walled=costmap.walled)


@settings(max_examples=300, deadline=None)
@given(RESOLUTIONS, LENGTHS, st.floats(-5.0, 5.0), st.floats(0.01, 0.2), st.floats(0.01, 0.4))
def test_what_is_free_is_exactly_what_was_asked_for(
    resolution: float, length: float, curvature: float, period: float, speed: float
) -> None:
    """Metres to cells and back lose a bit, so a caller that compares would be told now and then that the way is shorter."""
    view = CostmapView(np.zeros((3, 3), dtype=np.uint8), resolution, 1.5, 1.5, 0.3, car().footprint.vertices / resolution, 0.15)
    assert view.free_arc(curvature, length)[0] == abs(length)
    braking = speed * period + speed**2 / 1.6
    assert view.free_arc(curvature, braking)[0] >= braking
    wall = np.full((3, 3), LETHAL, dtype=np.uint8)
    blocked = CostmapView(wall, resolution, 1.5, 1.5, 0.3, car().footprint.vertices / resolution, 0.15)
    assert blocked.free_arc(curvature, length)[0] == 0.0


def walled_and_drawn(rng: np.random.Generator) -> tuple[OccupancyGrid, OccupancyGrid]:
    """A random map whose wall is its border alone, and the same with a ring of occupied cells around it."""
    shape = rng.integers(4, 14, 2)
    data = np.where(rng.random(shape) < 0.06, OCCUPIED, 0).astype(np.int8)
    resolution, origin = float(rng.choice([0.039, 0.05, 0.1])), SE2(*rng.uniform(-3, 3, 3))
    ring = np.pad(data, 1, constant_values=OCCUPIED)
    return OccupancyGrid(data, resolution, origin), OccupancyGrid(ring, resolution, origin @ SE2(-resolution, -resolution))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_border_of_a_known_map_is_the_wall_that_physics_builds_there(seed: int) -> None:
    """The outline, arcs, turns, lines of sight and costs: all as if the wall were drawn; so does `ClearanceField` on the ring."""
    rng = np.random.default_rng(seed)
    bare, drawn = walled_and_drawn(rng)
    parameters = CostmapParameters(resolution=bare.resolution, allow_unknown=bool(rng.integers(2)))
    a, b = (LayeredCostmap(grid, car(), parameters).costmap() for grid in (bare, drawn))
    assert np.array_equal(a.data, b.data[1:-1, 1:-1])
    walls = ClearanceField(drawn, drawn.occupied)
    for _ in range(20):
        pose = bare.origin @ SE2(rng.uniform(0, bare.size[0]), rng.uniform(0, bare.size[1]), rng.uniform(-4, 4))
        outline = np.array(Footprint.rectangle(*rng.uniform(0.02, 0.2, 3)).vertices)
        here, there = view_of(a, pose, outline), view_of(b, pose, outline)
        free = footprint_free(a.data, here.x, here.y, here.theta, here.outline, a.walled)
        gap = walls.footprint(pose.transform(outline))
        assert free == (gap > 0.0) or gap < 1e-9
        curvature, length, angle = rng.uniform(-5, 5), rng.uniform(-0.6, 0.6), rng.uniform(-3, 3)
        if free:
            np.testing.assert_allclose(here.free_arc(curvature, length)[0], there.free_arc(curvature, length)[0], atol=1e-9)
            assert here.free_turn(angle) == there.free_turn(angle)
        end = rng.uniform(-1, np.array(bare.shape[::-1]) + 1)
        cost = segment_cost(a.data, here.x, here.y, *end)
        np.testing.assert_allclose(cost, segment_cost(b.data, there.x, there.y, *(end + 1)), rtol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_memory_of_dynamic_a_star_knows_the_border(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bare, drawn = walled_and_drawn(rng)
    a, b = (ObstacleMemory(grid.origin, grid.size, grid, 0.08) for grid in (bare, drawn))
    for _ in range(20):
        start, end = (bare.origin.transform(rng.uniform((0.0, 0.0), bare.size)) for _ in range(2))
        radius = rng.uniform(0.02, 0.3)
        assert a.disc_blocked((start[0], start[1]), radius) == b.disc_blocked((start[0], start[1]), radius)
        assert a.way_blocked(start, end, radius, 0.1) == b.way_blocked(start, end, radius, 0.1)


def test_the_edge_of_a_window_is_no_wall() -> None:
    """A window that rolls along ends where nothing is known, wherever it ends; a robot without a map knows no border either."""
    robot, far = car(), SE2(20.0, 20.0, 0.4)
    room = OccupancyGrid(np.zeros((800, 800), dtype=np.int8), 0.05)
    narrow = RollingCostmapParameters(local_width=0.5)
    for layer in (RollingCostmap(room, robot, parameters=narrow), RollingCostmap(None, robot), LayeredCostmap(None, robot)):
        layer.update(far, Observation(0.0, lidar=Scan(0.0, np.array([np.inf]), np.array([0.0]), 5.0, 0.0)))
        view = Outlines(robot.footprint, 0.01).views(layer.costmap(), far)[0]
        assert view.free_arc(0.0, 30.0)[0] == 30.0
        assert view.free_turn(math.tau)


def test_at_the_border_of_the_prior_map_the_window_has_its_wall() -> None:
    """Seen from a window too, in which the map lies shifted and turned."""
    robot, room = car(), OccupancyGrid(np.zeros((60, 100), dtype=np.int8), 0.05)
    for map_from_odom in (SE2(), SE2(0.4, -0.3, 0.7)):
        layer = RollingCostmap(room, robot)
        pose = map_from_odom.inverse() @ SE2(4.5, 1.5, 0.0)
        layer.update(pose, Observation(0.0), map_from_odom)
        free = Outlines(robot.footprint, 0.0).views(layer.costmap(), pose)[0].free_arc(0.0, 3.0)[0]
        assert 0.3 <= free <= 0.4 + 1e-9  # the nose is 0.1 m ahead; turned cells reach 0.04 m out of the wall


def distance_to_edges(polygon: np.ndarray, point: np.ndarray) -> float:
    """From a point inside a convex polygon to its nearest edge."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    edges = b - a
    away = edges[:, 0] * (point - a)[:, 1] - edges[:, 1] * (point - a)[:, 0]
    return float((away / np.linalg.norm(edges, axis=1)).min())


@settings(max_examples=60, deadline=None)
@given(st.integers(3, 9), st.floats(0.0, 0.1), st.integers(0, 2**32 - 1))
def test_padding_is_a_distance_to_the_edges(corners: int, margin: float, seed: int) -> None:
    """Not a scale: every corner of the outline is `margin` off the padded one, and every edge of it is."""
    rng = np.random.default_rng(seed)
    angles = (np.arange(corners) + rng.uniform(-0.2, 0.2, corners)) * math.tau / corners
    footprint = Footprint(np.stack([0.3 * np.cos(angles), 0.1 * np.sin(angles)], axis=1))
    padded = footprint.padded(margin)
    gaps = [distance_to_edges(padded.vertices, corner) for corner in footprint.vertices]
    np.testing.assert_allclose(gaps, margin, atol=1e-12)
    np.testing.assert_allclose(padded.inscribed_radius, footprint.inscribed_radius + margin, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_tightest_outline_keeps_off_by_slip(seed: int) -> None:
    """Oracle: exact distances along the arc, sampled finely. Where the robot stands nearer than that already, it comes no nearer
    than a quarter of `SLIP`."""
    rng = np.random.default_rng(seed)
    data = np.where(rng.random((40, 40)) < 0.03, OCCUPIED, 0).astype(np.int8)
    grid, robot = OccupancyGrid(data, 0.05), car()
    walls = ClearanceField(grid, grid.occupied)
    costmap = Costmap(np.where(grid.occupied, np.uint8(LETHAL), np.uint8(0)), 0.05)
    for _ in range(8):
        pose = SE2(*rng.uniform(0.5, 1.5, 2), rng.uniform(-3, 3))
        here = walls.footprint(pose.transform(robot.footprint.vertices))
        view = Outlines(robot.footprint, 0.01).views(costmap, pose)[-1]
        curvature, length = float(rng.uniform(-6, 6)), float(rng.uniform(0.05, 0.5))
        free = view.free_arc(curvature, length)[0]
        least = here
        for s in np.linspace(0.0, free, 60):
            turn = curvature * s
            chord = s * np.sinc(turn / math.tau)
            at = pose @ SE2(chord * math.cos(turn / 2), chord * math.sin(turn / 2), turn)
            least = min(least, walls.footprint(at.transform(robot.footprint.vertices)))
        promised = SLIP if here >= SLIP * math.sqrt(2.0) else here / math.sqrt(2.0) - 0.25 * SLIP
        assert here == 0.0 or least >= promised - 0.002


def test_too_tight_is_said_and_nothing_is_touched() -> None:
    """A corridor of a few millimetres more than the outline is wide: the robot does not drive into it."""
    costs = np.zeros((200, 400), dtype=np.uint8)
    robot, r = car(), 0.005
    half = round((robot.footprint.inscribed_radius + 0.4 * SLIP) / r)
    costs[:, 200:240] = LETHAL
    costs[100 - half : 100 + half, 200:240] = 0
    costmap, follower, pose = Costmap(costs, r), PurePursuit(robot, 0.05), SE2(0.5, 0.5, 0.0)
    path = Path(np.array([[0.5, 0.5], [1.8, 0.5]]))
    said = None
    for tick in range(1200):
        command = follower.command(
            State.of(Belief(pose)), path, costmap, Observation(0.05 * tick), Goal(np.array([1.8, 0.5]), None, 0.1)
        )
        if isinstance(command, GiveUp):
            said = command
            break
        v, omega = command.twist.v, command.twist.omega
        pose = pose @ SE2(0.05 * v, 0.0, 0.05 * omega)
        assert pose.x + 0.11 < 1.0  # the posts' face
    assert said is not None
    assert said.status == "stuck"
    assert "too tight" in said.reason
