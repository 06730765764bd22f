"""Where two runs part: the first tick at which anything differs, what that is, and both runs in one recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robocar.core import Array, Image, LogFormatError
from robocar.formats import Trajectory, read_tum
from robocar.regression.results import Row, read_config, read_run

ORDER = ("truth", "observation", "odometry", "estimate", "command")
"""How one thing leads to another within a tick; the command then leads to the next tick's truth."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A quantity and the first tick at which it differs.

    Args:
        quantity: `truth`, `odometry`, `estimate`, `observation/<sensor>` or `command/<field>`.
        tick: counted from 0; time: of the tick [s].
        base, new: the two values, nan and a short text for what is no number.
    """

    quantity: str
    tick: int
    time: float
    base: str
    new: str


@dataclass(frozen=True, slots=True)
class Divergence:
    """Two runs, and where they part.

    Args:
        base, new: the runs.
        ticks: compared, of those that both have.
        differences: the first one of each quantity that ever differs, earliest first.
        complete: whether both have recordings; without them only the trajectories are compared.
        recording: both runs overlaid, None if they do not differ.
        farthest: largest distance between the two true positions at the same time [m].
    """

    base: Row
    new: Row
    ticks: int
    differences: tuple[Difference, ...]
    complete: bool
    recording: Path | None
    farthest: float

    @property
    def first(self) -> Difference | None:
        """What differed first, None if nothing did."""
        return self.differences[0] if self.differences else None


def find_divergence(base: str | Path, new: str | Path, out: str | Path | None = None) -> Divergence:
    """Compare two run directories tick by tick, bit by bit.

    Sensors, commands and poses are compared as far as both recordings hold them; without recordings the three trajectories.

    Args:
        out: where the recording of both goes; None writes none.

    Raises:
        LogFormatError: one of them is no run directory, or lacks its trajectories.
        OutputError: the recording cannot be written.
    """
    folders = Path(base), Path(new)
    rows = [read_run(folder) for folder in folders]
    tracks = [{name: _track(folder, name) for name in ("truth", "odometry", "estimate")} for folder in folders]
    found = [_poses(name, tracks[0][name], tracks[1][name]) for name in tracks[0]]
    complete = all((folder / "run.rrd").is_file() for folder in folders)
    if complete:
        found += _messages(*folders)
    found = [difference for difference in found if difference is not None]
    found.sort(key=lambda difference: (difference.tick, ORDER.index(difference.quantity.partition("/")[0])))
    ticks = min(len(track["truth"].times) for track in tracks)
    lengths = [len(track["truth"].times) for track in tracks]
    if lengths[0] != lengths[1] and not found:
        time = float(tracks[int(lengths[1] > lengths[0])]["truth"].times[ticks])
        ends = [f"{row.status} after {length} ticks" for row, length in zip(rows, lengths, strict=True)]
        found.append(Difference("truth", ticks, time, *ends))
    recording = None
    if found and out is not None:
        recording = _overlay(folders, [track["truth"] for track in tracks], found[0], Path(out))
    gap = np.linalg.norm(tracks[0]["truth"].poses[:ticks, :2] - tracks[1]["truth"].poses[:ticks, :2], axis=1)
    return Divergence(rows[0], rows[1], ticks, tuple(found), complete, recording, float(gap.max(initial=0.0)))


def describe(found: Divergence) -> str:
    """A few lines for people."""
    what = "" if found.complete else " (trajectories only: record both runs to compare sensors and commands too)"
    if found.first is None:
        return f"identical over {found.ticks} ticks{what}"
    first = found.first
    lines = [f"the runs part at tick {first.tick}, {first.time:.3f} s: {first.quantity}{what}"]
    lines += [f"  {d.quantity}: tick {d.tick}, {d.time:.3f} s: {d.base} became {d.new}" for d in found.differences]
    lines.append(f"{found.base.status} became {found.new.status}; at most {found.farthest:.3f} m apart at the same time")
    if found.recording is not None:
        lines.append(f"both in one recording: {found.recording}")
    return "\n".join(lines)


def to_json(found: Divergence) -> dict[str, Any]:
    """One object."""
    return {
        "ticks": found.ticks,
        "first": None if found.first is None else asdict(found.first),
        "differences": [asdict(difference) for difference in found.differences],
        "complete": found.complete,
        "farthest": found.farthest,
        "recording": None if found.recording is None else str(found.recording),
    }


def _track(folder: Path, name: str) -> Trajectory:
    path = folder / f"{name}.tum"
    if not path.is_file():
        raise LogFormatError(f"{folder}: has no {name}.tum")
    return read_tum(path)


def _poses(name: str, base: Trajectory, new: Trajectory) -> Difference | None:
    n = min(len(base.times), len(new.times))
    differs = (base.poses[:n] != new.poses[:n]).any(axis=1) | (base.times[:n] != new.times[:n])
    if not differs.any():
        return None
    tick = int(np.argmax(differs))
    return Difference(name, tick, float(base.times[tick]), _pose(base.poses[tick]), _pose(new.poses[tick]))


def _pose(pose: Array) -> str:
    return "({:.9g}, {:.9g}, {:.9g})".format(*pose)


def _messages(base: Path, new: Path) -> list[Difference | None]:
    """Sensors and commands; each is reported once."""
    found: dict[str, Difference] = {}
    for tick, (old, now) in enumerate(zip(_messages_of(base), _messages_of(new), strict=False)):
        time = float(old["observation/time"][0])
        for name in old.keys() | now.keys():
            if name not in found and not _equal(old.get(name), now.get(name)):
                found[name] = Difference(name, tick, time, _text(old.get(name)), _text(now.get(name)))
    return list(found.values())


def _messages_of(folder: Path) -> Iterator[Mapping[str, Any]]:
    """What was sensed and commanded at each tick, as plain rows, and images as their pixels."""
    from robocar.recording import read_observations
    from robocar.recording.codec import encode_command, encode_observation

    for observation, command in read_observations(folder / "run.rrd"):
        row = {f"observation/{name}": value for name, value in encode_observation(observation).items()}
        row |= {f"command/{name}": value for name, value in encode_command(command).items()}
        for name, reading in observation.readings.items():
            if isinstance(reading, Image):
                row[f"observation/{name} pixels"] = reading.pixels
        yield row


def _equal(a: Any, b: Any) -> bool:
    if a is None or b is None:
        return a is b
    old, now = np.asarray(a), np.asarray(b)
    if old.dtype.kind in "fiu" and now.dtype.kind in "fiu":
        return np.array_equal(old, now, equal_nan=old.dtype.kind == now.dtype.kind == "f")
    return np.array_equal(old, now)


def _text(value: Any) -> str:
    if value is None:
        return "nothing"
    numbers = np.asarray(value).ravel().tolist()
    shown = [f"{x:.9g}" if isinstance(x, float) and math.isfinite(x) else str(x) for x in numbers[:8]]
    return "(" + ", ".join(shown) + (", …" if len(numbers) > 8 else "") + ")"


def _overlay(folders: tuple[Path, Path], truths: list[Trajectory], first: Difference, out: Path) -> Path:
    """Both runs in the world of the base."""
    from robocar.recording.overlay import Side, write_overlay
    from robocar.recording.scenery import Scenery
    from robocar.scenario.model import Scenario
    from robocar.scenario.scene import Scene

    config = read_config(folders[0])
    try:
        place = {"folder": Path(config["folder"])} if "folder" in config else {}
        scenario = Scenario.model_validate(config["scenario"] | place)
        footprint = scenario.robot_model().footprint
        scene = Scene.load(scenario, footprint)
        scenery = Scenery(
            truth=scene.enclosed,
            prior=scene.prior,
            goal=scene.goal,
            landmarks=scene.landmarks,
            solids=scene.solids,
            wall_height=scene.scenario.wall_height,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise LogFormatError(f"{folders[0] / 'config.yaml'}: not the configuration of a run: {error}") from error
    names = [folder.resolve().name for folder in folders]
    labels = names if names[0] != names[1] else [str(folder) for folder in folders]
    base, new = (Side(label, truth.times, truth.poses) for label, truth in zip(labels, truths, strict=True))
    return write_overlay(out, scenery, footprint, (base, new), first.time, first.tick, f"{first.quantity} differs")
