"""Functions are small: at most 80 lines and seven parameters. Kernels have a measure of their own: a reference in the tests."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("robocar", "planners", "experiments", "benchmarks", "examples")
MOST_LINES, MOST_PARAMETERS = 80, 7


def sources() -> Iterator[Path]:
    """Our files, each once: `robocar` holds links to the folders beside it."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if path.resolve() == path:
                yield path


def functions(source: str) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """All but compiled ones, methods and those within functions too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not any(
            "njit" in ast.unparse(decorator) for decorator in node.decorator_list
        ):
            yield node


def size(function: ast.FunctionDef | ast.AsyncFunctionDef) -> tuple[int, int]:
    """Lines from `def` to the end, and parameters without self, cls, *args and **kwargs."""
    assert function.end_lineno is not None
    a = function.args
    names = [argument.arg for argument in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
    return function.end_lineno - function.lineno + 1, len(names) - (names[:1] in (["self"], ["cls"]))


def too_large(source: str) -> list[str]:
    sizes = [(function.name, *size(function)) for function in functions(source)]
    return [f"{name}: {lines} lines, {n} parameters" for name, lines, n in sizes if lines > MOST_LINES or n > MOST_PARAMETERS]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("def f(a, b, c, d, e, f, g): ...", []),
        ("def f(a, b, c, d, e, f, g, h): ...", ["f: 1 lines, 8 parameters"]),
        ("def f(a, b, c, d, /, e, f, *, g, h): ...", ["f: 1 lines, 8 parameters"]),
        ("def f(a, b, c, d, e, f, g, *h, **i): ...", []),
        ("class A:\n    def f(self, a, b, c, d, e, f, g): ...", []),
        ("class A:\n    @classmethod\n    async def f(cls, a, b, c, d, e, f, g, h): ...", ["f: 1 lines, 8 parameters"]),
        ("@njit(cache=True)\ndef f(a, b, c, d, e, f, g, h): ...", []),
        ("def f():\n" + 79 * "    1\n", []),
        ("def f():\n" + 80 * "    1\n", ["f: 81 lines, 0 parameters"]),
        ("def f():\n    def g(a, b, c, d, e, f, g, h): ...", ["g: 1 lines, 8 parameters"]),
    ],
)
def test_sizes_are_counted_as_they_should_be(source: str, expected: list[str]) -> None:
    """Oracle: by hand."""
    assert too_large(source) == expected


def test_no_function_is_too_large() -> None:
    """Outside of kernels, over all that is ours but the tests."""
    found = {path.relative_to(ROOT).as_posix(): too_large(path.read_text(encoding="utf-8")) for path in sources()}
    assert set(found) >= {"robocar/paths.py", "planners/search/a_star.py", "experiments/harmonic_tables.py"}
    assert {path: large for path, large in found.items() if large} == {}
