"""The car in physics. Oracles: the motors' data sheet in the MJCF, Ohm's law, symmetry, the model's own geometry."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from robocar.core import SE2, Drive, Footprint, Hold, ScenarioError, Twist
from robocar.sim.fit_out import FitOut
from robocar.sim.physics import PhysicsParameters
from robocar.sim.robot_model import RobotModel
from robocar.sim.world import World
from tests.sim.rooms import IDENTICAL_CARS, drive, execute, room

CAR = RobotModel.load()
WHEELS = ("front_left", "rear_left", "front_right", "rear_right")
NOMINAL_VOLTAGE, STALL_TORQUE, NO_LOAD_SPEED, GEAR = 11.1, 0.03333, 450.0, 30.0  # robot.xml, class "motor"


def lifted() -> mujoco.MjModel:
    """The car on a stand: its base fixed, its wheels free in the air."""
    spec = CAR.spec(FitOut())
    spec.delete(spec.joint("base"))
    spec.option.timestep = 0.001
    return spec.compile()


# -- motors ------------------------------------------------------------------------------------------------------------


def test_the_numbers_of_the_motors_are_those_that_these_tests_expect() -> None:
    text = (CAR.folder / "robot.xml").read_text()
    assert f'nominal="{NOMINAL_VOLTAGE} {STALL_TORQUE} {NO_LOAD_SPEED:g}" gear="{GEAR:g}"' in text
    assert CAR.drive.motor.supply == NOMINAL_VOLTAGE


@pytest.mark.parametrize("voltage", [11.1, -11.1, 5.0])
def test_no_load_speed(voltage: float) -> None:
    model = lifted()
    data = mujoco.MjData(model)
    data.ctrl[:] = voltage
    mujoco.mj_step(model, data, 2000)
    speeds = [data.joint(f"{name}_wheel").qvel[0] for name in WHEELS]
    assert speeds == pytest.approx([voltage / NOMINAL_VOLTAGE * NO_LOAD_SPEED / GEAR] * 4, rel=0.02)


@pytest.mark.parametrize("voltage", [11.1, -11.1, 5.0])
def test_stall_torque_on_a_clamped_wheel(voltage: float) -> None:
    """The torque that the clamp, a stiff equality of the joint, has to hold against."""
    spec = CAR.spec(FitOut())
    spec.delete(spec.joint("base"))
    for name in WHEELS:
        spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=f"{name}_wheel")
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = voltage
    mujoco.mj_step(model, data, 2000)
    held = [-float(data.joint(f"{name}_wheel").qfrc_constraint[0]) for name in WHEELS]
    assert held == pytest.approx([voltage / NOMINAL_VOLTAGE * STALL_TORQUE * GEAR] * 4, rel=0.02)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_torque_falls_linearly_with_speed(share: float) -> None:
    model = lifted()
    data = mujoco.MjData(model)
    data.ctrl[:] = NOMINAL_VOLTAGE
    for name in WHEELS:
        data.joint(f"{name}_wheel").qvel = share * NO_LOAD_SPEED / GEAR
    mujoco.mj_forward(model, data)
    torques = [float(data.joint(f"{name}_wheel").qfrc_actuator[0]) for name in WHEELS]
    assert torques == pytest.approx([(1.0 - share) * STALL_TORQUE * GEAR] * 4, rel=0.02)


def test_a_channel_never_carries_more_than_the_driver_allows() -> None:
    """Ohm's law from outside: voltages after a tick of one firmware period, wheel speeds before it; full reversals on purpose."""
    world = room(physics=PhysicsParameters(control_period=0.01))
    resistance = NOMINAL_VOLTAGE**2 / NO_LOAD_SPEED / STALL_TORQUE
    emf_constant = NOMINAL_VOLTAGE / NO_LOAD_SPEED * GEAR
    rng = np.random.default_rng(0)
    wanted = (0.0, 0.0)
    world.robot.firmware.step = lambda left, right: wanted  # type: ignore[method-assign]
    currents, voltages = [], []
    for tick in range(300):
        if tick % 15 == 0:
            wanted = tuple(rng.choice([-11.1, 11.1, 0.0], 2))
        speeds = [
            [world.data.joint(f"robocar/{end}_{side}_wheel").qvel[0] for end in ("front", "rear")] for side in ("left", "right")
        ]
        world.robot.act(Hold())
        world.step()
        applied = np.array(world.ground_truth().voltages)
        voltages.append(applied)
        currents.append(2.0 * (applied - emf_constant * np.mean(speeds, axis=1)) / resistance)
    assert np.abs(currents).max() == pytest.approx(CAR.drive.motor.channel_current, rel=1e-3)  # reached, and never exceeded
    assert np.abs(voltages).max() <= CAR.drive.motor.supply + 1e-12
    assert world.diverged() is None


# -- on the floor ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("seed", "heading"), [(0, 0.0), (1, 2.0)])
def test_parked_for_a_minute_it_stays_where_it_is(seed: int, heading: float) -> None:
    world = room(seed=seed, start=SE2(4, 4, heading))
    start = world.ground_truth().pose
    moved = []
    for _ in range(1200):
        world.robot.act(Hold())
        world.step()
        moved.append(start.inverse() @ world.ground_truth().pose)
    assert world.time == pytest.approx(60.0)
    assert max(math.hypot(p.x, p.y) for p in moved) < 1e-3
    assert max(abs(p.theta) for p in moved) < math.radians(0.1)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_after_a_drive_it_comes_to_rest(seed: int) -> None:
    """No hunting around the last pulse: a second after the stop the motors are off and stay so."""
    world = room(seed=seed)
    drive(world, Drive(Twist(0.3, 0.1 * seed)), 1.0)
    drive(world, Drive(Twist()), 1.5)
    stopped = world.ground_truth().pose
    speeds, voltages = [], []
    for _ in range(200):
        world.robot.act(Hold())
        world.step()
        speeds.append(abs(world.ground_truth().twist.v))
        voltages.append(np.abs(world.ground_truth().voltages).max())
    assert np.median(speeds) < 1e-4
    assert np.median(voltages) == 0.0
    assert stopped.distance_to(world.ground_truth().pose) < 1e-3


@pytest.mark.parametrize(
    "twists",
    [
        [Twist(0.2, 0.8)] * 40,
        [Twist(0.3, 0.3)] * 20 + [Twist(0.1, -1.2)] * 20,
        [Twist(0.0, 1.5)] * 40,
        [Twist(-0.2, 0.6)] * 30,
    ],
)
def test_mirror_images_of_commands_are_mirror_images_of_motion(twists: list[Twist]) -> None:
    """Chaotic stick-slip would amplify rounding: motion that stays symmetric is motion that is reproducible."""
    ends = []
    for sign in (1.0, -1.0):
        world = room(physics=IDENTICAL_CARS)
        for twist in twists:
            world.robot.act(Drive(Twist(twist.v, sign * twist.omega)))
            world.step()
        pose = world.ground_truth().pose
        ends.append([pose.x - 4.0, sign * (pose.y - 4.0), sign * pose.theta])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)
    assert abs(ends[0][2]) > 0.2


def test_turns_left_and_right_by_command_mirror_each_other() -> None:
    _, left = execute(room(physics=IDENTICAL_CARS), "Kr90")
    _, right = execute(room(physics=IDENTICAL_CARS), "Kn90")
    # Counts are rounded down on both sides, which mirrors to rounding up: not more than one pulse of difference.
    assert left.theta == pytest.approx(-right.theta, abs=math.radians(1.8) * 0.042 / 0.23)
    assert math.hypot(left.x - right.x, left.y + right.y) < 0.002


def test_speed_commanded_is_speed_driven() -> None:
    """Kinematics: after the ramp, distance = speed x time; calibrated wheel radius."""
    world = room(12, 8, start=SE2(1, 4), physics=IDENTICAL_CARS)
    drive(world, Drive(Twist(0.3, 0.0)), 1.0)
    before = world.ground_truth().pose
    drive(world, Drive(Twist(0.3, 0.0)), 10.0)
    moved = before.inverse() @ world.ground_truth().pose
    assert moved.x == pytest.approx(3.0, rel=0.02)
    assert abs(moved.y) < 0.02


def test_it_rests_on_its_wheels_and_nothing_else() -> None:
    """Newton: the four wheels carry the weight."""
    world = room()
    data, model = world.data, world.model
    names = sorted(model.geom(geom).name for contact in data.contact for geom in contact.geom)
    assert names == sorted([f"robocar/{name}_wheel" for name in WHEELS] + ["floor"] * 4)
    weight = float(np.sum(model.body_mass)) * 9.81
    force = np.zeros(6)
    total = 0.0
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        total += force[0]
    assert total == pytest.approx(weight, rel=0.01)


# -- geometry ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fit_out", [FitOut(camera=True), FitOut("ring", "hokuyo")])
def test_the_footprint_covers_everything_that_collides(fit_out: FitOut) -> None:
    """Brute force: points on the surface of every geom that collides, wheels too, seen from above."""
    model = CAR.spec(fit_out).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    colliding = [i for i in range(model.ngeom) if model.geom_contype[i] or model.geom_conaffinity[i]]
    assert len(colliding) == 5  # hull and wheels
    signs = np.array(list(product([-1, 1], repeat=3)))
    outline = CAR.footprint.vertices
    edges = np.roll(outline, -1, axis=0) - outline
    for i in colliding:
        points = data.geom_xpos[i] + (signs * model.geom_aabb[i, 3:] + model.geom_aabb[i, :3]) @ data.geom_xmat[i].reshape(3, 3).T
        offsets = points[:, None, :2] - outline
        inside = edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
        assert np.all(inside >= -1e-12), model.geom(i).name


def test_the_footprint_is_no_larger_than_the_hull() -> None:
    """robot.xml: a box of 20 x 18 cm around the origin."""
    footprint = CAR.footprint
    assert isinstance(footprint, Footprint)
    assert np.ptp(footprint.vertices, axis=0) == pytest.approx([0.20, 0.18])
    assert footprint.inscribed_radius == pytest.approx(0.09)
    assert footprint.circumscribed_radius == pytest.approx(math.hypot(0.10, 0.09))
    assert footprint.circumscribed_radius < 0.15  # it turns on the spot inside a cell of 30 cm


def test_the_geometric_track_is_the_distance_of_the_wheels() -> None:
    model = CAR.spec(FitOut()).compile()
    assert CAR.geometric_track == pytest.approx(2 * abs(model.body("front_left_wheel").pos[1]))


# -- fit-outs ----------------------------------------------------------------------------------------------------------

SONARS = {
    "none": {},
    "front": {"front_left": 0.0, "front_right": 0.0},
    "front+sides": {"front_left": 0.0, "front_right": 0.0, "left": math.pi / 2, "right": -math.pi / 2},
    "ring": {f"ring_{i:02d}": i * math.tau / 16 for i in range(16)},
}
LIDARS = {"none": None, "hokuyo": (math.radians(205), 570, 5.6), "scan360": (math.tau * 359 / 360, 360, 6.0)}


@pytest.mark.parametrize(
    "fit_out", [FitOut(*choice) for choice in product(SONARS, LIDARS, [False, True], [False, True])], ids=str
)  # type: ignore[arg-type]
def test_every_fit_out_compiles_and_gives_what_it_says(fit_out: FitOut) -> None:
    """Issue 2, part 5: bearings, ranges and numbers of beams."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_frame()
    spec.attach(CAR.spec(fit_out), prefix="robocar/", frame=spec.worldbody.add_frame())
    model = spec.compile()
    robot = CAR.describe(fit_out)
    expected = SONARS[fit_out.sonars]
    assert [sonar.name for sonar in robot.sonars] == list(expected)
    directions = [sonar.robot_from_sensor.theta for sonar in robot.sonars]
    np.testing.assert_allclose(np.exp(1j * np.array(directions)), np.exp(1j * np.array(list(expected.values()))), atol=1e-9)
    # Each looks away from the car: its mount lies on the side that it looks to.
    assert all(
        math.cos(s.robot_from_sensor.theta) * s.robot_from_sensor.x + math.sin(s.robot_from_sensor.theta) * s.robot_from_sensor.y
        > 0.05
        for s in robot.sonars
    )
    assert all(s.beam_width == pytest.approx(math.radians(15)) and s.max_range == 5.0 for s in robot.sonars)
    lidar = robot.lidar and (float(np.ptp(robot.lidar.bearings)), len(robot.lidar.bearings), robot.lidar.max_range)
    assert lidar == (LIDARS[fit_out.lidar] and pytest.approx(LIDARS[fit_out.lidar]))
    assert (robot.compass, robot.camera) == (fit_out.compass, fit_out.camera)
    assert model.ncam == int(fit_out.camera)
    assert model.nu == 4 + 2 * fit_out.camera
    assert robot.pulses_per_turn == 200


def test_the_hokuyo_looks_to_both_sides_alike_and_the_full_scan_has_no_beam_twice() -> None:
    for lidar in ("hokuyo", "scan360"):
        fitted = CAR.describe(FitOut(lidar=lidar)).lidar
        assert fitted
        assert len(np.unique(np.round(np.exp(1j * fitted.bearings), 6))) == len(fitted.bearings)
        np.testing.assert_allclose(np.diff(fitted.bearings), fitted.bearings[1] - fitted.bearings[0])
        assert fitted.bearings[0] == pytest.approx(-math.radians(102.5) if lidar == "hokuyo" else -math.pi)
        assert np.any(np.isclose(fitted.bearings, 0.0)) == (lidar == "scan360")  # 570 beams have none in the middle


def test_a_fitted_car_senses_what_it_carries_and_nothing_else() -> None:
    plain, full = room(fit_out=FitOut("none")), room(fit_out=FitOut("front+sides", "scan360", compass=True))
    seen, more = plain.robot.sense(), full.robot.sense()
    assert (len(seen.sonars), seen.lidar, seen.compass, seen.image, seen.top_image) == (0, None, None, None, None)
    assert [scan.name for scan in more.sonars] == list(SONARS["front+sides"])
    assert more.lidar
    assert more.lidar.ranges.shape == (360,)
    assert more.compass
    assert abs(more.compass.value) < math.radians(5 * 0.4)


# -- calibration -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    [
        "wheel_radius: 0.042",
        "effective_track: [[0, 0.2]]",
        "wheel_radius: -1\neffective_track: [[0, 0.2]]",
        "wheel_radius: .nan\neffective_track: [[0, 0.2]]",
        "wheel_radius: .inf\neffective_track: [[0, 0.2]]",
        "wheel_radius: yes\neffective_track: [[0, 0.2]]",
        "wheel_radius: 0.04\nwheel_radius: 0.05\neffective_track: [[0, 0.2]]",
        "wheel_radius: 0.04\neffective_track: [[0, 0.2], [.nan, 0.2]]",
        "wheel_radius: 0.04\neffective_track: [[0, 0.2",
        "wheel_radius: 2020-13-45\neffective_track: [[0, 0.2]]",
        "wheel_radius: fast\neffective_track: [[0, 0.2]]",
        "wheel_radius: 0.04\neffective_track: [[1, 0.2], [0, 0.2]]",
        "wheel_radius: 0.04\neffective_track: [[0, -0.2]]",
        "wheel_radius: 0.04\neffective_track: [0, 0.2]",
        "wheel_radius: 0.04\neffective_track: []",
        "- 1\n- 2",
        "",
        "{",
    ],
)
def test_a_broken_calibration_is_named(content: str, tmp_path: Path) -> None:
    nested = "".join(f"  {line}\n" for line in content.splitlines())
    (tmp_path / "calibration.yaml").write_text(f"without_camera:\n{nested}")
    for name in ("robot.xml", "robot.yaml"):
        (tmp_path / name).write_text((CAR.folder / name).read_text())
    broken = RobotModel.load(tmp_path)
    for fit_out in (FitOut(), FitOut(camera=True)):  # the second one's entry is not even there
        with pytest.raises(ScenarioError, match=r"calibration\.yaml(, line \d+)?: .") as refused:
            broken.calibration(fit_out)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("camera", [False, True])
def test_the_shipped_calibration_is_read(camera: bool) -> None:
    """The file itself, and what a skid-steered car must have: an effective track wider than the geometric one."""
    content = yaml.safe_load((CAR.folder / "calibration.yaml").read_text())
    content = content["with_camera" if camera else "without_camera"]
    calibration = CAR.calibration(FitOut(camera=camera))
    assert calibration.wheel_radius == content["wheel_radius"]
    assert np.column_stack([calibration.curvature, calibration.track]).tolist() == content["effective_track"]
    assert calibration.wheel_radius == pytest.approx(0.042, rel=0.02)
    assert calibration.track.min() > CAR.geometric_track


# -- all worlds --------------------------------------------------------------------------------------------------------


def test_there_are_scenarios() -> None:
    from robocar.scenario.load import scenario_names

    assert "thesis-field" in scenario_names()


def _scenario_names() -> list[str]:
    from robocar.scenario.load import scenario_names

    return scenario_names()


@pytest.mark.parametrize("name", _scenario_names())
def test_a_second_of_pseudo_random_control_raises_no_warning(name: str) -> None:
    """As MuJoCo Menagerie's tests: whatever the motors do, MuJoCo has nothing to warn of, and the car stays on the floor."""
    from robocar.episode.run import simulate

    world: World = simulate(name, seed=3)
    try:
        rng = np.random.default_rng(3)
        wanted = (0.0, 0.0)
        world.robot.firmware.step = lambda left, right: wanted  # type: ignore[method-assign]
        for _ in range(round(1.0 / world.control_period)):
            wanted = tuple(rng.uniform(-11.1, 11.1, 2))
            world.robot.act(Hold(pan=float(rng.uniform(-2, 2))))
            world.step()
        assert world.data.warning.number.tolist() == [0] * len(world.data.warning.number)
        assert world.diverged() is None
        assert abs(world.data.joint("robocar/base").qpos[2]) < 0.02
    finally:
        world.close()
