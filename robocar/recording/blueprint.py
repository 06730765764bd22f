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


def blueprint(scenery: Scenery) -> rrb.Blueprint:
    """Map from above, 3D view, cameras where fitted, time series, log and a page that explains the colours."""
    centre, width, height = extent(scenery)
    target = [centre[0], centre[1], 0.0]
    # From straight above, high enough for both extents; a hair south of it, so that up on the screen is +y.
    distance = 1.12 * max(height, width / 1.3)
    above = rrb.EyeControls3D(
        kind="Orbital", position=[centre[0], centre[1] - 1e-3 * distance, distance], look_target=target, eye_up=[0.0, 1.0, 0.0]
    )
    reach = 0.75 * max(width, height)
    aside = rrb.EyeControls3D(
        kind="Orbital",
        position=[centre[0] - 0.5 * reach, centre[1] - reach, 0.9 * reach],
        look_target=target,
        eye_up=[0.0, 0.0, 1.0],
    )
    growing: dict[Any, Any] = {path: everything_until_now() for path in _PATHS}
    flat = ["+ /world/**", "- /world/map/truth/walls", "- /world/robot/camera/**", "- /world/top_camera/**"]
    top = rrb.Spatial3DView(
        origin="world",
        contents=flat,
        name="Map",
        eye_controls=above,
        background=list(palette.BACKGROUND),
        line_grid=False,
        overrides=growing,
    )
    spatial = rrb.Spatial3DView(
        origin="world",
        contents=["+ /world/**", "- /world/top_camera/**"],
        name="3D",
        eye_controls=aside,
        background=list(palette.BACKGROUND),
        line_grid=False,
        overrides=growing,
    )
    seen = ["+ $origin/**", "+ /world/landmarks", "+ /world/robot/detections"]
    robot = scenery.robot  # unknown in recorded logs, which may hold pictures of either camera
    views = []
    if robot is None or robot.camera:
        views.append(rrb.Spatial2DView(origin="world/robot/camera", contents=seen, name="Camera"))
    if robot is None or robot.top_camera:
        views.append(rrb.Spatial2DView(origin="world/top_camera", contents="$origin/**", name="Top camera"))
    link = rrb.TimeAxis(
        link=rrb.components.LinkAxis.LinkToGlobal,
        view_range=rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()),
    )
    series = [
        rrb.TimeSeriesView(
            origin=f"signals/{name}",
            name=title,
            axis_x=link,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
        )
        for name, title in (
            ("speed", "Speed [m/s]"),
            ("turn_rate", "Turn rate [rad/s]"),
            ("error", "Errors [m, rad]"),
            ("clearance", "Clearance [m]"),
            ("voltage", "Motor voltage [V]"),
        )
    ]
    rest = rrb.TimeSeriesView(
        origin="signals",
        contents=["+ /signals/**", *(f"- /signals/{name}/**" for name in SIGNALS[:5])],
        name="Planner",
        axis_x=link,
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                top,
                rrb.Horizontal(
                    rrb.TextDocumentView(origin="log/about", name="About this run"),
                    rrb.TextLogView(origin="log", name="Log"),
                    column_shares=[1, 1],
                ),
                row_shares=[3, 1.2],
            ),
            rrb.Vertical(
                rrb.Horizontal(spatial, rrb.Tabs(*views, active_tab=0)) if views else spatial,
                rrb.Tabs(
                    rrb.Vertical(*series[:4], name="Motion"),
                    rrb.Vertical(series[4], rest, name="Motors and planner"),
                    active_tab=0,
                ),
                row_shares=[1.2, 2],
            ),
            column_shares=[1.6, 1],
        ),
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
