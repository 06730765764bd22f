"""Noise of the odometry motion model, alpha1 to alpha4, from the physics: what wheel odometry is off by after turns and ways.

Cars with the tolerances that each seed draws (tyres, wheels) drive arcs, straight ways and turns on the spot on an empty floor.
Over windows of a few seconds, odometry's step is compared with the true one; the squares of the errors along the way and of the
turn are fitted by the model's variances (`robocar.estimation.odometry.motion_models`) with weights that make long and short
windows count alike.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from robocar.core import SE2, Array, Drive, OccupancyGrid, Twist, wrap_angle
from robocar.core.randomness import stream
from robocar.estimation.odometry.motion_models import MotionParameters
from robocar.estimation.odometry.odometry import WheelOdometry
from robocar.reporting.report import Report
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.world import World
from robocar.sim.world_spec import build_world

DURATION, WINDOW = 60.0, 3.0  # [s]; the filter sees a landmark about as often


def drive(seed: int) -> tuple[Array, Array]:
    """True and reckoned poses (n, 3) of one car at the ticks."""
    floor = OccupancyGrid(np.zeros((400, 400), dtype=np.int8), 0.1, SE2(-20.0, -20.0))
    world = World(build_world(floor, border="open"), [RobotSetup(SE2(), fit_out=FitOut(sonars="none"))], seed=seed)
    rng = stream(seed, "experiment/motion_noise")
    odometry = WheelOdometry(world.robot.robot.calibration, SE2())
    truth, reckoned = [], []
    until, twist = 0.0, Twist()
    while world.time < DURATION:
        if world.time >= until:
            until = world.time + rng.uniform(1.0, 4.0)
            spin = rng.random() < 0.4
            twist = Twist(0.0 if spin else rng.uniform(0.1, 0.35), rng.uniform(-1.4, 1.4) if spin else rng.normal(0.0, 0.5))
        reading = world.robot.sense().wheel_angles
        assert reading is not None
        odometry.update(reading.time, reading.value)
        truth.append(world.ground_truth().pose.as_array())
        reckoned.append(odometry.pose.as_array())
        world.robot.act(Drive(twist))
        world.step()
    world.close()
    return np.array(truth), np.array(reckoned)


def rows(truth: Array, reckoned: Array, period: float = 0.05) -> Array:
    """For each window: way [m], turn [rad], error along the way [m], error of the turn [rad], (n, 4)."""
    found = []
    length = round(WINDOW / period)
    for k in range(20, len(truth) - length, length):
        ways = np.linalg.norm(np.diff(reckoned[k : k + length + 1, :2], axis=0), axis=1)
        turns = np.abs([wrap_angle(turn) for turn in np.diff(reckoned[k : k + length + 1, 2])])
        steps = [SE2(*poses[k]).inverse() @ SE2(*poses[k + length]) for poses in (truth, reckoned)]
        chords = [math.hypot(step.x, step.y) for step in steps]
        found.append((ways.sum(), turns.sum(), chords[1] - chords[0], wrap_angle(steps[1].theta - steps[0].theta)))
    return np.array(found)


def fit(way: Array, turn: Array, error: Array) -> tuple[float, float]:
    """Coefficients of way and of turn in the error's variance: least squares, relative to the fitted variance."""
    weights = np.ones(len(way))
    result = np.zeros(2)
    for _ in range(20):
        result, _ = nnls(np.column_stack([way, turn]) * weights[:, None], error**2 * weights)
        weights = 1.0 / np.maximum(way * result[0] + turn * result[1], 1e-6)
    return float(result[0]), float(result[1])


def main(out: Path, quick: bool = False) -> None:
    """Drives, fits and compares with the defaults."""
    table = np.concatenate([rows(*drive(seed)) for seed in range(3 if quick else 20)])
    way, turn, along, turned = table.T
    alpha2, alpha1 = fit(way, turn, turned)
    alpha3, alpha4 = fit(way, turn, along)
    defaults = MotionParameters()
    report = Report(out, "Noise of the odometry motion model")
    units = {"alpha1": "rad", "alpha2": "rad^2/m", "alpha3": "m", "alpha4": "m^2/rad"}
    found = {"alpha1": alpha1, "alpha2": alpha2, "alpha3": alpha3, "alpha4": alpha4}
    for name, value in found.items():
        report.number(name, value, units[name])
    report.table(
        ("parameter", "identified", "default", "unit"),
        [(name, value, getattr(defaults, name), units[name]) for name, value in found.items()],
        f"{len(table)} windows of {WINDOW:g} s. Errors of the turn: {math.degrees(float(np.std(turned))):.2f} degrees, "
        f"along the way: {1000 * float(np.std(along)):.1f} mm (standard deviations over all windows).",
    )
    report.write()


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
