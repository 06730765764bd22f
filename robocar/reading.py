"""Files from outside are read here, and nowhere else: with bounds on all that their authors can choose.

Size, nesting, number of nodes (aliases count as often as they are used), digits of integers, keys that stand twice. Past a bound
or a mistake there is one message: the file, the line where there is one, the value. What is past a bound is never built.
"""

from __future__ import annotations

import io
import json
import math
import os
import stat
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, BinaryIO, TypeAlias

from robocar.core import MapFormatError, RobocarError
from robocar.core.text import shown

PathLike: TypeAlias = str | os.PathLike[str]

MAX_BYTES = 1 << 27
"""Of a file, packed or not: 128 MiB, a log of many hours, and four times the largest map."""
MAX_TEXT = 1 << 22
"""Of a YAML or JSON file, which become objects of many times their size: 4 MiB."""
MAX_NODES = 100_000
"""Of a YAML file: keys and values, those behind an alias each time that it is used."""
MAX_DEPTH = 64
"""Of brackets in brackets."""
MAX_DIGITS = 40
"""Of an integer; longer ones are no numbers of robots, and take time that grows with the square of their length."""


def read_bytes(path: PathLike, error: type[RobocarError] = MapFormatError, limit: int = MAX_BYTES) -> bytes:
    """The content of a regular file; raises `error` where it is missing, something else, or larger than `limit` bytes."""
    with _opened(path, error) as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise error(f"{path}: more than {limit} bytes, the most that is read of such a file")
    return data


@contextmanager
def _opened(path: PathLike, error: type[RobocarError]) -> Iterator[BinaryIO]:
    """A regular file, open. What it is, is asked of the open file, which nobody can exchange; a pipe is not waited for."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        if os.path.isdir(path):  # which Windows does not open
            raise error(f"{path}: not a file (a directory)")
        with open(os.open(path, flags), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise error(f"{path}: not a file (a pipe or a device)")
            yield file
    except FileNotFoundError as failure:
        raise error(f"{path}: no such file") from failure
    except (OSError, ValueError) as failure:  # ValueError: a null byte in the path
        raise error(f"{path}: cannot be read ({failure})") from failure


def read_start(path: PathLike, error: type[RobocarError] = MapFormatError, count: int = 4096) -> bytes:
    """The first bytes of a regular file."""
    with _opened(path, error) as file:
        return file.read(count)


def read_text(path: PathLike, error: type[RobocarError] = MapFormatError, limit: int = MAX_BYTES) -> str:
    """The content of a UTF-8 text file, with or without a byte-order mark; line ends are left as they are."""
    return decoded(read_bytes(path, error, limit), path, error)


def decoded(data: bytes, path: PathLike, error: type[RobocarError] = MapFormatError) -> str:
    """UTF-8 text; the message of `error` names the line of the first byte that is none."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        line = data.count(b"\n", 0, failure.start) + 1
        raise error(f"{path}, line {line}: byte 0x{data[failure.start]:02x} is not UTF-8 text") from failure


def is_packed(data: bytes) -> bool:
    """Whether bytes begin as gzip's do."""
    return data.startswith(b"\x1f\x8b")


def gunzip(data: bytes, path: PathLike, error: type[RobocarError] = MapFormatError, limit: int = MAX_BYTES) -> bytes:
    """Unpacked bytes; never more than `limit`, however well they were packed."""
    unpacked = b""
    try:
        while data:
            unpacker = zlib.decompressobj(wbits=31)
            part = unpacker.decompress(data, limit + 1 - len(unpacked))
            unpacked = unpacked + part if unpacked else part
            if len(unpacked) > limit:
                raise error(f"{path}: unpacks to more than {limit} bytes, the most that is read of such a file")
            if not unpacker.eof:
                raise zlib.error("it ends too early")
            data = unpacker.unused_data.lstrip(b"\0")  # gzip's files may be appended to each other, and padded
    except zlib.error as failure:
        raise error(f"{path}: damaged or truncated gzip file ({failure})") from failure
    return unpacked


def read_yaml(path: PathLike, error: type[RobocarError] = MapFormatError) -> Any:
    """What a YAML file holds; see `parse_yaml`."""
    return parse_yaml(read_text(path, error, MAX_TEXT), str(path), error)


def parse_yaml(text: str, where: str, error: type[RobocarError]) -> Any:
    """What a YAML text of one document holds, made of plain values.

    Raises:
        error: it is no YAML, or past a bound; a key stands twice in a mapping, as YAML forbids and PyYAML takes silently. The
            message begins with `where` and the line.
    """
    import yaml

    base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's is ten times faster, where it was built in
    try:
        _check_events(yaml, text, base)
        loader = base(text)
        try:
            root = loader.get_single_node()
            if root is None:
                return None
            _check_nodes(yaml, root)
            return loader.construct_document(root)
        finally:
            loader.dispose()
    except yaml.YAMLError as failure:
        mark = getattr(failure, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark is not None else ""
        problem = getattr(failure, "problem", None) or str(failure).partition("\n")[0]
        raise error(f"{where}{line}: not YAML: {problem}") from failure
    except _Refused as failure:
        raise error(f"{where}, line {failure.line + 1}: {failure}") from failure
    except Exception as failure:  # PyYAML's conversions raise what Python's do: of the date 2020-13-45, of !!int x
        raise error(f"{where}: not YAML: {failure if isinstance(failure, ValueError) else type(failure).__name__}") from failure


class _Refused(Exception):
    """YAML, but past a bound."""

    def __init__(self, problem: str, mark: Any) -> None:
        super().__init__(problem)
        self.line: int = mark.line


def _check_events(yaml: Any, text: str, loader: Any) -> None:
    """Before anything is built, or entered recursively."""
    depth = 0
    for count, event in enumerate(yaml.parse(text, Loader=loader)):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise _Refused(f"brackets or indents nested deeper than {MAX_DEPTH}", event.start_mark)
        if count > 2 * MAX_NODES:
            raise _Refused(f"more than {MAX_NODES} keys and values", event.start_mark)


def _check_nodes(yaml: Any, root: Any) -> None:
    """What the composed nodes would become: how many, which keys, which integers."""
    sizes: dict[int, int] = {}  # of the nodes that are done; the open ones have 0

    def size(node: Any, depth: int) -> int:
        known = sizes.get(id(node))
        if known == 0:
            raise _Refused("an alias that stands for what it is in", node.start_mark)
        if known is not None:
            return known
        if depth > MAX_DEPTH:
            raise _Refused(f"aliases nested deeper than {MAX_DEPTH}", node.start_mark)
        sizes[id(node)] = 0
        total = 1
        if isinstance(node, yaml.ScalarNode):
            _check_integer(node)
        elif isinstance(node, yaml.MappingNode):
            _check_keys(yaml, node)
            total += sum(size(part, depth + 1) for pair in node.value for part in pair)
        else:
            total += sum(size(part, depth + 1) for part in node.value)
        if total > MAX_NODES:
            raise _Refused(f"more than {MAX_NODES} keys and values, counting aliases as often as they are used", node.start_mark)
        sizes[id(node)] = total
        return total

    size(root, 0)


def _check_integer(node: Any) -> None:
    if node.tag.endswith((":int", ":float", ":timestamp")) and len(node.value) > 3 * MAX_DIGITS:
        raise _Refused(f"a number of {len(node.value)} characters, at most {3 * MAX_DIGITS} are read", node.start_mark)
    if node.tag.endswith(":int") and sum(c.isalnum() for c in node.value) > MAX_DIGITS:
        raise _Refused(f"an integer of {len(node.value)} digits, at most {MAX_DIGITS} are read", node.start_mark)


def _check_keys(yaml: Any, node: Any) -> None:
    # Of the nodes as they are written, before `<<` merges others into them, whose keys may be set anew.
    seen: dict[tuple[str, str], Any] = {}
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            continue  # refused as unhashable
        first = seen.setdefault((key.tag, key.value), key)
        if first is not key:
            line = first.start_mark.line + 1
            raise _Refused(f"not YAML: the key {shown(key.value)} stands twice, first in line {line}", key.start_mark)


def read_json(path: PathLike, error: type[RobocarError]) -> Any:
    """What a JSON file holds, in which numbers are finite and no key stands twice.

    Raises:
        error: it cannot be read, is no JSON, or past a bound.
    """
    return parse_json(read_text(path, error, MAX_BYTES), str(path), error)


def parse_json(text: str, where: str, error: type[RobocarError]) -> Any:
    """What a JSON text holds; see `read_json`."""
    try:
        return json.loads(
            text, parse_constant=_no_number, parse_float=_finite, parse_int=_integer, object_pairs_hook=_different_keys
        )
    except (ValueError, RecursionError) as failure:
        why = "brackets nested too deep" if isinstance(failure, RecursionError) else str(failure)
        raise error(f"{where}: not JSON that can be read: {why}") from failure


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number")


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(f"{shown(word)} is too large for a number")
    return value


def _integer(word: str) -> int:
    if len(word) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(word)} digits, at most {MAX_DIGITS} are read")
    return int(word)


def _different_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise ValueError(f"the key {shown(twice)} stands twice")
    return found


def read_arrays(path: PathLike, error: type[RobocarError] = MapFormatError) -> Mapping[str, Any]:
    """The arrays of an `.npz` archive of plain numbers by name, read-only.

    Their headers are read first: what is none of numbers, is larger than its archive's entry or, all in all, than `MAX_BYTES`
    is refused before anything is allocated. Nothing is unpickled.
    """
    import zipfile

    import numpy as np
    from numpy.lib import format as npy

    arrays: dict[str, Any] = {}
    left = MAX_BYTES
    try:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path, error))) as archive:
            for entry in archive.infolist():
                name = entry.filename.removesuffix(".npy")
                with archive.open(entry) as file:
                    version = npy.read_magic(file)
                    if len(name) > MAX_DIGITS:
                        raise ValueError(f"array {shown(name)}: its name is longer than {MAX_DIGITS} characters")
                    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
                    shape, fortran, dtype = read_header(file)
                    if dtype.kind not in "biuf":
                        raise ValueError(f"array {shown(name)} holds {shown(str(dtype))}, not plain numbers")
                    size = math.prod(shape) * dtype.itemsize
                    left -= size
                    if left < 0 or size > entry.file_size:
                        raise ValueError(
                            f"array {shown(name)} of shape {shown(shape)} has no room in its file or {MAX_BYTES} bytes"
                        )
                    data = file.read(size)
                    if len(data) < size:
                        raise ValueError(f"array {shown(name)} is cut off")
                    arrays[name] = np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
    except error:
        raise
    except Exception as failure:  # zipfile and NumPy's header raise whatever their parts do
        raise error(f"{path}: no .npz archive of plain arrays, or damaged ({shown(failure)})") from failure
    return arrays
