"""Mobile-robot navigation in MuJoCo physics without ROS.

The stable API: `robocar.run(scenario, navigator=..., estimator=..., seed=..., out=None)` returns a `RunResult`;
`robocar.simulate(scenario)` gives the physics alone. Both are imported when first used, so that `import robocar` stays light.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robocar.kernel_cache import provide_cache

if TYPE_CHECKING:
    from robocar.episode.result import RunResult
    from robocar.episode.run import run, simulate

__version__ = "0.1.0"
__all__ = ["RunResult", "__version__", "run", "simulate"]

# `planners`, `experiments` and `benchmarks` are in here: folders in a wheel, links in a checkout. In an unpacked sdist, and where
# there are no symbolic links, they lie beside this folder.
if not (Path(__file__).parent / "planners" / "__init__.py").is_file():
    __path__.append(str(Path(__file__).parents[1]))

provide_cache()  # before the first import of Numba


def __getattr__(name: str) -> Any:
    if name not in ("RunResult", "run", "simulate"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("robocar.episode.run"), name)
