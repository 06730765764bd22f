"""The scenarios that come with Robocar can be driven, and their maps are what they claim to be.

Oracles: scipy.ndimage and scipy.sparse.csgraph on the maps' cells; the thesis' published field.
"""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from robocar.core import OccupancyGrid
from robocar.core.solids import Box
from robocar.episode.registry import find
from robocar.formats import load_map, save_ros_map
from robocar.paths import MODELS
from robocar.scenario.load import load_scenario, scenario_names
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

SCENARIOS = scenario_names()
MAPS = sorted(file.stem for file in (MODELS / "maps").glob("*.yaml"))
ASKED_FOR = {"thesis-field", "thesis-rooms", "corridors", "u-trap", "spiral", "cluttered"}
FEET = RobotModel.load().footprint
NARROW = {"narrow-gap", "doors"}  # scenarios about passages below 0.45 m, or at it


def shipped(name: str) -> Scene:
    return Scene.load(load_scenario(name), FEET)


def disc_cells(grid: OccupancyGrid, radius: float) -> NDArray[np.bool_]:
    """Cells where the centre of a disc may be: none of the blocked cells' squares nearer than `radius`, the border closed."""
    reach = math.ceil(radius / grid.resolution)
    row, col = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    # From a cell's centre to the nearest point of the square of a cell that many rows and columns away.
    gap = np.hypot(np.maximum(abs(row) - 0.5, 0), np.maximum(abs(col) - 0.5, 0)) * grid.resolution
    closed = np.pad(grid.occupied, reach, constant_values=True)
    return ~ndimage.binary_dilation(closed, gap < radius)[reach:-reach, reach:-reach]


def connected(grid: OccupancyGrid, scene: Scene, radius: float) -> bool:
    """Whether a disc comes from start to goal, over cells with a common side."""
    assert scene.goal is not None
    labels, _ = ndimage.label(disc_cells(grid, radius))
    start, goal = (labels[tuple(grid.cell_from_world(p))] for p in (scene.start.position, scene.goal.position))
    return bool(start == goal != 0)


class TestShipped:
    def test_the_scenarios_that_were_asked_for_exist(self) -> None:
        assert set(SCENARIOS) >= ASKED_FOR

    @pytest.mark.parametrize("name", SCENARIOS)
    def test_loads_and_is_described_in_one_line(self, name: str) -> None:
        scene = shipped(name)
        assert scene.scenario.name == name
        assert 20 <= len(scene.scenario.description) <= 130
        assert "\n" not in scene.scenario.description

    @pytest.mark.parametrize("name", SCENARIOS)
    def test_names_only_what_is_registered(self, name: str) -> None:
        defaults = load_scenario(name).defaults
        entries = [find(kind, getattr(defaults, kind)) for kind in ("navigator", "estimator", "mapper")]
        assert all(entry.summary for entry in entries)

    @pytest.mark.parametrize("name", SCENARIOS)
    def test_the_car_fits_at_the_start_whatever_its_heading_and_at_the_goal(self, name: str) -> None:
        scene = shipped(name)
        assert scene.goal is not None
        room = disc_cells(scene.true_grid, FEET.circumscribed_radius)
        assert room[tuple(scene.true_grid.cell_from_world(scene.start.position))]
        assert room[tuple(scene.true_grid.cell_from_world(scene.goal.position))]

    @pytest.mark.parametrize("name", SCENARIOS)
    def test_the_goal_can_be_reached_with_room_to_spare(self, name: str) -> None:
        """scipy.ndimage's labels of the cells where the disc of the inscribed radius and 0.03 m fits."""
        scene = shipped(name)
        assert connected(scene.true_grid, scene, FEET.inscribed_radius + 0.03)

    @pytest.mark.parametrize("name", sorted(set(SCENARIOS) - NARROW))
    def test_a_way_of_passages_wider_than_45_cm_leads_to_the_goal(self, name: str) -> None:
        scene = shipped(name)
        assert connected(scene.true_grid, scene, 0.225)

    @pytest.mark.parametrize("name", [name for name in SCENARIOS if load_scenario(name).prior != "none"])
    def test_the_prior_shows_a_way_to_the_goal(self, name: str) -> None:
        scene = shipped(name)
        assert scene.prior is not None
        assert connected(scene.prior, scene, FEET.circumscribed_radius)

    @pytest.mark.parametrize("name", SCENARIOS)
    def test_the_time_limit_leaves_a_slow_car_time(self, name: str) -> None:
        """scipy's Dijkstra over the free cells, driven at half the top speed of 0.4 m/s."""
        scene = shipped(name)
        length = shortest_length(scene.true_grid, scene, FEET.circumscribed_radius)
        assert length / 0.2 < scene.scenario.time_limit


def shortest_length(grid: OccupancyGrid, scene: Scene, radius: float) -> float:
    """Octile length of the shortest way of a disc [m], inf where there is none."""
    assert scene.goal is not None
    free = disc_cells(grid, radius)
    number = np.full(np.add(free.shape, 2), -1)
    number[1:-1, 1:-1][free] = np.arange(free.sum())
    starts, ends, costs = [], [], []
    for row, col in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here, there = number[1:-1, 1:-1], np.roll(number, (-row, -col), (0, 1))[1:-1, 1:-1]
        both = (here >= 0) & (there >= 0)
        starts.append(here[both])
        ends.append(there[both])
        costs.append(np.full(both.sum(), math.hypot(row, col) * grid.resolution))
    n = int(free.sum())
    graph = coo_array((np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends))), shape=(n, n)).tocsr()
    start, goal = (number[tuple(grid.cell_from_world(p) + 1)] for p in (scene.start.position, scene.goal.position))
    assert min(start, goal) >= 0
    return float(dijkstra(graph, directed=False, indices=start)[goal])


class TestUnknownObstacles:
    @pytest.mark.parametrize("name", ["thesis-field", "warehouse"])
    def test_they_close_the_shortest_way_that_the_prior_shows(self, name: str) -> None:
        scene = shipped(name)
        assert scene.prior is not None
        known, true = (shortest_length(grid, scene, FEET.circumscribed_radius) for grid in (scene.prior, scene.true_grid))
        assert known * 1.05 < true < math.inf

    def test_the_plan_of_the_offices_lacks_furniture_and_nothing_else(self) -> None:
        scene = shipped("office-plan")
        assert scene.prior is not None
        assert scene.prior.same_place(scene.grid)
        assert np.all(scene.grid.occupied[scene.prior.occupied])
        assert scene.grid.occupied.sum() > 1.2 * scene.prior.occupied.sum()


class TestThesisField:
    """The field of 350 x 250 cm with its 11 x 8 centred cells of 30 cm (thesis, sections 2.6 and 4.3)."""

    COLS, ROWS, CELL = 11, 8, 0.30

    def blocked_cells(self, scene: Scene, grown: float) -> NDArray[np.bool_]:
        """Cells of 30 cm that touch an obstacle grown by this much, (8, 11), by points 1 cm apart."""
        assert scene.grid.size == pytest.approx((3.5, 2.5))
        blocked = np.zeros((self.ROWS, self.COLS), dtype=bool)
        points = np.arange(0.005, self.CELL, 0.01)
        for row, col in product(range(self.ROWS), range(self.COLS)):
            x, y = np.meshgrid(0.10 + self.CELL * col + points, 0.05 + self.CELL * row + points)
            inside = scene.grid.occupied[tuple(np.moveaxis(scene.grid.cell_from_world(np.stack([x, y], axis=-1)), -1, 0))]
            for solid in scene.solids:
                local = solid.pose.inverse().transform(np.stack([x, y], axis=-1))
                if isinstance(solid, Box):
                    half = np.array(solid.size[:2]) / 2 + grown
                    inside |= np.all(np.abs(local) <= half, axis=-1)
                else:
                    inside |= np.hypot(local[..., 0], local[..., 1]) <= solid.radius + grown
            blocked[row, col] = inside.any()
        return blocked

    def ways(self, blocked: NDArray[np.bool_]) -> float:
        """Cost of the cheapest way from corner to corner with 10 a side, 14 a diagonal, no corner cut (scipy's Dijkstra)."""
        starts, ends, costs = [], [], []
        for row, col in product(range(self.ROWS), range(self.COLS)):
            for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
                r, c = row + dr, col + dc
                on_field = r < self.ROWS and 0 <= c < self.COLS
                if on_field and not blocked[[row, row, r, r], [col, c, col, c]].any():
                    starts.append(row * self.COLS + col)
                    ends.append(r * self.COLS + c)
                    costs.append(14 if dr and dc else 10)
        n = self.ROWS * self.COLS
        graph = coo_array((costs, (starts, ends)), shape=(n, n)).tocsr()
        return float(dijkstra(graph, directed=False, indices=0)[n - 1])

    def test_start_and_goal_are_centres_of_the_corner_cells(self) -> None:
        scene = shipped("thesis-field")
        assert scene.goal is not None
        assert scene.start.position == pytest.approx([0.25, 0.20])
        assert scene.goal.position == pytest.approx([0.25 + 10 * 0.30, 0.20 + 7 * 0.30])

    def test_balls_stand_where_the_thesis_sees_them(self) -> None:
        """Heading 0 sees green and blue, 90 degrees orange and green, 180 red and orange, 270 blue and red."""
        balls = {ball.color: tuple(ball.position[:2]) for ball in shipped("thesis-field").landmarks}
        assert balls == {"blue": (3.5, 0.0), "green": (3.5, 2.5), "orange": (0.0, 2.5), "red": (0.0, 0.0)}

    def test_unknown_obstacles_make_every_cheapest_way_dearer_twice(self) -> None:
        """Whatever way the prior suggests, something stands in it; and so it goes on after the first was found."""
        scene = shipped("thesis-field")
        prior = self.ways(self.blocked_cells(Scene.load(load_scenario("thesis-field", {"unknown_obstacles": []}), FEET), 0.0))
        alone = [
            self.ways(self.blocked_cells(Scene.load(load_scenario("thesis-field", {"unknown_obstacles": [one]}), FEET), 0.0))
            for one in load_scenario("thesis-field").model_dump()["unknown_obstacles"]
        ]
        together = self.ways(self.blocked_cells(scene, 0.0))
        assert len(alone) == 3
        assert prior < together < math.inf
        assert max(alone) < together  # no single one of them forces the whole detour

    def test_a_way_two_cells_wide_remains_around_grown_obstacles(self) -> None:
        """Squares of two by two free cells that share a side, labelled by scipy.ndimage."""
        free = ~self.blocked_cells(shipped("thesis-field"), 0.05)
        squares = free[:-1, :-1] & free[1:, :-1] & free[:-1, 1:] & free[1:, 1:]
        labels, _ = ndimage.label(squares)
        assert labels[0, 0] == labels[-1, -1] != 0


class TestMaps:
    @pytest.mark.parametrize("name", MAPS)
    def test_files_round_trip_byte_for_byte(self, name: str, tmp_path: Path) -> None:
        source = MODELS / "maps" / f"{name}.yaml"
        grid = load_map(source)
        written = save_ros_map(grid, tmp_path / name)
        again = load_map(written)
        assert again.same_place(grid)
        np.testing.assert_array_equal(again.data, grid.data)
        assert (tmp_path / f"{name}.pgm").read_bytes() == source.with_suffix(".pgm").read_bytes()

    @pytest.mark.parametrize("name", MAPS)
    def test_are_known_everywhere_at_5_cm_and_used(self, name: str) -> None:
        grid = load_map(MODELS / "maps" / f"{name}.yaml")
        assert grid.resolution == 0.05
        assert not grid.unknown.any()
        used = {load_scenario(s).map for s in SCENARIOS} | {load_scenario(s).prior for s in SCENARIOS}
        assert f"maps/{name}.yaml" in used

    def test_one_map_is_turned_and_one_has_its_origin_in_the_middle(self) -> None:
        turned, middle = (load_map(MODELS / "maps" / f"{name}.yaml") for name in ("tilted", "thesis_rooms"))
        assert 0.1 < abs(turned.origin.theta) < math.pi / 2 - 0.1
        np.testing.assert_allclose(middle.corners(), [[-8, -8], [8, -8], [8, 8], [-8, 8]], atol=1e-12)
