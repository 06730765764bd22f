"""Two runs in one recording, to see where they part."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from robocar.core import Array, Footprint
from robocar.core.text import markdown_text, printable
from robocar.recording import columns, drawing, palette
from robocar.recording.blueprint import everything_until_now, from_above
from robocar.recording.scenery import Scenery
from robocar.recording.streams import Streams

COLORS = {"base": palette.ODOMETRY, "new": palette.ESTIMATE}
SINCE = "since_divergence"
"""A timeline that begins where the runs part. A viewer opens a recording at the beginning of its timeline."""


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two runs: its name and its true poses (n, 3) x, y [m], theta [rad] at times (n,) [s]."""

    label: str
    times: Array
    poses: Array


def write_overlay(
    path: Path, scenery: Scenery, footprint: Footprint, sides: tuple[Side, Side], time: float, tick: int, title: str
) -> Path:
    """Writes both runs over the same map, opening where they part.

    Args:
        scenery: of the world of both.
        sides: the run that was there before and the new one.
        time, tick: at which they part: the recording opens there.
        title: of the page that says what is to be seen.

    Raises:
        OutputError: the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    base, new = sides
    stream = Streams(path, f"{base.label} and {new.label}", _blueprint(scenery), live=False)
    drawing.log_scenery(stream, scenery)
    for name, side in (("base", base), ("new", new)):
        _log_side(stream, name, side, footprint, tick)
    n = min(len(base.times), len(new.times))
    gap = np.linalg.norm(base.poses[:n, :2] - new.poses[:n, :2], axis=1)
    stream.log("signals/distance", rr.SeriesLines(colors=[palette.rgba32(palette.TRUTH)], names="between the two [m]"))
    for rows in (slice(0, min(tick, n)), slice(tick, n)):
        _send(stream, "signals/distance", base.times, tick, rows, lambda at: columns.scalars(gap[at]))
    common = drawing.raised(base.poses[: tick + 1, :2], drawing.PLAN_LAYER)
    line = rr.LineStrips3D([common], colors=[palette.rgba32(palette.TRUTH)], radii=rr.Radius.ui_points(1.5))
    stream.log("world/common_path", line)
    at = base.poses[min(tick, len(base.poses) - 1), :2]
    ring = drawing.circle(at, 0.25, drawing.OUTLINE_LAYER)
    stream.log(
        "world/divergence",
        rr.LineStrips3D([ring], colors=[palette.rgba32(palette.GOAL)], radii=rr.Radius.ui_points(2.0)),
    )
    page = f"""# {markdown_text(title)}

At tick {tick}, {time:.3f} s, inside the red ring.

* green: the way that they have in common
* orange: {markdown_text(base.label)}
* blue: {markdown_text(new.label)}

Timeline `{SINCE}` begins there; `sim_time` and `tick` have it all.
"""
    stream.log("log/about", rr.TextDocument(page, media_type="text/markdown"))
    stream.flush()
    stream.close()
    return path


def _log_side(stream: Streams, name: str, side: Side, footprint: Footprint, tick: int) -> None:
    color = palette.rgba32(COLORS[name])
    outline = drawing.outline(footprint.vertices, drawing.OUTLINE_LAYER)
    thin, thick = rr.Radius.ui_points(1.5), rr.Radius.ui_points(2.0)
    stream.log(f"world/{name}/footprint", rr.LineStrips3D([outline], colors=[color], radii=thick))
    stream.log(f"world/{name}/path", rr.LineStrips3D.from_fields(colors=[color], radii=thin))
    stream.log(f"world/{name}/path", rr.CoordinateFrame(drawing.WORLD_FRAME))
    stream.log(f"signals/speed/{name}", rr.SeriesLines(colors=[color], names=printable(side.label)))
    n = len(side.times)
    corners = drawing.raised(side.poses[:, :2], drawing.PLAN_LAYER)
    pieces = np.stack([corners[:-1], corners[1:]], axis=1)
    speed = np.linalg.norm(np.diff(side.poses[:, :2], axis=0), axis=1) / np.diff(side.times)
    for rows in (slice(0, min(tick, n)), slice(tick, n)):
        _send(stream, f"world/{name}", side.times, tick, rows, lambda at: columns.poses(side.poses[at]))
        later = slice(max(rows.start, 1), rows.stop)
        _send(stream, f"world/{name}/path", side.times, tick, later, lambda at: columns.segments(pieces[at - 1].reshape(-1, 3)))
        _send(stream, f"signals/speed/{name}", side.times, tick, later, lambda at: columns.scalars(speed[at - 1]))


def _send(
    stream: Streams, entity: str, times: Array, tick: int, rows: slice, build: Callable[[NDArray[np.intp]], Iterable[Any]]
) -> None:
    """Some rows, all of them before the runs part or none; the timeline `since` knows the latter only."""
    at = np.arange(rows.start, rows.stop)
    if at.size == 0:
        return
    index = columns.indexes(at, times[at])
    if rows.start >= tick:
        index.append(rr.TimeColumn(SINCE, duration=times[at] - times[tick]))
    stream.send_columns(entity, index, build(at))


def _blueprint(scenery: Scenery) -> rrb.Blueprint:
    world = rrb.Spatial3DView(
        origin="world",
        contents=["+ /world/**", "- /world/map/truth/walls"],
        name="Map",
        eye_controls=from_above(scenery),
        background=list(palette.BACKGROUND),
        line_grid=False,
        overrides={f"world/{name}/path": everything_until_now((SINCE, "sim_time", "tick")) for name in COLORS},
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            world,
            rrb.Vertical(
                rrb.TimeSeriesView(origin="signals/distance", name="Distance [m]"),
                rrb.TimeSeriesView(origin="signals/speed", name="Speed [m/s]"),
                rrb.TextDocumentView(origin="log/about", name="About"),
            ),
            column_shares=[1.6, 1],
        ),
        rrb.TimePanel(timeline=SINCE, state="expanded", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
