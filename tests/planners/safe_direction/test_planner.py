"""Safe-direction navigation. Oracles: the paper's equations by hand, naive sums, geometry, a world without physics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import (
    OCCUPIED,
    SE2,
    Belief,
    Drive,
    GiveUp,
    Goal,
    Observation,
    OccupancyGrid,
    ParameterError,
    RangeSensor,
    Robot,
    State,
)
from robocar.planners.safe_direction.fan import Fan, choose, directions, fan, safe_direction, shortest_direction
from robocar.planners.safe_direction.memory import RollingMemory
from robocar.planners.safe_direction.method import Directions, SafeDirectionParameters
from robocar.planners.safe_direction.planner import build, build_with_memory
from robocar.planners.safe_direction.view import DirectionPanorama, Readings, Sector, leading_edges, sector_of, window
from robocar.planners.search.transforms import distance_transform
from tests.planners.kinematic import DT, car, context

from robocar.core import Scan, ScenarioError, Twist  # isort: skip
from robocar.core.rays import cast_rays

BEARINGS = np.radians(np.arange(-180.0, 180.0))
LASER = RangeSensor("laser", SE2(0.03, 0.0), BEARINGS, 0.0, 0.06, 6.0, DT)


def robot(bearings: np.ndarray = BEARINGS) -> Robot:
    """The car with a laser instead of sonars."""
    plain = car(())
    laser = RangeSensor("laser", SE2(0.03, 0.0), bearings, 0.0, 0.06, 6.0, DT)
    return Robot(plain.footprint, plain.limits, plain.calibration, plain.pulses_per_turn, lidar=laser)


def room(*boxes: tuple[float, float, float, float], size: tuple[float, float] = (6.0, 4.0)) -> OccupancyGrid:
    data = np.zeros((round(size[1] / 0.05), round(size[0] / 0.05)), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
    for x0, y0, x1, y1 in boxes:
        data[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = OCCUPIED
    return OccupancyGrid(data, 0.05)


def scan(world: OccupancyGrid, pose: SE2, time: float = 0.0, bearings: np.ndarray = BEARINGS) -> Scan:
    at = pose @ SE2(0.03, 0.0)
    ranges = cast_rays(world, world.occupied, at.position, at.theta + bearings, 6.0)
    return Scan(time, ranges, bearings, 6.0, 0.0, SE2(0.03, 0.0))


def look(world: OccupancyGrid, pose: SE2, parameters: SafeDirectionParameters | None = None) -> tuple[Directions, Readings]:
    p = parameters or SafeDirectionParameters()
    sector = sector_of(robot(), p.view_angle, p.max_range)
    panorama = DirectionPanorama(sector, p.resolution, 0.12)
    assert panorama.look(pose, scan(world, pose), ())
    method = Directions(robot(), sector, p)
    return method, method.readings(pose, panorama)


# -- the fan and the choice -------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 30.0))
@settings(max_examples=50, deadline=None)
def test_totals_are_the_sums_of_equation_3(seed: int, reach: float) -> None:
    """Oracle: the walk along each direction in steps of half a cell, in plain Python."""
    rng = np.random.default_rng(seed)
    clearance = rng.uniform(-0.3, 5.0, (20, 24))
    x, y = rng.uniform(2.0, 18.0, 2)
    headings = directions(rng.uniform(-4, 4), math.tau, 19)
    found = fan(headings, clearance, (x, y), 0.1 * reach, 0.1, True)
    for k, heading in enumerate(headings):
        total, length = 0.0, 0.0
        for i in range(1, int(2 * reach) + 1):
            row, col = math.floor(y + 0.5 * i * math.sin(heading)), math.floor(x + 0.5 * i * math.cos(heading))
            if not (0 <= row < 20 and 0 <= col < 24) or clearance[row, col] <= 0.0:
                break
            total, length = total + 0.5 * clearance[row, col], 0.5 * i
        assert found.totals[k] == pytest.approx(0.01 * total)
        assert found.lengths[k] == pytest.approx(0.1 * length)


def hand_made(totals: dict[float, float], lengths: float | np.ndarray = 3.0) -> Fan:
    """A fan of 181 directions ahead (heading 0) with given N at some degrees, 1 elsewhere."""
    degrees = np.arange(-90.0, 91.0)
    values = np.ones(181)
    for at, value in totals.items():
        values[degrees == at] = value
    return Fan(np.radians(degrees), np.broadcast_to(lengths, 181).copy(), values, False)


@pytest.mark.parametrize("alpha", [0.0, 0.2, 0.6, 1.0])
def test_the_target_lies_on_the_sum_of_unit_vectors(alpha: float) -> None:
    """Equation 6 by hand: safest at 50 degrees, shortest at -10."""
    choice = choose(hand_made({50.0: 3.0}), math.radians(-10.0), False, alpha, 1.0)
    safe, short = np.radians([50.0, -10.0])
    expected = math.atan2(
        alpha * math.sin(safe) + (1 - alpha) * math.sin(short), alpha * math.cos(safe) + (1 - alpha) * math.cos(short)
    )
    assert choice.heading == pytest.approx(expected)
    assert choice.safe == pytest.approx(safe)
    assert choice.alpha == alpha
    assert choice.ratio == pytest.approx(1 / 3)


def test_a_shortest_direction_that_is_safe_enough_is_taken() -> None:
    """Equations 15 and 16: N of 2.9 against 3 is more than 0.95 of it, and less than 0.98."""
    found = hand_made({50.0: 3.0, -10.0: 2.9})
    assert choose(found, math.radians(-10.0), False, 0.6, 0.95).heading == pytest.approx(math.radians(-10.0))
    assert choose(found, math.radians(-10.0), False, 0.6, 0.95).alpha == 0.0
    assert choose(found, math.radians(-10.0), False, 0.6, 0.98).alpha == 0.6


def test_out_of_the_sector_it_turns_and_does_not_advance() -> None:
    """Equations 10 to 13."""
    choice = choose(hand_made({}), 2.5, True, 0.6, 0.95)
    assert choice.turn
    assert choice.length == 0.0
    assert choice.heading == 2.5


def test_the_safest_direction_is_on_this_side_of_a_post() -> None:
    """A post at 20 to 25 degrees, 0.4 m off, hides the larger N at 50 degrees from a shortest direction at 0; farther off not."""
    degrees = np.arange(-90.0, 91.0)
    post = (degrees >= 20) & (degrees <= 25)
    near, far = (hand_made({50.0: 3.0, -30.0: 2.0}, np.where(post, d, 3.0)) for d in (0.4, 1.5))
    assert degrees[safe_direction(near, 0.0, math.pi, 1.0)] == -30.0
    assert degrees[safe_direction(far, 0.0, math.pi, 1.0)] == 50.0


@given(st.floats(-3.1, 3.1), st.floats(0.0, 1.0), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_the_way_always_leads_on(shortest: float, alpha: float, seed: int) -> None:
    """Property: within half a circle around p_D, P keeps 1 - alpha of it: P . u_D >= 1 - alpha, whatever the totals."""
    rng = np.random.default_rng(seed)
    found = Fan(directions(0.3, math.tau, 181), rng.uniform(0.0, 3.0, 181), rng.uniform(0.0, 2.0, 181), True)
    choice = choose(found, shortest, False, alpha, 1.0, math.pi, 0.0)
    safe = math.cos(choice.safe - shortest)
    assert choice.alpha * safe + (1.0 - choice.alpha) >= 1.0 - alpha - 1e-9


# -- transforms and directions ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0, 17, 45, 100, -160])
def test_in_the_open_the_shortest_direction_is_the_goals(degrees: int) -> None:
    """The goal lies 20 m away, far outside the grid of 6 m."""
    world = OccupancyGrid(np.zeros((10, 10), dtype=np.int8), 0.05, SE2(50.0, 50.0))
    method, seen = look(world, SE2(1.0, 2.0, 0.4))
    heading = math.radians(degrees)
    decision = method.decide(seen, 0.4, np.array([1.0 + 20 * math.cos(heading), 2.0 + 20 * math.sin(heading)]))
    assert decision.choice is not None
    assert abs(math.remainder(decision.choice.shortest - heading, math.tau)) < math.radians(2.0)


def test_the_shortest_direction_leads_past_the_end_of_a_wall() -> None:
    """Geometry: the goal straight behind a wall that ends 1 m to the left; the way touches the grown end of it."""
    blocked = np.zeros((81, 81), dtype=bool)
    blocked[10:61, 60] = True  # its end 20 cells above the robot's row, 19.5 cells ahead
    distance = distance_transform(blocked, np.array([40.5, 78.5]), "euclidean")
    heading = shortest_direction(distance, 40.5, 40.5, (78.5, 40.5), 60.0)
    assert heading is not None
    assert math.degrees(heading) == pytest.approx(math.degrees(math.atan2(20.5, 20.0)), abs=3.0)


def test_no_way_is_no_direction() -> None:
    blocked = np.zeros((41, 41), dtype=bool)
    blocked[[10, 30], 10:31] = blocked[10:31, [10, 30]] = True
    distance = distance_transform(blocked, (2, 2), "euclidean")
    assert shortest_direction(distance, 20.5, 20.5, (2.5, 2.5), 15.0) is None


# -- one scan, two readings -------------------------------------------------------------------------------------------------


def test_behind_a_box_is_unseen_for_one_reading_and_free_for_the_other() -> None:
    """Fig. 1: a box ahead; its face is occupied, before it is free, behind it nothing is known; what is free is truly free."""
    world = room((2.5, 1.5, 3.0, 2.5))
    _, seen = look(world, SE2(1.5, 2.0))
    face, before, behind = (tuple(seen.grid.cell_from_world(p)) for p in ([2.53, 2.0], [2.2, 2.0], [3.3, 2.0]))
    assert seen.occupied[face]
    assert seen.free[before]
    assert not seen.free[behind]
    assert not seen.occupied[behind]
    points = seen.grid.world_from_cell(np.argwhere(seen.free))
    cells = world.cell_from_world(points)
    inside = world.contains(cells)
    assert inside.mean() > 0.99
    assert not world.occupied[tuple(cells[inside].T)].any()
    assert not (seen.free & seen.occupied).any()


@given(st.floats(0.4, 5.6), st.floats(0.4, 3.6), st.floats(-3.1, 3.1))
@settings(max_examples=40, deadline=None)
def test_surfaces_are_where_they_are(x: float, y: float, theta: float) -> None:
    """Property: each occupied cell is within a cell and a half of one of the room's walls."""
    world = room()
    _, seen = look(world, SE2(x, y, theta))
    points = seen.grid.world_from_cell(np.argwhere(seen.occupied))
    off = np.minimum.reduce(
        [abs(points[:, 0] - 0.025), abs(points[:, 0] - 5.975), abs(points[:, 1] - 0.025), abs(points[:, 1] - 3.975)]
    )
    assert len(off) > 20
    assert off.max() < 0.075


def test_a_panorama_grows_while_the_robot_turns_and_is_dropped_when_it_drives() -> None:
    """A sector of 90 degrees that is turned by 90 has seen half a circle; half a metre on it has seen a quarter again."""
    world = room()
    panorama = DirectionPanorama(Sector(math.pi / 2, 3.0), 0.05, 0.12)
    seen = []
    for pose in (SE2(3.0, 2.0, 0.0), SE2(3.0, 2.0, math.pi / 2), SE2(3.5, 2.0, math.pi / 2)):
        panorama.look(pose, scan(world, pose), ())
        seen.append(np.isfinite(panorama.ranges).mean())
    assert seen == pytest.approx([0.25, 0.5, 0.25], abs=0.02)


def test_what_moves_has_leading_edges() -> None:
    """A box that has moved 0.15 m towards the car; nothing where only the car has moved."""
    _, before = look(room((3.0, 1.8, 3.3, 2.2)), SE2(1.5, 2.0))
    _, after = look(room((2.85, 1.8, 3.15, 2.2)), SE2(1.5, 2.0))
    _, moved = look(room((3.0, 1.8, 3.3, 2.2)), SE2(1.62, 2.03, 0.2))
    edges = after.grid.world_from_cell(leading_edges(before, after))
    assert len(edges) >= 5
    assert np.all((abs(edges[:, 0] - 2.875) < 0.08) & (abs(edges[:, 1] - 2.0) < 0.3))
    assert len(leading_edges(before, moved)) == 0


def test_the_memory_keeps_what_is_out_of_sight_and_forgets_what_is_far() -> None:
    """A post passed by stays, on the same place; half the memory's side away it is forgotten; seen gone it is taken back."""
    memory, post = RollingMemory(6.0, 0.05), np.array([2.02, 2.02])

    def seen(pose: SE2, occupied: bool) -> Readings:
        grid = window(pose, 1.0, 0.05)
        free, full = np.zeros(grid.shape, dtype=bool), np.zeros(grid.shape, dtype=bool)
        free[1:-1, 1:-1] = True
        cell = tuple(grid.cell_from_world(post))
        if occupied:
            free[cell], full[cell] = False, True
        return Readings(grid, free, full, *(grid.grid_from_world(pose.position).tolist()))

    def remembered(found: Readings) -> bool:
        return bool(found.occupied[tuple(found.grid.cell_from_world(post))])

    assert remembered(memory.merge(SE2(1.7, 2.0), seen(SE2(1.7, 2.0), True)))
    assert remembered(memory.merge(SE2(4.0, 2.0), seen(SE2(4.0, 2.0), False)))
    gone = [remembered(memory.merge(SE2(1.7, 2.0), seen(SE2(1.7, 2.0), False))) for _ in range(4)]
    assert gone[0]
    assert not gone[-1]
    memory.merge(SE2(1.7, 2.0), seen(SE2(1.7, 2.0), True))
    memory.merge(SE2(7.0, 2.0), seen(SE2(7.0, 2.0), False))
    assert not remembered(memory.merge(SE2(4.2, 2.0), seen(SE2(4.2, 2.0), False)))


# -- the navigator in a world without physics -----------------------------------------------------------------------------------


def episode(navigator, world: OccupancyGrid, start: SE2, goal: Goal, ticks: int = 1500):
    """The loop with the truth as belief; returns the poses and the last command."""
    pose, poses, command = start, [start], None
    for tick in range(ticks):
        observation = Observation(tick * DT, lidar=scan(world, pose, tick * DT))
        command = navigator.command(State.of(Belief(pose)), observation, goal)
        if isinstance(command, GiveUp) or goal.reached(pose):
            break
        pose = pose @ command.twist.step(DT)
        poses.append(pose)
    return poses, command


@pytest.mark.parametrize("make", [build, build_with_memory])
def test_a_goal_in_an_obstacle_is_approached_and_given_up_with_a_reason(make) -> None:
    """The goal lies in the face of a wall: the car gets within half a metre, touches nothing and says why it stops."""
    world = room((4.0, 0.0, 4.3, 4.0))
    poses, command = episode(make(context(robot(), None)), world, SE2(1.0, 2.0), Goal(np.array([4.02, 2.3])))
    assert isinstance(command, GiveUp)
    assert "lies in an obstacle" in command.reason
    assert math.dist(poses[-1].position, (4.02, 2.3)) < 0.5
    assert max(pose.x for pose in poses) < 4.0 - 0.1


@pytest.mark.parametrize("make", [build, build_with_memory])
def test_with_all_beams_lost_it_stands(make) -> None:
    navigator = make(context(robot(), None))
    lost = Scan(0.0, np.full(360, math.nan), BEARINGS, 6.0, 0.0, SE2(0.03, 0.0))
    command = navigator.command(State.of(Belief(SE2(1.0, 2.0))), Observation(0.0, lidar=lost), Goal(np.array([4.0, 2.0])))
    assert isinstance(command, Drive)
    assert command.twist == Twist()
    assert "beams are lost" in command.trace["safe_direction"].message


def test_walled_in_it_waits_and_says_so() -> None:
    world = room(size=(2.5, 2.5))
    _, command = episode(build(context(robot(), None)), world, SE2(1.2, 1.2), Goal(np.array([6.0, 1.2])))
    assert isinstance(command, GiveUp)
    assert command.status == "stuck"
    assert "all round" in command.reason


def test_a_silent_laser_stops_the_car_though_its_sonars_speak() -> None:
    both = robot()
    mixed = Robot(both.footprint, both.limits, both.calibration, 200, car().sonars, both.lidar)
    navigator, world, goal = build(context(mixed, None)), room(), Goal(np.array([5.0, 2.0]))
    pose = SE2(1.0, 2.0)
    first = navigator.command(State.of(Belief(pose)), Observation(0.0, lidar=scan(world, pose)), goal)
    sonar = Scan(1.0, np.array([2.0]), np.zeros(1), 4.0, 0.26, SE2(0.1, 0.0))
    later = navigator.command(State.of(Belief(pose)), Observation(1.0, sonars=(sonar,)), goal)
    assert first.twist != Twist()  # type: ignore[union-attr]
    assert later.twist == Twist()  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("name", "value"),
    [("alpha", 1.1), ("alpha", -0.1), ("alpha", math.nan), ("delta", 0.0), ("delta", 1.5), ("view_angle", 0.0),
     ("view_angle", 7.0), ("max_range", 0.0), ("max_range", math.inf), ("number_of_directions", 2), ("resolution", 0.0),
     ("metric", "manhattan"), ("step_share", 1.0), ("memory_size", 1.0), ("padding", -1.0), ("patience", 0.0),
     ("safe_sector", 0.0), ("safe_range", 0.0)],
)  # fmt: skip
def test_parameters_out_of_range_name_themselves(name: str, value: object) -> None:
    with pytest.raises(ParameterError, match=name):
        build(context(robot(), None, None, **{name: value}))


def test_without_a_range_sensor_it_cannot_be_built() -> None:
    with pytest.raises(ScenarioError, match=r"robot\.lidar"):
        build(context(car(()), None))


def test_sectors_of_the_sensors() -> None:
    """By hand: a full turn; 205 degrees; a ring; the two front cones of 15 degrees at 0.2 rad; never more than asked for."""
    fan205 = np.radians(np.linspace(-102.5, 102.5, 570))
    assert sector_of(robot(), math.tau, 3.0) == Sector(math.tau, 3.0)
    assert sector_of(robot(fan205), math.tau, 9.0).width == pytest.approx(math.radians(205.0))
    assert sector_of(robot(fan205), math.pi, 9.0) == Sector(math.pi, 6.0)
    ring = car(tuple(SE2(0.0, 0.0, k * math.tau / 16 - math.pi) for k in range(16)))
    assert sector_of(ring, math.tau, 3.0).whole
    assert sector_of(car(), math.tau, 3.0).width == pytest.approx(0.4 + math.radians(15.0))
