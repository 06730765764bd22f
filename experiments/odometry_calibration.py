"""Wheel radius and effective track of the skid-steered car, from straights, arcs, turns on the spot and driven squares.

The wheels of a skid-steered car slip sideways when it turns, so that it turns less than its geometric track would have it.
What the experiment measures as with a tape and a protractor (the true motion), it divides by what the encoders counted:

    wheel radius      r = distance / mean wheel angle                  on straights
    effective track   b = r (right - left wheel angle) / turn          on arcs of each curvature and on the spot

as means over cars with different tyres and wheels. Driven squares, clockwise and counter-clockwise, are the test (UMBmark:
Borenstein and Feng, Measurement and Correction of Systematic Odometry Errors in Mobile Robots, 1996): the distance between
the pose that odometry believes at the end and the true one, before (nominal radius, geometric track) and after.

A full run writes `models/robocar/calibration.yaml`, which the firmware and odometry read.
"""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import yaml

from robocar.core import SE2, Array, Drive, Hold, OccupancyGrid, Serial, Twist, wrap_angle
from robocar.core.robot import Calibration
from robocar.estimation.odometry import WheelOdometry
from robocar.experiment import Report
from robocar.paths import MODELS
from robocar.sim.car import geometric_track
from robocar.sim.simulation import Simulation
from robocar.sim.world import build_world

NOMINAL_RADIUS = 0.042  # [m] thesis, section 3.5
SPEEDS = (0.15, 0.25, 0.35)  # [m/s] of straights
CURVATURES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # [1/m]
SPIN = 100.0  # [1/m] the table's entry for turning on the spot
SPIN_RATES = (0.5, 1.0, 1.4)  # [rad/s]


def car(seed: int) -> Simulation:
    """A car on an open floor."""
    floor = OccupancyGrid(np.zeros((20, 20), dtype=np.int8), 0.5, SE2(-5.0, -5.0))
    return Simulation(build_world(floor, border="open"), start=SE2(), seed=seed)


def drive(simulation: Simulation, twist: Twist, seconds: float) -> tuple[float, float, float, float]:
    """Keeps a twist after a second of settling; way [m], turn [rad], and the angles of the left and right wheels [rad]."""
    period = simulation.control_period
    for _ in range(round(1.0 / period)):
        simulation.sense()
        simulation.act(Drive(twist))
    way = turn = 0.0
    pose, first = simulation.ground_truth().pose, _wheels(simulation)
    for _ in range(round(seconds / period)):
        simulation.act(Drive(twist))
        following = simulation.ground_truth().pose
        way += pose.distance_to(following)
        turn += wrap_angle(following.theta - pose.theta)
        pose = following
    last = _wheels(simulation)
    return way, turn, last[0] - first[0], last[1] - first[1]


def _wheels(simulation: Simulation) -> tuple[float, float]:
    reading = simulation.sense().wheel_angles
    assert reading is not None
    return reading.value.left, reading.value.right


def wheel_radius(seeds: range) -> Array:
    """One estimate per car and speed, (n,) [m]."""
    found = []
    for seed in seeds:
        for speed in SPEEDS:
            way, _, left, right = drive(car(seed), Twist(speed), 2.0 / speed)
            found.append(way / (0.5 * (left + right)))
    return np.array(found)


def effective_track(radius: float, curvature: float, seeds: range) -> Array:
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
                _, turn, left, right = drive(car(seed), twist, 4.0 * math.pi / max(abs(twist.omega), 0.5))
                found.append(radius * (right - left) / turn)
    return np.array(found)


def square(seed: int, clockwise: bool, calibrations: list[Calibration]) -> list[tuple[float, float]]:
    """Drives a square of 1.5 m by serial commands; end point that each calibration's odometry sees minus the true one [m]."""
    simulation = car(seed)
    odometries = [WheelOdometry(calibration, SE2()) for calibration in calibrations]
    for line in (["M5", "Kn90"] if clockwise else ["M5", "Kr90"]) * 4:
        command = Serial(line)
        while True:
            observation = simulation.sense()
            assert observation.wheel_angles is not None
            for odometry in odometries:
                odometry.update(observation.time, observation.wheel_angles.value)
            if observation.serial and observation.serial[-1] == "DONE":
                break
            simulation.act(command)
            command = Hold()
    true = simulation.ground_truth().pose
    return [(odometry.pose.x - true.x, odometry.pose.y - true.y) for odometry in odometries]


def systematic_error(ends: Array) -> float:
    """UMBmark's E_max: the larger distance from the origin of the two centres of gravity, ends (2, n, 2) by direction [m]."""
    return float(np.linalg.norm(ends.mean(axis=1), axis=1).max())


def main(out: Path, quick: bool = False) -> None:
    """Identify, test, write."""
    seeds = range(1000, 1002 if quick else 1008)
    report = Report(out, "Odometry calibration")
    radii = wheel_radius(seeds)
    radius = float(radii.mean())
    curvatures = (*((1.0, 8.0) if quick else CURVATURES), SPIN)
    tracks = [effective_track(radius, curvature, seeds) for curvature in curvatures]
    table = [[float(c), round(float(t.mean()), 5)] for c, t in zip(curvatures, tracks, strict=True)]
    radius = round(radius, 6)
    calibration = Calibration(radius, np.array([row[0] for row in table]), np.array([row[1] for row in table]))
    nominal = Calibration(NOMINAL_RADIUS, np.array([0.0, SPIN]), np.full(2, geometric_track()))

    test_seeds = range(2000, 2002 if quick else 2005)
    ends = np.array([[square(seed, cw, [nominal, calibration]) for seed in test_seeds] for cw in (True, False)])
    before, after = systematic_error(ends[:, :, 0]), systematic_error(ends[:, :, 1])

    report.number("wheel_radius", radius, "m", paper=NOMINAL_RADIUS)
    report.number("wheel_radius_std", float(radii.std(ddof=1)), "m")
    report.number("geometric_track", geometric_track(), "m")
    for (curvature, track), samples in zip(table, tracks, strict=True):
        name = "spin" if curvature == SPIN else f"curvature_{curvature:g}"
        report.number(f"effective_track/{name}", track, "m")
        report.number(f"effective_track_std/{name}", float(samples.std(ddof=1)), "m")
    report.number("umbmark_systematic_error_nominal", before, "m")
    report.number("umbmark_systematic_error_calibrated", after, "m")
    report.table(
        ("omega / v [1/m]", "effective track [m]", "spread over cars [m]"),
        [
            ("on the spot" if c == SPIN else f"{c:g}", f"{t:.4f}", f"{s.std(ddof=1):.4f}")
            for (c, t), s in zip(table, tracks, strict=True)
        ],
        f"Wheel radius {1000 * radius:.2f} mm (spread {1000 * radii.std(ddof=1):.3f} mm), "
        f"geometric track {geometric_track():.3f} m.",
    )
    report.table(
        ("", "systematic error after a 1.5 m square [m]"),
        [("nominal radius, geometric track", f"{before:.3f}"), ("calibrated", f"{after:.4f}")],
    )
    report.write()
    _picture(out / "effective_track.png", curvatures, tracks, ends)
    content = "# Written by experiments/odometry_calibration.py. effective_track: rows of [omega / v in 1/m, track in m].\n"
    content += yaml.safe_dump({"wheel_radius": radius, "effective_track": table}, default_flow_style=None)
    (out / "calibration.yaml").write_text(content)
    if not quick:
        (MODELS / "robocar" / "calibration.yaml").write_text(content)


def _picture(path: Path, curvatures: tuple[float, ...], tracks: list[Array], ends: Array) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    left.errorbar(curvatures, [t.mean() for t in tracks], [t.std() for t in tracks], marker="o", capsize=3)
    left.axhline(geometric_track(), color="grey", linestyle="--", label="geometric track")
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
