"""Parts that Python hands over itself: a class, or any callable that builds the part from the context."""

from __future__ import annotations

import dis
import hashlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import PurePath
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any, TypeAlias

import numpy as np

from robocar.core import ParameterError

Part: TypeAlias = str | Callable[..., Any]
"""A registered name or `package.module:factory`; or the class or factory itself, called with the `Context`."""


def part_name(part: Part) -> str:
    """For people and for files: `module:qualified name` of what is no name already."""
    if isinstance(part, str):
        return part
    while isinstance(part, partial):
        part = part.func
    owner = part if hasattr(part, "__qualname__") else type(part)
    return f"{getattr(part, '__module__', None) or owner.__module__}:{owner.__qualname__}"


def part_identity(part: Part) -> str:
    """A text that two different parts never share, and that the same one has in every process.

    What stands at the top of a module is known by its place, whatever its code is today. A lambda, a function within a function
    or a `partial` is known by its code and by the values that it holds.

    Raises:
        ParameterError: it holds something that no text tells apart from another one of its kind.
    """
    name = part_name(part)
    if isinstance(part, str) or _found(*name.split(":")) is part:
        return name
    try:
        return f"{name}#{hashlib.sha256(_text(part).encode(errors='backslashreplace')).hexdigest()[:16]}"
    except _Untold as error:
        raise ParameterError(
            f"{name} holds {error}, by which two runs cannot be told apart: give a class or a function at the top of a module"
        ) from None


class _Untold(Exception):
    pass


def _found(module: str, name: str) -> Any:
    found: Any = sys.modules.get(module)
    for word in name.split("."):
        found = getattr(found, word, None)
    return found


def _text(value: Any) -> str:
    """All that a value is."""
    match value:
        case None | bool() | int() | float() | complex() | str() | bytes() | PurePath():
            return repr(value)
        case np.ndarray() | np.generic():
            array = np.asarray(value)
            if array.dtype.hasobject:
                raise _Untold("an array of objects")
            return f"{array.dtype.str}{array.shape}{hashlib.sha256(array.tobytes()).hexdigest()}"
        case list() | tuple():
            return f"{type(value).__name__}({', '.join(map(_text, value))})"
        case set() | frozenset():
            return f"set({', '.join(sorted(map(_text, value)))})"
        case Mapping():
            return f"map({', '.join(sorted(f'{_text(k)}: {_text(v)}' for k, v in value.items()))})"
        case partial():
            return f"partial({_text(value.func)}, {_text(value.args)}, {_text(value.keywords)})"
        case MethodType():
            return f"method({_text(value.__self__)}, {value.__func__.__qualname__})"
        case CodeType():
            return f"code({value.co_code.hex()}, {_text(value.co_names)}, {_text(value.co_consts)})"
        case _ if callable(value) and _found(*part_name(value).split(":")) is value:
            return part_name(value)
        case FunctionType():
            held = [cell.cell_contents for cell in value.__closure__ or ()]
            seen = {name: value.__globals__[name] for name in _globals_of(value.__code__) if name in value.__globals__}
            defaults = value.__defaults__, value.__kwdefaults__
            return f"{part_name(value)}({_text(value.__code__)}, {_text(held)}, {_text(seen)}, {_text(defaults)})"
        case ModuleType():
            return f"module({value.__name__})"
        case _ if is_dataclass(value) and not isinstance(value, type):
            return f"{part_name(type(value))}({_text({f.name: getattr(value, f.name) for f in fields(value)})})"
    raise _Untold(f"an object of type {type(value).__name__}")


def _globals_of(code: CodeType) -> set[str]:
    """Names that it looks up in its module, a notebook's loop variable, say."""
    found = {str(step.argval) for step in dis.get_instructions(code) if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
    return found.union(*(_globals_of(inner) for inner in code.co_consts if isinstance(inner, CodeType)))
