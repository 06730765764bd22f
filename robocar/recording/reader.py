"""Reads recordings back.

Only for recordings that can be trusted not to be damaged on purpose: a corrupt file may abort the interpreter inside Rerun.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from robocar.core import Array, Command, LogFormatError, Observation
from robocar.recording import codec

PathLike = str | os.PathLike[str]


def read_signal(path: PathLike, entity: str) -> tuple[Array, Array]:
    """A time series of the recording, e.g. `signals/clearance`.

    Returns:
        times (n,) [s] and values (n,).

    Raises:
        LogFormatError: the file is no recording, or has no such series.
    """
    times, values = _column(path, entity, "Scalars:scalars")
    return times, values.astype(np.float64)


def read_trajectory(path: PathLike, entity: str = "world/truth") -> tuple[Array, Array]:
    """The poses of `world/truth`, `world/odometry`, `world/estimate` or a mover, exactly as they were logged.

    Returns:
        times (n,) [s] and poses (n, 3) as x, y [m], theta [rad].

    Raises:
        LogFormatError: the file is no recording, or has no such poses.
    """
    times, values = _column(path, entity, "pose")
    return times, values.astype(np.float64).reshape(-1, 3)


def read_observations(path: PathLike) -> Iterator[tuple[Observation, Command]]:
    """What was sensed at each tick and the command that followed, identical to the last bit; commands come without traces.

    Raises:
        LogFormatError: the file is no recording, or lacks observations, commands or pictures.
    """
    observations, commands = _rows(path, "observation"), _rows(path, "command")
    if not observations or observations.keys() != commands.keys():
        raise LogFormatError(
            f"{path}: {len(observations)} observations and {len(commands)} commands; a run has one of each per tick"
        )
    if unknown := sorted({column for row in observations.values() for column in codec.unknown_columns(row)}):
        raise LogFormatError(f"{path}: recorded by another version of Robocar: columns {', '.join(unknown)}")
    cameras = {sensor for row in observations.values() for sensor in codec.images(row)}
    pictures = {sensor: _rows(path, f"{codec.image_entity(sensor)}/image") for sensor in cameras}
    for tick in sorted(observations):
        row = observations[tick]
        pixels = {}
        for sensor in codec.images(row):
            if tick not in pictures[sensor]:
                raise LogFormatError(f"{path}: tick {tick} has a picture of sensor {sensor!r} but no pixels")
            pixels[sensor] = codec.decode_png(pictures[sensor][tick]["EncodedImage:blob"][0].values.to_numpy())
        yield codec.decode_observation(row, pixels), codec.decode_command(commands[tick])


def _batches(path: PathLike, entity: str) -> Iterator[pa.RecordBatch]:
    """The temporal chunks of an entity in the order of their first tick."""
    try:
        stream = RrdReader(os.fspath(path)).stream().filter(content=f"/{entity.strip('/')}", has_timeline="tick")
        batches = [chunk.to_record_batch() for chunk in stream]
    except (RuntimeError, ValueError, OSError) as error:
        raise LogFormatError(f"{path}: not a recording that can be read: {error}") from error
    yield from sorted(batches, key=lambda batch: batch["tick"][0].as_py())


def _column(path: PathLike, entity: str, component: str) -> tuple[Array, NDArray[Any]]:
    """Times [s] of the rows that have the component, and all its values one after the other."""
    times, values = [], []
    for batch in _batches(path, entity):
        if component in batch.schema.names:
            column = batch[component]
            times.append(batch["sim_time"].cast(pa.int64()).to_numpy()[column.is_valid().to_numpy(zero_copy_only=False)] * 1e-9)
            values.append(column.flatten().to_numpy())
    if not times:
        raise LogFormatError(f"{path}: nothing of {component} is recorded at {entity}")
    return np.concatenate(times), np.concatenate(values)


def _rows(path: PathLike, entity: str) -> dict[int, codec.Row]:
    """Rows by tick, of all that is kept as lists."""
    rows: dict[int, codec.Row] = {}
    for batch in _batches(path, entity):
        ticks = batch["tick"].to_pylist()
        for tick in ticks:
            rows.setdefault(tick, {})
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if not pa.types.is_list(column.type):
                continue
            values = column.values
            if pa.types.is_floating(values.type):
                values = values.to_numpy()
            elif pa.types.is_string(values.type):
                values = values.to_pylist()
            for tick, (start, end), valid in zip(
                ticks, pairwise(column.offsets.to_pylist()), column.is_valid().to_pylist(), strict=True
            ):
                if valid and end > start:
                    rows[tick][name] = values[start:end]
    return rows
