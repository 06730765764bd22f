"""Mobile-robot navigation in MuJoCo physics without ROS.

The stable API: `robocar.run(scenario, navigator=..., estimator=..., seed=..., out=None)` returns a `RunResult`;
`robocar.simulate(scenario)` gives the physics alone. Both are imported when first used, so that `import robocar` stays light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robocar.episode.result import RunResult
    from robocar.episode.run import run, simulate

__version__ = "0.1.0"
__all__ = ["RunResult", "__version__", "run", "simulate"]


def __getattr__(name: str) -> Any:
    if name not in ("RunResult", "run", "simulate"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("robocar.episode.run"), name)
