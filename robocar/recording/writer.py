"""Writes a run as a Rerun recording (`run.rrd`)."""

from __future__ import annotations

import math
import os
import time as wall
from collections.abc import Mapping
from functools import lru_cache
from itertools import chain
from pathlib import Path as FilePath
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from robocar.core import (
    SE2,
    Array,
    Belief,
    Command,
    Done,
    GiveUp,
    Image,
    MapView,
    Observation,
    OccupancyGrid,
    OutputError,
    Reading,
    Scan,
    Serial,
    State,
)
from robocar.core.observation import USUAL_SENSORS
from robocar.core.text import printable
from robocar.core.trace import Circles, Drawable, Points, Scalar, Text, Trace
from robocar.core.truth import GroundTruth
from robocar.core.work import total
from robocar.recording import about, codec, columns, drawing, palette
from robocar.recording.blueprint import blueprint, extent
from robocar.recording.columns import Buffer
from robocar.recording.scenery import Scenery
from robocar.recording.sheet import SERIES, Sheet
from robocar.recording.streams import Streams
from robocar.recording.throttle import Throttle

FLUSH_TICKS, LIVE_FLUSH_TICKS, FLUSH_SECONDS = 200, 4, 1.5
GRID_INTERVAL, GRID_RATE = 0.5, 200_000.0  # [s], [cells/s]
TRACE_INTERVAL, TRACE_RATE = 0.2, 20_000.0  # [s], [B/s]
PARTICLE_INTERVAL, MOST_PARTICLES = 0.5, 200
LASER_INTERVAL, MOST_BEAMS = 0.2, 200


class RerunRecorder:
    """A recorder that writes `path` and, if `live`, also shows the run in a viewer while it goes on.

    Numbers are collected and written every `flush_ticks` ticks, and where these take long after `FLUSH_SECONDS` of wall time, so
    that a killed run can be read up to there. The clock decides where chunks end, never what is in them. What is large is written
    less often than it changes: maps twice a second, what a trace draws five times, less often where it is big, particles as a
    subset. Observations and commands are written exactly (`robocar.recording.codec`).

    Args:
        path: of the file; an existing one is replaced.
        run_id: names the run; the same id makes recordings of equal runs equal.
        scenery: the static world.
        live: also stream to a viewer: True opens one, a text is the address of one that runs already.
        properties: facts known before the run, e.g. scenario and seed.
        flush_ticks: between two writings; by default 200, or 4 if live.

    Raises:
        OutputError: the file cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        run_id: str,
        scenery: Scenery,
        live: bool | str = False,
        properties: Mapping[str, Any] | None = None,
        flush_ticks: int | None = None,
    ) -> None:
        self._properties = dict(properties or {})
        self._flush_ticks = flush_ticks or (LIVE_FLUSH_TICKS if live else FLUSH_TICKS)
        self._tick, self._time = -1, 0.0
        self._sheet = Sheet()
        self._buffers: dict[str, Buffer] = {}
        self._rows: dict[tuple[Any, ...], Buffer] = {}
        self._observed = Buffer("observation", _table)
        self._commanded = Buffer("command", _table)
        self._mounts: dict[str, Any] = {}
        self._sonars: dict[str, tuple[Any, Buffer]] = {}
        self._texts: dict[str, Any] = {}
        self._traces = Throttle(TRACE_INTERVAL, TRACE_RATE, drawing.drawable_bytes)
        self._next_grid = self._next_particles = self._next_ellipse = -math.inf
        self._next_laser: dict[str, float] = {}
        self._grid: OccupancyGrid | None = None
        # Lines of a map of 40 m are not drawn as thin as those of one of 4 m.
        self._scale = max(1.0, max(extent(scenery)[1:]) / 4.0)
        self._contact = False
        self._closed = False
        rr.set_strict_mode(True)  # otherwise a bad argument is a warning and the data is gone
        self._stream = Streams(FilePath(path), run_id, blueprint(scenery), live)
        self._static(scenery)

    def _static(self, scenery: Scenery) -> None:
        drawing.log_scenery(self._stream, scenery)
        for name, color in SERIES.items():
            style = rr.SeriesLines(colors=[palette.rgba32(color)], widths=1.5, names=name.rpartition("/")[2])
            self._stream.log(f"signals/{name}", style)
        # Where the three coincide, the narrower ones on top leave the rims of the wider ones to be seen.
        for name, color, width in (
            ("odometry", palette.ODOMETRY, 2.6),
            ("estimate", palette.ESTIMATE, 2.0),
            ("truth", palette.TRUTH, 1.3),
        ):
            line = rr.LineStrips3D.from_fields(colors=[palette.rgba32(color)], radii=rr.Radius.ui_points(width))
            # The path lies in the map, not in the moving frame of its parent.
            self._stream.log(f"world/{name}/path", line, rr.CoordinateFrame(drawing.WORLD_FRAME))
        self._stream.log("world/estimate/particles", rr.CoordinateFrame(drawing.WORLD_FRAME))
        line = rr.LineStrips3D.from_fields(colors=[palette.rgba32(palette.ESTIMATE)], radii=rr.Radius.ui_points(1.0))
        self._stream.log("world/estimate/covariance", line, rr.CoordinateFrame(drawing.WORLD_FRAME))
        self._about(None)
        self._flush()

    def log(
        self,
        observation: Observation,
        state: State,
        command: Command,
        truth: GroundTruth | None,
        *,
        odometry: SE2 | None = None,
        planning_time: float | None = None,
        signals: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """See `Recorder.log`."""
        self._tick += 1
        self._time = observation.time
        self._observed.append(self._tick, self._time, codec.encode_observation(observation))
        self._commanded.append(self._tick, self._time, codec.encode_command(command))
        belief = state.belief
        self._sheet.append(self._tick, self._time, (belief, command, truth, odometry, planning_time))
        for name, value in signals.items():
            self._number(name, value)
        for unit, count in total(state.work, command.work).items():
            self._number(f"work/{_part(unit)}", count)
        if truth is not None:
            self._truth(truth)
        self._command(command)
        self._sensors(observation)
        self._belief(belief)
        self._map(state.map)
        self._trace(belief.trace)
        self._trace(command.trace)
        for name, item in self._traces.due(self._time):
            self._draw(name, item)
        if (self._tick + 1) % self._flush_ticks == 0 or wall.monotonic() - self._flushed > FLUSH_SECONDS:
            self._flush()

    def finish(self) -> None:
        """See `Recorder.finish`."""
        if not self._closed:
            for name, item in self._traces.due(math.inf):
                self._draw(name, item)
            self._flush()

    def close(self, result: Mapping[str, Any] | None = None) -> None:
        """See `Recorder.close`. Closing twice is the same as closing once."""
        if self._closed:
            return
        self.finish()
        facts = dict(about.flat(self._properties)) | dict(about.flat(result or {}))
        if facts:
            self._stream.send_property("run", rr.AnyValues(**facts))
        self._about(result)
        self._closed = True
        self._flush()
        self._stream.close()

    # ---- one tick, part by part ----

    def _truth(self, truth: GroundTruth) -> None:
        for name, pose in truth.movers.items():
            entity = f"world/movers/{_part(name)}"
            self._buffer(entity, columns.poses).append(self._tick, self._time, (pose.x, pose.y, pose.theta))
        if truth.contact and not self._contact:
            self._status("the car touches something", "WARN")
        self._contact = truth.contact

    def _command(self, command: Command) -> None:
        match command:
            case Serial(line):
                self._log("log/serial", _text(f"> {line}", "INFO"))
            case Done(reason):
                self._status(f"done: {reason}", "INFO")
            case GiveUp(reason, status):
                self._status(f"{status}: {reason}", "WARN")

    def _sensors(self, observation: Observation) -> None:
        for line in observation.serial:
            self._log("log/serial", _text(f"< {line}", "ERROR" if line.startswith("ERR") else "INFO"))
        if observation.landmarks:
            self._log("world/robot/detections", drawing.detections(observation.landmarks))
        for sensor, reading in observation.readings.items():
            match codec.plain(reading):
                case Scan(beam_width=0.0):
                    self._laser(sensor, reading)
                case Scan():
                    self._sonar(sensor, reading)
                case Image():
                    self._image(sensor, reading)
                case Reading(_, int() | float() | np.ndarray() as value) if sensor not in USUAL_SENSORS:
                    self._series(sensor, value)

    def _series(self, sensor: str, value: float | Array) -> None:
        """The numbers of a sensor that has no picture of its own, over time."""
        entity = f"sensor/{_entity(sensor)}"
        if np.ndim(value) == 0:
            self._number(entity, float(value))
        else:
            for k, number in enumerate(np.ravel(value)):
                self._number(f"{entity}/{k}", float(number))

    def _sonar(self, sensor: str, scan: Scan) -> None:
        if len(scan.bearings) == 0 or not math.isfinite(scan.bearings[0]):
            return
        mount = (scan.robot_from_sensor, scan.beam_width, float(scan.bearings[0]))
        known = self._sonars.get(sensor)
        if known is None or known[0] != mount:
            entity = f"world/robot/{_entity(sensor)}"
            self._log(entity, drawing.transform(scan.robot_from_sensor, drawing.SENSOR_LAYER))
            self._log(f"{entity}/cone", drawing.cone(mount[2], scan.beam_width))
            known = self._sonars[sensor] = (mount, self._buffer(f"{entity}/cone", columns.cones))
        distance = float(scan.ranges[0])
        row = (distance, _ECHO) if math.isfinite(distance) else (scan.max_range, _NO_ECHO)
        known[1].append(self._tick, self._time, row)

    def _laser(self, sensor: str, scan: Scan) -> None:
        if self._time < self._next_laser.get(sensor, -math.inf):
            return
        self._next_laser[sensor] = self._time + LASER_INTERVAL
        entity = f"world/robot/{_entity(sensor)}"
        if self._mounts.get(entity) != scan.robot_from_sensor:
            self._mounts[entity] = scan.robot_from_sensor
            self._log(entity, drawing.transform(scan.robot_from_sensor, drawing.SENSOR_LAYER))
            self._log(f"{entity}/hits", rr.Points3D.from_fields(colors=[palette.rgba32(palette.LASER)], radii=[0.015]))
        self._buffer(f"{entity}/hits", columns.clouds).append(self._tick, self._time, drawing.laser_hits(scan, MOST_BEAMS))

    def _image(self, sensor: str, image: Image) -> None:
        entity = codec.image_entity(sensor)
        mount = (image.intrinsics.tobytes(), np.asarray(image.robot_from_camera).tobytes(), image.pixels.shape)
        if self._mounts.get(entity) != mount:
            self._mounts[entity] = mount
            self._log(entity, *drawing.camera(image))
        png = codec.encode_png(image.pixels)
        self._log(f"{entity}/image", rr.EncodedImage(contents=png, media_type="image/png"))

    def _belief(self, belief: Belief) -> None:
        if belief.covariance is not None and self._time >= self._next_ellipse and np.isfinite(belief.covariance).all():
            self._next_ellipse = self._time + PARTICLE_INTERVAL
            row = (belief.pose.position, belief.covariance[:2, :2])
            self._buffer("world/estimate/covariance", _ellipse_columns).append(self._tick, self._time, row)
        if belief.particles is not None and len(belief.particles) and self._time >= self._next_particles:
            self._next_particles = self._time + PARTICLE_INTERVAL
            self._log("world/estimate/particles", drawing.particles(belief.particles, MOST_PARTICLES))

    def _map(self, view: MapView | None) -> None:
        if view is None or self._time < self._next_grid:
            return
        grid = view.grid()
        self._next_grid = self._time + GRID_INTERVAL
        if grid is None or grid is self._grid:
            return
        known = self._grid
        if known is None or not grid.same_place(known) or not np.array_equal(grid.data, known.data):
            self._next_grid = self._time + max(GRID_INTERVAL, grid.data.size / GRID_RATE)
            self._log("world/map/estimate", drawing.grid_image(grid, palette.grid_colors(grid), drawing.MAP_LAYER))
        self._grid = grid

    def _trace(self, trace: Trace) -> None:
        for name, item in trace.items():
            if isinstance(item, Scalar):
                self._number(_entity(f"trace/{name}" if name in SERIES else name), item.value)
            elif isinstance(item, Text):
                last = self._texts.get(name)
                if last is not item and last != item:
                    self._texts[name] = item
                    self._status(item.message, item.level)
            elif isinstance(item, Circles):  # at once: they belong to the picture of this tick
                self._row(f"world/robot/camera/{_entity(name)}", drawing.drawable(item))
            else:
                folder = "world" if name.startswith("costmap/") else "world/plan"
                self._traces.offer(f"{folder}/{_entity(name)}", item)

    # ---- small ones ----

    def _number(self, name: str, value: float) -> None:
        self._buffer(f"signals/{name}", columns.scalars).append(self._tick, self._time, value)

    def _status(self, message: str, level: str) -> None:
        self._log("log/status", _text(message, level))

    def _buffer(self, entity: str, build: columns.Builder) -> Buffer:
        buffer = self._buffers.get(entity)
        if buffer is None:
            buffer = self._buffers[entity] = Buffer(entity, build)
        return buffer

    def _draw(self, entity: str, item: Drawable) -> None:
        if isinstance(item, Points) and item.values is None and not item.labels:  # what planners show most often
            row = (drawing.raised(item.positions, drawing.PLAN_LAYER), palette.rgba32(item.color), item.radius * self._scale)
            self._buffer(entity, columns.marks).append(max(self._tick, 0), self._time, row)
        else:
            self._row(entity, drawing.drawable(item, self._scale))

    def _log(self, entity: str, *parts: rr.AsComponents) -> None:
        self._row(entity, drawing.components(*parts))

    def _row(self, entity: str, row: drawing.Row) -> None:
        """A row of whatever there is; rows with the same components go into the same columns."""
        key = (entity, *row)
        buffer = self._rows.get(key)
        if buffer is None:
            buffer = self._rows[key] = Buffer(entity, columns.archetypes)
        buffer.append(max(self._tick, 0), self._time, row)

    def _about(self, result: Mapping[str, Any] | None) -> None:
        page = rr.TextDocument(about.page(self._properties, result), media_type="text/markdown")
        self._stream.log("log/about", page)

    def _flush(self) -> None:
        """What cannot be sent is forgotten, and an error once all else is sent."""
        self._flushed = wall.monotonic()
        failed: list[Exception] = []
        for buffer in (self._sheet, self._observed, self._commanded, *self._buffers.values(), *self._rows.values()):
            try:
                buffer.send(self._stream)
            except Exception as error:  # of values that no column holds
                failed.append(error)
        try:
            self._stream.flush()
        except OutputError:
            self._closed = True
            raise
        if failed:
            raise failed[0]


def _text(message: str, level: str) -> rr.TextLog:
    return rr.TextLog(printable(message), level=printable(level))


_ECHO, _NO_ECHO = palette.rgba32(palette.ECHO), palette.rgba32(palette.NO_ECHO)
_part = lru_cache(maxsize=1024)(rr.escape_entity_path_part)


@lru_cache(maxsize=1024)
def _entity(name: str) -> str:
    """The entity path of a trace's name, which may hold any sign; `/` makes a level."""
    return "/".join(map(_part, filter(None, name.split("/")))) or "unnamed"


def _ellipse_columns(rows: columns.Rows) -> list[rr.ComponentColumn]:
    positions, covariances = (np.array(part) for part in zip(*rows, strict=True))
    return columns.strips(drawing.covariance_ellipses(positions, covariances), drawing.ELLIPSE_CORNERS)


def _table(rows: columns.Rows) -> list[rr.ComponentColumn]:
    """Columns of the rows of `codec`, without those that are empty throughout."""
    table = []
    for name in dict.fromkeys(chain.from_iterable(rows)):
        values = [row.get(name, ()) for row in rows]
        lengths = [len(value) for value in values]
        filled = [value for value in values if len(value)]
        if isinstance(filled[0][0], str):
            flat = pa.array(list(chain.from_iterable(filled)), pa.string())
        elif any(isinstance(value, np.ndarray) for value in filled):
            flat = pa.array(np.concatenate(filled, dtype=np.float64))
        else:
            flat = pa.array(np.array(list(chain.from_iterable(filled)), dtype=np.float64))
        table.append(columns.cells(name, flat, lengths))
    return table
