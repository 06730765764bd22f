"""Worlds: what physics and sensors meet is what the grid says.

Oracles: core's ray casting, pinhole projection, MuJoCo without the measures.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Landmark, OccupancyGrid, ScenarioError, UnknownNameError
from robocar.core.rays import cast_rays
from robocar.core.solids import Box, Cylinder
from robocar.formats import load_map
from robocar.formats.generated import cave, rooms
from robocar.sim.movers import Mover
from robocar.sim.world_spec import FLOOR_BIT, SENSED_GROUP, SOLID_BIT, add_top_camera, build_world

SENSED = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)

# MuJoCo takes a geom turned by less than 2e-6 rad for one that is not turned.
BARELY_TURNED = OccupancyGrid(np.array([[65, 0], [-1, -1]], dtype=np.int8), 1.0, SE2(0.0, 0.0, 1.8478634349644299e-06))

poses = st.builds(SE2, st.floats(-20, 20), st.floats(-20, 20), st.floats(-math.pi, math.pi))


@st.composite
def grids(draw: st.DrawFn) -> OccupancyGrid:
    """Small grids with free, unknown, doubtful and occupied cells, anywhere; at least one cell to stand in."""
    rows, cols = draw(st.integers(2, 14)), draw(st.integers(2, 14))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    walls = draw(st.floats(0.05, 0.7))
    values = rng.choice([-1, 0, 64, 65, 100], size=(rows, cols), p=[(1 - walls) / 3] * 3 + [walls / 2] * 2)
    values[rng.integers(rows), rng.integers(cols)] = 0
    return OccupancyGrid(values.astype(np.int8), draw(st.floats(0.03, 1.0)), draw(poses))


def place(world: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = world.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def sensed(model: mujoco.MjModel, data: mujoco.MjData, point: np.ndarray, angles: np.ndarray, z: float) -> np.ndarray:
    """Ranges of level rays in the physics, inf where nothing is hit."""
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1).ravel()
    geoms, ranges = np.zeros(len(angles), dtype=np.int32), np.zeros(len(angles))
    origin = np.array([*point, z])
    mujoco.mj_multiRay(model, data, origin, directions, SENSED, True, -1, geoms, ranges, None, len(angles), 1e3)
    return np.where(ranges < 0, np.inf, ranges)


def assert_same_walls(grid: OccupancyGrid, blocked: OccupancyGrid, model, data, seed: int) -> None:
    """Rays from free and unknown cells of `grid` meet the walls of `blocked` where the grid says."""
    rng = np.random.default_rng(seed)
    cells = np.argwhere(~grid.occupied)
    cells = cells[rng.permutation(len(cells))[:5]]
    inside = cells[:, ::-1] + rng.uniform(0.05, 0.95, size=(len(cells), 2))
    points = grid.origin.transform(inside * grid.resolution)
    angles = rng.uniform(-math.pi, math.pi, size=(len(points), 40))
    got = np.concatenate([sensed(model, data, p, a, 0.1) for p, a in zip(points, angles, strict=True)])
    nudged = np.array(
        [
            np.concatenate([cast_rays(blocked, blocked.occupied, p, a + d, 1e3) for p, a in zip(points, angles, strict=True)])
            for d in (-1e-6, 0.0, 1e-6)
        ]
    )
    # A ray that a millionth of a radian makes pass a corner on the other side has no defined range.
    with np.errstate(invalid="ignore"):
        spread = np.where(np.isinf(nudged).all(axis=0), 0.0, nudged.max(axis=0) - nudged.min(axis=0))
    clear = spread < 1e-3 * (1.0 + np.where(np.isinf(got), 0.0, got))
    assert clear.mean() > 0.9
    np.testing.assert_allclose(got[clear], nudged[1][clear], rtol=1e-9, atol=1e-9)


@settings(max_examples=80, deadline=None)
@given(grid=grids(), seed=st.integers(0, 2**32 - 1))
@example(grid=BARELY_TURNED, seed=0)
def test_rays_meet_the_walls_where_the_grid_has_them(grid: OccupancyGrid, seed: int) -> None:
    model, data = place(build_world(grid, border="open"))
    assert_same_walls(grid, grid, model, data, seed)


@settings(max_examples=40, deadline=None)
@given(grid=grids(), seed=st.integers(0, 2**32 - 1))
@example(grid=BARELY_TURNED, seed=0)
def test_a_border_wall_stands_just_outside_the_grid(grid: OccupancyGrid, seed: int) -> None:
    model, data = place(build_world(grid, border="wall"))
    edge = -grid.resolution
    ringed = OccupancyGrid(np.pad(grid.data, 1, constant_values=100), grid.resolution, grid.origin @ SE2(edge, edge, 0.0))
    assert_same_walls(grid, ringed, model, data, seed)


@settings(max_examples=30, deadline=None)
@given(grid=grids(), height=st.floats(0.1, 2.0))
def test_contacts_meet_the_same_boxes_as_rays(grid: OccupancyGrid, height: float) -> None:
    """A small ball in the middle of each cell touches a wall exactly where the cell is occupied."""
    world = build_world(grid, border="open", wall_height=height)
    radius = 0.2 * grid.resolution
    probe = world.worldbody.add_body(name="probe")
    probe.add_freejoint()
    probe.add_geom(size=[radius, 0, 0], mass=1.0, contype=SOLID_BIT, conaffinity=SOLID_BIT)
    model = world.compile()
    data = mujoco.MjData(model)
    touched = np.zeros(grid.shape, dtype=bool)
    for cell in np.ndindex(grid.shape):
        data.qpos[:3] = [*grid.world_from_cell(np.array(cell)), height / 2]
        mujoco.mj_fwdPosition(model, data)
        touched[cell] = data.ncon > 0
    np.testing.assert_array_equal(touched, grid.occupied)


def test_walls_are_as_high_as_asked() -> None:
    grid = OccupancyGrid(np.array([[0, 100]]), 1.0)
    model, data = place(build_world(grid, border="open", wall_height=0.42))
    below, above = (sensed(model, data, np.array([0.5, 0.5]), np.zeros(1), z)[0] for z in (0.42 - 1e-6, 0.42 + 1e-6))
    assert below == pytest.approx(0.5)
    assert above == math.inf


def test_what_stands_never_collides_with_itself() -> None:
    """Boxes that overlap walls, border, floor and one another make no contact."""
    grid = rooms(40, 40, np.random.default_rng(0), origin=SE2(1, 2, 0.5))
    middle = grid.origin @ SE2(1.0, 1.0, 0.3)
    world = build_world(
        grid,
        solids=[Box((1.0, 1.0, 0.2), middle), Box((0.5, 2.0, 0.3), middle), Cylinder(0.4, 0.3, middle)],
        landmarks=[Landmark("low", "red", np.array([middle.x, middle.y, 0.05]), 0.1)],
    )
    _, data = place(world)
    assert data.ncon == 0


def sliding_crate(world: mujoco.MjSpec, x: float, y: float, speed: float) -> None:
    """A crate without friction that slides along x."""
    body = world.worldbody.add_body(name="crate", pos=[x, y, 0.05])
    body.add_freejoint()
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 0.05, 0.05], mass=1.0, contype=3, conaffinity=3, condim=1, priority=1
    )
    world.add_key(qpos=[x, y, 0.05, 1, 0, 0, 0], qvel=[speed, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("seed", range(3))
def test_static_geoms_computed_once_change_nothing(seed: int) -> None:
    """The same run with MuJoCo's `sleep` flag, on which the speed of large worlds rests, and without: equal bit by bit."""
    rng = np.random.default_rng(seed)
    grid = cave(40, 40, rng, origin=SE2(0.5, -1.0, 0.7))
    start = grid.world_from_cell(np.argwhere(grid.free)[200])
    runs = []
    for sleep in (True, False):
        world = build_world(grid)
        sliding_crate(world, *start, speed=1.5)
        if not sleep:
            world.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        model = world.compile()
        assert bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP) == sleep
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        states = []
        for _ in range(600):
            mujoco.mj_step(model, data)
            states.append(np.concatenate([data.qpos, data.qvel]))
        runs.append(np.array(states))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.ptp(runs[0][:, 0]) > 0.02  # it did move


def test_nothing_falls_asleep() -> None:
    world = build_world(OccupancyGrid(np.zeros((4, 4)), 1.0))
    sliding_crate(world, 2.0, 2.0, speed=0.0)
    model, data = place(world)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-6
    assert np.all(data.tree_asleep < 0)


def test_a_crate_stops_at_the_wall() -> None:
    grid = OccupancyGrid(np.array([[0, 0, 0, 0, 100]]), 0.5)
    world = build_world(grid, border="open")
    sliding_crate(world, 0.3, 0.25, speed=2.0)
    model = world.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    farthest = 0.0
    for _ in range(400):
        mujoco.mj_step(model, data)
        farthest = max(farthest, data.qpos[0])
    assert farthest == pytest.approx(2.0 - 0.05, abs=0.01)  # the wall's face less half a crate


def test_the_floor_carries_only_what_asks_for_it() -> None:
    world = build_world(OccupancyGrid(np.zeros((4, 4)), 1.0), border="open")
    for name, bits in (("wheel", FLOOR_BIT), ("hull", SOLID_BIT)):
        body = world.worldbody.add_body(name=name, pos=[1 + bits / 2, 2, 0.1])
        body.add_freejoint()
        body.add_geom(size=[0.05, 0, 0], mass=1, contype=bits, conaffinity=bits)
    model, data = place(world)
    for _ in range(300):
        mujoco.mj_step(model, data)
    assert data.body("wheel").xpos[2] == pytest.approx(0.05, abs=0.005)
    assert data.body("hull").xpos[2] < -1.0


def test_obstacles_stand_where_they_are_put() -> None:
    """Analytic distances to a turned box and a cylinder."""
    world = build_world(
        OccupancyGrid(np.zeros((10, 10)), 1.0),
        border="open",
        solids=[Box((1.0, 1.0, 0.2), SE2(5, 2, math.pi / 4)), Cylinder(0.5, 0.2, SE2(5, 8))],
    )
    model, data = place(world)
    hits = [sensed(model, data, np.array([1.0, y]), np.zeros(1), 0.1)[0] for y in (2, 8)]
    over = [sensed(model, data, np.array([1.0, y]), np.zeros(1), 0.21)[0] for y in (2, 8)]
    assert hits == pytest.approx([4 - math.sqrt(0.5), 3.5])
    assert over == [math.inf, math.inf]


def test_a_ball_is_an_obstacle_only_below_the_walls_tops() -> None:
    grid = OccupancyGrid(np.zeros((4, 4)), 1.0)
    balls = [
        Landmark("low", "red", np.array([2.0, 1.0, 0.1]), 0.1),
        Landmark("on the wall", "green", np.array([2.0, 2.0, 0.3 + 0.1]), 0.1),
    ]
    model, data = place(build_world(grid, landmarks=balls, border="open"))
    low = sensed(model, data, np.array([0.5, 1.0]), np.zeros(1), 0.1)[0]
    high = sensed(model, data, np.array([0.5, 2.0]), np.zeros(1), 0.4)[0]
    assert low == pytest.approx(1.4)
    assert high == math.inf
    assert model.geom("landmark/low").contype[0] == SOLID_BIT
    assert model.geom("landmark/on the wall").contype[0] == 0


@pytest.fixture
def picture():
    """Renders a camera of a model, or skips where no OpenGL is."""

    def take(model: mujoco.MjModel, data: mujoco.MjData, camera: str) -> np.ndarray:
        width, height = model.cam_resolution[model.camera(camera).id]
        try:
            renderer = mujoco.Renderer(model, height, width)
        except Exception as error:
            pytest.skip(f"no offscreen OpenGL: {error}")
        renderer.update_scene(data, camera)
        pixels = renderer.render().astype(int)
        renderer.close()
        return pixels

    return take


def project(model: mujoco.MjModel, data: mujoco.MjData, camera: str, points: np.ndarray) -> np.ndarray:
    """Pinhole projection of world points (n, 3) to pixels (column, row), (n, 2)."""
    number = model.camera(camera).id
    width, height = model.cam_resolution[number]
    seen = (points - data.cam_xpos[number]) @ data.cam_xmat[number].reshape(3, 3)
    focal = height / 2 / math.tan(math.radians(model.cam_fovy[number]) / 2)
    return np.array([width / 2, height / 2]) + focal * seen[:, :2] * [1, -1] / -seen[:, 2:]


@pytest.mark.parametrize(("rows", "cols"), [(60, 60), (30, 120), (120, 30)])
def test_the_top_camera_sees_the_whole_map_as_it_is(picture, rows: int, cols: int) -> None:
    grid = rooms(rows, cols, np.random.default_rng(1), origin=SE2(3.0, -2.0, 0.6))
    ball = Landmark("b", "blue", np.array([*grid.world_from_cell(np.argwhere(grid.free)[40]), 0.4]), 0.06)
    spec = build_world(grid, landmarks=[ball])
    add_top_camera(spec, grid)
    model, data = place(spec)
    pixels = picture(model, data, "top")
    rim = np.concatenate([np.c_[grid.corners(), np.full(4, z)] for z in (0.0, 0.3)])
    corners = project(model, data, "top", rim)
    assert np.all((corners >= 0) & (corners <= [640, 480]))
    # The walls' tops are brighter than any floor; the darkest wall top and the brightest floor lie on either side of 128.
    walls = np.argwhere(grid.occupied)
    tops = project(model, data, "top", np.c_[grid.world_from_cell(walls), np.full(len(walls), 0.3)])
    u, v = np.floor(project(model, data, "top", ball.position[None])[0]).astype(int)
    away = np.linalg.norm(tops - [u, v], axis=1) > 20
    columns, lines = np.floor(tops[away]).astype(int).T
    assert np.mean(pixels[lines, columns].mean(axis=1) > 128) > 0.99
    # Free cells near the middle of the picture are not hidden by walls' perspective.
    free = np.argwhere(grid.free)
    central = free[np.linalg.norm(grid.world_from_cell(free) - grid.corners().mean(axis=0), axis=1) < 0.6]
    floor = project(model, data, "top", np.c_[grid.world_from_cell(central), np.zeros(len(central))])
    columns, lines = np.floor(floor).astype(int).T
    assert np.mean(pixels[lines, columns].mean(axis=1) < 128) > 0.9
    red, green, blue = pixels[v, u]
    assert blue > 2 * max(red, green)


def test_lighting_changes_the_brightness(picture) -> None:
    grid = rooms(40, 40, np.random.default_rng(0))
    means = []
    for lighting in ("dim", "default", "bright"):
        spec = build_world(grid, lighting=lighting)
        add_top_camera(spec, grid)
        means.append(picture(*place(spec), "top").mean())
    assert means[0] < 0.7 * means[1]
    assert means[1] < 0.8 * means[2]


def test_cameras_see_one_geom_for_all_walls_and_rays_do_not() -> None:
    grid = cave(64, 64, np.random.default_rng(0))
    model, data = place(build_world(grid, border="open"))
    scene = mujoco.MjvScene(model, 10_000)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL, scene)
    drawn = {scene.geoms[k].objid for k in range(scene.ngeom) if scene.geoms[k].objtype == mujoco.mjtObj.mjOBJ_GEOM}
    assert drawn == {model.geom("floor").id, model.geom("walls").id}
    # Without any mask of groups, too, a ray ends at a box.
    cell = np.argwhere(grid.free)[300]
    geom = np.zeros(1, dtype=np.int32)
    mujoco.mj_ray(model, data, np.array([*grid.world_from_cell(cell), 0.1]), np.array([0.6, 0.8, 0.0]), None, True, -1, geom)
    assert model.geom_type[geom[0]] == mujoco.mjtGeom.mjGEOM_BOX
    assert model.geom_group[geom[0]] == SENSED_GROUP


def test_an_empty_map_and_a_full_one_are_worlds() -> None:
    empty, _ = place(build_world(OccupancyGrid(np.zeros((3, 5)), 0.1), border="open"))
    full, _ = place(build_world(OccupancyGrid(np.full((3, 5), 100), 0.1), border="open"))
    unknown, _ = place(build_world(OccupancyGrid(np.full((3, 5), -1), 0.1), border="open"))
    assert (empty.ngeom, unknown.ngeom, full.ngeom) == (1, 1, 3)  # floor; floor, one box, the mesh


def test_a_large_cave_takes_no_more_boxes_than_its_cover() -> None:
    grid = cave(512, 512, np.random.default_rng(0))
    model, data = place(build_world(grid))
    boxes = int(np.sum(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX))
    assert boxes < 0.2 * grid.occupied.sum()
    mujoco.mj_step(model, data, 10)
    assert not any(warning.number for warning in data.warning)
    assert_same_walls(grid, grid, model, data, seed=1)


def test_maps_from_elsewhere_become_the_same_walls(data_dir: Path) -> None:
    files = [*sorted(data_dir.glob("ros_maps/*/*.yaml")), *sorted(data_dir.glob("movingai/*.map"))]
    assert len(files) >= 9
    for file in files:
        grid = load_map(file, None if file.suffix == ".yaml" else 0.3)
        model, data = place(build_world(grid, border="open"))
        assert_same_walls(grid, grid, model, data, seed=0)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"wall_height": 0.0}, ScenarioError, "wall_height 0.0"),
        ({"wall_height": math.nan}, ScenarioError, "wall_height nan"),
        ({"border": "fence"}, ScenarioError, "'fence' is neither 'wall' nor 'open'"),
        ({"lighting": "disco"}, UnknownNameError, "'disco'.*default, dim, bright"),
        ({"solids": [Box((0.1, -0.1, 0.1))]}, ScenarioError, "box at"),
        ({"solids": [Cylinder(math.inf, 0.1)]}, ScenarioError, "Cylinder"),
        ({"solids": [Cylinder(0.0, 0.1)]}, ScenarioError, "Cylinder"),
        ({"landmarks": [Landmark("a", "beige", np.zeros(3), 0.1)]}, UnknownNameError, "'beige'.*red, green"),
        ({"landmarks": [Landmark("a", "red", np.zeros(2), 0.1)]}, ScenarioError, "position"),
        ({"landmarks": [Landmark("a", "red", np.zeros(3), 0.0)]}, ScenarioError, "radius 0.0"),
        ({"landmarks": [Landmark("a", "red", np.zeros(3), 0.1)] * 2}, ScenarioError, "more than once: a"),
        ({"movers": [Mover("m", "cylinder", (0.1, 0.3), SE2(0.5, 0.5))] * 2}, ScenarioError, "more than once: m"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments: dict, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        build_world(OccupancyGrid(np.array([[0, 0, 100, 0, 0]]), 1.0), **arguments)
