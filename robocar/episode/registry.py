"""Algorithms by name: found, checked and built.

The names that come with Robocar are in `algorithms`. Packages of others register theirs in the entry-point groups
`robocar.planners` (navigators) and `robocar.estimators` (`name = "package.module:factory"`). The command line also takes
`package.module:factory` itself, Python a class or factory. Files only name what is registered: data runs no code.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from types import ModuleType
from typing import Any

from robocar.core import Context, ParameterError, RobocarError, UnknownNameError
from robocar.core.capabilities import Capabilities, capabilities_of
from robocar.core.suggestions import did_you_mean
from robocar.episode.algorithms import TABLES, Entry, Kind
from robocar.episode.blame import describe_with_place
from robocar.episode.given import Part, part_name

_GROUPS: dict[Kind, str] = {"navigator": "robocar.planners", "estimator": "robocar.estimators"}
_ASKED: dict[Kind, tuple[str, tuple[str, ...], str]] = {
    "navigator": ("command", ("state", "observation", "goal"), "Command"),
    "estimator": ("update", ("observation", "command"), "Belief (or State)"),
    "mapper": ("update", ("belief", "observation"), "None"),
}
"""The method that the loop calls, its arguments, and what it gives."""


def names(kind: Kind) -> dict[str, Entry]:
    """Registered names of this kind, those of other packages included."""
    table = dict(TABLES[kind])
    if kind in _GROUPS:
        for point in importlib.metadata.entry_points(group=_GROUPS[kind]):
            table.setdefault(point.name, Entry(point.value, f"from {point.dist.name if point.dist else 'elsewhere'}"))
    return table


def find(kind: Kind, part: Part) -> Entry:
    """The entry of a registered name, of `package.module:factory`, or of a class or factory.

    Raises:
        UnknownNameError: nothing is registered under this name; the message lists what is.
        ParameterError: something else was given.
    """
    if not isinstance(part, str):
        if callable(part):
            return Entry(part, "given as a class or factory")
        wanted = "a class, a factory build(context), a registered name or package.module:factory"
        raise ParameterError(f"{kind}: expected {wanted}, not an object of type {type(part).__name__}")
    if ":" not in part or part in names(kind):
        return registered(kind, part)
    _load(part, f"{kind} {part!r}")
    return Entry(part, "given as package.module:factory")


def registered(kind: Kind, name: str) -> Entry:
    """The entry of a registered name; nothing is imported.

    Raises:
        UnknownNameError: nothing is registered under this name; the message lists what is.
    """
    if name in TABLES[kind]:  # without asking what is installed
        return TABLES[kind][name]
    table = names(kind)
    if name not in table:
        raise UnknownNameError(f"unknown {kind} {name!r}{did_you_mean(name, table)}; known: {', '.join(sorted(table))}")
    return table[name]


def capabilities(kind: Kind, part: Part) -> Capabilities:
    """What the factory of an algorithm declares (`robocar.core.capabilities`)."""
    return capabilities_of(_load(find(kind, part).factory, f"{kind} {part_name(part)!r}"))


def build(kind: Kind, part: Part, context: Context) -> Any:
    """The algorithm for this context; None for the mapper `none`.

    Raises:
        UnknownNameError: see `find`.
        ParameterError: the context's parameters hold a name that none of the algorithm's dataclasses has, or a bad value; or
            somebody else's factory failed, or built something that the loop cannot call.
    """
    entry = find(kind, part)
    check_parameters(kind, part, context.parameters)
    ours = part in TABLES[kind] if isinstance(part, str) else False
    what = f"{kind} {part_name(part)!r}"
    factory, parts = _load(entry.factory, what), [_load(path, what) for path in entry.parts]
    if not ours:
        _check_factory(what, factory)
    try:
        built = factory(context, *parts)
    except RobocarError:
        raise
    except Exception as error:
        if ours:
            raise
        raise ParameterError(f"{what} cannot be built: {describe_with_place(error)}") from error
    if not ours:
        _check_signature(kind, what, built)
    return built


def parameters(entry: Entry) -> dict[str, Any]:
    """Defaults of everything that can be set on an algorithm, by name: `weight`, or `<part>.<name>` for those of its parts."""
    ours = {part: [_load(path, path) for path in paths] for part, paths in entry.parameters.items()}
    return {
        f"{part}.{field.name}".lstrip("."): field.default
        for part, classes in (ours or _declared(entry.factory)).items()
        for cls in classes
        for field in fields(cls)
    }


def _declared(factory: Part) -> Mapping[str, Sequence[Any]]:
    """Parameters of another package's factory: those it declares, else its module's `Parameters` or dataclass called after it."""
    path = part_name(factory)
    if declared := capabilities_of(_load(factory, path)).parameters:
        return declared
    module = path.partition(":")[0]
    home = _import(module, path) if isinstance(factory, str) else sys.modules.get(module)
    called_after = "".join(word.capitalize() for word in module.rpartition(".")[2].split("_")) + "Parameters"
    for name in ("Parameters", called_after):
        cls = getattr(home, name, None)
        if isinstance(cls, type) and is_dataclass(cls):
            return {"": (cls,)}
    return {}


def check_parameters(kind: Kind, part: Part, given: Mapping[str, Any]) -> None:
    """Whether an algorithm has all these parameters, nested by part.

    Raises:
        ParameterError: it has not; the message says the new name of one that was flat, or the nearest one, and all of them.
    """
    known, name = parameters(find(kind, part)), part_name(part)
    if not known and name not in TABLES[kind]:
        return  # a third party's factory without a dataclass of parameters looks at them itself
    for key in _dotted(given):
        if key in known:
            continue
        # Until they were nested by part, parameters were told by their last name alone.
        now = [path for path in known if path.rpartition(".")[2] == key]
        hint = f"; it is now {' or '.join(f'{kind}.{path}' for path in now)}" if now else did_you_mean(key, known)
        if any(path.startswith(f"{key}.") for path in known):
            hint = f"; it is a part: set {kind}.{key}.<parameter>"
        raise ParameterError(f"{kind} {name!r} has no parameter {key!r}{hint}; it has: {', '.join(sorted(known)) or 'none'}")


def _dotted(given: Mapping[str, Any]) -> Iterator[str]:
    for key, value in given.items():
        if isinstance(value, Mapping):
            yield from (f"{key}.{inner}" for inner in _dotted(value))
        else:
            yield key


def _check_signature(kind: Kind, what: str, built: object) -> None:
    """Refuses what the loop could not call, at once and not at its first tick."""
    method, arguments, result = _ASKED[kind]
    wanted = f"{method}({', '.join(arguments)}) -> {result}"
    if built is None and kind == "mapper":
        return
    try:
        function = getattr(built, method, None)
        signature = inspect.signature(function) if callable(function) else None
    except ValueError:  # of something compiled, which does not say
        return
    except Exception as error:  # of a property
        raise ParameterError(f"{what}: {type(built).__name__}.{method}: {describe_with_place(error)}") from error
    if signature is None:
        raise ParameterError(f"{what}: {type(built).__name__} has no method {wanted}")
    try:
        signature.bind(*arguments)
        old = kind == "navigator" and tuple(signature.parameters)[:2] == ("belief", "mapper")  # takes three, and others
    except TypeError:
        old = True
    if old:
        raise ParameterError(f"{what}: {type(built).__name__}.{method}{signature} cannot be called; a {kind} needs {wanted}")


def _check_factory(what: str, factory: Any) -> None:
    """Refuses what cannot be called with the context alone."""
    try:
        signature = inspect.signature(factory)
    except (TypeError, ValueError):  # of something compiled, which does not say
        return
    try:
        signature.bind(None)
    except TypeError as error:
        raise ParameterError(
            f"{what} is called with one argument, the context (robocar.core.Context), and cannot be: {signature}: {error}"
        ) from error


def _load(path: Part, what: str) -> Any:
    if not isinstance(path, str):
        return path
    module, _, attribute = path.partition(":")
    found = getattr(_import(module, what), attribute, None)
    if not callable(found):
        raise UnknownNameError(f"{what}: {module!r} has no function or class {attribute!r}")
    return found


def _import(module: str, what: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise UnknownNameError(f"{what}: there is no module {error.name!r}") from error
    except Exception as error:  # whatever the module does while it is imported
        raise UnknownNameError(f"{what}: {module!r} cannot be imported: {describe_with_place(error)}") from error
