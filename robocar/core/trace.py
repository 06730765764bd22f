"""What planners and estimators want to be seen: values that the recording knows how to draw.

Algorithms are silent; they return a `Trace`, a mapping from names to the drawables below, and `robocar.recording` shows each
at `world/plan/<name>` (positions are in the map frame), on the camera's picture, or in the time series and the log. A new
algorithm needs no new drawing code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias, assert_never

import numpy as np

from robocar.core.geometry import SE2, Array
from robocar.core.grid import Costmap, GridMap

Color: TypeAlias = tuple[int, int, int]

PLAN_COLOR: Color = (214, 39, 160)
"""Of what is planned, in every recording."""


@dataclass(frozen=True, slots=True)
class Points:
    """Points (n, 2) or (n, 3) [m]; `values` (n,) colour them from low to high where given, else `color` does."""

    positions: Array
    values: Array | None = None
    color: Color = (255, 170, 0)
    radius: float = 0.02
    labels: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Lines:
    """Polylines, each (n, 2) [m]; `values` (one each) colour them from low to high where given, else `color` does."""

    lines: tuple[Array, ...]
    values: Array | None = None
    color: Color = (255, 170, 0)
    radius: float = 0.005


@dataclass(frozen=True, slots=True)
class Segments:
    """Independent segments (n, 2, 2) [m], e.g. the edges of a search tree."""

    segments: Array
    color: Color = (120, 160, 255)
    radius: float = 0.003


@dataclass(frozen=True, slots=True)
class Arrows:
    """Arrows from `origins` (n, 2) along `vectors` (n, 2) [m]."""

    origins: Array
    vectors: Array
    color: Color = (255, 60, 60)
    radius: float = 0.01


@dataclass(frozen=True, slots=True)
class Circles:
    """Circles in the picture of the car's camera: `centers` (n, 2) and `radii` (n,) [px], a colour and a label for each."""

    centers: Array
    radii: Array
    colors: tuple[Color, ...]
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Field:
    """Numbers on a grid, drawn as a heat map from low to high; NaN and infinite cells stay transparent."""

    grid: GridMap


@dataclass(frozen=True, slots=True)
class Scalar:
    """One number of the time series `signals/<name>`."""

    value: float
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Text:
    """One line of `log/status`."""

    message: str
    level: str = "INFO"


Drawable: TypeAlias = Points | Lines | Segments | Arrows | Circles | Field | Scalar | Text
Trace: TypeAlias = Mapping[str, Drawable]


class LazyTrace(Mapping[str, Drawable]):
    """A trace whose drawables are made when somebody looks at them, so that a search costs the same unrecorded."""

    def __init__(self, makers: Mapping[str, Callable[[], Drawable]]) -> None:
        self._makers = dict(makers)
        self._made: dict[str, Drawable] = {}

    def __getitem__(self, name: str) -> Drawable:
        if name not in self._made:
            self._made[name] = self._makers[name]()
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


def merged(*traces: Trace) -> Trace:
    """All of them, still lazy; the first counts where a name is used twice."""
    return LazyTrace({name: partial(trace.__getitem__, name) for trace in reversed(traces) for name in trace})


def transformed(trace: Trace, map_from_frame: SE2) -> Trace:
    """A trace whose positions are in another frame, in the map frame; still lazy."""

    def made(name: str) -> Drawable:
        return _moved(trace[name], map_from_frame)

    return LazyTrace({name: partial(made, name) for name in trace})


def _moved(item: Drawable, pose: SE2) -> Drawable:
    match item:
        case Circles() | Scalar() | Text():
            return item
        case Points(positions):
            flat = np.asarray(positions)
            return replace(item, positions=np.concatenate([pose.transform(flat[:, :2]), flat[:, 2:]], axis=1))
        case Lines(lines):
            return replace(item, lines=tuple(pose.transform(line) for line in lines))
        case Segments(segments):
            return replace(item, segments=pose.transform(segments))
        case Arrows(origins, vectors):
            return replace(item, origins=pose.transform(origins), vectors=SE2(theta=pose.theta).transform(vectors))
        case Field(grid):
            placed = replace(grid, origin=pose @ grid.origin)
            return Field(replace(placed, frame="map") if isinstance(placed, Costmap) else placed)
    assert_never(item)
