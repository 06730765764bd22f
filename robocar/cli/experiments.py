"""The command `experiment`: finds and runs the scripts in `experiments/`."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path

import tyro

from robocar.cli.output import Flag, put


def experiment(name: tyro.conf.Positional[str], /, out: Path = Path("runs"), quick: Flag = False, debug: Flag = False) -> int:
    """Run one experiment: tables, pictures and recordings of a paper.

    Args:
        name: see `robocar list experiments`.
        out: folder in which the experiment's folder is made.
        quick: a short version.
        debug: show tracebacks.
    """
    run_experiment(name, out, quick)
    put(str(out / name / "report.md"))
    return 0


def experiment_names() -> dict[str, Path]:
    """Name and file of every experiment."""
    spec = importlib.util.find_spec("robocar.experiments")
    if spec is None or not spec.submodule_search_locations:
        return {}
    folder = Path(next(iter(spec.submodule_search_locations)))
    return {f.stem: f for f in sorted(folder.glob("*.py")) if not f.stem.startswith("_")}


def run_experiment(name: str, out: Path, quick: bool) -> None:
    """Run `robocar.experiments.<name>.main(folder, quick)`; the results go to `<out>/<name>/`.

    Raises:
        UnknownNameError: there is no such experiment.
    """
    from robocar.core import UnknownNameError
    from robocar.core.suggestions import did_you_mean

    known = experiment_names()
    if name not in known:
        raise UnknownNameError(f"unknown experiment {name!r}{did_you_mean(name, known)}; known: {', '.join(known)}")
    importlib.import_module(f"robocar.experiments.{name}").main(Path(out) / name, quick)


COMMANDS: dict[str, Callable[..., int]] = {"experiment": experiment}
