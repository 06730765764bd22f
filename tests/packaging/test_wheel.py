"""The wheel holds the project and works away from the checkout. Oracles: the tree's files, and a fresh virtual environment."""

import json
import re
import shutil
import subprocess
import sys
import tarfile
import textwrap
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path, PurePosixPath

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from robocar.episode.run import run
from robocar.formats import load_map
from robocar.scenario.load import load_scenario, scenario_names
from tests.packaging.environments import outside

ROOT = Path(__file__).parents[2]
LINKED = ("planners", "experiments", "benchmarks")
NO_PART = {"__pycache__", ".DS_Store"}


def files_below(folder: Path) -> set[PurePosixPath]:
    """Files of the tree, relative to the folder's parent, without caches."""
    return {
        PurePosixPath(path.relative_to(folder.parent))
        for path in folder.rglob("*")
        if path.is_file() and not NO_PART & set(path.parts)
    }


def test_the_wheel_holds_the_tree_and_nothing_else(wheel: Path) -> None:
    expected = {path for path in files_below(ROOT / "robocar") if path.parts[1] not in LINKED}
    expected |= {PurePosixPath("robocar") / path for folder in (*LINKED, "models") for path in files_below(ROOT / folder)}
    with zipfile.ZipFile(wheel) as archive:
        held = {PurePosixPath(name) for name in archive.namelist() if not name.endswith("/")}
    meta = {path for path in held if path.parts[0].endswith(".dist-info")}
    assert held - meta == expected
    assert {path.name for path in meta} >= {"METADATA", "RECORD", "entry_points.txt", "LICENSE"}
    # The parts that a user would miss first, by name: the comparison above would not notice if the tree lost them too.
    needed = ["py.typed", "planners/search/a_star.py", "experiments/barn.py", "benchmarks/bench_loop.py"]
    needed += ["models/robots/robocar/robot.xml", "models/scenarios/thesis-field.yaml", "models/maps/thesis_field.pgm"]
    assert {PurePosixPath("robocar") / name for name in needed} <= held
    assert {path.parts[0] for path in held - meta} == {"robocar"}  # the one import name


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
    assert re.search(r"^robocar\s*=\s*robocar\.__main__:main$", scripts, re.MULTILINE)


@pytest.mark.parametrize("name", ["robocar", *(f"robocar.{folder}" for folder in LINKED)])
def test_the_fresh_environment_imports_the_wheel_and_not_the_checkout(name: str, installed: Path, tmp_path: Path) -> None:
    done = outside(installed, tmp_path, "python", "-c", f"import {name}; print({name}.__file__)")
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(installed.parent)


def test_the_sdist_holds_each_folder_once_and_makes_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    """Oracle: the wheel of the checkout; links are for checkouts, so an archive of folders holds none."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]  # the wheel from the sdist
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (sdist,), (again,) = tmp_path.glob("*.tar.gz"), tmp_path.glob("*.whl")
    with tarfile.open(sdist) as archive:
        assert [member.name for member in archive.getmembers() if member.issym() or member.islnk()] == []
        held = {PurePosixPath(*PurePosixPath(member.name).parts[1:]) for member in archive.getmembers()}
    assert {path for path in held if path.parts[:1] == ("planners",)} == files_below(ROOT / "planners")
    assert not {path for path in held if path.parts[0] == "robocar" and path.parts[1] in LINKED}
    with zipfile.ZipFile(wheel) as first, zipfile.ZipFile(again) as second:
        assert sorted(first.namelist()) == sorted(second.namelist())
    # Without links `robocar` finds the folders beside itself, so the sdist's tests run where it was unpacked.
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    (unpacked,) = (path for path in tmp_path.iterdir() if path.is_dir())
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/planners/geometry", "tests/test_migration.py"]
    done = subprocess.run(words, cwd=unpacked, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    script = "import robocar.planners, robocar.benchmarks; print(robocar.planners.__file__, robocar.benchmarks.__file__)"
    done = subprocess.run([sys.executable, "-c", script], cwd=unpacked, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(unpacked / folder / "__init__.py") for folder in ("planners", "benchmarks")]


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
