"""Wheel radius and effective track of the skid-steered car, from straights, arcs, turns on the spot and driven squares.

The wheels of a skid-steered car slip sideways when it turns, so that it turns less than its geometric track would have it.
What the experiment measures as with a tape and a protractor (the true motion), it divides by what the encoders counted:

    wheel radius      r = distance / mean wheel angle                  on straights
    effective track   b = r (right - left wheel angle) / turn          on arcs of each curvature and on the spot

as means over cars with different tyres and wheels, once without and once with the camera's head, whose weight lies ahead of
the wheels' middle. Driven squares, clockwise and counter-clockwise, are the test (UMBmark:
Borenstein and Feng, Measurement and Correction of Systematic Odometry Errors in Mobile Robots, 1996): the distance between
the pose that odometry believes at the end and the true one, before (nominal radius, geometric track) and after.

A full run writes `models/robots/robocar/calibration.yaml`, which the firmware and odometry read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import yaml

from robocar.core import SE2, Array, Drive, Hold, OccupancyGrid, Serial, Twist, wrap_angle
from robocar.core.robot import Calibration
from robocar.estimation.odometry.odometry import WheelOdometry
from robocar.paths import MODELS
from robocar.reporting.report import Report
from robocar.sim.fit_out import FitOut
from robocar.sim.robot_handle import RobotSetup
from robocar.sim.robot_model import RobotModel
from robocar.sim.world import World
from robocar.sim.world_spec import build_world

NOMINAL_RADIUS = 0.042  # [m] thesis, section 3.5
SPEEDS = (0.15, 0.25, 0.35)  # [m/s] of straights
CURVATURES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # [1/m]
SPIN = 100.0  # [1/m] the table's entry for turning on the spot
SPIN_RATES = (0.5, 1.0, 1.4)  # [rad/s]


def car(seed: int, camera: bool) -> World:
    """A car on an open floor, with or without the camera's head; its pictures are not looked at."""
    floor = OccupancyGrid(np.zeros((20, 20), dtype=np.int8), 0.5, SE2(-5.0, -5.0))
    setup = RobotSetup(SE2(), fit_out=FitOut(camera=camera), sensors={"camera": {"period": 1e6}})
    return World(build_world(floor, border="open"), [setup], seed=seed)


def drive(world: World, twist: Twist, seconds: float) -> tuple[float, float, float, float]:
    """Keeps a twist after a second of settling; way [m], turn [rad], and the angles of the left and right wheels [rad]."""
    period = world.control_period
    for _ in range(round(1.0 / period)):
        world.robot.sense()
        world.robot.act(Drive(twist))
        world.step()
    way = turn = 0.0
    pose, first = world.ground_truth().pose, _wheels(world)
    for _ in range(round(seconds / period)):
        world.robot.act(Drive(twist))
        world.step()
        following = world.ground_truth().pose
        way += pose.distance_to(following)
        turn += wrap_angle(following.theta - pose.theta)
        pose = following
    last = _wheels(world)
    return way, turn, last[0] - first[0], last[1] - first[1]


def _wheels(world: World) -> tuple[float, float]:
    reading = world.robot.sense().wheel_angles
    assert reading is not None
    return reading.value.left, reading.value.right


def wheel_radius(seeds: range, camera: bool = False) -> Array:
    """One estimate per car and speed, (n,) [m]."""
    found = []
    for seed in seeds:
        for speed in SPEEDS:
            way, _, left, right = drive(car(seed, camera), Twist(speed), 2.0 / speed)
            found.append(way / (0.5 * (left + right)))
    return np.array(found)


def effective_track(radius: float, curvature: float, seeds: range, camera: bool = False) -> Array:
    """One estimate per car, direction and speed at this curvature, (n,) [m]."""
    found = []
    for seed in seeds:
        for sign in (1.0, -1.0):
            if curvature == SPIN:
                twists = [Twist(0.0, sign * rate) for rate in SPIN_RATES]
            else:
                omega = min(1.2, 0.3 * curvature)
                twists = [Twist(omega / curvature, sign * omega)]
            for twist in twists:
                _, turn, left, right = drive(car(seed, camera), twist, 4.0 * math.pi / max(abs(twist.omega), 0.5))
                found.append(radius * (right - left) / turn)
    return np.array(found)


def square(seed: int, clockwise: bool, calibrations: list[Calibration], camera: bool = False) -> list[tuple[float, float]]:
    """Drives a square of 1.5 m by serial commands; end point that each calibration's odometry sees minus the true one [m]."""
    world = car(seed, camera)
    odometries = [WheelOdometry(calibration, SE2()) for calibration in calibrations]
    for line in (["M5", "Kn90"] if clockwise else ["M5", "Kr90"]) * 4:
        command = Serial(line)
        while True:
            observation = world.robot.sense()
            assert observation.wheel_angles is not None
            for odometry in odometries:
                odometry.update(observation.time, observation.wheel_angles.value)
            if observation.serial and observation.serial[-1] == "DONE":
                break
            world.robot.act(command)
            world.step()
            command = Hold()
    true = world.ground_truth().pose
    return [(odometry.pose.x - true.x, odometry.pose.y - true.y) for odometry in odometries]


def systematic_error(ends: Array) -> float:
    """UMBmark's E_max: the larger distance from the origin of the two centres of gravity, ends (2, n, 2) by direction [m]."""
    return float(np.linalg.norm(ends.mean(axis=1), axis=1).max())


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What was found for one fit-out: samples over cars, and where driven squares ended for either calibration, (2, n, 2, 2)."""

    radii: Array
    curvatures: tuple[float, ...]
    tracks: list[Array]
    ends: Array
    calibration: Calibration

    @property
    def content(self) -> dict[str, object]:
        """As in `calibration.yaml`."""
        table = np.column_stack([self.calibration.curvature, self.calibration.track])
        return {"wheel_radius": self.calibration.wheel_radius, "effective_track": table.tolist()}


def identify(camera: bool, quick: bool) -> Identified:
    """Identifies the car with or without its camera's head, and drives the squares."""
    seeds = range(1000, 1002 if quick else 1008)
    radii = wheel_radius(seeds, camera)
    curvatures = (*((1.0, 8.0) if quick else CURVATURES), SPIN)
    tracks = [effective_track(float(radii.mean()), curvature, seeds, camera) for curvature in curvatures]
    means = np.array([round(float(t.mean()), 5) for t in tracks])
    calibration = Calibration(round(float(radii.mean()), 6), np.array(curvatures), means)
    nominal = Calibration(NOMINAL_RADIUS, np.array([0.0, SPIN]), np.full(2, RobotModel.load().geometric_track))
    test_seeds = range(2000, 2002 if quick else 2005)
    ends = np.array([[square(seed, cw, [nominal, calibration], camera) for seed in test_seeds] for cw in (True, False)])
    return Identified(radii, curvatures, tracks, ends, calibration)


def main(out: Path, quick: bool = False) -> None:
    """Identify, test, write."""
    report = Report(out, "Odometry calibration")
    found = {"without_camera": identify(False, quick), "with_camera": identify(True, quick)}
    report.number("geometric_track", RobotModel.load().geometric_track, "m")
    for fit_out, car_ in found.items():
        radius, radii = car_.calibration.wheel_radius, car_.radii
        tag = "" if fit_out == "without_camera" else "with_camera/"
        report.number(f"{tag}wheel_radius", radius, "m", paper=NOMINAL_RADIUS)
        report.number(f"{tag}wheel_radius_std", float(radii.std(ddof=1)), "m")
        rows = []
        for curvature, track, samples in zip(car_.curvatures, car_.calibration.track, car_.tracks, strict=True):
            name = "spin" if curvature == SPIN else f"curvature_{curvature:g}"
            report.number(f"{tag}effective_track/{name}", float(track), "m")
            report.number(f"{tag}effective_track_std/{name}", float(samples.std(ddof=1)), "m")
            rows.append(("on the spot" if curvature == SPIN else f"{curvature:g}", f"{track:.4f}", f"{samples.std(ddof=1):.4f}"))
        before, after = systematic_error(car_.ends[:, :, 0]), systematic_error(car_.ends[:, :, 1])
        report.number(f"{tag}umbmark_systematic_error_nominal", before, "m")
        report.number(f"{tag}umbmark_systematic_error_calibrated", after, "m")
        report.table(
            ("omega / v [1/m]", "effective track [m]", "spread over cars [m]"),
            rows,
            f"The car {fit_out.replace('_', ' ')}: wheel radius {1000 * radius:.2f} mm (spread {1000 * radii.std(ddof=1):.3f} "
            f"mm), geometric track {RobotModel.load().geometric_track:.3f} m.",
        )
        report.table(
            ("", "systematic error after a 1.5 m square [m]"),
            [("nominal radius, geometric track", f"{before:.3f}"), ("calibrated", f"{after:.4f}")],
        )
    report.write()
    bare = found["without_camera"]
    _picture(out / "effective_track.png", bare.curvatures, bare.tracks, bare.ends)
    content = "# Written by experiments/odometry_calibration.py. effective_track: rows of [omega / v in 1/m, track in m].\n"
    content += yaml.safe_dump({name: car_.content for name, car_ in found.items()}, default_flow_style=None)
    (out / "calibration.yaml").write_text(content)
    if not quick:
        (MODELS / "robots" / "robocar" / "calibration.yaml").write_text(content)


def _picture(path: Path, curvatures: tuple[float, ...], tracks: list[Array], ends: Array) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    left.errorbar(curvatures, [t.mean() for t in tracks], [t.std() for t in tracks], marker="o", capsize=3)
    left.axhline(RobotModel.load().geometric_track, color="grey", linestyle="--", label="geometric track")
    left.set(xscale="log", xlabel="curvature ω/v [1/m] (100: on the spot)", ylabel="effective track [m]")
    left.legend()
    for k, (name, marker) in enumerate((("nominal", "x"), ("calibrated", "o"))):
        for direction, color in ((0, "tab:blue"), (1, "tab:orange")):
            label = f"{name}, {'clockwise' if direction == 0 else 'counter-clockwise'}"
            right.plot(*ends[direction, :, k].T, marker, color=color, label=label)
    right.axhline(0, color="grey", lw=0.5)
    right.axvline(0, color="grey", lw=0.5)
    right.set(xlabel="x error [m]", ylabel="y error [m]", title="odometry after a driven square (UMBmark)", aspect="equal")
    right.legend(fontsize=7)
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
