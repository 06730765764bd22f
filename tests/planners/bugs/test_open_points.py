"""Open points, sub-goals and the virtual circle. Oracles: eq. 1-6 of the paper, the world's corners, the rules with numpy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import OCCUPIED, SE2, Footprint, Observation, OccupancyGrid, ParameterError, Robot, Scan
from robocar.core.rays import cast_rays
from robocar.planners.bugs.open_points import OpenPoint, VirtualCircle, find_open_points, open_point_rows
from robocar.planners.tracking.panorama import ScanPanorama, Surround, middle
from tests.planners.beams import MAX_RANGE, laser_car, scan_of
from tests.planners.bugs import open_points_reference as reference
from tests.planners.kinematic import car

WIDE = math.radians(25.0)
BOXES = ((1.5, 1.5, 2.2, 2.0), (4.0, 1.0, 4.4, 2.8), (2.5, 3.6, 3.8, 4.2), (4.6, 4.4, 5.0, 4.8), (0.8, 3.2, 1.1, 4.6))


def world() -> OccupancyGrid:
    data = np.zeros((120, 120), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
    for x0, y0, x1, y1 in BOXES:
        data[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = OCCUPIED
    return OccupancyGrid(data, 0.05)


def corners() -> np.ndarray:
    return np.array([(x, y) for x0, y0, x1, y1 in BOXES for x in (x0, x1) for y in (y0, y1)])


def panorama_of(ranges: np.ndarray) -> ScanPanorama:
    n = len(ranges)
    return ScanPanorama(0.0, np.zeros(2), np.linspace(-math.pi, math.pi, n, endpoint=False), ranges, MAX_RANGE, math.tau / n)


@given(st.floats(-7, 7), st.floats(0.1, 6), st.sampled_from([-1, 1]), st.floats(0.05, 1))
def test_a_subgoal_lies_beside_its_open_point_on_the_free_side(bearing: float, distance: float, side: int, radius: float) -> None:
    """Eq. 4 and 5: at r from it, perpendicular to the line from the sensor; counter-clockwise of it for side 1."""
    position = distance * np.array([math.cos(bearing), math.sin(bearing)])
    beside = OpenPoint(position, bearing, distance, side).subgoal(radius) - position
    assert math.hypot(*beside) == pytest.approx(radius)
    assert beside @ position == pytest.approx(0.0, abs=1e-9)
    assert np.sign(position[0] * beside[1] - position[1] * beside[0]) == side


def test_the_virtual_circle_of_a_rectangle() -> None:
    """By hand: half the diagonal of 0.4 x 0.3 m is 0.25 m; the centre lies 0.05 m ahead of the axle."""
    circle = VirtualCircle.of(Footprint.rectangle(front=0.25, rear=0.15, half_width=0.15), 0.02)
    assert circle.radius == pytest.approx(0.27)
    assert circle.body == pytest.approx(0.25)
    assert circle.offset == pytest.approx((0.05, 0.0))


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3))
def test_the_axle_is_where_the_circle_wants_it(x: float, y: float, heading: float) -> None:
    """Eq. 6 and its inverse: a robot whose axle is there has its circle's centre at the point."""
    circle = VirtualCircle.of(Footprint.rectangle(front=0.25, rear=0.15, half_width=0.15), 0.02)
    axle = circle.axle(np.array([x, y]), heading)
    assert circle.centre(SE2(axle[0], axle[1], heading)) == pytest.approx([x, y])


def look(surround: Surround, grid: OccupancyGrid, robot: Robot, rng: np.random.Generator) -> ScanPanorama:
    """A scan without noise from somewhere at random between the boxes."""
    while True:
        x, y = rng.uniform(0.3, 5.7, 2)
        if not any(x0 - 0.3 < x < x1 + 0.3 and y0 - 0.3 < y < y1 + 0.3 for x0, y0, x1, y1 in BOXES):
            break
    pose = SE2(x, y, rng.uniform(-3, 3))
    seen = surround.panorama(Observation(0.0, lidar=scan_of(robot, grid, pose, 0.0)), pose)
    assert seen is not None
    return seen


def test_open_points_of_scans_without_noise_are_corners() -> None:
    """Oracle: the boxes' corners in sight, in 99 % of cases within 5 cm or one spacing of the beams on that surface."""
    grid, robot, rng = world(), laser_car(), np.random.default_rng(3)
    surround, near, count = Surround(robot, WIDE), 0, 0
    while count < 600:
        seen = look(surround, grid, robot, rng)
        hits = seen.origin + seen.ranges[:, None] * np.stack([np.cos(seen.bearings), np.sin(seen.bearings)], axis=1)
        for point in find_open_points(seen, 0.2, 0.01):
            if point.sure:
                # The last two beams on the surface: how far apart they meet it.
                turned = np.remainder(point.side * (point.bearing - seen.bearings), math.tau)
                last, before = np.argsort(turned)[:2]
                spacing = math.dist(hits[last], hits[before])
                count += 1
                near += np.linalg.norm(corners() - point.position, axis=1).min() <= max(0.05, spacing)
    assert near / count >= 0.99


def test_open_points_whose_place_the_beams_tell_are_corners() -> None:
    """Oracle: the boxes' corners, in 99 % of cases within 5 cm or range times the angle between beams. In 97 % of all cases the
    corner lies that near to the stretch in which its end is said to lie."""
    grid, robot, rng = world(), laser_car(), np.random.default_rng(5)
    surround, told, inside = Surround(robot, WIDE), [], []
    while len(inside) < 500:
        seen = look(surround, grid, robot, rng)
        for point in (p for p in find_open_points(seen, 0.2, 0.01) if p.sure):
            tolerance = max(0.05, point.range * seen.spacing)
            stretch = point.position + np.linspace(-point.before, point.beyond, 50)[:, None] * np.array(point.along)
            inside.append(np.linalg.norm(corners()[:, None] - stretch, axis=2).min() <= tolerance)
            if max(point.before, point.beyond) <= tolerance:
                told.append(np.linalg.norm(corners() - point.position, axis=1).min() <= tolerance)
    assert len(told) > 0.6 * len(inside)
    assert np.mean(told) >= 0.99
    assert np.mean(inside) >= 0.97


def test_corners_that_hide_something_are_found() -> None:
    """Oracle: rays 0.01 degrees apart; a jump of over 0.4 m at less than 60 degrees from the surface's normal is seen."""
    grid, robot, rng = world(), laser_car(), np.random.default_rng(4)
    surround, found, count = Surround(robot, WIDE), 0, 0
    fine = np.linspace(-math.pi, math.pi, 36000, endpoint=False)
    while count < 150:
        x, y = rng.uniform(0.3, 5.7, 2)
        if any(x0 - 0.3 < x < x1 + 0.3 and y0 - 0.3 < y < y1 + 0.3 for x0, y0, x1, y1 in BOXES):
            continue
        pose = SE2(x, y, 0.0)
        seen = surround.panorama(Observation(0.0, lidar=scan_of(robot, grid, pose, 0.0)), pose)
        assert seen is not None
        points = np.array([point.position for point in find_open_points(seen, 0.2, 0.01)]).reshape(-1, 2)
        ranges = cast_rays(grid, grid.occupied, (x, y), fine, MAX_RANGE)
        for k in np.flatnonzero(np.roll(ranges, -1) > ranges + 0.4):
            grazing = ranges[k] - ranges[k - 100] > 2.0 * ranges[k] * math.radians(1.0)
            beyond = np.take(ranges, range(k + 1, k + 200), mode="wrap").min() > ranges[k] + 0.2  # a beam passes for sure
            if grazing or not beyond or ranges[k - 200] > ranges[k] + 0.2 or ranges[k] > MAX_RANGE - 0.4:
                continue
            corner = np.array([x, y]) + ranges[k] * np.array([math.cos(fine[k]), math.sin(fine[k])])
            count += 1
            found += np.linalg.norm(points - corner, axis=1).min(initial=9.0) <= max(0.08, 2 * ranges[k] * math.radians(1.0))
    assert found / count >= 0.99


@pytest.mark.parametrize("width", [0.6, 1.0, 2.0])
def test_noise_on_long_walls_makes_no_open_points(width: float) -> None:
    """A corridor without end, seen with the laser's noise: its ranges jump by metres from beam to beam, and nothing ends."""
    rng, bearings = np.random.default_rng(0), panorama_of(np.ones(360)).bearings
    with np.errstate(divide="ignore"):
        clean = 0.5 * width / np.abs(np.sin(bearings))
    phantoms = 0
    for _ in range(200):
        noisy = clean + rng.normal(0.0, 0.01, 360)
        seen = panorama_of(np.where(noisy > MAX_RANGE, np.inf, noisy))
        phantoms += sum(point.sure for point in find_open_points(seen, 0.2, 0.01))
    assert phantoms <= 2  # of 800 ends of the visible walls


@pytest.mark.parametrize("thin", [True, False], ids=["laser", "sonar"])
@pytest.mark.parametrize("std", [0.0005, 0.01, 0.05])
def test_open_points_are_those_of_the_rules_with_numpy(thin: bool, std: float) -> None:
    """Oracle: the same rules with least squares by numpy; noisy scans among the boxes, or ranges at random, with lost beams."""
    grid, rng, count, unsure = world(), np.random.default_rng(7), 0, 0
    for k in range(90):
        n = int(rng.choice([3, 5, 16, 60, 360]))
        bearings = np.linspace(-math.pi, math.pi, n, endpoint=False) + rng.uniform(-4.0, 4.0)
        origin = rng.uniform(0.3, 5.7, 2)
        if k % 3:
            ranges = cast_rays(grid, grid.occupied, origin, bearings, 4.0) + rng.normal(0.0, std, n)
        else:
            ranges = rng.choice([0.5, 1.0, 1.3, 4.5], n) + rng.normal(0.0, std, n)
        ranges = np.where(ranges > 4.0, math.inf, np.maximum(ranges, 0.0))
        for start, lost in zip(rng.integers(n, size=n // 12), rng.integers(1, 8, n // 12), strict=True):
            ranges[np.arange(start, start + lost) % n] = math.nan
        seen = ScanPanorama(0.0, origin, bearings, ranges, 4.0, math.tau / n, thin)
        found, expected = open_point_rows(seen, 0.2, std), reference.rows(seen, 0.2, std)
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)
        count, unsure = count + len(found), unsure + np.count_nonzero(found[:, 5] == 0.0)
    assert count > 500
    assert (unsure > 5) == thin


def test_lost_beams_do_not_matter_and_unseen_directions_have_no_ends() -> None:
    """A post 1 m away before a wall at 3 m: two open points, with single beams lost too; none where the scan has a gap."""
    ranges = np.full(360, 3.0)
    ranges[170:191] = 1.0
    whole = find_open_points(panorama_of(ranges), 0.2, 0.01)
    assert [point.side for point in whole] == [-1, 1]
    some = ranges.copy()
    some[[175, 180, 40, 250]] = np.nan
    again = find_open_points(panorama_of(some), 0.2, 0.01)
    assert [point.bearing for point in again] == pytest.approx([point.bearing for point in whole])
    gap = ranges.copy()
    gap[186:240] = np.nan
    assert [point.side for point in find_open_points(panorama_of(gap), 0.2, 0.01)] == [-1]


def test_without_an_answer_there_is_nothing() -> None:
    seen = panorama_of(np.full(360, np.nan))
    assert seen.lost
    assert find_open_points(seen, 0.2, 0.01) == []
    assert seen.hits().shape == (0, 2)


@settings(deadline=None)  # the first example compiles
@given(st.lists(st.lists(st.floats(0.1, 6.0), min_size=8, max_size=8), min_size=1, max_size=7), st.integers(0, 2**32 - 1))
def test_several_looks_give_the_median(rows: list[list[float]], seed: int) -> None:
    """Oracle: numpy's nanmedian; where the middle two of an even number lie on different surfaces, the lower of them."""
    looks = np.array(rows)
    looks[np.random.default_rng(seed).random(looks.shape) < 0.2] = np.nan
    seen = middle([panorama_of(look) for look in looks])
    columns = ~np.isnan(looks).all(axis=0)
    low, high = (np.nanpercentile(looks[:, columns], 50, axis=0, method=method) for method in ("lower", "higher"))
    expected = np.where(high - low < 0.1, np.nanmedian(looks[:, columns], axis=0), low)
    assert seen.ranges[columns] == pytest.approx(expected)
    assert np.isnan(seen.ranges[~columns]).all()


def test_too_few_beams_are_refused_with_the_number_needed() -> None:
    with pytest.raises(ParameterError, match=r"at least 15 beams all round.*has 8"):
        Surround(laser_car(beams=8), WIDE)
    with pytest.raises(ParameterError, match="has 0"):
        Surround(car(()), WIDE)


def test_a_laser_that_does_not_look_back_is_refused() -> None:
    robot = laser_car()
    assert robot.lidar is not None
    ahead = replace(robot.lidar, bearings=np.linspace(-1.8, 1.8, 500))
    with pytest.raises(ParameterError, match="up to 153"):
        Surround(replace(robot, lidar=ahead), WIDE)


@settings(deadline=None)  # the first example compiles
@given(st.lists(st.sampled_from([0.5, 3.0, -1.0, 0.0, math.nan, math.inf, -math.inf, 1e9]), min_size=24, max_size=24))
def test_any_readings_will_do(readings: list[float]) -> None:
    """Property: open points are finite, in range and in order, whatever the sensor says."""
    robot = laser_car(beams=24)
    scan = Scan(0.0, np.array(readings), np.linspace(-math.pi, math.pi, 24, endpoint=False), MAX_RANGE)
    seen = Surround(robot, WIDE).panorama(Observation(0.0, lidar=scan), SE2(1.0, 2.0, 0.5))
    assert seen is not None
    points = find_open_points(seen, 0.2, 0.01)
    assert all(np.isfinite(point.position).all() and 0.0 < point.range <= MAX_RANGE for point in points)
    assert np.isfinite(seen.hits()).all()
