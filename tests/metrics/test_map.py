"""Map metrics on cases that can be computed by hand, and against brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from robocar.core import SE2, Calibration, Footprint, Limits, OccupancyGrid, RangeSensor, Robot
from robocar.core.rays import cast_rays
from robocar.metrics import DrawnMap, Eye
from robocar.metrics import map as map_metrics
from robocar.metrics.map import map_scores, on_common_cells, reachable_cells, score, visible_cells
from robocar.scenario.scene import enclosed

SIZE = 0.1


def grid(rows: list[str], origin: SE2 = SE2(), resolution: float = SIZE) -> OccupancyGrid:
    """The first line is the top row; `#` occupied, `.` free, `?` unknown."""
    values = {"#": 100, ".": 0, "?": -1}
    return OccupancyGrid(np.array([[values[c] for c in row] for row in rows[::-1]], dtype=np.int8), resolution, origin)


def everywhere(subject: OccupancyGrid) -> np.ndarray:
    return np.ones(subject.shape, dtype=bool)


def test_a_map_that_is_the_truth() -> None:
    """Oracle: by hand."""
    truth = grid(["####", "#..#", "####"])
    found = score(truth, truth, everywhere(truth))
    assert (found.accuracy, found.precision, found.recall, found.f1, found.iou, found.unknown) == (1, 1, 1, 1, 1, 0)


def test_a_wall_that_is_one_cell_off() -> None:
    """Oracle: by hand: within the tolerance all is right; without it nothing of the wall is, and IoU never has one."""
    truth, drawn = grid(["..#..."] * 5), grid(["...#.."] * 5)
    near, exact = score(drawn, truth, everywhere(truth)), score(drawn, truth, everywhere(truth), tolerance=0)
    assert (near.precision, near.recall, near.f1, near.iou, near.accuracy) == (1, 1, 1, 0, 1)
    assert (exact.precision, exact.recall, exact.f1, exact.iou) == (0, 0, 0, 0)
    assert exact.accuracy == pytest.approx(20 / 30)


def test_misses_and_inventions() -> None:
    """Oracle: by hand: of 5 cells of wall 2 are not within a cell of the 2 drawn ones, one more drawn cell is nowhere near."""
    truth = grid(["......", "......", "......", "#####."])
    drawn = grid([".....#", "......", "......", ".##..?"])
    found = score(drawn, truth, everywhere(truth))
    assert found.precision == pytest.approx(2 / 3)
    assert found.recall == pytest.approx(4 / 5)
    assert found.f1 == pytest.approx(2 * (2 / 3) * (4 / 5) / (2 / 3 + 4 / 5))
    assert found.iou == pytest.approx(2 / 6)
    assert found.unknown == pytest.approx(1 / 24)
    # Wrong: the invention, and of the missed wall the cell that no drawn one is near.
    assert found.accuracy == pytest.approx(21 / 23)


def test_scope_and_missing_values() -> None:
    """Oracle: by hand: only the scope counts; without anything to judge a value is None, and a map that misses all has F1 0."""
    truth, blank = grid(["#..?"]), grid(["????"])
    nothing = score(blank, truth, np.array([[False, True, True, False]]))
    assert (nothing.accuracy, nothing.precision, nothing.recall, nothing.f1, nothing.iou) == (None,) * 5
    assert nothing.unknown == 1.0
    missed = score(grid(["...."]), truth, everywhere(truth))
    assert (missed.precision, missed.recall, missed.f1) == (None, 0.0, 0.0)
    outside = score(grid(["...#"]), truth, everywhere(truth))  # where the truth itself is unknown
    assert outside.precision is None


@settings(max_examples=100, deadline=None)
@given(*(arrays(np.int8, (6, 7), elements=st.sampled_from([-1, 0, 100])) for _ in range(2)), st.integers(0, 2))
def test_score_by_brute_force(a: np.ndarray, b: np.ndarray, tolerance: int) -> None:
    """Oracle: loops over all cells and neighbours."""
    drawn, truth = OccupancyGrid(a, SIZE), OccupancyGrid(b, SIZE)

    def near(data: np.ndarray, row: int, col: int) -> bool:
        return bool(
            (data[max(0, row - tolerance) : row + tolerance + 1, max(0, col - tolerance) : col + tolerance + 1] == 100).any()
        )

    cells = [(r, c) for r in range(6) for c in range(7) if b[r, c] >= 0]
    claims = [near(b, *cell) for cell in cells if a[cell] == 100]
    walls = [near(a, *cell) for cell in cells if b[cell] == 100]
    found = score(drawn, truth, np.ones((6, 7), dtype=bool), tolerance)
    assert found.precision == (pytest.approx(np.mean(claims)) if claims else None)
    assert found.recall == (pytest.approx(np.mean(walls)) if walls else None)
    assert found.unknown == (pytest.approx(np.mean([a[cell] < 0 for cell in cells])) if cells else None)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3), st.floats(-2, 2), st.floats(-3, 3), st.sampled_from([0.05, 0.1, 0.17])
)
def test_common_cells(x: float, y: float, theta: float, shift: float, turn: float, resolution: float) -> None:
    """Oracle: the world points of the cells' centres, looked up in each map; nothing of either is lost."""
    rng = np.random.default_rng(3)
    truth = OccupancyGrid(rng.choice([0, 100], (12, 17)).astype(np.int8), SIZE, SE2(x, y, theta))
    drawn = OccupancyGrid(rng.choice([-1, 0, 100], (9, 8)).astype(np.int8), resolution, SE2(shift, -shift, turn))
    common = on_common_cells(drawn, truth)
    assert common is not None
    wide, true = common
    centres = wide.world_from_cell(np.argwhere(np.ones(wide.shape, dtype=bool)))
    for source, result in ((drawn, wide), (truth, true)):
        at = source.grid_from_world(centres)
        clear = np.all(np.abs(at - np.rint(at)) > 1e-6, axis=1)  # rounding decides on borders
        cells = source.cell_from_world(centres)
        inside = source.contains(cells)
        expected = np.full(len(centres), -1)
        expected[inside] = source.data[cells[inside, 0], cells[inside, 1]]
        assert np.array_equal(result.data.ravel()[clear], expected[clear])
    assert np.count_nonzero(wide.occupied) == np.count_nonzero(drawn.occupied)
    assert wide.contains(wide.cell_from_world(truth.corners() * (1 - 1e-9) + truth.corners().mean(axis=0) * 1e-9)).all()


def test_maps_too_large_to_be_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: by hand: 6 cells are more than 5."""
    truth = grid(["..", "..", ".."])
    monkeypatch.setattr(map_metrics, "MAX_CELLS", 5)
    assert on_common_cells(truth, truth) is None
    assert map_scores(DrawnMap(truth, truth, Eye(1.0), True), [[0.1, 0.1, 0.0]], Footprint.circle(0.05)) == {}


def test_what_is_visible_in_a_room() -> None:
    """Oracle: by hand: a convex room is seen whole, its wall's corners too; what lies behind the wall is not."""
    truth = grid(["#######.", "#.....#.", "#.....#.", "#######."])
    seen = visible_cells(truth, [[0.35, 0.21, 0.0]], 5.0)
    assert seen[1:3, 1:6].all()
    assert not seen[:, 7].any()
    faces = seen & truth.occupied
    assert faces[[0, 3], 1:6].all()
    assert faces[1:3, [0, 6]].all()


def test_reach_and_field_of_view() -> None:
    """Oracle: by hand: a disc of the reach's radius, or a sector of it."""
    truth = OccupancyGrid(np.zeros((80, 80), dtype=np.int8), SIZE)
    row, col = np.indices(truth.shape)
    dx, dy = (col + 0.5) * SIZE - 4.05, (row + 0.5) * SIZE - 4.05
    distance, bearing = np.hypot(dx, dy), np.arctan2(dy, dx)
    disc = visible_cells(truth, [[4.05, 4.05, 1.0]], 2.0)
    assert disc[distance < 1.9].all()
    assert not disc[distance > 2.15].any()
    sector = visible_cells(truth, [[4.05, 4.05, 1.0]], 2.0, math.radians(90))
    off = np.abs(np.angle(np.exp(1j * (bearing - 1.0))))
    assert sector[(distance < 1.9) & (off < math.radians(40)) & (distance > 0.2)].all()
    assert not sector[(off > math.radians(50)) & (distance > 0.5)].any()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_faces_are_seen_where_rays_end(seed: int) -> None:
    """Oracle: `core.rays.cast_rays`: the cell a little behind the end of each ray that hits is an occupied one that is seen."""
    rng = np.random.default_rng(seed)
    truth = OccupancyGrid(np.where(rng.random((30, 40)) < 0.1, 100, 0).astype(np.int8), SIZE)
    free = np.argwhere(truth.free)
    place = truth.world_from_cell(free[rng.integers(len(free))]) + rng.uniform(-0.04, 0.04, 2)
    angles = rng.uniform(-math.pi, math.pi, 200)
    ranges = cast_rays(truth, truth.occupied, place, angles, 6.0)
    hit = np.isfinite(ranges)
    ends = place + (ranges[hit] + 1e-6)[:, None] * np.stack([np.cos(angles[hit]), np.sin(angles[hit])], axis=1)
    cells = truth.cell_from_world(ends)
    seen = visible_cells(truth, [[*place, 0.0]], 6.0)
    found = seen[cells[:, 0], cells[:, 1]]
    # A sliver of a face may lie between two of the eye's rays.
    assert np.mean(found) >= 0.97
    assert not (seen & truth.occupied & ~ndimage.binary_dilation(truth.free & seen, np.ones((3, 3)))).any()


def test_where_a_disc_can_come_to() -> None:
    """Oracle: by hand: through a door of three cells, not through one of a single cell; the disc covers what it touches."""
    rows = ["#########", "#...#...#", "#...#...#", "#.......#", "#########"]
    truth = grid(rows)
    through, covered = reachable_cells(truth, (0.25, 0.25), 0.04)
    assert through[1, 7]
    assert covered.sum() == np.count_nonzero(truth.free)
    narrow, _ = reachable_cells(truth, (0.25, 0.25), 0.09)
    assert narrow[2, 2]
    assert not narrow[:, 4:].any()
    nowhere, nothing = reachable_cells(truth, (0.05, 0.05), 0.04)
    assert not nowhere.any()
    assert not nothing.any()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.03, 0.12, 0.2]))
def test_where_a_disc_can_come_to_by_dilation(seed: int, radius: float) -> None:
    """Oracle: scipy.ndimage: the component of the cells whose centre is at least the radius from every blocked square."""
    rng = np.random.default_rng(seed)
    data = np.where(rng.random((25, 30)) < 0.08, 100, 0).astype(np.int8)
    data[rng.random((25, 30)) < 0.02] = -1
    truth = OccupancyGrid(data, SIZE)
    reach = math.ceil(radius / SIZE) + 1
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    gap = np.hypot(np.maximum(abs(i) - 0.5, 0), np.maximum(abs(j) - 0.5, 0)) * SIZE
    fits = ~ndimage.binary_dilation(~truth.free, gap < radius - 1e-12)
    labels, _ = ndimage.label(fits)
    start = np.argwhere(fits)[rng.integers(fits.sum())]
    centres, covered = reachable_cells(truth, truth.world_from_cell(start), radius)
    expected = labels == labels[tuple(start)]
    assert np.array_equal(centres, expected)
    disc = np.hypot(i, j) * SIZE <= radius
    assert np.array_equal(covered, ndimage.binary_dilation(expected, disc))


def robot(sonars: tuple[RangeSensor, ...] = (), lidar: RangeSensor | None = None) -> Robot:
    calibration = Calibration(0.042, np.array([0.0, 1.0]), np.array([0.4, 0.4]))
    return Robot(Footprint.circle(0.1), Limits(-0.2, 0.4, 1.5, 0.8, 4.0), calibration, 200, sonars, lidar)


def sensor(bearings: np.ndarray, max_range: float) -> RangeSensor:
    return RangeSensor("s", SE2(), bearings, 0.0, 0.0, max_range, 0.1)


def test_the_eye_of_a_robot() -> None:
    """Oracle: by hand."""
    half = sensor(np.linspace(-math.pi / 2, math.pi / 2, 181), 5.0)
    ring = sensor(np.linspace(-math.pi, math.pi, 360, endpoint=False), 6.0)
    assert Eye.of(robot(lidar=half)) == Eye(5.0, pytest.approx(math.pi))
    assert Eye.of(robot(lidar=ring)) == Eye(6.0, math.tau)
    assert Eye.of(robot((sensor(np.zeros(1), 2.0), sensor(np.zeros(1), 3.0)))) == Eye(3.0, math.tau)


def test_the_summary_of_a_run() -> None:
    """Oracle: by hand: a room with a nook behind a wall, drawn but for the nook, with one wrong cell on the way."""
    truth = enclosed(grid(["......"] * 5 + ["####..", "......", "......"]), True)
    data = truth.data.copy()
    data[1:3, 1:5] = -1  # the nook below the wall
    data[6, 3] = 100
    drawn = OccupancyGrid(data, SIZE, truth.origin)
    poses = np.stack([np.linspace(0.05, 0.45, 9), np.full(9, 0.55), np.zeros(9)], axis=1)
    car, eye = Footprint.circle(0.04), Eye(5.0)
    values: dict = map_scores(DrawnMap(drawn, truth, eye, explored=True), poses, car)
    assert values["map/path_blocked"] == 1
    assert values["map/known_area"] == pytest.approx((10 * 8 - 8) * SIZE**2)
    free = np.count_nonzero(truth.free)
    assert values["map/explored"] == pytest.approx((free - 8) / free)
    assert values["map/reachable_unknown"] == pytest.approx(8 / (10 * 8), abs=0.01)
    assert values["map/around_unknown"] < values["map/reachable_unknown"]
    assert values["map/recall"] == 1.0
    assert values["map/precision"] < 1.0
    alone = map_scores(DrawnMap(drawn, truth, eye), poses, car)
    assert not [name for name in alone if "reachable" in name]
    assert map_scores(DrawnMap(drawn, truth, eye), np.empty((0, 3)), car)["map/unknown"] is None


def test_the_wall_around() -> None:
    """Oracle: by hand."""
    truth = grid(["..", ".."], SE2(1.0, 2.0, 0.3))
    ring = enclosed(truth, True)
    assert ring.occupied.sum() == 12
    assert ring.world_from_cell((1, 1)) == pytest.approx(truth.world_from_cell((0, 0)))
    assert enclosed(truth, False) is truth
