"""What a part is or needs beyond its protocol: declared at its factory, never guessed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from types import MappingProxyType
from typing import Any, TypeVar

from robocar.core.robot import Robot

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What `declares` says of a factory.

    Args:
        explores: a navigator that draws a map instead of going to the goal: it needs a map and ends with `Done`.
        maps: an estimator that gives a whole `State`, map included (SLAM); others give a `Belief`.
        complete: a mapper whose grid shows every obstacle as it is now (`MapView.complete`).
        oracle: an estimator that is given the simulator's truth (`Context.oracle`); without a simulator it cannot be built.
        avoids_movers: a navigator that promises to keep off what moves: says of a robot why that does not show it what moves,
            '' where it does. None: it promises nothing, and what moves is to it what stands there now.
        parameters: dataclasses whose fields may be set, by part, `{"": (Mine,), "controller": (DwaParameters,)}`: `""` is the
            algorithm itself. For factories of other packages; ours stand in `robocar/episode/algorithms.py`.
    """

    explores: bool = False
    maps: bool = False
    complete: bool = False
    oracle: bool = False
    avoids_movers: Callable[[Robot], str] | None = None
    parameters: Mapping[str, tuple[type, ...]] = field(default_factory=dict)


_NONE = Capabilities()
_DECLARED: dict[Any, Capabilities] = {}


def declares(
    *,
    explores: bool = False,
    maps: bool = False,
    complete: bool = False,
    oracle: bool = False,
    avoids_movers: Callable[[Robot], str] | None = None,
    parameters: Mapping[str, tuple[type, ...]] = MappingProxyType({}),
) -> Callable[[F], F]:
    """A decorator for factories, `@declares(explores=True)`: see `Capabilities`.

    Raises:
        TypeError: parameters that are no dataclasses with defaults.
    """
    _check(parameters)

    def declare(factory: F) -> F:
        _DECLARED[factory] = Capabilities(explores, maps, complete, oracle, avoids_movers, parameters)
        return factory

    return declare


def _check(parameters: object) -> None:
    if not isinstance(parameters, Mapping):
        raise TypeError(f"parameters are dataclasses by part, {{'controller': (DwaParameters,)}}, not {parameters!r:.80}")
    names: list[str] = []
    for part, classes in parameters.items():
        if not isinstance(part, str) or "." in part or not isinstance(classes, tuple) or not classes:
            raise TypeError(
                f"parameters of a part are a tuple, {{'controller': (DwaParameters,)}}, not {part!r}: {classes!r:.80}"
            )
        for cls in classes:
            good = isinstance(cls, type) and is_dataclass(cls)
            if not (good and all(f.init and f.default is not MISSING for f in fields(cls))):
                raise TypeError(f"parameters of part {part!r} must be dataclasses whose fields have plain defaults, not {cls!r}")
            names += [f.name for f in fields(cls)] if part == "" else []
    if both := sorted(set(names) & parameters.keys()):
        raise TypeError(f"{both[0]!r} is a part and a parameter of the algorithm itself")


def capabilities_of(factory: object) -> Capabilities:
    """What was declared for a factory; nothing where nothing was."""
    try:
        return _DECLARED.get(factory, _NONE)
    except TypeError:  # an object that cannot be hashed, so nothing was declared for it
        return _NONE
