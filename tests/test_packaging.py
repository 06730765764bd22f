"""The wheel holds the project and works away from the checkout. Oracles: the tree's files, and a fresh virtual environment."""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
import sysconfig
import textwrap
import tomllib
import venv
import zipfile
from email import message_from_bytes
from pathlib import Path, PurePosixPath

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from robocar.episode.run import run
from robocar.formats import load_map
from robocar.scenario.load import load_scenario, scenario_names

ROOT = Path(__file__).parents[1]
PACKAGES = ("robocar", "planners", "experiments")
NO_PART = {"__pycache__", ".DS_Store"}


def files_below(folder: Path) -> set[PurePosixPath]:
    """Files of the tree, relative to the folder's parent, without caches."""
    return {
        PurePosixPath(path.relative_to(folder.parent))
        for path in folder.rglob("*")
        if path.is_file() and not NO_PART & set(path.parts)
    }


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("build", reason="builds a wheel: pip install build")
    pytest.importorskip("hatchling", reason="builds a wheel: pip install hatchling")
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`bin` of a fresh environment: the wheel in it, its dependencies borrowed from this one."""
    home = tmp_path_factory.mktemp("venv")
    venv.create(home, with_pip=False, symlinks=True)
    python = home / "bin" / "python"
    install = ["install", "--quiet", "--no-deps", "--no-index", "--disable-pip-version-check", str(wheel)]
    subprocess.run([sys.executable, "-m", "pip", "--python", str(python), *install], check=True, capture_output=True)
    # Only the folder: .pth files in it, such as that of an editable checkout, are not followed.
    site = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], capture_output=True, text=True, check=True
    ).stdout.strip()
    borrowed = dict.fromkeys([sysconfig.get_path("purelib"), sysconfig.get_path("platlib")])
    (Path(site) / "borrowed.pth").write_text("\n".join(borrowed) + "\n")
    return home / "bin"


def outside(bin_folder: Path, folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Runs a command of the fresh environment in a folder that is not the checkout."""
    # What the fresh environment has to compile need not be fast; the results are the same.
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"NUMBA_OPT": "0"}
    program = str(bin_folder / command[0])
    return subprocess.run([program, *command[1:]], cwd=folder, env=env, capture_output=True, text=True, check=False)


def test_the_wheel_holds_the_tree_and_nothing_else(wheel: Path) -> None:
    expected = set().union(*(files_below(ROOT / package) for package in PACKAGES))
    expected |= {PurePosixPath("robocar") / path for path in files_below(ROOT / "models")}
    with zipfile.ZipFile(wheel) as archive:
        held = {PurePosixPath(name) for name in archive.namelist() if not name.endswith("/")}
    meta = {path for path in held if path.parts[0].endswith(".dist-info")}
    assert held - meta == expected
    assert {path.name for path in meta} >= {"METADATA", "RECORD", "entry_points.txt", "LICENSE"}
    # The parts that a user would miss first, by name: the comparison above would not notice if the tree lost them too.
    needed = ["robocar/py.typed", "planners/py.typed", "robocar/models/robocar/robocar.xml", "planners/search/a_star.py"]
    needed += ["robocar/models/scenarios/thesis-field.yaml", "robocar/models/maps/thesis_field.pgm", "experiments/__init__.py"]
    assert {PurePosixPath(name) for name in needed} <= held


def test_the_wheel_says_what_pyproject_says(wheel: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = message_from_bytes(archive.read(name))
        scripts = archive.read(name.replace("METADATA", "entry_points.txt")).decode()
    assert metadata["Name"] == "robocar"
    assert metadata["Requires-Python"] == project["requires-python"]
    assert metadata["License-Expression"] == project["license"]
    needed = {canonicalize_name(Requirement(line).name) for line in metadata.get_all("Requires-Dist", []) if "extra" not in line}
    assert needed == {canonicalize_name(Requirement(line).name) for line in project["dependencies"]}
    assert re.search(r"^robocar\s*=\s*robocar\.cli:main$", scripts, re.MULTILINE)


def test_the_fresh_environment_imports_the_wheel_and_not_the_checkout(installed: Path, tmp_path: Path) -> None:
    script = f"import {', '.join(PACKAGES)}; print({', '.join(f'{package}.__file__' for package in PACKAGES)}, sep='\\n')"
    done = outside(installed, tmp_path, "python", "-c", script)
    assert done.returncode == 0, done.stderr
    places = [Path(line) for line in done.stdout.splitlines()]
    assert [place.is_relative_to(installed.parent) for place in places] == [True] * len(PACKAGES)


def test_scenarios_are_listed_from_another_folder(installed: Path, tmp_path: Path) -> None:
    done = outside(installed, tmp_path, "robocar", "list", "scenarios", "--json")
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)) == {path.stem for path in (ROOT / "models" / "scenarios").glob("*.yaml")}
    assert list(tmp_path.iterdir()) == []


def test_installed_scenarios_find_their_maps(installed: Path, tmp_path: Path) -> None:
    """Oracle: the same maps, loaded from the checkout."""
    script = """
        from robocar.formats import load_map
        from robocar.scenario import load_scenario, scenario_names
        for scenario in map(load_scenario, scenario_names()):
            print(scenario.file("map").name, *load_map(scenario.file("map"), scenario.resolution).shape)
    """
    done = outside(installed, tmp_path, "python", "-c", textwrap.dedent(script))
    assert done.returncode == 0, done.stderr
    expected = []
    for scenario in map(load_scenario, scenario_names()):
        grid = load_map(scenario.file("map"), scenario.resolution)
        expected.append(f"{scenario.file('map').name} {grid.shape[0]} {grid.shape[1]}")
    assert done.stdout.splitlines() == expected


def test_the_console_script_says_its_version(installed: Path, wheel: Path, tmp_path: Path) -> None:
    """Oracle: the version in the wheel's file name."""
    assert outside(installed, tmp_path, "robocar", "--version").stdout == f"robocar {wheel.name.split('-')[1]}\n"


def test_the_installed_wheel_runs_and_its_suites_are_there(installed: Path, tmp_path: Path) -> None:
    """Oracle: the same run in this process, from the checkout."""
    words = ["robocar", "run", "u-trap", "--set", "time_limit=1", "--no-recording", "--json", "--out", str(tmp_path)]
    done = outside(installed, tmp_path, *words)
    assert done.returncode == 1, done.stderr
    found = json.loads(done.stdout)
    assert (found["status"], found["hash"]) == ("timeout", run("u-trap", settings={"time_limit": 1}).hash)
    suites = json.loads(outside(installed, tmp_path, "robocar", "list", "suites", "--json").stdout)
    assert set(suites) == {path.stem for path in (ROOT / "models" / "suites").glob("*.yaml")}


def test_a_planner_in_its_own_repository_is_tested_with_the_wheel_alone(installed: Path, tmp_path: Path) -> None:
    """`examples/own_planner`, step by step as its README says. Oracle: pytest's exit status and words."""
    project = tmp_path / "own_planner"
    shutil.copytree(ROOT / "examples" / "own_planner", project, ignore=shutil.ignore_patterns(".*", "__pycache__"))

    def tests(*words: str) -> tuple[int, str]:
        done = outside(
            installed, project, "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "tilted or walls", *words
        )
        return done.returncode, done.stdout

    status, out = tests("--robocar-update", "--robocar-recordings=none")
    assert status == 0, out
    assert "baseline new" in out
    status, out = tests("--robocar-recordings=none")
    assert status == 0, out
    planner = project / "wall_shy.py"
    planner.write_text(planner.read_text().replace("wall_weight: float = 3.0", "wall_weight: float = 1.0"))
    status, out = tests()
    assert status == 1
    assert "tilted--wall_shy_build--truth--none--s0 is not what its baseline says" in out
    assert "1 runs behave differently (another hash)" in out
    assert (project / "robocar-recordings" / "tilted--wall_shy_build--truth--none--s0.rrd").is_file()


def test_constraints_pin_all_that_pyproject_asks_for() -> None:
    """Oracle: the version specifiers in pyproject.toml. A pin is `name==version`: no registry, no path, no editable install."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert [line for line in pins if not re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9A-Za-z.]*", line)] == []
    versions = {canonicalize_name(name): version for name, version in (line.split("==") for line in pins)}
    assert len(versions) == len(pins)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = [*project["build-system"]["requires"], *project["project"]["dependencies"]]
    wanted += [line for extra in ("dev", "bench", "cluster", "rl") for line in project["project"]["optional-dependencies"][extra]]
    requirements = [Requirement(line) for line in wanted]
    unmet = [str(r) for r in requirements if not r.specifier.contains(versions.get(canonicalize_name(r.name), "0"))]
    assert unmet == []


def stub(folder: Path, name: str, script: str) -> None:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


@pytest.mark.parametrize(
    ("python", "told"),
    [
        # Python without ensurepip, as Debian's is before python3-venv is installed.
        (
            f'case "$2" in *ensurepip*) exit 1;; *) exec {sys.executable} "$@";; esac',
            "install -y --no-install-recommends python3.",
        ),
        # Python too old or too new: `suits` asks for its version.
        ("exit 1", "install -y --no-install-recommends python3 python3-venv"),
    ],
    ids=["without venv", "wrong version"],
)
def test_setup_without_rights_says_the_line_to_type(tmp_path: Path, python: str, told: str) -> None:
    """Oracle: a PATH on which nobody is root, sudo asks for a password, and Python is not what it should be."""
    (tmp_path / "scripts").mkdir()
    script = tmp_path / "scripts" / "setup.sh"
    script.write_bytes((ROOT / "scripts" / "setup.sh").read_bytes())
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "dirname").symlink_to("/usr/bin/dirname")
    for name, text in {"id": "echo 1000", "sudo": "exit 1", "apt-get": "echo called >> apt.log", "sleep": ""}.items():
        stub(programs, name, text)
    for name in ("python3", "python3.11", "python3.12"):
        stub(programs, name, python)
    done = subprocess.run(
        ["/bin/bash", str(script), "demo"], env={"PATH": str(programs)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("sudo apt-get")]
    assert told in line
    assert not (tmp_path / ".venv").exists()
    assert not (tmp_path / "apt.log").exists()
