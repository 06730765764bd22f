"""A recording in the real viewer, without a screen. Oracle: the colours of what was logged, where it was logged.

Golden pictures would break with every version of the viewer; what must not change is that the things are to be seen.
"""

import ctypes.util
import glob
import math
import socket
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from robocar.core import Image, Observation, State
from robocar.recording import RerunRecorder, Scenery, palette, read_trajectory
from tests.recording.synthetic import GrowingMap, drive, record, room, scenery

pytestmark = pytest.mark.skipif(
    ctypes.util.find_library("vulkan") is None or not glob.glob("/usr/share/vulkan/icd.d/*.json"),
    reason="no Vulkan driver (Debian: mesa-vulkan-drivers libvulkan1 libxkbcommon0 libxkbcommon-x11-0)",
)
LOOK_AT = 18.0  # [s]


@contextmanager
def viewer_without_screen():
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    # The viewer beside this Python: the environment need not be activated.
    beside = Path(sys.executable).with_name("rerun")
    path = str(beside) if beside.is_file() else None
    with ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=path) as viewer:
        yield viewer


def picture_of(viewer, view):
    """(h, w, 3) RGB"""
    png = np.frombuffer(viewer.take_screenshot(view.view_id), np.uint8)
    return cv2.cvtColor(cv2.imdecode(png, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def shoot(path):
    """Opens the recording: pictures (h, w, 3) RGB of Map, 3D and Camera, reports by view, warnings about data."""
    with viewer_without_screen() as viewer:
        viewer.open(str(path))
        patience = time.monotonic() + 60
        while viewer.get_state().loading and time.monotonic() < patience:
            time.sleep(0.1)
        viewer.set_time("sim_time", duration=LOOK_AT, play_state="paused")
        time.sleep(2.0)
        views = {view.name: view for view in viewer.get_state().views}
        pictures = {name: picture_of(viewer, views[name]) for name in ("Map", "3D", "Camera") if name in views}
        logs = [log for log in viewer.get_logs() if "Component" in str(log)]
    return pictures, {name: view.reports for name, view in views.items()}, logs


def pixels_of(picture, color, tolerance=24):
    """Where the picture has about this colour, (n, 2) as row, col."""
    return np.argwhere(np.abs(picture.astype(int) - color).max(axis=2) <= tolerance)


def test_a_run_is_shown_while_it_goes_on(tmp_path):
    """The viewer has the car before the recording is closed."""
    with viewer_without_screen() as viewer:
        recorder = RerunRecorder(tmp_path / "run.rrd", run_id="live", scenery=scenery(), live=viewer.url)
        record(recorder, drive(200))
        time.sleep(3.0)
        views = {view.name: view for view in viewer.get_state().views}
        picture = picture_of(viewer, views["Map"])
        recorder.close()
    assert len(pixels_of(picture, palette.CAR_BODY)) > 300
    assert len(read_trajectory(tmp_path / "run.rrd")[0]) == 200


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    path = tmp_path_factory.mktemp("viewer") / "run.rrd"
    recorder = RerunRecorder(path, run_id="viewer", scenery=scenery())
    record(recorder, drive(500))
    recorder.close()
    return shoot(path)


@pytest.mark.parametrize(
    ("what", "color", "least"),
    [
        ("car", palette.CAR_BODY, 300),
        ("plan", palette.PLAN, 200),
        ("path that was driven", palette.TRUTH, 100),
        ("path that is believed", palette.ESTIMATE, 100),
        ("path by dead reckoning", palette.ODOMETRY, 100),
        ("goal", palette.GOAL, 50),
        ("known obstacles", tuple(int(c) for c in palette.COSTS[254][:3]), 3000),
        ("floor", (248, 249, 250), 20000),
        ("mover", palette.MOVER, 200),
    ],
)
def test_the_map_view_shows(seen, what, color, least):
    found = pixels_of(seen[0]["Map"], color)
    assert len(found) > least, f"{what}: {len(found)} pixels of {color}"


def test_the_car_is_drawn_where_it_is(seen):
    """The centre of the car's pixels, measured against the walls of the room: 3.5 x 3 m, upper row is largest y."""
    picture = seen[0]["Map"]
    known = pixels_of(picture, palette.COSTS[254][:3], 30)
    top, left = known.min(axis=0)
    bottom, right = known.max(axis=0)
    row, col = pixels_of(picture, palette.CAR_BODY).mean(axis=0)
    x, y = (col - left) / (right - left) * 3.5, (bottom - row) / (bottom - top) * 3.0
    phase = LOOK_AT * 0.25
    assert math.hypot(x - (1.75 + math.cos(phase)), y - (1.5 + math.sin(phase))) < 0.12


def test_the_3d_view_shows_car_and_plan(seen):
    assert len(pixels_of(seen[0]["3D"], palette.CAR_BODY)) > 30
    assert len(pixels_of(seen[0]["3D"], palette.PLAN)) > 30


def test_the_viewer_has_nothing_to_complain_about(seen):
    _, reports, logs = seen
    expected = {"Map", "3D", "About this run", "Log", "Speed [m/s]", "Turn rate [rad/s]", "Errors [m, rad]", "Clearance [m]"}
    assert expected <= reports.keys()
    assert {name: r for name, r in reports.items() if r} == {}
    assert logs == []


def test_an_empty_room_shows_neither_car_nor_plan_and_a_camera_shows_its_picture(tmp_path):
    """The negative control of the colours above; and a green picture in the camera view."""
    path = tmp_path / "run.rrd"
    recorder = RerunRecorder(path, run_id="empty", scenery=Scenery(truth=room(), robot=None))
    picture = np.tile(np.array([10, 200, 30], np.uint8), (60, 80, 1))
    intrinsics = np.array([[60.0, 0.0, 40.0], [0.0, 60.0, 30.0], [0.0, 0.0, 1.0]])
    camera_ahead = np.array([[0.0, 0.0, 1.0, 0.1], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.2], [0.0, 0.0, 0.0, 1.0]])
    for tick in drive(2):
        observation = Observation(tick.observation.time, image=Image(tick.observation.time, picture, intrinsics, camera_ahead))
        command = replace(tick.command, trace={})
        recorder.log(observation, State.of(tick.belief, GrowingMap()), command, None)
    recorder.close()
    pictures, reports, logs = shoot(path)
    assert len(pixels_of(pictures["Camera"], (10, 200, 30))) > 5000
    assert len(pixels_of(pictures["Map"], palette.CAR_BODY)) == 0
    assert len(pixels_of(pictures["Map"], palette.PLAN)) == 0
    assert len(pixels_of(pictures["Map"], palette.WALL)) > 3000
    assert (reports, logs) == ({name: [] for name in reports}, [])
