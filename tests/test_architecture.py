"""Imports go down only (design, section 2). Oracle: the syntax tree of every module, and a fresh interpreter."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
LINKED = ("planners", "experiments", "benchmarks")
"""Folders at the top whose import names begin with `robocar.`: `robocar/<name>` is a link to each."""
HERE = "(itself)"
BY_NAME = ("import_module", "__import__")
"""Calls that import what a text names. The registry and the command `experiment` make theirs at run time; a literal counts."""

# Bottom up: a room may import from its own modules and from all layers below its own. Rooms of one layer do not know each other.
# A room with rooms inside has layers of its own; HERE stands for the modules that lie directly in it.
LAYERS: tuple[Mapping[str, Any], ...] = (
    {"core": None},
    {"paths": None, "reading": None, "kernel_cache": None},
    {"validation": None},
    {
        "formats": None,
        "sim": ({"sensors": None}, {HERE: None}),
        "estimation": ({"odometry": None}, {"landmarks": None, "mapping": None}, {HERE: None}),
        "metrics": None,
        "recording": None,
        "planners": (
            {"geometry": None},
            {"search": None},
            {"costmap": None, "tracking": None},
            {"sampling": None, "controllers": None},
            {"navigators": None},
            {
                "harmonic": ({"laplace": None}, {HERE: None}),
                "safe_direction": None,
                "bugs": ({HERE: None}, {"ocpb": None}),
                "exploration": None,
            },
            {HERE: None},
        ),
    },
    {"scenario": None},
    {"episode": None},
    {HERE: None},  # robocar/__init__.py, the API
    {"regression": None, "rl": None},
    {"reporting": None},
    {"experiments": None, "cli": None},
    {"benchmarks": None, "__main__": None},
)
LIBRARIES = {
    "mujoco": {"sim", "experiments", "benchmarks"},
    "dm_control": {"experiments", "benchmarks"},
    "rerun": {"recording", "experiments", "benchmarks"},
}
"""Where alone a library is imported."""
ONLY = {"core": {"numpy", "numba"}, "planners": {"numpy", "numba", "scipy", "cv2", "pyamg"}}
"""Rooms that import these libraries and no others."""


def files() -> list[Path]:
    """Every module; those of the linked folders where they lie."""
    own = [path for path in (ROOT / "robocar").rglob("*.py") if path.relative_to(ROOT / "robocar").parts[0] not in LINKED]
    return sorted([*own, *(path for folder in LINKED for path in (ROOT / folder).rglob("*.py"))])


def name_of(path: Path) -> str:
    """The name that a module is imported by."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] == "robocar" else ("robocar", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in files()}
PACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}


def imports_of(path: Path, name: str) -> set[str]:
    """Absolute names of all that a module imports, anywhere in it; `from a import b` gives a.b, `import_module("a.b")` too."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            base += node.module.split(".") if node.module else []
            found |= {".".join([*base, alias.name]) for alias in node.names}
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in BY_NAME:
            found |= {word.value for word in node.args[:1] if isinstance(word, ast.Constant) and isinstance(word.value, str)}
    return found


def folder_of(name: str) -> str:
    """The package that a module lies in; modules directly in `robocar` count as folders of their own."""
    return name if name in PACKAGES or name.count(".") == 1 else name.rpartition(".")[0]


def own_imports(name: str) -> set[str]:
    """Modules of ours that a module imports."""
    found = set()
    for imported in imports_of(MODULES[name], name):
        parts = imported.split(".")
        longest = next((n for n in range(len(parts), 0, -1) if ".".join(parts[:n]) in MODULES), 0)
        if longest:
            found.add(".".join(parts[:longest]))
    return found - {name}


def place(name: str) -> list[str]:
    """Rooms from the outermost to the innermost, then HERE: `robocar.planners.search.a_star` is in planners, search."""
    parts = name.split(".")[1:]
    if name not in PACKAGES and len(parts) > 1:
        parts = parts[:-1]
    return [*parts, HERE]


def lies_above(name: str, imported: str, layers: Sequence[Mapping[str, Any]] = LAYERS) -> bool:
    """Whether the table lets a module import another one."""
    here, there = place(name), place(imported)
    while here[0] == there[0] and here != there:
        inner = next(layer[here[0]] for layer in layers if here[0] in layer)
        if inner is None:
            return True
        layers, here, there = inner, here[1:], there[1:]
    level = {room: k for k, layer in enumerate(layers) for room in layer}
    return here == there or level[here[0]] > level[there[0]]


def rooms(layers: Sequence[Mapping[str, Any]] = LAYERS, above: str = "robocar") -> Iterator[str]:
    """Every room and module that the table names."""
    for room, inner in (pair for layer in layers for pair in layer.items()):
        name = above if room == HERE else f"{above}.{room}"
        yield name
        if inner:
            yield from (nested for nested in rooms(inner, name) if nested != name)


def as_text(layers: Sequence[Mapping[str, Any]] = LAYERS, indent: str = "") -> str:
    """The table for people, top down."""
    lines: list[str] = []
    for layer in reversed(layers):
        lines.append(indent + " · ".join(layer))
        for room, inner in layer.items():
            if inner:
                lines.append(f"{indent}    in {room}:")
                lines.append(as_text(inner, indent + "        "))
    return "\n".join(lines)


def test_every_folder_and_every_top_level_module_has_its_layer() -> None:
    """Oracle: the tree. Shows the layers: `pytest tests/test_architecture.py -k every_folder -s`."""
    sys.stdout.write(f"\n{as_text()}\n")
    folders = {name.rpartition(".")[0] for name in MODULES if name not in PACKAGES} | PACKAGES  # a package is what it says it is
    assert folders == PACKAGES
    folders |= {name for name in MODULES if name.count(".") == 1}
    named = Counter(rooms())
    assert set(named) == folders
    assert set(named.values()) == {1}


@pytest.mark.parametrize(
    ("name", "imported", "allowed"),
    [
        ("robocar.sim.world", "robocar.core.grid", True),
        ("robocar.core.grid", "robocar.sim.world", False),
        ("robocar.sim.world", "robocar.formats.load", False),  # side by side
        ("robocar.planners.costmap.layered", "robocar.planners.search.grid_search", True),
        ("robocar.planners.search.grid_search", "robocar.planners.costmap.layered", False),
        ("robocar.planners.tracking.tracker", "robocar.planners.costmap.layered", False),
        ("robocar.planners.bugs.ocpb.strategy", "robocar.planners.bugs.view", True),
        ("robocar.planners.bugs.view", "robocar.planners.bugs.ocpb.strategy", False),
        ("robocar.planners.harmonic.planner", "robocar.planners.harmonic.laplace", True),
        ("robocar.planners.search.a_star", "robocar.episode.registry", False),
        ("robocar.cli.commands", "robocar", True),
        ("robocar.scenario.model", "robocar", False),
        ("robocar.cli.experiments", "robocar.experiments.barn", False),
        ("robocar.benchmarks.bench_loop", "robocar.experiments.barn", True),
        ("robocar.__main__", "robocar.cli", True),
    ],
)
def test_the_table_is_read_as_it_is_written(name: str, imported: str, allowed: bool) -> None:
    """Oracle: the rules above the table, by hand."""
    assert lies_above(name, imported) is allowed


def test_imports_are_found(tmp_path: Path) -> None:
    """Oracle: Python's rules: one dot is the module's own package, two its parent."""
    module = tmp_path / "car.py"
    module.write_text(
        "import os.path\nfrom . import a\nfrom .b import c\nfrom ..core import d\ndef f():\n    import mujoco as m\n"
        "importlib.import_module('rerun')\n__import__('cv2')\n"
    )
    expected = {"os.path", "robocar.sim.a", "robocar.sim.b.c", "robocar.core.d", "mujoco", "rerun", "cv2"}
    assert imports_of(module, "robocar.sim.car") == expected


@pytest.mark.parametrize("name", MODULES)
def test_imports_go_down_only(name: str) -> None:
    wrong = sorted(imported for imported in own_imports(name) if not lies_above(name, imported))
    assert not wrong, f"{name} must not import {wrong}; the layers, top down:\n{as_text()}"


def test_no_import_runs_in_a_circle() -> None:
    """Neither among modules nor, as folders, among rooms. Oracle: what imports nothing else can be taken away, to the last one.

    Imports within functions and for type checkers count too.
    """
    modules = {name: own_imports(name) for name in MODULES}
    folders: dict[str, set[str]] = {}
    for name, imported in modules.items():
        folder, others = folder_of(name), {folder_of(other) for other in imported}
        folders[folder] = folders.get(folder, set()) | others - {folder}
    for graph in (modules, folders):
        left = dict(graph)
        while free := [name for name, imported in left.items() if not imported & set(left)]:
            for name in free:
                del left[name]
        assert not left, f"in a circle, or above one: {sorted(left)}"


@pytest.mark.parametrize("name", MODULES)
def test_libraries_stay_in_their_places(name: str) -> None:
    room, path = place(name)[0], MODULES[name]
    libraries = {imported.split(".")[0] for imported in imports_of(path, name)} - set(sys.stdlib_module_names)
    assert not libraries & {*LINKED, "tests"}, f"{name}: our import names begin with robocar"
    libraries -= {"robocar"}
    wrong = {library for library in libraries if room not in LIBRARIES.get(library, {room})}
    wrong |= libraries - ONLY.get(room, libraries)
    assert not wrong, f"{name} must not import {sorted(wrong)}"


def test_planners_read_no_clock() -> None:
    """They are silent and repeatable: whoever wants to know how long one takes measures around it."""
    planners = [name for name in MODULES if name.startswith("robocar.planners.")]
    assert planners
    clocks = {name: imports_of(MODULES[name], name) & {"time", "datetime"} for name in planners}
    assert {name: found for name, found in clocks.items() if found} == {}


def test_compiled_functions_sort_by_quicksort_or_order_by_mergesort() -> None:
    """Numba calls its quicksort of values and that of indices by one name, told apart only by a counter of the process that
    compiled them. Cached by two processes with the same count, one is run in place of the other: a crash, or a wrong order.
    """
    wrong, orders = [], 0
    for name, path in MODULES.items():
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(function, ast.FunctionDef) or not any("njit" in ast.unparse(d) for d in function.decorator_list):
                continue
            for call in (node for node in ast.walk(function) if isinstance(node, ast.Call)):
                if isinstance(call.func, ast.Attribute) and call.func.attr == "argsort":
                    orders += 1
                    if not any(word.arg == "kind" and ast.unparse(word.value) == "'mergesort'" for word in call.keywords):
                        wrong.append(f"{name}.{function.name}")
    assert orders > 0
    assert wrong == []


def test_a_class_name_says_which() -> None:
    """No two public classes of ours have the same name, and none is called only `Parameters`."""
    found: dict[str, list[str]] = {}
    for name, path in MODULES.items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(name)
    assert "AStarParameters" in found
    assert "Parameters" not in found
    assert {name: where for name, where in found.items() if len(where) > 1} == {}


def test_a_file_holds_one_concept() -> None:
    """At most 400 lines (style, rule 2), tests too."""
    every = [*MODULES.values(), *(path for folder in ("tests", "examples") for path in (ROOT / folder).rglob("*.py"))]
    lengths = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in every}
    assert {name: lines for name, lines in lengths.items() if lines > 400} == {}


@pytest.mark.parametrize("folder", LINKED)
def test_the_linked_folders_are_where_they_are_imported_from(folder: str) -> None:
    assert (ROOT / "robocar" / folder).readlink() == Path("..") / folder


def test_an_editable_install_shows_one_name() -> None:
    (link,) = (ROOT / ".editable").iterdir()
    assert link.readlink() == Path("..") / "robocar"


@pytest.mark.parametrize(
    "module", ["robocar.core", "robocar.core.distance", "robocar.core.geodesic", "robocar.core.rays", "robocar.metrics"]
)
def test_the_core_is_light(module: str) -> None:
    """Oracle: the modules that a fresh interpreter holds after the import."""
    script = f"import sys, {module}; print(*sorted(n for n in sys.modules if '.' not in n))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    heavy = {"mujoco", "dm_control", "rerun", "cv2", "matplotlib", "pydantic"}
    heavy |= {"scipy", "numba"} if module == "robocar.core" else set()  # numba itself looks for scipy
    assert "robocar" in loaded
    assert not heavy & set(loaded)
