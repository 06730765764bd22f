"""Benchmark of localization: one step of the particle filter, and finding balls in a picture.

Beside the filter stands a plain Python loop over the particles with the parameters of PythonRobotics' example (100 particles, 4
landmarks, range 0.2 m; `$ROBOCAR_DATA/references/params.json` where it is there), written anew for this comparison: what a
textbook implementation costs per particle. Times are the smallest of many, as other processes only ever add to them.
"""

from __future__ import annotations

import json
import math
import os
import time as wall
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from robocar.core import SE2, Detection, Image, Landmark
from robocar.estimation.landmarks.area import Area
from robocar.estimation.landmarks.balls import BallDetector
from robocar.estimation.landmarks.particle_filter import FilterParameters, ParticleFilter
from robocar.estimation.landmarks.sensor_models import Atlas
from robocar.estimation.odometry.motion_models import MotionParameters
from robocar.reporting.report import Report

CORNERS = {"blue": (3.5, 0.0), "green": (3.5, 2.5), "orange": (0.0, 2.5), "red": (0.0, 0.0)}
MARKS = tuple(Landmark(color, color, np.array([*place, 0.4]), 0.1) for color, place in CORNERS.items())
RGB = {"blue": (13, 38, 217), "green": (13, 166, 26), "orange": (255, 115, 0), "red": (217, 13, 13)}


def best(action: Callable[[], object], rounds: int) -> float:
    """Smallest time of one call [s]."""
    times = []
    for _ in range(rounds):
        begun = wall.perf_counter()
        action()
        times.append(wall.perf_counter() - begun)
    return min(times)


def filter_step(particles: int) -> Callable[[], object]:
    """Predict, weigh by four landmarks, resample."""
    parameters = FilterParameters(
        min_particles=particles, max_particles=particles, resample_below=1.0, recovery_alpha_fast=0.0, initial_std_xy=0.1
    )
    pose = SE2(1.0, 1.0, 0.3)
    localization = ParticleFilter(parameters, MotionParameters(), Atlas(MARKS), Area(None, MARKS), pose, np.random.default_rng(0))
    seen = []
    for mark in MARKS:
        x, y = pose.inverse_apply(float(mark.position[0]), float(mark.position[1]))
        seen.append(Detection(0.0, mark.name, math.atan2(y, x), math.hypot(x, y), np.diag([1e-4, 1e-3])))
    step = SE2(1e-3, 0.0, 1e-3)

    def once() -> None:
        localization.predict(step)
        localization.weigh(seen)
        localization.resample()

    return once


def plain_step(parameters: dict) -> tuple[Callable[[], object], int]:
    """The same step particle by particle: velocity motion, ranges to four landmarks, low-variance resampling."""
    rng = np.random.default_rng(0)
    count, places = int(parameters["n_particles"]), parameters["landmarks"]
    v_std, yaw_std = parameters["input_std_v_yawdeg"][0], math.radians(parameters["input_std_v_yawdeg"][1])
    state = [[0.0, 0.0, 0.0] for _ in range(count)]
    std = float(parameters["range_std"])
    ranges = [math.hypot(x, y) for x, y in places]

    def once() -> None:
        nonlocal state
        weights = []
        for particle in state:
            v, omega = 1.0 + v_std * rng.standard_normal(), 0.1 + yaw_std * rng.standard_normal()
            particle[0] += 0.1 * v * math.cos(particle[2])
            particle[1] += 0.1 * v * math.sin(particle[2])
            particle[2] += 0.1 * omega
            weight = 1.0
            for (x, y), seen in zip(places, ranges, strict=True):
                off = math.hypot(x - particle[0], y - particle[1]) - seen
                weight *= math.exp(-0.5 * (off / std) ** 2) + 1e-12
            weights.append(weight)
        total = sum(weights)
        chosen, i, sofar = [], 0, weights[0] / total
        offset = rng.random() / count
        for k in range(count):
            while offset + k / count > sofar and i < count - 1:
                i += 1
                sofar += weights[i] / total
            chosen.append(list(state[i]))
        state = chosen

    return once, count


def picture(balls: int) -> Image:
    """160 x 120 pixels with discs in the field's colours."""
    pixels = np.full((120, 160, 3), 60, dtype=np.uint8)
    for color, (x, y, radius) in list(zip(RGB, ((25, 40, 12), (70, 50, 5), (110, 40, 20), (140, 80, 8)), strict=True))[:balls]:
        cv2.circle(pixels, (x, y), radius, RGB[color], -1)
    focal = 60.0 / math.tan(math.radians(22.5))
    intrinsics = np.array([[focal, 0.0, 80.0], [0.0, focal, 60.0], [0.0, 0.0, 1.0]])
    camera = np.array([[0.0, 0, 1, 0.07], [-1, 0, 0, 0], [0, -1, 0, 0.144], [0, 0, 0, 1]])
    return Image(0.0, pixels, intrinsics, camera)


def reference_parameters() -> dict:
    """PythonRobotics' particle filter example; its published numbers where the file is not there."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    file = Path(os.environ.get("ROBOCAR_DATA") or default) / "references" / "params.json"
    if file.is_file():
        return json.loads(file.read_text())["particle_filter"]
    landmarks = [[10.0, 0.0], [10.0, 10.0], [0.0, 15.0], [-5.0, 20.0]]
    return {"landmarks": landmarks, "n_particles": 100, "range_std": 0.2, "input_std_v_yawdeg": [2.0, 40.0]}


def main(out: Path = Path("runs/bench_localization"), quick: bool = False) -> None:
    """Measures, prints and writes a table."""
    rounds = 200 if quick else 3000
    report = Report(out, "Benchmark of localization")
    rows = []
    targets = {400: 60e-6, 10_000: 3e-3}
    plain, count = plain_step(reference_parameters())
    textbook = best(plain, max(20, rounds // 50)) / count
    for particles in (100, 400, 1000, 10_000):
        seconds = best(filter_step(particles), max(50, rounds * 400 // max(particles, 400)))
        report.number(f"filter_step/{particles}", seconds, "s")
        report.number(f"filter_step/{particles}/per_particle_against_plain_python", seconds / particles / textbook, "1")
        target = targets.get(particles)
        text = f"{1e6 * target:.0f}" if target else None
        rows.append((f"filter step, {particles} x 4", f"{1e6 * seconds:.0f}", text, f"{textbook * particles / seconds:.0f}"))
    report.number("plain_python/per_particle", textbook, "s")
    detector = BallDetector(MARKS)
    for balls in (0, 1, 4):
        image = picture(balls)
        seconds = best(lambda image=image: detector.detect(image), rounds)
        report.number(f"balls/{balls}", seconds, "s")
        rows.append((f"balls in a picture, {balls} there", f"{1e6 * seconds:.0f}", "2000", None))
    report.table(
        ("what", "smallest time [µs]", "target [µs]", "times as fast per particle as a plain Python loop"),
        rows,
    )
    print(report.write().read_text())


if __name__ == "__main__":
    import tyro

    tyro.cli(main)
