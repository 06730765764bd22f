"""The views that a recording opens with."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from robocar.recording import palette
from robocar.recording.scenery import Scenery

SIGNALS = ("speed", "turn_rate", "error", "clearance", "voltage", "planning_time")

_PATHS = ("world/truth/path", "world/odometry/path", "world/estimate/path")


def everything_until_now(timelines: tuple[str, ...] = ("sim_time", "tick")) -> rrb.VisibleTimeRanges:
    """Paths are stored piece by piece: all pieces up to the time cursor are the path."""
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(timeline, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative())
            for timeline in timelines
        ]
    )


def extent(scenery: Scenery) -> tuple[np.ndarray, float, float]:
    """Centre (2,), width and height [m] of what is to be seen."""
    seen = [grid.corners() for grid in (scenery.truth, scenery.prior) if grid is not None][:1]
    seen += [mark.position[None, :2] + offset * mark.radius for mark in scenery.landmarks for offset in (-1.0, 1.0)]
    points = np.concatenate(seen) if seen else np.array([[-2.0, -2.0], [2.0, 2.0]])
    low, high = points.min(axis=0), points.max(axis=0)
    width, height = np.maximum(high - low, 1.0)
    return (low + high) / 2, float(width), float(height)


def from_above(scenery: Scenery) -> rrb.EyeControls3D:
    """An eye straight above the middle, high enough for both extents; a hair south of it, so that up on the screen is +y."""
    centre, width, height = extent(scenery)
    distance = 1.12 * max(height, width / 1.3)
    position = [centre[0], centre[1] - 1e-3 * distance, distance]
    return rrb.EyeControls3D(kind="Orbital", position=position, look_target=[centre[0], centre[1], 0.0], eye_up=[0.0, 1.0, 0.0])


def _from_aside(scenery: Scenery) -> rrb.EyeControls3D:
    centre, width, height = extent(scenery)
    reach = 0.75 * max(width, height)
    position = [centre[0] - 0.5 * reach, centre[1] - reach, 0.9 * reach]
    return rrb.EyeControls3D(kind="Orbital", position=position, look_target=[centre[0], centre[1], 0.0], eye_up=[0.0, 0.0, 1.0])


def _world_view(name: str, eye: rrb.EyeControls3D, without: tuple[str, ...]) -> rrb.Spatial3DView:
    """All of the world but what lies at the entities `without`."""
    growing: dict[Any, Any] = {path: everything_until_now() for path in _PATHS}
    return rrb.Spatial3DView(
        origin="world",
        contents=["+ /world/**", *(f"- /world/{entity}" for entity in without)],
        name=name,
        eye_controls=eye,
        background=list(palette.BACKGROUND),
        line_grid=False,
        overrides=growing,
    )


def _camera_views(scenery: Scenery) -> list[rrb.Spatial2DView]:
    """Of the cameras that the robot has; recorded logs, whose robot is unknown, may hold pictures of either."""
    seen = ["+ $origin/**", "+ /world/landmarks", "+ /world/robot/detections"]
    robot = scenery.robot
    views = []
    if robot is None or robot.camera:
        views.append(rrb.Spatial2DView(origin="world/robot/camera", contents=seen, name="Camera"))
    if robot is None or robot.top_camera:
        views.append(rrb.Spatial2DView(origin="world/top_camera", contents="$origin/**", name="Top camera"))
    return views


def _signal_views() -> rrb.Tabs:
    """Time series, all on one time axis: what moves the robot, and what its planner says of itself."""
    link = rrb.TimeAxis(
        link=rrb.components.LinkAxis.LinkToGlobal,
        view_range=rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()),
    )
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
    series = [
        rrb.TimeSeriesView(origin=f"signals/{name}", name=title, axis_x=link, plot_legend=legend)
        for name, title in (
            ("speed", "Speed [m/s]"),
            ("turn_rate", "Turn rate [rad/s]"),
            ("error", "Errors [m, rad]"),
            ("clearance", "Clearance [m]"),
            ("voltage", "Motor voltage [V]"),
        )
    ]
    others = ["+ /signals/**", *(f"- /signals/{name}/**" for name in SIGNALS[:5])]
    rest = rrb.TimeSeriesView(origin="signals", contents=others, name="Planner", axis_x=link)
    return rrb.Tabs(
        rrb.Vertical(*series[:4], name="Motion"), rrb.Vertical(series[4], rest, name="Motors and planner"), active_tab=0
    )


def blueprint(scenery: Scenery) -> rrb.Blueprint:
    """Map from above, 3D view, cameras where fitted, time series, log and a page that explains the colours."""
    top = _world_view("Map", from_above(scenery), without=("map/truth/walls", "robot/camera/**", "top_camera/**"))
    spatial = _world_view("3D", _from_aside(scenery), without=("top_camera/**",))
    cameras = _camera_views(scenery)
    pages = rrb.Horizontal(
        rrb.TextDocumentView(origin="log/about", name="About this run"),
        rrb.TextLogView(origin="log", name="Log"),
        column_shares=[1, 1],
    )
    right = rrb.Horizontal(spatial, rrb.Tabs(*cameras, active_tab=0)) if cameras else spatial
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(top, pages, row_shares=[3, 1.2]),
            rrb.Vertical(right, _signal_views(), row_shares=[1.2, 2]),
            column_shares=[1.6, 1],
        ),
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
