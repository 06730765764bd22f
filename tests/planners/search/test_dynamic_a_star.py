"""Dynamic A*: its grid of echoes by brute force, its lattice by hand, its drives in a small world and in physics.

Oracles: dense samples of the shapes; the thesis' 11 x 8 cells; the world's own contact check; the metrics of runs in MuJoCo.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import OCCUPIED, SE2, Belief, GiveUp, Goal, Observation, OccupancyGrid, ParameterError, Scan, State
from robocar.core.geodesic import geodesic_distance
from robocar.core.work import total
from robocar.episode.result import RunResult
from robocar.episode.run import run
from robocar.planners.search.car_lattice import CarLattice
from robocar.planners.search.dynamic_a_star import DynamicAStar, DynamicAStarParameters, build
from robocar.planners.search.obstacle_memory import (
    _EXPLAINED,
    _HIT,
    _LEAST,
    _MOST,
    _PRIOR,
    ObstacleMemory,
    _disc_blocked,
    _mark_cone,
    _way_blocked,
)
from tests.planners.kinematic import DT, car, context, drive

FRONT = (SE2(0.1, 0.05, 0.2), SE2(0.1, -0.05, -0.2))
SIDES = (*FRONT, SE2(0.0, 0.09, math.pi / 2), SE2(0.0, -0.09, -math.pi / 2))
ROWS, COLS = 24, 30
NO_DEADLINE = settings(deadline=None, max_examples=60)


def field(width: float, height: float, *boxes: tuple[float, float, float, float]) -> OccupancyGrid:
    """An open field on 5 cm cells, its edge closed, with boxes given as (x0, y0, x1, y1) [m]."""
    data = np.zeros((round(height / 0.05), round(width / 0.05)), dtype=np.int8)
    data[[0, -1]] = data[:, [0, -1]] = OCCUPIED
    for x0, y0, x1, y1 in boxes:
        data[round(y0 / 0.05) : round(y1 / 0.05), round(x0 / 0.05) : round(x1 / 0.05)] = OCCUPIED
    return OccupancyGrid(data, 0.05)


def goal(x: float, y: float) -> Goal:
    return Goal(np.array([x, y]))


class TestEchoes:
    @given(
        col=st.floats(-2, COLS + 2),
        row=st.floats(-2, ROWS + 2),
        heading=st.floats(-7, 7),
        reading=st.floats(1, 40),
        half=st.floats(0.05, 0.4),
        free_reach=st.floats(5, 26),
    )
    @NO_DEADLINE
    def test_mark_every_cell_of_the_cone_and_no_other(
        self, col: float, row: float, heading: float, reading: float, half: float, free_reach: float
    ) -> None:
        """Distance and angle of every cell centre; those within rounding of a border are left out."""
        tolerance = 0.8
        evidence = np.zeros((ROWS, COLS), dtype=np.int8)
        _mark_cone(evidence, col, row, heading, reading, half, free_reach, tolerance)
        y, x = np.mgrid[0:ROWS, 0:COLS] + 0.5
        distance = np.hypot(x - col, y - row)
        angle = np.abs(np.angle(np.exp(1j * (np.arctan2(y - row, x - col) - heading))))
        reach = reading + tolerance if reading <= free_reach else free_reach
        expected = np.zeros((ROWS, COLS))
        inside = (distance <= reach) & (angle <= half)
        expected[inside & (distance < reading - 0.5)] = -3
        expected[inside & (distance >= reading - 0.5) & (angle <= 0.6 * half)] = 2
        borders = [distance - reach, distance - (reading - 0.5), (angle - half) * distance, (angle - 0.6 * half) * distance]
        clear = np.min(np.abs(borders), axis=0) > 1e-6
        assert clear.sum() > 0.9 * clear.size
        assert np.array_equal(evidence[clear], expected[clear])

    def test_evidence_has_bounds_and_is_taken_back(self) -> None:
        evidence = np.zeros((20, 20), dtype=np.int8)
        for _ in range(9):
            _mark_cone(evidence, 2.0, 10.0, 0.0, 8.0, 0.13, 18.0, 0.8)
        assert (evidence.max(), evidence.min()) == (_MOST, _LEAST)
        seen = np.argwhere(evidence == _MOST)
        for _ in range(3):  # later readings look through, and take 3 each
            _mark_cone(evidence, 2.0, 10.0, 0.0, 17.0, 0.13, 18.0, 0.8)
        assert len(seen) > 0
        assert np.all(evidence[tuple(seen.T)] < _HIT)

    @pytest.mark.parametrize("fixed", [_PRIOR, _EXPLAINED])
    def test_what_the_prior_decided_stays(self, fixed: int) -> None:
        evidence = np.full((20, 20), fixed, dtype=np.int8)
        _mark_cone(evidence, 2.0, 10.0, 0.0, 8.0, 0.2, 18.0, 0.8)
        assert np.all(evidence == fixed)

    def test_a_wall_heard_from_several_places_is_marked_where_it_is(self) -> None:
        """A rotated frame; echoes of the plane x = 1 m, heard straight on while driving along it."""
        memory = ObstacleMemory(SE2(-0.5, -0.5, 0.3), (3.0, 3.0), None, 0.05)
        for y in np.arange(0.0, 0.5, 0.02):
            scan = Scan(0.0, np.array([0.5]), np.zeros(1), 4.0, math.radians(15))
            memory.mark(SE2(0.5, float(y), 0.0), scan, 0.65, 0.65)
        echoes = memory.echoes()
        assert len(echoes) > 20
        assert np.abs(echoes[:, 0] - 1.0).max() < 0.05
        assert echoes[:, 1].min() < 0.05
        assert echoes[:, 1].max() > 0.42
        memory.forget()
        assert memory.echoes().shape == (0, 2)

    def test_far_echoes_and_silence_mark_nothing(self) -> None:
        memory = ObstacleMemory(SE2(), (3.0, 3.0), None, 0.05)
        for reading in (1.2, 3.0, math.inf, math.nan):
            memory.mark(SE2(1.0, 1.0, 0.0), Scan(0.0, np.array([reading]), np.zeros(1), 4.0, 0.26), 0.65, 0.65)
        assert len(memory.echoes()) == 0

    def test_without_a_prior_the_grid_grows_in_every_direction(self) -> None:
        """Echoes far outside the first extent are kept where they were heard, the old ones too."""
        memory = ObstacleMemory(SE2(0.0, 0.0, 0.5), (1.0, 1.0), None, 0.05)
        poses = [SE2(0.2, 0.2, 0.0), SE2(-3.0, 1.0, 2.0), SE2(2.0, -4.0, -1.0), SE2(5.0, 6.0, 1.0)]
        for pose in poses:
            memory.mark(pose, Scan(0.0, np.array([0.4]), np.zeros(1), 4.0, 0.26), 0.65, 0.65)
        heard = np.array([pose.apply(0.4, 0.0) for pose in poses])
        distances = np.linalg.norm(memory.echoes()[:, None] - heard[None], axis=2)
        assert distances.min(axis=0).max() < 0.05  # each was marked
        assert distances.min(axis=1).max() < 0.10  # and nothing else

    def test_echoes_of_what_the_prior_shows_are_its_own(self) -> None:
        """A wall 0.5 m ahead, heard 5 cm too near and 20 cm too near; the tolerance is 8 cm."""
        prior = field(2.0, 2.0, (1.0, 0.5, 1.2, 1.5))
        marked = []
        for reading in (0.45, 0.30):
            memory = ObstacleMemory(prior.origin, prior.size, prior, 0.08)
            memory.mark(SE2(0.5, 1.0, 0.0), Scan(0.0, np.array([reading]), np.zeros(1), 4.0, 0.26), 0.65, 0.65)
            marked.append(len(memory.echoes()))
        assert marked[0] == 0 < marked[1]


obstacles = st.lists(st.tuples(st.integers(0, ROWS - 1), st.integers(0, COLS - 1)), min_size=1, max_size=3)
STEPS = np.linspace(0.0, 1.0, 11)


def samples(cells: list[tuple[int, int]]) -> np.ndarray:
    """Points (n, 2) as x, y, 0.1 apart, over the squares of the cells."""
    x, y = np.meshgrid(STEPS, STEPS)
    return np.concatenate([np.stack([col + x.ravel(), row + y.ravel()], axis=1) for row, col in cells])


def grid_of(cells: list[tuple[int, int]], value: int = _HIT) -> np.ndarray:
    evidence = np.zeros((ROWS, COLS), dtype=np.int8)
    evidence[tuple(np.array(cells).T)] = value
    return evidence


class TestBlocked:
    @given(cells=obstacles, col=st.floats(2, COLS - 2), row=st.floats(2, ROWS - 2), radius=st.floats(1, 7))
    @NO_DEADLINE
    def test_disc(self, cells: list[tuple[int, int]], col: float, row: float, radius: float) -> None:
        """Sampled squares against the disc, drawn 0.08 smaller and 0.08 larger."""
        away = np.hypot(*(samples(cells) - [col, row]).T)
        found = _disc_blocked(grid_of(cells), col, row, radius)
        assert np.any(away < radius - 0.08) <= found <= np.any(away < radius + 0.08)
        assert not _disc_blocked(grid_of(cells, _HIT - 1), col, row, radius)

    @given(
        cells=obstacles, start=st.tuples(st.floats(2, COLS - 2), st.floats(2, ROWS - 2)),
        end=st.tuples(st.floats(2, COLS - 2), st.floats(2, ROWS - 2)), half_width=st.floats(1, 5), front=st.floats(0, 5),
    )  # fmt: skip
    @NO_DEADLINE
    def test_way(self, cells: list[tuple[int, int]], start: Any, end: Any, half_width: float, front: float) -> None:
        """In the frame of the drive: at least what overlaps by more than a corner of a square, at most what comes within one."""
        length = math.dist(start, end) + 1e-12
        ahead = (np.array(end) - start) / length
        away = samples(cells) - start
        along, across = away @ ahead, np.abs(away @ [-ahead[1], ahead[0]])

        def touched(more: float) -> bool:
            return bool(np.any((along > -more) & (along < length + front + more) & (across < half_width + more)))

        found = _way_blocked(grid_of(cells), *start, *end, half_width, front)
        corner = math.sqrt(0.5) - 0.5  # how far a turned square reaches beyond its inscribed circle
        moved = length > 1e-6
        assert (touched(-corner - 0.08) and moved) <= found <= touched(0.5 + 0.08)

    def test_outside_the_grid_nothing_is_blocked(self) -> None:
        evidence = np.full((ROWS, COLS), _MOST, dtype=np.int8)
        assert not _disc_blocked(evidence, -20.0, -20.0, 5.0)
        assert not _way_blocked(evidence, -20.0, -20.0, -20.0, 50.0, 3.0, 2.0)


class TestLattice:
    def test_the_thesis_field_has_11_by_8_centred_cells(self) -> None:
        """3.5 - 11 x 0.3 = 0.2 m and 2.5 - 8 x 0.3 = 0.1 m remain, half on each side."""
        prior = OccupancyGrid(np.zeros((50, 70), dtype=np.int8), 0.05)
        lattice = CarLattice(0.30, prior, SE2(), np.array([3.0, 2.0]))
        assert lattice.shape == (8, 11)
        assert lattice.centre((0, 0)) == pytest.approx((0.25, 0.20))
        assert lattice.centre((7, 10)) == pytest.approx((3.25, 2.30))

    def test_follows_the_maps_frame(self) -> None:
        origin = SE2(2.0, -1.0, 0.7)
        prior = OccupancyGrid(np.zeros((50, 70), dtype=np.int8), 0.05, origin)
        assert CarLattice(0.30, prior, SE2(), np.zeros(2)).centre((2, 3)) == pytest.approx(origin.apply(1.15, 0.80))

    @given(x=st.floats(-5, 5), y=st.floats(-5, 5), gx=st.floats(-5, 5), gy=st.floats(-5, 5))
    @NO_DEADLINE
    def test_without_a_map_a_cell_is_centred_on_the_start_and_the_goal_is_inside(
        self, x: float, y: float, gx: float, gy: float
    ) -> None:
        lattice = CarLattice(0.30, None, SE2(x, y, 0.4), np.array([gx, gy]))
        middle = lattice.shape[0] // 2
        assert lattice.shape[0] == lattice.shape[1]
        assert lattice.centre((middle, middle)) == pytest.approx((x, y), abs=1e-9)
        low, high = lattice.centre((0, 0)), lattice.centre((lattice.shape[0] - 1,) * 2)
        assert low[0] + 2 < gx < high[0] - 2
        assert low[1] + 2 < gy < high[1] - 2


class TestParameters:
    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("metric", "manhattan"),
            ("look_around", "maybe"),
            ("cell_size", 0.0),
            ("speed", -1.0),
            ("turn_rate", math.nan),
            ("margin", -0.1),
        ],
    )  # fmt: skip
    def test_senseless_ones_are_refused(self, name: str, value: Any) -> None:
        with pytest.raises(ValueError, match=name):
            DynamicAStarParameters(**{name: value})
        with pytest.raises(ParameterError, match=name):
            build(context(car(), None, **{name: value}))

    def test_without_a_goal_it_gives_up(self) -> None:
        command = build(context(car(), None)).command(State.of(Belief(SE2())), Observation(0.0), None)  # type: ignore[arg-type]
        assert isinstance(command, GiveUp)
        assert "needs a goal" in command.reason


def navigator(world: OccupancyGrid | None, mounts: tuple[SE2, ...] = SIDES, **parameters: Any) -> DynamicAStar:
    return build(context(car(mounts), world, **parameters))


class TestDrives:
    """Without physics: the car moves exactly as told, and contact is checked exactly at every tick."""

    START, END = SE2(0.4, 0.4, 0.0), (2.6, 1.6)

    def test_around_what_the_map_shows(self) -> None:
        world = field(3.0, 2.0, (1.0, 0.0, 1.2, 1.2))
        result = drive(navigator(world), car(SIDES), world, self.START, goal(*self.END))
        shortest = geodesic_distance(world, world.occupied, self.START.position, self.END, 0.09)
        assert result.status == "success", result.reason
        assert shortest - 0.1 < result.length < 1.5 * shortest

    @pytest.mark.parametrize("mounts", [FRONT, SIDES], ids=["front", "sides"])
    def test_around_what_the_map_does_not_show(self, mounts: tuple[SE2, ...]) -> None:
        world, known = field(3.0, 2.0, (1.0, 0.0, 1.2, 1.2)), field(3.0, 2.0)
        result = drive(navigator(known, mounts), car(mounts), world, self.START, goal(*self.END), 6000)
        assert result.status == "success", result.reason
        assert total(*result.work)["replans"] >= 1
        # Each plan shows its search: as many closed cells as it says, numbered from 0.
        searches = [trace["search"].grid.data for trace in result.traces if "search" in trace]
        expanded = [work["expansions"] for work in result.work]
        assert len(searches) == len(expanded) >= 2
        for heat, count in zip(searches, expanded, strict=True):
            closed = np.unique(heat[np.isfinite(heat) & (heat < np.nanmax(heat))])
            np.testing.assert_array_equal(closed, np.arange(len(closed)))
            assert count - 2 <= len(closed) <= count

    def test_without_any_map(self) -> None:
        world = field(3.0, 2.0, (1.0, 0.0, 1.2, 1.2))
        result = drive(navigator(None), car(SIDES), world, self.START, goal(*self.END), 6000)
        assert result.status == "success", result.reason

    @pytest.mark.parametrize("metric", ["octile", "thesis"])
    def test_with_either_metric(self, metric: str) -> None:
        """On a free field both are about as long as the octile way; echoes of the edges may lead them astray for a cell."""
        world = field(3.0, 2.0)
        result = drive(navigator(world, metric=metric), car(SIDES), world, self.START, goal(*self.END))
        dx, dy = self.END[0] - self.START.x, self.END[1] - self.START.y
        octile = max(dx, dy) + (math.sqrt(2) - 1) * min(dx, dy)
        assert result.status == "success"
        assert math.hypot(dx, dy) - 0.1 < result.length < octile + 2 * 0.3

    def test_it_turns_around_in_each_cell_only_where_no_sonar_looks_sideways(self) -> None:
        """Total turning: with front sonars about 2 pi in each of the cells, with side sonars little."""
        world = field(3.0, 2.0)
        turned = {}
        for name, mounts, parameters in (
            ("front", FRONT, {}),
            ("sides", SIDES, {}),
            ("never", FRONT, {"look_around": "never"}),
            ("always", SIDES, {"look_around": "always"}),
        ):
            result = drive(navigator(world, mounts, **parameters), car(mounts), world, self.START, goal(*self.END), 6000)
            assert result.status == "success"
            turned[name] = sum(abs(twist.omega) for twist in result.twists) * DT
        assert turned["front"] > 7 * math.tau
        assert turned["always"] > 7 * math.tau
        assert turned["sides"] < 2 * math.tau
        assert turned["never"] < 2 * math.tau

    def test_a_goal_walled_in_on_the_map(self) -> None:
        world = field(3.0, 2.0, (1.8, 0.0, 1.95, 2.0))
        result = drive(navigator(world), car(SIDES), world, self.START, goal(*self.END))
        assert result.status == "no_path"
        assert result.reason.startswith("no way to the goal through free cells: ")

    def test_a_goal_walled_in_by_what_the_map_does_not_show(self) -> None:
        world, known = field(3.0, 2.0, (1.8, 0.0, 1.95, 2.0)), field(3.0, 2.0)
        result = drive(navigator(known), car(SIDES), world, self.START, goal(*self.END), 12_000)
        assert result.status == "stuck", result.reason
        assert max(pose.x for pose in result.poses) > 1.2  # it went and looked

    def test_built_again_the_same_run_is_the_same(self) -> None:
        world, known = field(3.0, 2.0, (1.0, 0.0, 1.2, 1.2)), field(3.0, 2.0)
        first, second = (drive(navigator(known), car(SIDES), world, self.START, goal(*self.END), 6000) for _ in range(2))
        assert first.poses == second.poses


# -- in physics -----------------------------------------------------------------------------------------------------------

RUNS: dict[str, dict[str, Any]] = {
    f"{sensing}/{estimator}/{seed}": {"estimator": estimator, "seed": seed, "settings": {"robot.sonars": sensing}}
    for sensing in ("front", "front+sides")
    for estimator in ("truth", "odometry")
    for seed in (0, 1)
}
RUNS["no prior"] = {"estimator": "truth", "settings": {"prior": "none", "robot.sonars": "front+sides"}}
RUNS["thesis metric"] = {"estimator": "truth", "settings": {"navigator.metric": "thesis", "robot.sonars": "front+sides"}}


@pytest.fixture(scope="module")
def field_runs() -> dict[str, RunResult]:
    return {name: run("thesis-field", navigator="dynamic-a-star", **keywords) for name, keywords in RUNS.items()}


class TestThesisField:
    @pytest.mark.parametrize("name", RUNS)
    def test_reaches_the_goal_without_contact(self, name: str, field_runs: dict[str, RunResult]) -> None:
        result = field_runs[name]
        assert result.status == "success", result.reason
        assert result.value("contacts") == 0
        assert result.value("min_clearance") > 0.0  # type: ignore[operator]
        assert math.dist(result.truth.poses[-1, :2], (3.25, 2.30)) <= 0.25

    @pytest.mark.parametrize("name", [name for name in RUNS if name.startswith("front")])
    def test_replans_as_the_obstacles_lie_on_every_shortest_way(self, name: str, field_runs: dict[str, RunResult]) -> None:
        assert field_runs[name].value("replans") >= 1  # type: ignore[operator]

    @pytest.mark.parametrize("end", ["truth/0", "truth/1", "odometry/0", "odometry/1"])
    def test_side_sonars_save_the_turning_and_half_of_the_time(self, end: str, field_runs: dict[str, RunResult]) -> None:
        spinning, looking = field_runs[f"front/{end}"], field_runs[f"front+sides/{end}"]
        assert looking.value("duration") < 0.5 * spinning.value("duration")  # type: ignore[operator]
        turning = [result.value("angle_over_length") for result in (looking, spinning)]
        assert turning[0] < 0.5 * turning[1]  # type: ignore[operator]


def test_an_enclosed_goal_in_physics_is_given_up() -> None:
    """Four boxes that the map does not show stand around the goal."""
    around = [((0.9, 0.1), (2.8, 1.65)), ((0.9, 0.1), (2.8, 0.75)), ((0.1, 0.9), (2.35, 1.2)), ((0.1, 0.9), (3.25, 1.2))]
    boxes = [{"box": [*size, 0.3], "pose": [*place, 0.0]} for size, place in around]
    content = {"name": "enclosed", "map": "maps/thesis_field.yaml", "start": [0.25, 0.2, 0.0], "goal": [2.8, 1.2],
               "unknown_obstacles": boxes, "robot": {"sonars": "front+sides"}, "time_limit": 400}  # fmt: skip
    result = run(content, navigator="dynamic-a-star", estimator="truth")
    assert result.status == "stuck", result.reason
    assert "no way to the goal through free cells" in result.reason
    assert result.value("contacts") == 0
