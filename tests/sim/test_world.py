"""The physics run: determinism by comparison of hashes, events and checks by hand."""

from __future__ import annotations

import hashlib
import math
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robocar.core import SE2, Done, Drive, GiveUp, Hold, ScenarioError, Serial, Twist
from robocar.core.solids import Box
from robocar.sim.firmware import FirmwareParameters
from robocar.sim.fit_out import FitOut
from robocar.sim.physics import PhysicsParameters
from robocar.sim.robot_model import RobotModel
from robocar.sim.world import World
from tests.sim.rooms import IDENTICAL_CARS, drive, room


def wander(world: World, ticks: int = 60) -> str:
    """The hash after a drive that depends on what is sensed."""
    for _ in range(ticks):
        observation = world.robot.sense()
        near = min((float(np.nan_to_num(scan.ranges[0], nan=9.0)) for scan in observation.sonars), default=9.0)
        world.robot.act(Drive(Twist(min(0.3, 0.2 * near), 0.5 * math.sin(2 * world.time))))
        world.step()
    return world.hash


@pytest.mark.parametrize(
    ("command", "error", "message"),
    [
        (None, TypeError, "robot robocar: expected a Drive, Serial, .* not None"),
        ("go", TypeError, "not 'go'"),
        (Twist(0.3), TypeError, "not Twist"),
        (Drive("go"), TypeError, "twist='go'"),  # type: ignore[arg-type]
        (Serial(None), TypeError, "line=None"),  # type: ignore[arg-type]
        (Drive(Twist(math.nan, 0.0)), ValueError, "robot robocar: expected finite numbers, not .*v=nan"),
        (Drive(Twist(0.0, math.inf)), ValueError, "omega=inf"),
        (Hold(pan=math.nan), ValueError, "pan=nan"),
    ],
)
def test_what_is_no_command_is_refused_at_once(command: object, error: type[Exception], message: str) -> None:
    """And the world goes on as if nothing had been said."""
    world, quiet = room(), room()
    with pytest.raises(error, match=message):
        world.robot.act(command)  # type: ignore[arg-type]
    world.step()
    quiet.step()
    assert world.hash == quiet.hash


# -- determinism -------------------------------------------------------------------------------------------------------


def test_equal_seeds_give_equal_hashes_and_other_seeds_others() -> None:
    hashes = [wander(room(seed=seed)) for seed in (7, 7, 8)]
    assert hashes[0] == hashes[1]
    assert hashes[0] != hashes[2]
    assert all(len(bytes.fromhex(value)) == 32 for value in hashes)


def test_another_process_gives_the_same_hash() -> None:
    code = (
        "from tests.sim.rooms import room; from tests.sim.test_world import wander; import sys; "
        "sys.stdout.write(wander(room(seed=7)))"
    )
    command = [sys.executable, "-c", code]
    other = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=True, timeout=120)
    assert other.stdout == wander(room(seed=7))


def test_the_hash_is_that_of_the_states() -> None:
    """Design, section 8: sha256 over (time, qpos, qvel, ctrl) at each control tick, computed here from outside."""
    world = room(seed=1)
    digest = hashlib.sha256()
    assert world.hash == digest.hexdigest()
    for _ in range(20):
        world.robot.sense()
        world.robot.act(Drive(Twist(0.2, 0.4)))
        world.step()
        data = world.data
        digest.update(np.float64(data.time).tobytes() + data.qpos.tobytes() + data.qvel.tobytes() + data.ctrl.tobytes())
        assert world.hash == digest.hexdigest()


def test_looking_changes_nothing() -> None:
    """Ground truth, clearance and the hash itself asked for or not; the camera above the field fitted or not."""
    plain = wander(room(seed=7))
    watched = room(seed=7)
    for _ in range(60):
        for _ in range(3):
            watched.ground_truth()
            watched.robot.clearance()
        assert watched.hash
        assert watched.diverged() is None
        wander(watched, 1)
        watched.ground_truth()
    assert watched.hash == plain
    filmed = room(seed=7, fit_out=FitOut(top_camera=True))
    try:
        assert wander(filmed) == plain
    finally:
        filmed.close()


def test_cars_of_different_seeds_differ_a_little_and_identical_cars_do_not() -> None:
    """Tolerances: 5 % of friction, 0.1 % of wheel radius, clipped at two and a half sigma."""

    def built(seed: int, physics: PhysicsParameters | None = None) -> np.ndarray:
        model = room(2, 2, seed=seed, physics=physics).model
        wheels = [model.geom(f"robocar/{name}_wheel") for name in ("front_left", "rear_left", "front_right", "rear_right")]
        return np.array([[wheel.friction[0], wheel.size[0], wheel.size[2]] for wheel in wheels])

    nominal = built(0, IDENTICAL_CARS)
    np.testing.assert_array_equal(nominal, built(1, IDENTICAL_CARS))
    np.testing.assert_allclose(nominal, np.tile([0.9, 0.042, 0.042], (4, 1)))
    cars = np.array([built(seed) for seed in range(30)]) / nominal
    assert np.ptp(cars[:, :, 0], axis=1).max() < 1e-12  # one floor, one rubber
    assert np.abs(cars[:, :, 0] - 1).max() <= 2.5 * 0.05 + 1e-9
    assert np.abs(cars[:, :, 1] - 1).max() <= 2.5 * 0.001 + 1e-9
    np.testing.assert_array_equal(cars[:, :, 1], cars[:, :, 2])  # wheels stay round
    assert cars[:, 0, 0].std() == pytest.approx(0.05, rel=0.5)
    assert cars[:, :, 1].std() == pytest.approx(0.001, rel=0.35)


# -- time --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("control_period", "timestep"), [(0.05, 0.005), (0.1, 0.002), (0.02, 0.0025), (0.01, 0.01)])
def test_a_tick_lasts_one_control_period(control_period: float, timestep: float) -> None:
    world = room(2, 2, physics=PhysicsParameters(timestep, control_period))
    assert world.time == 0.0
    for tick in range(1, 21):
        world.robot.sense()
        world.robot.act(Hold())
        world.step()
        assert world.time == pytest.approx(tick * control_period, abs=1e-9)
    assert world.control_period == control_period
    assert world.model.opt.timestep == timestep


@pytest.mark.parametrize(
    ("physics", "firmware", "named"),
    [
        (PhysicsParameters(control_period=0.055), None, "control_period"),
        (PhysicsParameters(control_period=0.005), None, "control_period"),
        (PhysicsParameters(control_period=0.0), None, "control_period"),
        (PhysicsParameters(control_period=-0.05), None, "control_period"),
        (PhysicsParameters(timestep=0.003), None, "timestep"),
        (PhysicsParameters(timestep=0.02), None, "timestep"),
        (PhysicsParameters(timestep=0.0), None, "timestep"),
        (None, FirmwareParameters(period=0.03), "control_period"),
        (None, FirmwareParameters(period=0.0), "firmware's period"),
    ],
)
def test_periods_that_do_not_divide_are_refused(
    physics: PhysicsParameters | None, firmware: FirmwareParameters | None, named: str
) -> None:
    with pytest.raises(ScenarioError, match=rf"must be an integer multiple.*{named}|{named}.*must be an integer multiple"):
        room(2, 2, physics=physics, firmware=firmware)


# -- commands ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [Done("seen enough"), GiveUp("no way")])
def test_who_has_finished_stands_still(command: Done | GiveUp) -> None:
    world = room()
    drive(world, Drive(Twist(0.3, 0.0)), 1.0)
    drive(world, command, 1.0)
    assert abs(world.ground_truth().twist.v) < 0.003


def test_hold_keeps_a_twist_and_a_serial_command_going() -> None:
    twist, serial = room(), room()
    drive(twist, Drive(Twist(0.3, 0.0)), 1.0)
    drive(twist, Hold(), 1.0)
    assert twist.ground_truth().twist.v == pytest.approx(0.3, rel=0.05)
    drive(serial, Serial("M9"), 0.05)
    assert serial.robot.busy
    drive(serial, Hold(), 2.0)
    assert serial.robot.busy
    assert serial.ground_truth().twist.v == pytest.approx(FirmwareParameters().command_speed, rel=0.05)


def test_ground_truth_is_consistent_with_itself() -> None:
    """The pose's differences over a tick are the twist, turned into the world."""
    world = room(physics=IDENTICAL_CARS)
    drive(world, Drive(Twist(0.3, 0.6)), 1.5)
    mean = []
    for _ in range(20):
        before = world.ground_truth()
        drive(world, Drive(Twist(0.3, 0.6)), 0.05)
        after = world.ground_truth()
        step = before.pose.inverse() @ after.pose
        mean.append([step.x / 0.05 - after.twist.v, step.theta / 0.05 - after.twist.omega])
        assert after.time == pytest.approx(before.time + 0.05)
    np.testing.assert_allclose(np.mean(mean, axis=0), 0.0, atol=0.02)


# -- events and contacts -----------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=25)
@given(x=st.floats(0.5, 7.5), y=st.floats(0.5, 7.5), theta=st.floats(-math.pi, math.pi))
def test_a_kidnapped_car_lands_exactly_and_at_rest(kidnapped: World, x: float, y: float, theta: float) -> None:
    kidnapped.robot.act(Drive(Twist(0.3, 0.5)))
    kidnapped.step()
    target = SE2(x, y, theta)
    kidnapped.robot.kidnap(target)
    truth = kidnapped.ground_truth()
    assert (truth.pose.x, truth.pose.y) == (x, y)
    assert math.remainder(truth.pose.theta - theta, math.tau) == pytest.approx(0.0, abs=1e-12)
    assert truth.twist == Twist()
    kidnapped.robot.act(Drive(Twist()))
    kidnapped.step()
    assert kidnapped.ground_truth().pose.distance_to(target) < 0.02
    assert kidnapped.diverged() is None


@pytest.fixture(scope="module")
def kidnapped() -> World:
    return room()


def test_a_kidnapping_is_not_felt_by_the_encoders_but_seen_by_the_sonars() -> None:
    world = room(seed=1)
    drive(world, Drive(Twist(0.2, 0.0)), 1.0)
    drive(world, Drive(Twist()), 1.0)
    before = world.robot.sense()
    world.robot.kidnap(SE2(7.0, 4.0, 0.0))
    world.robot.act(Hold())
    world.step()
    after = world.robot.sense()
    assert before.wheel_angles
    assert after.wheel_angles
    assert abs(after.wheel_angles.value.left - before.wheel_angles.value.left) <= math.radians(1.8) + 1e-9
    assert np.nanmean([scan.ranges[0] for scan in after.sonars]) == pytest.approx(0.9, abs=0.05)


def test_clearance_is_measured_anew_after_a_kidnapping() -> None:
    world = room(clearance=lambda corners: float(np.min(corners[:, 0])))
    assert world.robot.clearance() == pytest.approx(3.9, abs=1e-3)
    world.robot.kidnap(SE2(1.0, 4.0, 0.0))
    assert world.robot.clearance() == pytest.approx(0.9, abs=1e-9)
    assert world.ground_truth().clearance == world.robot.clearance()


@pytest.mark.parametrize(("heading", "speed"), [(0.0, 0.2), (math.pi, -0.2), (0.6, 0.2)])
def test_contacts_are_noticed_ahead_behind_and_at_a_corner(heading: float, speed: float) -> None:
    """Clearance zero is contact: the footprint against the wall at x = 8, by the corner that comes first."""

    def clearance(corners: np.ndarray) -> float:
        return max(8.0 - float(corners[:, 0].max()), 0.0)

    world = room(start=SE2(7.7, 4.0, heading), clearance=clearance)
    touched, rooms = [], []
    for _ in range(40):
        world.robot.act(Drive(Twist(speed, 0.0)))
        world.step()
        truth = world.ground_truth()
        touched.append(truth.contact)
        rooms.append(truth.clearance)
    first = touched.index(True)
    assert first > 3
    assert rooms[first] < 0.005
    assert min(rooms[: first - 1]) > 0.0  # touching at the very end of a tick is noticed in the next one


def test_driving_along_a_wall_without_touching_is_no_contact() -> None:
    world = room(start=SE2(2.0, 0.12, 0.0), physics=IDENTICAL_CARS)
    for _ in range(40):
        world.robot.act(Drive(Twist(0.3, 0.0)))
        world.step()
        assert not world.ground_truth().contact


def test_obstacles_are_pushed_against_for_real() -> None:
    """No tunnelling: the footprint never enters a box that stands in the way, by more than the contact's softness."""
    box = Box((0.3, 0.3, 0.2), SE2(4.6, 4.0))
    world = room(solids=[box])
    drive(world, Drive(Twist(0.4, 0.0)), 4.0)
    nose = RobotModel.load().footprint.at(world.ground_truth().pose)[:, 0].max()
    assert nose == pytest.approx(4.45, abs=0.005)


# -- what is wrong is said ---------------------------------------------------------------------------------------------


def test_divergence_is_named() -> None:
    world = room(2, 2)
    assert world.diverged() is None
    world.data.warning[int(mujoco.mjtWarning.mjWARN_BADQACC)].number = 1
    assert world.diverged() == "MuJoCo warns: mjWARN_BADQACC"
    broken = room(2, 2)
    broken.data.qpos[0] = math.nan
    assert broken.diverged() == "the state is not finite"


def test_closing_twice_is_no_error() -> None:
    world = room(2, 2, fit_out=FitOut(top_camera=True))
    world.close()
    world.close()
