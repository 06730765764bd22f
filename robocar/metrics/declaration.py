"""How a metric says what it is, and how all of them are computed.

A metric is a function on plain values that is declared where it stands:

    @metric("near_walls", unit="s", tolerance=Tolerance("lower", absolute=0.5), needs=("time", "clearance"))
    def near_walls(time, clearance):
        '''Time with less than 10 cm of clearance [s].'''

`needs` names fields of `RunLog`, or metrics declared before: the function gets their values, in this order. The judgement of
`robocar compare`, the suites and `docs/metrics.md` read the declarations. A metric of another package is declared by importing
its module before the run; the entry-point group `robocar.metrics`, whose values are modules, does so in every process.
"""

from __future__ import annotations

import importlib.metadata
import inspect
import math
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, Literal, TypedDict, TypeVar

import numpy as np

from robocar.core import MetricError
from robocar.core.text import describe
from robocar.metrics.run_log import RunLog

GROUP = "robocar.metrics"
"""Entry points whose modules declare metrics."""

Better = Literal["lower", "higher", "neither"]
Value = float | int | None
_Function = TypeVar("_Function", bound=Callable[..., Any])


class Metric(TypedDict):
    """A value, None where the run has none, and its unit ("1" for ratios and counts)."""

    value: Value
    unit: str


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A change of a metric counts when it is larger than both margins.

    Args:
        better: which direction is an improvement; `neither`: the metric is listed and never judged.
        absolute: in the metric's unit.
        relative: to the size of the baseline's value.
    """

    better: Better = "neither"
    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        if self.better not in ("lower", "higher", "neither"):
            raise ValueError(f"better must be 'lower', 'higher' or 'neither', not {self.better!r}")
        for name in ("absolute", "relative"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be a finite number from 0 on, not {value!r}")

    def margin(self, base: float) -> float:
        """How far a value may be from `base`, in the metric's unit."""
        return max(self.absolute, self.relative * abs(base))

    def worsening(self, change: float) -> float:
        """The change, positive where it is one for the worse; 0 where nobody can say."""
        return {"lower": change, "higher": -change, "neither": 0.0}[self.better]


_NOT_JUDGED = Tolerance()


@dataclass(frozen=True, slots=True)
class Declaration:
    """What a metric says of itself.

    Args:
        name: in `metrics.json`.
        unit: "1" for ratios and counts.
        tolerance: which direction is better, and what change is none yet.
        summary: one sentence.
        needs: fields of `RunLog`, and other metrics, without which it is None.
        where: the field of `RunLog` without which (None or False) it is not listed; None: every run lists it.
        wall_clock: whether the machine's load changes it: equal runs need not have it equal.
        module: of the function that computes it.
    """

    name: str
    unit: str
    tolerance: Tolerance = _NOT_JUDGED
    summary: str = ""
    needs: tuple[str, ...] = ()
    where: str | None = None
    wall_clock: bool = False
    module: str = ""


@dataclass(frozen=True, slots=True)
class _Computation:
    """A function, and the metrics that come from one call of it."""

    function: Callable[..., Any]
    declarations: tuple[Declaration, ...]
    optional: tuple[str, ...]
    bundle: bool  # the function returns values by name

    @property
    def place(self) -> str:
        return f"{self.function.__module__}.{self.function.__qualname__}"


_FIELDS = frozenset(field.name for field in fields(RunLog)) | {"success"}
_COMPUTATIONS: dict[tuple[str, ...], _Computation] = {}


def metric(
    name: str,
    *,
    unit: str,
    tolerance: Tolerance = _NOT_JUDGED,
    needs: tuple[str, ...] = (),
    optional: tuple[str, ...] = (),
    where: str | None = None,
    wall_clock: bool = False,
) -> Callable[[_Function], _Function]:
    """Declares the metric that a function computes; the function itself stays as it is.

    Args:
        name: of the metric, `group/name` for those of a group.
        unit: "1" for ratios and counts.
        tolerance: which direction is better, and what change is none yet; without one the metric is listed and not judged.
        needs: fields of `RunLog`, or metrics declared before; their values are the function's arguments. Where one is None, so
            is the metric.
        optional: fields that follow as arguments, and may be None.
        where: see `Declaration`.
        wall_clock: see `Declaration`.

    Raises:
        ValueError: the name is taken, a need is unknown, or the function takes other arguments.
    """

    def declare(function: _Function) -> _Function:
        declaration = Declaration(name, unit, tolerance, _first_sentence(function), needs, where, wall_clock, function.__module__)
        _add(_Computation(function, (declaration,), optional, bundle=False))
        return function

    return declare


def metrics(
    declarations: Iterable[Declaration], *, needs: tuple[str, ...] = (), optional: tuple[str, ...] = (), where: str | None = None
) -> Callable[[_Function], _Function]:
    """Declares the metrics that one function computes together.

    Args:
        declarations: of each; `needs`, `where` and `module` are filled in.
        needs: see `metric`.
        optional: see `metric`.
        where: see `Declaration`.

    Returns:
        A decorator of a function that returns values by name. Names that it leaves out are not listed.

    Raises:
        ValueError: see `metric`.
    """

    def declare(function: _Function) -> _Function:
        own = {"needs": needs, "where": where, "module": function.__module__}
        together = tuple(replace(declaration, **own) for declaration in declarations)
        _add(_Computation(function, together, optional, bundle=True))
        return function

    return declare


def declared() -> Mapping[str, Declaration]:
    """All metrics by name, in the order of `metrics.json`.

    Raises:
        MetricError: the module of an entry point cannot be imported.
    """
    _load_entry_points()
    return {declaration.name: declaration for computation in _COMPUTATIONS.values() for declaration in computation.declarations}


def summarize(log: RunLog) -> dict[str, Metric]:
    """The metrics of a run, in the order of `metrics.json`.

    Values that are not finite are None; so is the metric of a function that fails, with a warning: the run itself is not lost.
    """
    units = {name: declaration.unit for name, declaration in declared().items()}
    values: dict[str, Value] = {}
    for computation in _COMPUTATIONS.values():
        where = computation.declarations[0].where
        evidence = True if where is None else getattr(log, where)
        if evidence is not None and evidence is not False:
            values |= _compute(computation, log, values)
    return {name: Metric(value=value, unit=units[name]) for name, value in values.items()}


def _compute(computation: _Computation, log: RunLog, known: Mapping[str, Value]) -> dict[str, Value]:
    def value_of(name: str) -> Any:
        return getattr(log, name) if name in _FIELDS else known.get(name)

    names = [declaration.name for declaration in computation.declarations]
    needed = [value_of(name) for name in computation.declarations[0].needs]
    if any(value is None for value in needed):
        return dict.fromkeys(names)
    try:
        result = computation.function(*needed, *(value_of(name) for name in computation.optional))
        found = dict(result) if computation.bundle else {names[0]: result}
        if strange := sorted(found.keys() - set(names)):
            raise ValueError(f"{strange[0]!r} is not declared")
        return {name: _number(value) for name, value in found.items()}
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # of a package that we do not know
        reason = f"metric {names[0]!r} of {computation.place} fails, and is None: {describe(error)}"
        warnings.warn(reason, RuntimeWarning, stacklevel=3)
        return dict.fromkeys(names)


def _number(value: Any) -> Value:
    if isinstance(value, np.generic):
        value = value.item()
    if value is not None and not isinstance(value, int | float):
        raise TypeError(f"{value!r} is not a number")
    return None if value is None or not math.isfinite(value) else value


def _add(computation: _Computation) -> None:
    names = tuple(declaration.name for declaration in computation.declarations)
    for others, other in _COMPUTATIONS.items():
        # The same function once more is a module that was loaded again, or a cell of a notebook.
        if set(names) & set(others) and not (names == others and other.place == computation.place):
            raise ValueError(f"metric {(set(names) & set(others)).pop()!r} is declared by {other.place} already")
    if not names or not all(isinstance(name, str) and name and name.isprintable() for name in names):
        raise ValueError(f"a metric needs a name, {computation.place} gives {list(names)!r}")
    first = computation.declarations[0]
    if isinstance(first.needs, str) or isinstance(computation.optional, str):
        raise ValueError(
            f"metric {names[0]!r}: needs and optional are tuples of names, ({first.needs or computation.optional!r},)"
        )
    earlier = {name for others in _COMPUTATIONS for name in others} - set(names)
    for name in first.needs:
        if name not in _FIELDS | earlier:
            raise ValueError(f"metric {names[0]!r} needs {name!r}: neither a metric declared before nor one of {_listed()}")
    for name in (*computation.optional, *([first.where] if first.where else [])):
        if name not in _FIELDS:
            raise ValueError(f"metric {names[0]!r} asks for {name!r}, which is not one of {_listed()}")
    arguments = (*first.needs, *computation.optional)
    try:
        inspect.signature(computation.function).bind(*arguments)
    except TypeError as error:
        raise ValueError(f"metric {names[0]!r}: {computation.place} gets ({', '.join(arguments)}): {error}") from error
    _COMPUTATIONS[names] = computation


def _listed() -> str:
    return ", ".join(sorted(_FIELDS))


def _first_sentence(function: Callable[..., Any]) -> str:
    paragraph = " ".join((inspect.getdoc(function) or "").partition("\n\n")[0].split())
    return re.split(r"(?<=\.)\s", paragraph, maxsplit=1)[0]


@cache
def _load_entry_points() -> None:
    for point in importlib.metadata.entry_points(group=GROUP):
        try:
            point.load()
        except Exception as error:  # whatever the module does while it is imported
            raise MetricError(f"entry point {point.name!r} of {GROUP}: {describe(error)}") from error
