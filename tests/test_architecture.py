"""Imports go one way (design, section 2). Oracle: the syntax tree of every module, and a fresh interpreter."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted(path for folder in ("robocar", "planners", "experiments") for path in (ROOT / folder).rglob("*.py"))
SIDE_BY_SIDE = ("formats", "sim", "estimation", "metrics", "recording")
"""Parts that know the core, and not each other."""


def imports_of(path: Path) -> set[str]:
    """Absolute names of all that a module imports, anywhere in it; `from a import b` gives a.b."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            base += node.module.split(".") if node.module else []
            found |= {".".join([*base, alias.name]) for alias in node.names}
    return found


def part_of(path: Path) -> str:
    """`core`, `sim`, `metrics`, ... for modules of robocar; `planners` or `experiments` for theirs."""
    top, *rest = path.relative_to(ROOT).with_suffix("").parts
    return rest[0] if top == "robocar" else top


def name_is(name: str, *parents: str) -> bool:
    return any(name == parent or name.startswith(parent + ".") for parent in parents)


def own(names: set[str]) -> set[str]:
    return {name for name in names if name_is(name, "robocar", "planners", "experiments")}


ids = [str(path.relative_to(ROOT)) for path in MODULES]


def test_the_project_is_found() -> None:
    assert {"core", "sim", "formats", "estimation", "metrics"} <= {part_of(path) for path in MODULES}


def test_relative_imports_are_resolved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: Python's rule: one dot is the module's own package, two its parent."""
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    module = tmp_path / "robocar" / "sim" / "car.py"
    module.parent.mkdir(parents=True)
    module.write_text(
        "import os.path\nfrom . import a\nfrom .b import c\nfrom ..core import d\ndef f():\n    import mujoco as m\n"
    )
    assert imports_of(module) == {"os.path", "robocar.sim.a", "robocar.sim.b.c", "robocar.core.d", "mujoco"}


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_imports_go_one_way(path: Path) -> None:
    part, names = part_of(path), imports_of(path)
    # `paths` only says where the data lies.
    allowed = {"core": ("robocar.core",), "planners": ("robocar.core", "planners"), "paths": ()}
    allowed |= {side: ("robocar.core", f"robocar.{side}", "robocar.paths", "robocar.__version__") for side in SIDE_BY_SIDE}
    above = {"experiments": (), "navigation": ("robocar.run", "robocar.cli.main", "experiments", "planners")}
    wrong = {name for name in own(names) if part in allowed and not name_is(name, *allowed[part])}
    wrong |= {name for name in own(names) if name_is(name, *above.get(part, ("experiments",)))}
    assert not wrong, f"{path.relative_to(ROOT)} must not import {sorted(wrong)}"


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_libraries_stay_in_their_places(path: Path) -> None:
    """MuJoCo in `sim` only, Rerun in `recording` only, nothing but numpy and numba in `core`, and a short list in `planners`."""
    part = part_of(path)
    libraries = {name.split(".")[0] for name in imports_of(path)} - set(sys.stdlib_module_names)
    libraries -= {"robocar", "planners", "experiments"}
    forbidden = {"mujoco", "dm_control"} if part not in ("sim", "experiments") else set()
    forbidden |= {"rerun"} if part not in ("recording", "experiments") else set()
    limits = {"core": {"numpy", "numba"}, "planners": {"numpy", "numba", "scipy", "cv2", "pyamg"}}
    forbidden |= libraries - limits.get(part, libraries)
    assert not libraries & forbidden, f"{path.relative_to(ROOT)} must not import {sorted(libraries & forbidden)}"


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
