"""Two robots in one world. Oracles: their own runs alone, geometry, and each other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robocar.core import SE2, Drive, Hold, Observation, OccupancyGrid, ScenarioError, Twist
from robocar.core.distance import polygon_distance
from robocar.core.randomness import stream
from robocar.sim.firmware import FirmwareParameters
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.world import ROBOT_GROUPS, World
from robocar.sim.world_spec import build_world
from tests.sim.rooms import room
from tests.sim.sensors.exact import EXACT

SEEING = FitOut(sonars="front", lidar="scan360")
LEFT, RIGHT = SE2(2.0, 4.4, 0.0), SE2(2.0, 3.6, 0.0)  # side by side
AHEAD, BEHIND = SE2(4.0, 4.0, math.pi), SE2(3.0, 4.0, 0.0)  # face to face, 1 m between their centres


def two(a: SE2, b: SE2, names: tuple[str, str] = ("ann", "bob"), seed: int = 3, **kwargs: Any) -> World:
    """Two Robocars in a room of 8 x 8 m."""
    grid = OccupancyGrid(np.zeros((80, 80), dtype=np.int8), 0.1)
    setups = [RobotSetup(start, name, fit_out=SEEING, sensors=EXACT) for start, name in zip((a, b), names, strict=True)]
    return World(build_world(grid), setups, seed=seed, clearance=lambda corners: math.inf, **kwargs)


def drive(world: World, twists: dict[str, Twist], ticks: int) -> dict[str, list[Observation]]:
    """Each robot keeps to its own twist."""
    seen: dict[str, list[Observation]] = {name: [] for name in world.robots}
    for _ in range(ticks):
        for name, robot in world.robots.items():
            seen[name].append(robot.sense())
            robot.act(Drive(twists[name]))
        world.step()
    return seen


TWISTS = {"ann": Twist(0.3, 0.0), "bob": Twist(0.2, -0.4)}


def test_each_follows_its_own_commands_under_one_hash_that_comes_again() -> None:
    """Oracle: each one's way alone in the same room, within the tolerances of its tyres."""
    hashes = []
    for _ in range(2):
        world = two(LEFT, RIGHT)
        drive(world, TWISTS, 60)
        hashes.append(world.hash)
    assert hashes[0] == hashes[1]
    assert world.time == pytest.approx(3.0)
    for name, start in (("ann", LEFT), ("bob", RIGHT)):
        alone = room(start=start, fit_out=SEEING)
        for _ in range(60):
            alone.robot.act(Drive(TWISTS[name]))
            alone.step()
        expected, found = alone.ground_truth().pose, world.ground_truth(world.robots[name]).pose
        assert start.distance_to(found) > 0.5
        assert found.distance_to(expected) < 0.02
        assert math.remainder(found.theta - expected.theta, math.tau) == pytest.approx(0.0, abs=0.05)
    drive(world, {"ann": Twist(), "bob": TWISTS["bob"]}, 1)
    assert world.hash != hashes[0]


def test_they_see_each_other_and_not_themselves() -> None:
    """Oracle: the hull's faces, 0.10 m before the centres; alone, the room's walls."""
    world = two(AHEAD, BEHIND)
    seen = {name: robot.sense() for name, robot in world.robots.items()}
    for observation in seen.values():
        heard = {scan.name: float(scan.ranges[0]) for scan in observation.sonars}
        assert heard == {"front_left": pytest.approx(0.8, abs=0.01), "front_right": pytest.approx(0.8, abs=0.01)}
        assert observation.psd is not None
        assert observation.lidar is not None
        nearest = np.nanmin(observation.lidar.ranges)
        assert nearest > 0.3  # nothing of its own
    alone = room(start=BEHIND, fit_out=SEEING, sensors=EXACT).robot.sense()
    assert min(float(scan.ranges[0]) for scan in alone.sonars) > 4.5


def test_a_camera_shows_the_other_robot() -> None:
    """Oracle: the same picture without it."""
    grid = OccupancyGrid(np.zeros((80, 80), dtype=np.int8), 0.1)
    pictures = []
    for others in ([], [RobotSetup(AHEAD, "bob")]):
        world = World(build_world(grid), [RobotSetup(BEHIND, "ann", fit_out=FitOut(camera=True)), *others], seed=0)
        image = world.robots["ann"].sense().image
        assert image is not None
        pictures.append(image.pixels.astype(int))
        world.close()
    assert np.abs(pictures[0] - pictures[1]).max(axis=2).astype(bool).mean() > 0.01


def test_they_run_into_each_other_and_both_feel_it() -> None:
    """Oracle: the distance of their footprints, which is the clearance of either."""
    world = two(AHEAD, BEHIND)
    ann, bob = world.robots.values()
    truths = []
    for _ in range(80):
        ann.act(Drive(Twist(0.3)))
        bob.act(Hold())
        world.step()
        truths.append((world.ground_truth(ann), world.ground_truth(bob)))
        apart = polygon_distance(ann.robot.footprint.at(ann.pose()), bob.robot.footprint.at(bob.pose()))
        assert (truths[-1][0].clearance, truths[-1][1].clearance) == pytest.approx((apart, apart))
    contacts = [(a.contact, b.contact) for a, b in truths]
    assert contacts[0] == (False, False)
    assert contacts[-1] == (True, True)
    first = contacts.index((True, True))
    assert truths[first][0].clearance < 0.005
    assert truths[first - 2][0].clearance > 0.0


def test_a_contact_is_that_robot_s_own() -> None:
    world = two(SE2(7.7, 2.0), LEFT)
    drive(world, {"ann": Twist(0.3), "bob": Twist()}, 20)
    ann, bob = world.robots.values()
    assert (world.ground_truth(ann).contact, world.ground_truth(bob).contact) == (True, False)


def test_noise_depends_on_the_robot_s_name_only() -> None:
    """Ann is the same robot whoever drives beside her and in whatever order; Bob in her place is another one."""
    both, swapped, other = two(LEFT, RIGHT), two(RIGHT, LEFT, ("bob", "ann")), two(LEFT, RIGHT, ("eve", "bob"))

    def tyre(world: World, name: str) -> float:
        return float(world.model.geom(f"{name}/front_left_wheel").friction[0])

    assert tyre(both, "ann") == tyre(swapped, "ann")
    assert tyre(both, "bob") == tyre(swapped, "bob") == tyre(other, "bob")
    assert len({tyre(both, "ann"), tyre(both, "bob"), tyre(other, "eve")}) == 3


def test_a_lone_robot_s_streams_do_not_carry_its_name() -> None:
    """Oracle: the stream `car/tolerances`, drawn here."""
    grid = OccupancyGrid(np.zeros((80, 80), dtype=np.int8), 0.1)
    worlds = [World(build_world(grid), [RobotSetup(LEFT, name)], seed=5) for name in ("robocar", "ann")]
    expected = 0.9 * (1.0 + 0.05 * float(np.clip(stream(5, "car/tolerances").standard_normal(), -2.5, 2.5)))
    for world, name in zip(worlds, ("robocar", "ann"), strict=True):
        assert float(world.model.geom(f"{name}/front_left_wheel").friction[0]) == pytest.approx(expected, rel=1e-12)


def test_without_a_command_a_step_is_a_hold_and_a_command_waits_for_the_step() -> None:
    world = room()
    robot = world.robot
    robot.act(Drive(Twist(0.3)))
    assert world.time == 0.0
    for _ in range(20):
        world.step()
    assert world.ground_truth().twist.v == pytest.approx(0.3, rel=0.05)


def test_what_does_not_fit_into_one_world_is_refused() -> None:
    grid = OccupancyGrid(np.zeros((80, 80), dtype=np.int8), 0.1)

    def build(*setups: RobotSetup) -> World:
        return World(build_world(grid), setups, seed=0)

    with pytest.raises(ScenarioError, match="needs a robot"):
        build()
    with pytest.raises(ScenarioError, match="different names"):
        build(RobotSetup(LEFT), RobotSetup(RIGHT))
    with pytest.raises(ScenarioError, match="without a slash"):
        build(RobotSetup(LEFT, "a/b"))
    with pytest.raises(ScenarioError, match="at most 4 robots, not 5"):
        build(*(RobotSetup(SE2(1.0 + k, 4.0), f"r{k}") for k in range(len(ROBOT_GROUPS) + 1)))
    with pytest.raises(ScenarioError, match="firmware's period"):
        build(RobotSetup(LEFT, "a"), RobotSetup(RIGHT, "b", firmware=FirmwareParameters(period=0.025)))
    with pytest.raises(ScenarioError, match=r"room of their own.*'a' at SE2\(x=1\.0, .*'b' at SE2\(x=1\.02, "):
        build(RobotSetup(SE2(1.0, 1.0), "a"), RobotSetup(LEFT, "c"), RobotSetup(SE2(1.02, 1.0), "b"))
    with pytest.raises(ScenarioError, match="room of their own"):  # a cross: no corner of one lies in the other
        build(RobotSetup(SE2(1.0, 1.0), "a"), RobotSetup(SE2(1.0, 1.0, math.pi / 4), "b"))
    build(RobotSetup(SE2(1.0, 1.0), "a"), RobotSetup(SE2(1.0, 1.181), "b"))  # side by side, 0.18 m wide each
    with pytest.raises(ScenarioError, match=r"several robots.*ann, bob"):
        two(LEFT, RIGHT).robot  # noqa: B018
